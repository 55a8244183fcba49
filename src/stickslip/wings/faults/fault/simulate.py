"""Simulation of earthquake cycles, saved in parts."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ....kit import ArchiveError, Report, ScenarioError, checked, checkpoint_in, result_of, silent, within
from ..friction.fault import Fault, Nucleation, nucleation, profile
from ..friction.fault_cycles import Energy, FaultHistory, join_histories, simulate_fault
from ..friction.fault_record import YEAR, FaultEvents, Recording, moment_magnitude
from ..friction.fault_state import FaultState, initial_state
from ..friction.stress_transfer import KERNEL, Injection, Oscillation, StressTable
from . import EXPERIMENT
from .scenario import FaultScenario

PART = 50.0  # simulated years per saved part
SETTLING = 3  # initial events excluded from averages


@result_of(EXPERIMENT)
class FaultResult(NamedTuple):
    """Result of a scenario."""

    scenario: FaultScenario
    history: FaultHistory
    nucleation: Nucleation

    @property
    def settled(self) -> slice:
        """Indices of the events after the first three, or of all if there are fewer than five."""
        return slice(SETTLING if len(self.history.events.start) >= SETTLING + 2 else 0, None)

    @property
    def late_events(self) -> FaultEvents:
        """Events after the first three, or all if there are fewer than five."""
        return FaultEvents(*(column[self.settled] for column in self.history.events))

    @property
    def seismic_moment(self) -> np.ndarray:
        """Seismic moments (E,) of events with the length `line.strike_length`; NaN if it is not given [N m]."""
        return self.history.events.moment * (self.scenario.line.strike_length or np.nan)

    @property
    def magnitude(self) -> np.ndarray:
        """Moment magnitudes of the events (E,); NaN if `line.strike_length` is not given."""
        moment = self.seismic_moment
        return moment_magnitude(moment) if len(moment) and self.scenario.line.strike_length else moment

    @property
    def recurrence(self) -> float:
        """Mean time between the starts of settled events; NaN with fewer than two [s]."""
        times = self.late_events.start
        return float((times[-1] - times[0]) / (len(times) - 1)) if len(times) > 1 else np.nan

    @property
    def crept_length(self) -> float:
        """Total length of cells that slipped D_c or more beyond the plates; NaN if normal stress is constant [m]."""
        fault, state = self.history.fault, self.history.state
        return fault.cell * int((state.excess_slip >= fault.dc).sum()) if fault.changes else np.nan


@checked
def simulate_cycles(
    scenario: FaultScenario, *, folder: Path | None = None, workers: int | None = None, report: Report = silent
) -> FaultResult:
    """Run a scenario in one process.

    Parameters
    ----------
    folder : run folder, in which the history is saved every 50 simulated years; a killed run resumes from it, bit for
        bit
    report : called as report(stage, share done, text)

    Examples
    --------
    >>> import stickslip as ss
    >>> short = ss.scenario(
    ...     experiment="fault", line={"cell": 100.0}, run={"years": 1.0}
    ... )
    >>> simulate_cycles(short).history.slip.shape[1]
    12
    """
    fault, loading = scenario.fault, scenario.loading
    try:
        stress = loading.stress
        if not (stress is None or isinstance(stress, str)):
            stress = profile("stress", stress, fault.depth)
        state = initial_state(fault, velocity=loading.velocity, stress=stress)
    except ValueError as problem:
        raise ScenarioError(f"loading: {problem}") from problem
    estimate = nucleation(fault)
    report("fault", 0.0, estimate.sentence)
    nouns = FaultHistory, FaultEvents, Energy, FaultState, Fault, Injection, Oscillation, StressTable
    kept = checkpoint_in(folder, scenario, *nouns)
    if kept:
        # a reproduction runs several cell lengths and laws in the same folder
        dip = f"-{fault.slip}-{fault.dip:g}" if fault.dips else ""
        kept = kept.of(f"cells-of-{fault.cell:g}-m{dip}" + ("" if fault.law == "aging" else f"-{fault.law}"))
        kept.check()
        kept.announce()
    parts: list[FaultHistory] = []
    for number in range(1, int(np.ceil(scenario.run.years / PART)) + 1):
        name, until = f"part-{number:05d}", min(number * PART, scenario.run.years)
        if kept is None or not kept.has(name):
            part = simulate_fault(
                fault, until, start=state, recording=_recording(scenario), tolerance=scenario.run.tolerance,
                report=within(report, end=until / scenario.run.years),
            )  # fmt: skip
            if kept:
                kept.save(name, part)
        else:
            part = kept.load(name, FaultHistory)
            if part.state.kernel != KERNEL:
                raise ArchiveError(
                    f"{kept.folder} was computed with slip that is {part.state.kernel} in each cell, but faults now "
                    f"have {KERNEL} slip: resume with the version that began the run, or start again with --overwrite"
                )
        parts.append(part)
        state = part.state
    history = join_histories(parts)
    report("fault", 1.0, f"{len(history.events.start)} events in {history.state.time / YEAR:.1f} years")
    return FaultResult(scenario, history, estimate)


def _recording(scenario: FaultScenario) -> Recording:
    run = scenario.run
    return Recording(
        stations=run.stations, surface=run.surface, threshold=run.threshold, quiet_profiles=run.interval * YEAR,
        seismic_profiles=run.seismic_interval, spacing=run.spacing, quiet_sampling=run.sampling,
    )  # fmt: skip
