"""Dataset of a sweep: swept keys are dimensions, and the measures of its members are variables with units.

The format is NetCDF 3, which xarray can read with SciPy alone and which geoscience programs can also read. Some
experiments also compare members, such as the slip of sliders since an event or the Mohr circles of soils.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ... import __version__
from ...core.arguments import checked
from ...core.reading import check_regular_file
from ...core.units import units_in_use
from ...data.run_files import MEMBERS, NUMBERS, write_file
from ...data.schema import field_at
from ...experiments.registry import EXPERIMENTS, SweepMember, scenario_class
from ...figures.style import FORMATS, PLAIN, Look
from ..folder import write_comparison_files
from .axes import Axis, short_names
from .definition import Sweep, member, values_of

if TYPE_CHECKING:
    import xarray as xr

DATASET = "sweep.nc"
POINT, DRAW = "point", "draw"  # dimensions along which several axes, or the columns of a table, vary together
LONGEST = 300  # largest saved length of a failure message [characters]


def is_sweep(folder: str | Path) -> bool:
    """Return True if a folder contains the results of a sweep."""
    return (Path(folder) / DATASET).is_file()


@checked
def open_sweep(folder: str | Path, *, short: bool = False) -> "xr.Dataset":
    """Load the results of a sweep from its folder or file.

    In a grid without conditions, variables have one dimension per swept key, and `draw` for a draws table. Otherwise
    they have the dimension `point`, and `seed` if the seeds are given as a count. Values of unfinished members are NaN.
    `member` is the folder of each member, and `failure` its error message.

    Parameters
    ----------
    short : whether swept keys are abbreviated to unique endings, such as `mu` for `law.mu`

    Raises
    ------
    ValueError
        If the folder or file does not contain a sweep.

    Examples
    --------
    >>> open_sweep("results/sweep").final_friction.mean("seed")  # doctest: +SKIP
    """
    import xarray as xr  # slow to import

    path = Path(folder)
    path = path / DATASET if path.is_dir() else path
    try:
        check_regular_file(path, "give the folder of a finished sweep")
        with xr.open_dataset(path, engine="scipy") as dataset:
            found = dataset.load()
    except (OSError, TypeError, ValueError):
        raise ValueError(f"{path} does not contain a sweep: give the folder of a finished sweep") from None
    names = short_names(map(str, found.coords), map(str, found.data_vars)) if short else {}
    return found.rename(names | {dim: names[dim] for dim in found.dims if dim in names})


def write_sweep(folder: Path, chosen: Sweep, names: list[str], outputs: list[dict | None], failures: list[str]) -> None:
    """Write the dataset atomically.

    Parameters
    ----------
    names : folder of each member, in order
    outputs : output of each member, `measures` {name: [value, unit]} and `seconds`; None if it is not finished
    failures : error message of each member, or an empty string
    """
    import xarray as xr

    kind, dims, coordinates = scenario_class(chosen.base), [], {}
    for group in chosen.groups:
        alone = chosen.mode == "grid" or group[0].kind == "count"
        dims.append(DRAW if chosen.mode == "grid" and group[0].kind == "column" else group[0].key if alone else POINT)
        for axis in group:
            meaning, unit = field_at(kind, axis.key)
            attributes = {name: text for name, text in (("units", unit), ("long_name", meaning)) if text}
            coordinates[axis.key] = (dims[-1], _labels(axis), attributes)

    def shaped(values, **attributes):
        return dims, np.reshape(values, chosen.shape), attributes

    units = {name: unit for output in outputs if output for name, (_, unit) in output["measures"].items()}
    measured = [output["measures"] if output else {} for output in outputs]
    variables = {
        name: shaped([one[name][0] if name in one else np.nan for one in measured], units=unit)
        for name, unit in units.items()
    }
    spent = [output["seconds"] if output else np.nan for output in outputs]
    variables["seconds"] = shaped(spent, units="s", long_name="run time of the member")
    variables["finished"] = shaped(np.array([output is not None for output in outputs], np.int8))
    variables["member"] = shaped(np.array(names), long_name="folder in members/")
    if any(failures):
        variables["failure"] = shaped(np.array([failure[:LONGEST] for failure in failures]))
    about = {
        "title": f"sweep of {kind.model_fields['experiment'].default}",
        "source": f"stickslip {__version__}",
        "sweep": chosen.text,
    } | ({"refusals": chosen.refusals} if chosen.refusals else {})
    dataset = xr.Dataset(variables, coordinates, about)
    write_file(folder, DATASET, bytes(dataset.to_netcdf(engine="scipy")))


def _labels(axis: Axis) -> np.ndarray:
    """Return the values of an axis as numbers if possible, otherwise as strings."""
    if all(isinstance(v, int) and not isinstance(v, bool) and abs(v) < 2**31 for v in axis.values):
        return np.array(axis.values, np.int32)
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in axis.values):
        return np.array(axis.values, float)
    return np.array([str(v) for v in axis.values])


def comparison_files() -> tuple[str, ...]:
    """Names of the files that compare the members of sweeps, for all experiments and in all formats."""
    names = []
    for experiment in EXPERIMENTS:
        try:
            names += EXPERIMENTS[experiment].compares
        except Exception:  # third-party code, needed by its own sweeps only
            continue
    return tuple(dict.fromkeys(f"{name.removesuffix('.png')}.{kind}" if name.endswith(".png") else name
                               for name in names for kind in FORMATS))  # fmt: skip


def write_comparison(
    folder: Path, chosen: Sweep, names: list[str], outputs: list[dict | None], look: Look = PLAIN
) -> tuple[str, ...]:  # fmt: skip
    """Write the files that compare the members into the folder of a sweep, and return sentences about them."""
    experiment = EXPERIMENTS[scenario_class(chosen.base).model_fields["experiment"].default]
    if experiment.compare is None or not any(outputs):
        return ()
    members = [
        SweepMember(
            values_of(chosen, k),
            {name: tuple(pair) for name, pair in output["measures"].items()} if output else {},
            folder / MEMBERS / names[k] / NUMBERS,
        )
        for k, output in enumerate(outputs)
    ]
    with units_in_use(member(chosen, 0).scenario.named_units):
        return write_comparison_files(folder, experiment.compare(members), look)
