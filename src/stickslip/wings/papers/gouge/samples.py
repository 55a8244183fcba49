"""Samples of gouge as files: the series of one realization, compact enough to be kept and exchanged.

A file contains its scenario, and can be evaluated together with files of the same scenario and other seeds. It contains
no states; that at the end of the trunk, from which further tests can start, is written to a file of its own. All
columns except times and displacements of the load point are rounded to single precision.
"""

from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, NamedTuple

import numpy as np

from .... import __version__
from ....data import archive
from ....data.schema import given_keys
from ....kit import SI, ArchiveError, shortened
from .dimensionless import Range
from .protocol import Realization, Series, Test
from .scenario import GougeScenario

PHYSICS = 1  # increase it whenever a change of the preparation, law, integrator or protocol changes the statistics
EXACT = ("time", "load_point")  # columns whose small differences matter
STATES = "states"  # folder of the states, next to the samples
_FREE = {"seed", "realizations"}  # keys that differ between samples of one result


class Sample(NamedTuple):
    """A stored sample."""

    path: Path
    scenario: GougeScenario  # of this sample alone
    realization: Realization
    version: str  # of the package that computed it


def sample_path(folder: Path, scenario: GougeScenario) -> Path:
    """Return the path of a sample, named after its damping and seed."""
    law = scenario.law
    kind = f"damping-{law.damping_n:g}" if law.restitution is None else f"{law.reading}-{law.restitution:g}"
    return folder / f"{kind}-seed-{scenario.seed:04d}.h5"


def check_folder(folder: Path) -> None:
    """Create the folder of samples if it does not exist; raise ValueError if it cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=folder):
            pass
    except OSError as problem:
        raise ValueError(f"the folder {folder} cannot be written ({problem.strerror}): choose another one") from None


def write_sample(folder: Path, scenario: GougeScenario, realization: Realization) -> None:
    """Write a sample, and the state at the end of its trunk; `scenario` is that of this sample alone."""
    path = sample_path(folder, scenario)
    (folder / STATES).mkdir(parents=True, exist_ok=True)
    about: dict[str, Any] = {"scenario": scenario.text, "version": __version__, "units": SI}
    archive.write(folder / STATES / path.name, {"physics": PHYSICS, "end": realization.states["end"]}, **about)
    tests = tuple(test._replace(series=_round(test.series)) for test in realization.tests)
    archive.write(path, {"physics": PHYSICS, "sample": realization._replace(tests=tests, states={})}, **about)


def _round(series: Series) -> Series:
    """Round columns to single precision, except for those in `EXACT`."""
    return Series(*(c if n in EXACT else c.astype(np.float32) for n, c in series._asdict().items()))


def read_samples(folder: Path, scenarios: dict[str, GougeScenario]) -> dict[str, dict[int, Sample]]:
    """Read all samples of a folder, sorted by scenario and seed.

    Parameters
    ----------
    scenarios : by name; seeds and numbers of realizations do not matter

    Raises
    ------
    ArchiveError
        If a file is not a sample, if it belongs to none of the scenarios or to another version of the physics, or if
        two files have the same scenario and seed.
    """
    found: dict[str, dict[int, Sample]] = {name: {} for name in scenarios}
    for path in sorted(folder.glob("*.h5")):
        sample = read_sample(path, *scenarios.values())
        mine = next(found[name] for name, one in scenarios.items() if not _differences(sample.scenario, one))
        if other := mine.get(sample.scenario.seed):
            raise ArchiveError(f"{other.path} and {path} are the same sample: remove one of them")
        mine[sample.scenario.seed] = sample
    return {name: dict(sorted(mine.items())) for name, mine in found.items()}


REMEDY = (
    "give a folder that has only samples, which `stickslip reproduce gouge --paper-size` writes in its folder samples"
)


def read_sample(path: Path, *scenarios: GougeScenario) -> Sample:
    """Read a sample of one of several scenarios.

    Raises
    ------
    ArchiveError
        If the file is not a sample, or belongs to another scenario or version of the physics.
    """
    content = archive.read(path, nouns=(Realization, Range, Test, Series), remedy=REMEDY)
    about = archive.attributes(path)
    sample, physics = content.get("sample"), content.get("physics")
    if not isinstance(sample, Realization):
        raise ArchiveError(f"{path} is not a sample of gouge: move it to another folder")
    if physics != PHYSICS:
        raise ArchiveError(
            f"{path} was computed with version {physics} of the physics of gouge, and this is version {PHYSICS}: "
            f"compute it again in another folder"
        )
    try:
        scenario = GougeScenario.model_validate_json(about["scenario"])
    except ValueError:
        raise ArchiveError(
            f"{path} has a scenario that this version does not know: use the version that wrote it"
        ) from None
    fewest = min((_differences(scenario, one) for one in scenarios), key=len)
    if fewest:
        raise ArchiveError(
            f"{path} is a sample of another scenario ({'; '.join(fewest[:3])}): move it to another folder"
        )
    tests = tuple(t._replace(series=Series(*(np.asarray(c, float) for c in t.series))) for t in sample.tests)
    return Sample(path, scenario, sample._replace(tests=tests), about["stickslip"])


def _differences(one: GougeScenario, other: GougeScenario) -> list[str]:
    """Name each key in which two scenarios differ, with both values; seeds and numbers of realizations may differ."""
    a, b = ({key: value for key, value, *_ in given_keys(scenario) if key not in _FREE} for scenario in (one, other))
    return [
        f"{key} = {shortened(str(a.get(key, 'default')))} instead of {shortened(str(b.get(key, 'default')))}"
        for key in sorted(a.keys() | b.keys())
        if a.get(key) != b.get(key)
    ]
