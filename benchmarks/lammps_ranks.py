"""Strong scaling of LAMMPS over MPI ranks: 10,000 spheres on one and more cores, alternating, best of several rounds.

`python -m benchmarks lammps_ranks` measures on the available cores. `python -m benchmarks lammps_ranks log.lammps …`
prints the same numbers from logs of other runs, such as those in a folder written by `stickslip run --export`.
"""

import re
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

ROUNDS, STEPS, PART = 3, 400, 1250
LOOP = re.compile(r"Loop time of (\S+) on (\d+) procs for (\d+) steps with (\d+) atoms")


class Speed(NamedTuple):
    """Speed of one run."""

    ranks: int
    grains: int
    rate: float  # grain-steps per second


def speed(log: str) -> Speed:
    """Speed of the longest run in a LAMMPS log; raise ValueError if there is none."""
    found = [(float(s), int(p), int(steps), int(n)) for s, p, steps, n in LOOP.findall(log)]
    if not found:
        raise ValueError("the log contains no line with a loop time")
    seconds, ranks, steps, grains = max(found, key=lambda one: one[2])
    return Speed(ranks, grains, grains * steps / seconds)


def dense():
    """Eight copies of a dense packing with random velocities and spins, and its law."""
    import stickslip as ss
    from stickslip.loading.packing import jammed

    part, _ = jammed(PART, packing_fraction=0.66, seed=0)
    size = part.cell.vectors[0, 0]
    offsets = size * np.array([[a, b, c] for a in range(2) for b in range(2) for c in range(2)])
    position = (part.grains.position[None] + offsets[:, None]).reshape(-1, 3)
    velocity, spin = np.random.default_rng(3).normal(0, 0.02, (2, len(position), 3))
    grains = ss.spheres(position, np.tile(part.grains.radius, 8), velocity=velocity, spin=spin)
    state = ss.assembly(grains, cell=ss.box([2 * size] * 3, [True] * 3))
    return state, ss.laws.hertz_mindlin_reff(1.0, 0.4, 0.3, damping_n=0.3, damping_t=0.2)


def rows(*logs: str, smallest: bool = False):
    """One row per number of ranks above one, compared with the speed of one rank; or the speeds in logs."""
    import os

    from stickslip.core.dynamics.run import Leg
    from stickslip.extras import MissingExtraError
    from stickslip.wings.lammps.run import LOG, require_lammps, run_leg

    if logs:
        yield from speeds(logs)
        return
    try:
        require_lammps(2)
    except MissingExtraError as problem:
        yield f"LAMMPS skipped: {problem}"
        return
    state, law = dense()
    counts = [n for n in (1, 2, 4, 8, 16, 32) if n <= (os.cpu_count() or 1)]
    best = dict.fromkeys(counts, 0.0)
    for _ in range(1 if smallest else ROUNDS):
        for ranks in counts:
            with tempfile.TemporaryDirectory() as name:
                list(run_leg(Leg(state, law, 0.05, STEPS, 1, ranks=ranks), Path(name)))
                best[ranks] = max(best[ranks], speed((Path(name) / LOG).read_text()).rate)
    yield from [
        {"case": "LAMMPS, dense spheres, dashpots, by MPI ranks", "n": 8 * PART, "threads": ranks, "ours": best[ranks],
         "unit": "grain-steps/s", "peer": best[1], "peer_name": "one rank", "ratio": best[ranks] / best[1]}
        for ranks in counts[1:]
    ]  # fmt: skip


def speeds(logs):
    """Lines with the speeds in logs, and their ratios to the speed with the fewest ranks."""
    found = sorted(speed(Path(path).read_text(errors="replace")) for path in logs)
    for one in found:
        ratio = one.rate / found[0].rate
        yield (
            f"{one.ranks:6d} ranks, {one.grains} grains: {one.rate / 1e6:.3g} M grain-steps/s, {ratio:.2f} x "
            f"{found[0].ranks} ranks"
        )
