"""Load paths through collapses, compared with slow dynamics of the whole path under the same drag.

    python -m benchmarks collapses             # all samples (about half an hour on one core)
    python -m benchmarks collapses disks-load

Criteria for the first collapse of each sample were fixed beforehand: dynamics collapses within 1 % of the load at which
the path does, and the displacements of the grains and of the loaded wall or cell, from shortly before to shortly after
the collapse, differ by at most a tenth. In dynamics, the load continues to grow during the collapse. Cases in which
dynamics is late by no more than the duration of the collapse are therefore counted as well. A collapse amplifies
earlier differences, so later collapses are not compared.
"""

import time
from typing import NamedTuple

import numpy as np

import stickslip as ss
from stickslip.core.control import spring_forces
from stickslip.core.state import Control, State
from stickslip.loading.compression import TOP, biaxial_box, with_load, with_machine, with_travel
from stickslip.loading.settling import SlowRun, slow_dynamics
from stickslip.wings.status.collapse import Collapse, displacements, without_drift
from stickslip.wings.status.path import LoadPath, load_path
from tests.wings.status.five_packings import spheres

DRAG, WHOLE = 0.02, 1e6  # drag in both calculations, and duration of the leg in slow dynamics
INCREMENT = 0.005
WINDOW = 0.02  # part of the leg, around the collapse of a path, in which dynamics is compared with the path
LOAD, FIELD = 0.01, 0.1  # tolerances stated above


class Case(NamedTuple):
    """A sample with its load."""

    name: str
    state: State
    law: ss.Law
    end: Control


def disks_under_load(seed: int) -> Case:
    """Box of 60 disks, with the force on the lid raised to three times its initial value."""
    state, law = biaxial_box(60, seed=seed)
    return Case(f"disks-load {seed}", state, law, with_load(state.control, 60 + TOP, 3.0))


def disks_in_machine(seed: int) -> Case:
    """Box of 60 disks, with the lid moved down by 0.02 by a machine of stiffness 100 kn."""
    state, law = biaxial_box(60, seed=seed)
    state = with_machine(state, 60 + TOP, 100.0)
    return Case(f"disks-displacement {seed}", state, law, with_travel(state.control, 60 + TOP, [0, -0.02]))


def spheres_under_stress(seed: int) -> Case:
    """Cell of 14 spheres squeezed along y."""
    state, law, _ = spheres("sheared", seed)
    stress = {"xx": 0.7e-3, "yy": 1.6e-3, "zz": 0.7e-3, "xy": 0.0}
    return Case(f"spheres-load {seed}", state, law, ss.control.stress_controlled(state.control, stress))


def spheres_in_machine(seed: int) -> Case:
    """Box of 14 spheres, with one wall moved by 0.1 by a machine of stiffness 100 kn."""
    state, law, _ = spheres("box", seed)
    wall = int(np.flatnonzero(state.control.force.any(axis=1))[-1])
    state, way = with_machine(state, wall, 100.0), np.sign(state.control.force[wall])
    return Case(f"spheres-displacement {seed}", state, law, with_travel(state.control, wall, 0.1 * way))


KINDS = {
    "disks-load": (disks_under_load, range(1, 13)),
    "disks-displacement": (disks_in_machine, (2, 4, 5, 6, 7, 8)),
    "spheres-load": (spheres_under_stress, range(8)),
    "spheres-displacement": (spheres_in_machine, (1, 2, 5, 6, 7)),
}


def state_at(load: float, loads: np.ndarray, states: list[State]) -> State:
    """State of a series at the load nearest to a given load."""
    return states[int(np.abs(loads - load).argmin())]


def compare(case: Case) -> "tuple[str, Difference | None]":
    """Line on the first collapse of a path and of slow dynamics, and the differences in load and displacements."""
    begin = time.perf_counter()
    path = load_path(case.state, case.law, case.end, increment=INCREMENT, drag=DRAG)
    seconds, real = time.perf_counter() - begin, [c for c in path.collapses if not c.quiet]
    head = f"{case.name:24s} {path.verdict.name:10s} {path.points[-1].load:.4f} {len(real)} collapses ({seconds:.0f} s)"
    if not real:
        return head, None
    run = slow_dynamics(case.state, case.law, case.end, time=WHOLE, until=min(1.0, real[0].load + 0.04), drag=DRAG)
    first = real[0]
    off, field, wall = first_collapse(case, path, run, first)
    late = first.duration / WHOLE + 2 * run.load[0]
    line = (
        f"{head}, first at {first.load:.4f} (largest {first.largest:.1e}, overlap {first.overlap:.2f}): dynamics "
        f"{off:+.4f} of the leg, {off / first.load:+.2%} (its duration: {late:.4f}), field {field:.1%}, wall or cell "
        f"{wall:.1%}"
    )
    return line, Difference(off / first.load, off - late, field, wall)


class Difference(NamedTuple):
    """Differences between dynamics and path in the first collapse."""

    load: float  # difference relative to the load of the path
    late: float  # delay beyond the duration of the collapse, as a fraction of the leg
    field: float  # relative difference of displacements
    wall: float  # relative difference for the wall, cell or force


def first_collapse(case: Case, path: LoadPath, run: SlowRun, event: Collapse) -> tuple[float, float, float]:
    """Difference of collapse loads [fraction of the leg], and relative differences of displacements and of strength."""
    loads, states = np.append(0.0, run.load), [case.state, *run.states]
    near = np.flatnonzero(np.abs(loads - event.load) < WINDOW + event.duration / WHOLE)
    steps = [np.linalg.norm(displacements(states[k - 1], states[k])[:, :3]) for k in near if k]
    load = loads[near[near > 0][int(np.argmax(steps))]]
    ends = event.load - 0.5 * WINDOW, event.load + WINDOW + event.duration / WHOLE
    series = (path.load, path.states), (loads, states)
    start = state_at(ends[0], *series[0])  # rattlers of this state are excluded in both series
    mine, theirs = (
        without_drift(start, displacements(*(state_at(end, *one) for end in ends)))[:, :3] for one in series
    )
    grains = len(start.grains.radius)
    field = np.linalg.norm((mine - theirs)[:grains]) / np.linalg.norm(mine[:grains])
    bulk = [strength(case, one, ends) for one in series]
    return float(load - event.load), float(field), float(abs(bulk[1] / bulk[0] - 1))


def strength(case: Case, series, ends) -> float:
    """Change of the response to the load: force of the machine, displacement of the wall, or yy strain of the cell."""
    first, last = (state_at(end, *series) for end in ends)
    if case.state.control.spring.any():
        pull = [
            spring_forces(s.control, np.concatenate([s.grains.position, s.walls.point]), s.time) for s in (first, last)
        ]
        return float(np.abs(pull[1]).sum() / np.abs(pull[0]).sum())
    if len(case.state.walls.mass):
        return float(last.walls.point[TOP, 1] - first.walls.point[TOP, 1])
    return float(last.cell.vectors[1, 1] / first.cell.vectors[1, 1] - 1)


def rows(*kinds: str, smallest: bool = False):
    """Compare the samples of some kinds (default: all); a single sample for the smallest size."""
    for name, (make, seeds) in KINDS.items():
        if name in (["spheres-displacement"] if smallest else kinds or KINDS):
            results = []
            for seed in seeds[:1] if smallest else seeds:
                words, out = compare(make(seed))
                results += [] if out is None else [out]
                yield words
            tests = {
                f"load within {LOAD:.0%}": [abs(r.load) <= LOAD for r in results],
                "or late by its duration": [abs(r.load) <= LOAD or -LOAD < r.late <= 0 for r in results],
                f"field within {FIELD:.0%}": [r.field <= FIELD for r in results],
                f"wall or cell within {FIELD:.0%}": [r.wall <= FIELD for r in results],
            }
            counts = ", ".join(f"{words} {sum(passed)}" for words, passed in tests.items())
            yield f"{name}: of {len(results)} that collapse: {counts}"
