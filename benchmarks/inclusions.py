"""Inflated grains compared with elasticity without fitted parameters, and models that fits of displacements prefer.

python -m benchmarks inclusions [DISKS]

Grains are inflated in a lattice, in packings without friction (single grains), and in sheared packings with friction
(every tenth grain; 13 of these in steps of 2 % and of 10 %). A smaller number of disks, such as 300, shortens the run.
"""

import warnings

import numpy as np

import stickslip as ss

SMOOTH, ROUGH = ss.laws.hertz_mindlin(mu=0.0), ss.laws.hertz_mindlin(mu=0.3)
SHEARED = {0.95: 1e-4, 0.86: 2e-5, 0.845: 2e-5}  # steps of shear strain by packing fraction
CENTERS = 30  # number of single grains of each frictionless packing
OVERLAP = 1e-8


def lattice(law, across: int):
    """Disks of diameter 1 on a triangular lattice."""
    site = np.array([[0, 0], [1, 0], [0.5, 0.75**0.5], [1.5, 0.75**0.5]])
    steps = np.array([[2 * i, 3**0.5 * j] for i in range(across // 2) for j in range(across // 2)])
    place = (steps[:, None] + site).reshape(-1, 2)
    cell = [across, across / 2 * 3**0.5]
    return ss.packings.from_arrays(place, np.full(len(place), 0.5 + OVERLAP / 2), law, cell=cell, dim=2)


def sheared(disks: int, fraction: float):
    """Disks sheared slightly, so that friction is mobilised."""
    state, _ = ss.packings.jammed(disks, packing_fraction=fraction, dim=2, seed=3)
    for _ in range(3):
        state, outcome = ss.equilibrate(ss.packings.sheared(state, SHEARED[fraction]), ROUGH)
        assert outcome.ok
    return state


def describe(field) -> str:
    """Text with the ratio of the amplitude to that from the moduli, κ_e², and the preferred model."""
    fits = field.fit()
    elastic, dipole = fits.models[:2]
    lame = np.mean(field.lame)
    return (
        f"A {elastic.near.real / lame:.3f} ± {elastic.errors[0] / abs(lame):.3f} | {dipole.screening.real:.1e} ± "
        f"{dipole.errors[-1]:.1e} | {fits.preferred}"
    )


def rows(disks: str = "1000", *, smallest: bool = False):
    """Yield all rows of lattices and packings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield from _rows(100 if smallest else int(disks), smallest)


def _rows(disks: int, smallest: bool):
    law = ss.laws.linear(1.0, 0.5, 0.5)
    field = ss.modes.inflate(lattice(law, 20 if smallest else 40), law, growth=1e-9)
    rings = field.fit().rings
    expected = field.elastic(rings.radius)
    yield (f"triangular lattice: rings off by {np.abs(rings.mean[0] - expected).max() / expected.max():.1e} at most")
    if smallest:
        return
    for fraction in (0.95, 0.86):
        state, _ = ss.packings.jammed(disks, packing_fraction=fraction, dim=2, seed=1)
        centers = np.flatnonzero(~ss.measure.rattlers(state, 3))[:: disks // CENTERS][:CENTERS]
        inside, preferred = 0, []
        for center in centers:
            field = ss.modes.inflate(state, SMOOTH, int(center), growth=1e-9)
            fits = field.fit()
            inside += abs(fits.models[0].near.real - field.lame[0]) < fits.models[0].errors[0]
            preferred.append(fits.preferred)
        yield (
            f"frictionless, {fraction}: A of the moduli in {inside} of {len(centers)} intervals, elastic preferred in "
            f"{preferred.count('elastic')}"
        )
    for fraction in SHEARED:
        state = sheared(disks, fraction)
        centers = np.flatnonzero(~ss.measure.rattlers(state, 2))[::10]
        field = ss.modes.inflate(state, ROUGH, centers, growth=1e-8)
        yield (f"μ = 0.3, {fraction}, linear, {len(centers)}: {describe(field)}")
        for growth in (0.02, 0.1):
            field = ss.protocols.inflate(state, ROUGH, centers[::8], growth=growth, steps=5, tolerance=1e-12)
            opened, _, slid, _ = field.changes.sum(axis=1).mean(axis=0)
            yield (
                f"μ = 0.3, {fraction}, steps to {growth}, {len(field.centers)}: {describe(field)}; around each "
                f"{opened:.0f} contacts opened, {slid:.0f} began to slide"
            )
