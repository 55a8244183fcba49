"""Simulation of the failure of a packing: read it, and shear it until it fails."""

import hashlib
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import Law, State
from ....io import read_packing
from ....kit import (
    Obstacle,
    Report,
    ScenarioError,
    Workers,
    capture_warnings,
    checked,
    checkpoint_in,
    complete_path,
    let_settle,
    load_or_compute,
    result_of,
    silent,
)
from ....protocols import shear_to_failure
from ....results import Event, EventKind, Failure, PathStep
from . import EXPERIMENT
from .scenario import FailureScenario


class Packed(NamedTuple):
    """A packing with its law, as read."""

    state: State
    law: Law
    notes: tuple[str, ...]


@result_of(EXPERIMENT, head=lambda result: result.found.end)
class FailureResult(NamedTuple):
    """Result of a failure scenario."""

    scenario: FailureScenario
    notes: tuple[str, ...]  # notes on the input
    found: Failure

    @property
    def law(self) -> Law:
        """Law of the packing."""
        return self.found.law


def read_input(scenario: FailureScenario) -> Packed:
    """Read the packing of a scenario, and let it come to rest if requested; reject a packing that cannot be sheared.

    Raises
    ------
    ValueError
        If the packing cannot be read or sheared, or does not have the digest in the scenario.
    """
    given, law, shear = scenario.packing, scenario.law, scenario.shear
    options = given.model_dump(exclude={"file", "settle", "digest"})
    options["contacts"] = given.contacts and Path(given.contacts)
    options |= law.model_dump(exclude={"kind", "more", "file", "parameters", "checksum"})
    options["law"] = law.file or law.kind
    options["parameters"] = (law.parameters if law.file else law.more) or None
    (state, its_law, notes), said = capture_warnings(read_packing, Path(given.file), **options)
    notes = [*notes, *said]
    if acts := [note.reason for note in notes if isinstance(note, Obstacle)]:
        raise ScenarioError(f"{given.file} cannot be sheared: {'; '.join(acts)}")
    if given.settle:
        state, calm = let_settle(state, its_law)
        notes.append(f"settled: {calm.how}; {calm}")
    complete_path(state, its_law, **shear.model_dump())
    packed = Packed(state, its_law, tuple(map(str, notes)))
    if given.digest not in (None, digest_of(packed)):
        raise ScenarioError(
            f"{given.file} or its law has changed since the run began: restore it, or start again with --overwrite"
        )
    return packed


def digest_of(packed: Packed) -> str:
    """Digest of grains, cell, contacts, bonds and law of a packing."""
    out = hashlib.sha256(repr(packed.law).encode())
    state, count = packed.state, int(packed.state.contacts.count[0])
    parts = [state.grains.position, state.grains.radius, state.grains.mass, state.cell.vectors]
    parts += [state.contacts.key[:count], state.contacts.slip[:count], packed.law.table, *(state.bonds or ())]
    for part in parts:
        out.update(np.ascontiguousarray(part).tobytes())
    return out.hexdigest()[:16]


def keep_packing(folder: Path, scenario: FailureScenario, packed: Packed) -> None:
    """Save the packing of a new run, which then no longer needs the input file."""
    load_or_compute(_kept(folder, scenario), "packing", lambda: packed, Packed)


def _kept(folder: Path | None, scenario: FailureScenario):
    return checkpoint_in(folder, scenario, Packed, PathStep, Event, EventKind)


@checked
def simulate_failure(
    scenario: FailureScenario, *, folder: Path | None = None, workers: Workers = None, report: Report = silent
) -> FailureResult:
    """Shear or compress the packing of a scenario until it fails; see `ss.protocols.shear_to_failure`.

    Parameters
    ----------
    folder : run folder, in which the packing and each strain step are saved as soon as they are finished; a killed run
        resumes bitwise identically
    workers : unused, as each step starts from the previous one
    report : called as report(stage, share done, text)
    """
    kept = _kept(folder, scenario)
    packed = load_or_compute(kept, "packing", partial(read_input, scenario), Packed)
    found = shear_to_failure(packed.state, packed.law, **scenario.shear.model_dump(), kept=kept, report=report)
    return FailureResult(scenario, packed.notes, found)
