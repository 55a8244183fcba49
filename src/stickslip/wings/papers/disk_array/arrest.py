"""What separates arrest from sliding: the equilibria where the array comes to rest, and its kinetic threshold."""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import spectrum
from ....kit import Report, Workers, checkpoint_in, load_or_compute, silent
from ....measure import touching
from ....packings import perturbed
from ....protocols import free_run, kinetic_threshold
from ....results import KineticThreshold
from .simulate import DiskArrayResult, make_protocol, point_at_load

LATE_STATES = 8  # of a run, relaxed
ARREST_LOADS = (0.030, 0.040)  # at which the paper's array comes to rest after growth
KICK = 1e-4  # standard deviation of the initial velocities: far above what a pair grows from [length/time]
KICKED_LOADS = (0.030, 0.040, 0.0425, 0.045, 0.0475, 0.050, 0.055, 0.083)
FEWER_LOADS = (0.040, 0.045, 0.050, 0.083)  # of a quick run
REALIZATIONS = {False: 20, True: 8}  # at each load, in a full and in a quick run


class Arrest(NamedTuple):
    """Late states of a free run, relaxed at the same load."""

    load: float
    late: np.ndarray  # (K,) M of the late states [length²]
    static: np.ndarray  # (K,) M of the equilibria to which they relax [length²]
    pairs: np.ndarray  # (K,) complex pairs of these equilibria
    neighbours: np.ndarray  # (K,) disk–disk contacts of these equilibria
    charge: np.ndarray  # (K,) mean |t_iw| of the late states over that of the equilibrium from which the run starts
    before: int  # disk–disk contacts of that equilibrium


def find_arrest(result: DiskArrayResult, load: float) -> Arrest:
    """Relax the end of the free run at a load, and further late states of the same run, each an eighth of it apart."""
    scenario, law, how = result.scenario, result.law, result.scenario.dynamics
    point, protocol = point_at_load(result.path, load), make_protocol(result.scenario, result.law)
    end, rows = perturbed(point.state, scenario.seed, how.seed_velocity), []
    for k in range(LATE_STATES):
        duration = how.duration if k == 0 else how.duration / LATE_STATES
        end, _, _ = free_run(
            end, law, duration=duration, dt=how.dt, sample=duration, drag=how.drag, spin_drag=how.spin_drag
        )
        rest, _ = protocol.settle(end, load)
        rows.append((
            _msd(end, point.state), _msd(rest, point.state), len(spectrum(rest, law).pairs), _neighbours(rest),
            _wall_slip(end) / _wall_slip(point.state),
        ))  # fmt: skip
    return Arrest(load, *(np.array(column) for column in zip(*rows, strict=True)), _neighbours(point.state))


def _msd(state, start) -> float:
    """M, the sum of the squared displacements of all disks [length²]."""
    return float(((state.grains.position - start.grains.position) ** 2).sum())


def _wall_slip(state) -> float:
    """Mean |t_iw| of the contacts with the substrate [length]."""
    here = touching(state)
    here = here[state.contacts.j[here] >= len(state.grains.radius)]
    return float(np.linalg.norm(state.contacts.slip[here], axis=-1).mean())


def _neighbours(state) -> int:
    """Number of disk–disk contacts."""
    return int((state.contacts.j[touching(state)] < len(state.grains.radius)).sum())


def kick_array(
    result: DiskArrayResult, *, quick: bool = False, folder: Path | None = None, workers: Workers = None,
    report: Report = silent,
) -> KineticThreshold:  # fmt: skip
    """Kinetic threshold of the array on its load path."""
    scenario, kept = result.scenario, checkpoint_in(folder, result.scenario)
    return kinetic_threshold(
        result.path, make_protocol(scenario, result.law), loads=FEWER_LOADS if quick else KICKED_LOADS, kicks=KICK,
        realizations=REALIZATIONS[quick], duration=scenario.sliding.duration,
        dt=2 * scenario.dynamics.dt, seed=scenario.seed, workers=workers, kept=kept and kept.of("threshold"),
        report=report,
    )  # fmt: skip


def find_arrests(result: DiskArrayResult, folder: Path | None = None) -> list[Arrest]:
    """Relaxed late states at the loads at which the paper's array comes to rest; saved in the run folder."""
    kept = checkpoint_in(folder, result.scenario, Arrest)
    return [load_or_compute(kept, f"arrest-{x!r}", partial(find_arrest, result, x)) for x in ARREST_LOADS]
