"""Paper 001, end to end: oscillatory instabilities of sheared packings of spheres.

Bonfanti, Chattoraj, Guerra, Procaccia, Zapperi, doi:10.1103/PhysRevE.101.052902. Units: 2σ_1 = m = k_n = 1; I0 = 0.4,
k_t = 2/7, μ = 10, smooth Coulomb. The paper leaves the packing fraction open: 0.68 here, for every packing.
"""

from typing import NamedTuple

import numpy as np

from ..data.scenario import ShearScenario, scenario
from ..ensemble import Workers
from ..loading.release import Released
from ..loading.shear_run import Report, ShearResult, silent, simulate_shear
from .claims import Claim, claim

CUTS = (
    "2 packings instead of 5; strain steps of 5e-4 instead of 1e-4 beyond 1e-3 (2e-3); Newtonian runs of 25 growth "
    "times instead of 45, at least 2e4 time units instead of 5e4: too short to fail; 12 spectra in a run instead of 40"
)
NO_NUMBER = "the paper prints no number"
LEAST_DURATION = (
    "read with care: the least duration of a run was set after runs of 45 growth times alone had ended at a median of "
    "0.13 while the stress was still falling"
)


class Reproduction(NamedTuple):
    """The scenario, run, and the claims that it supports."""

    main: ShearResult
    claims: list[Claim]


def paper_scenario(*, quick: bool = False, seed: int = 0) -> ShearScenario:
    """N = 100 spheres, radii 0.5 and 0.7, sheared in steps of 2e-5, then of 1e-4 to a strain of 0.02."""
    if quick:
        return scenario(
            experiment="sphere-shear",
            seed=seed,
            packings=2,
            shear={"strain": (0.0, 1e-3, 0.02), "step": (2e-5, 5e-4)},
            release={"e_folds": 25.0, "least": 2e4, "duration": 3.5e5, "snapshots": 12},
        )
    return scenario(experiment="sphere-shear", seed=seed)


def reproduce(*, quick: bool = False, seed: int = 0, folder=None, workers: Workers = None, report: Report = silent):
    """Run the paper's scenario and judge its claims; arguments as in `simulate_shear`. Returns a Reproduction."""
    main = simulate_shear(paper_scenario(quick=quick, seed=seed), folder=folder, workers=workers, report=report)
    return Reproduction(main, judged(main))


def judged(main: ShearResult) -> list[Claim]:
    """All claims; medians over packings, ranges in the notes."""
    return _path_claims(main) + _growth_claims(main) + _failure_claims(main)


def _median(values) -> float | None:
    known = [v for v in values if v is not None and np.isfinite(v)]
    return float(np.median(known)) if known else None


def _range(values, form: str = "{:.3g}") -> str:
    known = [v for v in values if v is not None and np.isfinite(v)]
    if not known:
        return f"none of {len(values)} packings"
    return f"{form.format(min(known))} to {form.format(max(known))} over {len(known)} of {len(values)} packings"


def _path_claims(main: ShearResult) -> list[Claim]:
    paths = main.paths
    births = [p.onset.strain if p.onset else None for p in paths]
    exponents = [p.onset.exponent if p.onset else None for p in paths]
    zero = [float(p.pairs[0]) for p in paths]
    fraction = [p.packed.packing_fraction for p in paths]
    pressures = [p.packed.pressure for p in paths]
    note = (
        f"{NO_NUMBER} (nor the packing fraction, {np.median(fraction):.3g} here, pressure {_range(pressures)}); "
        f"{_range(births)}; bisected to 1e-6 from the last saved state without a pair"
    )
    drift = [abs(p.zero_modes - _zero_modes(p.packed.rattlers, main.scenario.packing.dim)) for p in paths]
    many = ", ".join(f"{p.pairs[-1]:.0f}" for p in paths)
    return [
        claim("onset-strain", "Fig 1", None, _median(births), "strain", 1.0, note),
        claim(
            "im-lambda-at-birth-exponent", "Fig 1", 0.5, _median(exponents), "1", 0.05,
            f"{_range(exponents, '{:.4f}')}; the birth of a pair must give a square root, the paper prints none",
        ),
        claim(
            "pairs-at-zero-slip", "Sec. III", 0, _median(zero), "pairs", 0.0,
            f"zero modes beside translations and rattlers: {max(drift)}",
        ),
        claim(
            "pairs-reappear", "Fig 1", True, bool(np.median([p.reappears for p in paths]) >= 0.5), "", 0.0,
            f"all pairs vanish and some come back in {sum(p.reappears for p in paths)} of {len(paths)} packings; "
            f"pairs at the last strain {paths[0].strain[-1]:g}: {many}",
        ),
    ]  # fmt: skip


def _zero_modes(rattlers: int, dim: int) -> int:
    """Zero modes at zero slip: translations, and all coordinates of every rattler."""
    return dim + (6 if dim == 3 else 3) * rattlers


def _growth_claims(main: ShearResult) -> list[Claim]:
    runs = main.single
    fitted = [r if r and r.growth else None for r in runs]
    rates = [r and r.growth.growth_rate / r.corrected_rate for r in fitted]
    frequencies = [r and r.growth.frequency / r.corrected_frequency for r in fitted]
    decades = [r and r.growth.decades for r in fitted]
    constant = [r.constant[0] if r and np.isfinite(r.constant[1]) else None for r in runs]
    changed = [r.constant[1] if r else None for r in runs]
    rate = _range([r.growth_rate if r else None for r in runs], "{:.2e}")
    return [
        claim(
            "growth-rate-ratio", "Fig 3", 1.0, _median(rates), "1", 1e-3,
            f"from states with one pair, predicted rates {rate}; after Verlet's correction 1 + (omega_r dt)^2/8: "
            f"{_range(rates, '{:.6f}')}",
        ),
        claim(
            "frequency-ratio", "Fig 3", 1.0, _median(frequencies), "1", 1e-4,
            f"after Verlet's correction 1 + (omega_r dt)^2/24: {_range(frequencies, '{:.8f}')}",
        ),
        claim(
            "decades-of-growth", "Fig 3", 10.0, _median(decades), "decades of M", 0.2,
            f"within the window of the fit, M from 1e-22 to 1e-11: {_range(decades, '{:.1f}')}",
        ),
        claim(
            "spectrum-constant-until", "Fig 2", None, _median(constant), "(2 sigma_1)^2", 1.0,
            f"{NO_NUMBER}; M at the last spectrum before the fastest Im lambda had changed by 1 %: {_range(constant)}; "
            f"at the first one after: {_range(changed)}",
        ),
    ]  # fmt: skip


def _drops(runs: list[Released | None]) -> tuple[list, list]:
    """Loss of shear stress over its initial value, and over the initial pressure."""
    there = [r for r in runs if r]
    return [r.drop / abs(r.shear_stress[0]) for r in there], [r.drop / r.pressure[0] for r in there]


def _failure_claims(main: ShearResult) -> list[Claim]:
    out = []
    for name, runs in (("stress-drop-one-pair", main.single), ("stress-drop-later", main.later)):
        relative, to_pressure = _drops(runs)
        words = ", ".join(
            f"{r.pairs} pair(s) at {r.strain:.2g}: {a:.3g} ({b:.3g} of p), M {r.msd[-1]:.0e}, {r.contacts_lost} lost"
            for r, a, b in zip([r for r in runs if r], relative, to_pressure, strict=True)
        )
        note = (
            f"the paper's 22 % is one run; fraction of the initial shear stress, which may be near zero; relative to "
            f"pressure {_range(to_pressure)}; {words or 'no run'}"
        )
        if name == "stress-drop-later":
            note += f"; {LEAST_DURATION}"
        out.append(claim(name, "Fig 5", 0.22, _median(relative), "1", 1.0, note))
    lost = [r.contacts_lost if r else None for r in main.later]
    first = [r.contacts_lost if r else None for r in main.single]
    note = f"{NO_NUMBER}; from later states {_range(lost)}; from one-pair states {_range(first)}"
    return [*out, claim("contacts-lost", "Sec. IV", None, _median(lost), "contacts", 1.0, note)]
