"""Friction angle of frictionless spheres in slow simple shear, compared with a published value.

    python -m benchmarks frictionless_shear [GRAINS [SAMPLES]]

Even without friction between grains, spheres have a friction angle: 5.76 ± 0.22 degrees in the limit of rigid grains
and slow shear (Peyneau and Roux 2008, doi:10.1103/PhysRevE.78.011307, abstract; docs/reference/element_tests). Element
tests shear samples at constant σ_yy at several inertial numbers I. tan φ = |σ_xy|/σ_yy is averaged over γ > 0.15 and
extrapolated by tan φ = A + B I^n with n = 0.4; n = 0.3 and 0.5 show the influence of that assumption. The tolerance,
chosen before the first run, is 10 % of the published value, or twice the combined error if that is larger. The table is
for docs/element_tests.md. The benchmark takes about fifteen minutes.
"""

from pathlib import Path

import numpy as np

import stickslip as ss
from stickslip.core.tables import read_table

from .records import number

PUBLISHED = Path(__file__).parents[1] / "docs" / "reference" / "element_tests" / "frictionless_shear.csv"
RATES, POWERS = (1e-3, 3e-4, 1e-4), (0.4, 0.3, 0.5)  # inertial numbers; powers n, the first of which is assumed
STRAIN, STEADY = 0.4, 0.15  # shear strain, and strain from which averages are computed
BLOCKS = 5  # number of parts of a steady series; their scatter gives the error of a single sample


def tangent(grains: int, samples: int, inertial_number: float, strain: float = STRAIN) -> tuple[float, float]:
    """Mean of tan φ in steady shear, and its standard error from samples or, with one sample, from blocks."""
    test = ss.scenario(
        experiment="element-test",
        realizations=samples,
        sample={
            "grains": grains,
            "pressure": 1e3,
            "friction": 0.0,
            "grading": {"kind": "uniform", "smallest": 0.9e-3, "largest": 1.1e-3},
        },
        law={"kind": "hertz_mindlin_reff", "young": 1e8, "poisson": 0.2, "mu": 0.0},
        path={
            "kind": "simple-shear",
            "strain": strain,
            "step": 2e-3,
            "integrator": "dynamic",
            "inertial_number": inertial_number,
        },
    )
    means, series = [], None
    for run in ss.simulate(test, workers=1).runs:
        series = run.series
        ratio = np.abs(series.stress[:, 0, 1]) / series.stress[:, 1, 1]
        steady = ratio[np.abs(series.load) > STEADY / STRAIN * strain]
        means += [steady.mean()] if samples > 1 else [block.mean() for block in np.array_split(steady, BLOCKS)]
    return float(np.mean(means)), float(np.std(means, ddof=1) / np.sqrt(len(means)))


def extrapolate(mean: np.ndarray, scatter: np.ndarray, power: float) -> tuple[float, float]:
    """Friction angle for I → 0 and its standard error [degree], by weighted least squares."""
    columns = np.stack([np.ones(len(RATES)), np.power(RATES, power)], axis=1) / scatter[:, None]
    inverse = np.linalg.inv(columns.T @ columns)
    limit, error = (inverse @ columns.T @ (mean / scatter))[0], np.sqrt(inverse[0, 0])
    return float(np.degrees(np.arctan(limit))), float(np.degrees(error))


def rows(grains: str = "1000", samples: str = "1", *, smallest: bool = False):
    """Rows with tan φ at each inertial number, its limit, and the verdict."""
    grains, samples = 40 if smallest else int(grains), int(samples)
    _, (_, (_, value, error, doi)) = read_table(PUBLISHED)
    yield f"{grains} spheres without friction, {samples} samples, γ from {STEADY:g} to {STRAIN:g}"
    points = []
    for rate in RATES:
        mean, scatter = tangent(grains, samples, rate, 0.03 if smallest else STRAIN)
        points.append((mean, scatter))
        yield number(f"tan φ, I = {rate:g}", mean, "", scatter)
        yield number(f"φ, I = {rate:g}", float(np.degrees(np.arctan(mean))), "°")
    mean, scatter = np.array(points).T
    limits = [extrapolate(mean, scatter, power) for power in POWERS]
    limit, wide = limits[0][0], float(np.hypot(limits[0][1], np.ptp([value for value, _ in limits]) / 2))
    allowed = max(0.1 * float(value), 2 * float(np.hypot(wide, float(error))))
    verdict = "agrees" if abs(limit - float(value)) < allowed else "differs"
    yield number("φ, I → 0", limit, "°", wide)
    yield f"published: {value} ± {error}° (doi:{doi}): {verdict}"
