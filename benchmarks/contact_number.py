"""Contact number and packing fraction of frictional packings against μ; takes a few minutes.

    python -m benchmarks contact_number [SEEDS [DIM]]

Bidisperse disks (1 to 1.4) and equal spheres are compressed with friction by `packings.compressed`, to pressures at
which grains overlap by at most 1e-3 of their diameter. Rattlers are not counted. The table is for docs/packings.md.
"""

import numpy as np

import stickslip as ss

FRICTION = (0.0, 0.01, 0.1, 0.3, 1.0, 10.0)
SAMPLES = {2: {"n": 200, "radius": (0.5, 0.7)}, 3: {"n": 100, "radius": 0.5}}
PRESSURE = 1e-5


def sample(dim: int, mu: float, seed: int, pressure: float = PRESSURE, **options):
    """Properties of one packing."""
    options = SAMPLES[dim] | options
    return ss.packings.compressed(options.pop("n"), mu=mu, pressure=pressure, dim=dim, seed=seed, **options)[1]


def excess(info, dim: int, mu: float) -> float:
    """Contact number minus the isostatic value d + 1 + 2 n_m/d for n_m sliding contacts per grain (2 d if μ = 0)."""
    held = 2 * info.contacts / info.coordination
    return info.coordination - (dim + 1 + 2 * info.sliding / held / dim if mu else 2 * dim)


def rows(seeds: str = "3", *dims: str, smallest: bool = False):
    """Yield the lines of the table."""
    seeds, small = 2 if smallest else int(seeds), {"n": 20} if smallest else {}
    for dim in [2] if smallest else list(map(int, dims)) or SAMPLES:
        about = SAMPLES[dim] | small
        yield f"{dim}D, {about['n']} grains of radius {about['radius']}, p = {PRESSURE:g}, {seeds} packings each"
        yield "| μ | contact number | above isostaticity | packing fraction | sliding contacts | rattlers |"
        yield "|---|---|---|---|---|---|"
        for mu in FRICTION[1:2] if smallest else FRICTION:
            found = [sample(dim, mu, seed, **small) for seed in range(seeds)]
            z, over = [i.coordination for i in found], np.mean([excess(i, dim, mu) for i in found])
            phi = np.mean([i.packing_fraction for i in found])
            sliding = np.mean([i.sliding / i.contacts for i in found])
            loose = np.mean([i.rattlers / about["n"] for i in found])
            error = np.std(z, ddof=1) / np.sqrt(seeds)
            line = (f"{np.mean(z):.2f} ± {error:.2f}", *(f"{x:.2f}" for x in (over, phi, sliding, loose)))
            yield f"| {mu:g} | {' | '.join(line)} |"
