"""Rigid clusters by linear algebra and by the pebble game: large lattices with holes, and a load path with pairs.

python -m benchmarks rigid_clusters
"""

import time

import numpy as np

import stickslip as ss

from .records import number

METHODS = ("null-space", "pebbles")
SIDE, SLIDING = 100, 0.3


def lattice(holes: float, law, across: int = SIDE):
    """Triangular lattice of disks with holes, in which a fraction SLIDING of the contacts slides."""
    rng = np.random.default_rng(0)
    sites = np.array([(x + 0.5 * y, y * 0.75**0.5) for y in range(across) for x in range(across)])
    places = 0.99 * sites[rng.random(len(sites)) > holes]
    state = ss.packings.from_arrays(places, np.full(len(places), 0.5), law, dim=2)
    mode = state.contacts.mode * (1 + (rng.random(len(state.contacts.mode)) < SLIDING))
    return state._replace(contacts=state.contacts._replace(mode=mode.astype(np.int8)))


def report(name: str, state, law, times: list, more: str = ""):
    """Lines with the results of both methods for a state; their durations [s] are appended to `times`."""
    for method in METHODS:
        start = time.process_time()
        clusters = ss.quasirigid.rigid_clusters(state, law, method=method)
        times.append(time.process_time() - start)
        hinges = np.count_nonzero(clusters.contact < 0)
        yield (
            f"{name:>18} {method:>10}: largest {clusters.sizes[:1]}, floppy {clusters.floppy}, "
            f"redundant {clusters.redundant}, hinges {hinges}{more}"
        )


def rows(*, smallest: bool = False):
    """Numbers for docs/quasi_rigid.md."""
    law = ss.laws.linear(kn=1.0, kt=0.5, mu=0.4)
    across, times = 10 if smallest else SIDE, []
    for holes in (0.1, 0.2, 0.3):
        yield from report(f"{across}², {holes:.0%} holes", lattice(holes, law, across), law, times)
    yield number("slowest decomposition of a lattice", max(times), "s")
    if smallest:
        return
    state, law = ss.packings.biaxial_box(150, seed=3)
    end = ss.quasirigid.with_load(state.control, 150 + ss.packings.TOP, 3.0)
    path = ss.quasirigid.load_path(state, law, end, increment=0.02)
    yield str(path.summary)
    for point in [*path.points[:: max(1, len(path.points) // 10)], path.points[-1]]:
        values = ss.spectrum(point.state, law, modes=False).eigenvalues
        pairs = np.count_nonzero(values.imag > 1e-9 * np.abs(values).max())
        yield from report(f"load {point.load:.3f}", point.state, law, times, f", complex pairs {pairs}")
