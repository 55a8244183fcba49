"""Evaluation of the claims of Bonfanti et al. 2020, doi:10.1103/PhysRevE.101.052902.

Values are medians over packings; the notes give ranges.
"""

from typing import NamedTuple

import numpy as np

from ....kit import Claim, claim, pluralize
from ....reports.claims import CAN
from ....results import Released
from .claims_of_laws import law_claims
from .claims_of_motion import matrix_claim, motion_claims, number_claims
from .claims_of_protocol import protocol_claims
from .medians import TOLERANCE, describe_range, known_median, median_claim
from .simulate import ShearResult

DECADES = 10.0  # decades of M over which the paper sees exponential growth
MISFIT = np.log10(2.0)  # decades by which M may deviate from the predicted line: the oscillation alone causes as much
LEAST_DURATION = (
    "to be read with care, as the minimum duration of a run was set after runs of only 45 growth times had ended at a "
    "median of 0.13 while the stress was still falling"
)
SHOWS = {
    "Fig 1": ("complex pairs along the strain", "pairs-reappear"),
    "Fig 2": ("eigenvalues during a run", "spectrum-constant-until"),
    "Fig 3": ("growth of M", "growth-rate-ratio"),
    "Fig 4": ("trajectories of spheres", "trajectories-three-dimensional"),
    "Fig 5": ("stress through failure", "stress-drop-one-pair"),
    "Sec. II": ("form of the law, its smoothing and its limit", "pairs-under-a-linear-law"),
    "Sec. III": ("drag that finds equilibria", "dynamics-overdamped"),
    "Sec. V": ("generality", "generic-without-hamiltonian"),
    "App. B": ("blocks of J", "symmetries-of-blocks"),
}


def evaluate_claims(main: ShearResult) -> list[Claim]:
    """Evaluate all claims."""
    on_paths = [*_path_claims(main), *number_claims(main), matrix_claim(main), *protocol_claims(main)]
    return on_paths + _growth_claims(main) + motion_claims(main) + _failure_claims(main) + law_claims()


def _path_claims(main: ShearResult) -> list[Claim]:
    paths = main.paths
    births = [p.onset.strain if p.onset else None for p in paths]
    exponents = [p.onset.exponent if p.onset else None for p in paths]
    fraction = [p.packed.packing_fraction for p in paths]
    pressures = [p.packed.pressure for p in paths]
    drift = [abs(p.zero_modes - _zero_modes(p.packed.rattlers, main.scenario.packing.dim)) for p in paths]
    back = sum(p.reappears for p in paths)
    return [
        median_claim(
            "onset-strain", "Fig 1: first pair; no strain is printed", None, births, "strain", "onset",
            f"the packing fraction is not printed either; it is {np.median(fraction):.3g} here, with pressure "
            f"{describe_range(pressures)}; onset {describe_range(births)}; bisected to 1e-6 from the last saved state "
            f"without a pair",
        ),
        median_claim(
            "im-lambda-at-birth-exponent", "Fig 1: birth of a pair; no exponent is printed", None, exponents, "1",
            "exponent", describe_range(exponents, "{:.4f}"), reference=0.5,
            reference_source="when two real eigenvalues meet, they leave the real axis as a square root",
        ),
        claim(
            "pairs-at-zero-slip", 'Fig 1: Sec. III, the frictionless start "has no complex eigenvalues"', 0,
            max(float(p.pairs[0]) for p in paths), "pairs", TOLERANCE["pairs"],
            f"maximum over {len(paths)} packings; zero modes other than translations and rattlers: {max(drift)}",
            error=0.0,
        ),
        claim(
            "pairs-reappear",
            'Fig 1: "with increasing strain the imaginary component can reduce and disappear, then reappear"', True,
            bool(back), "", 0.0,
            f"all pairs vanish and some reappear in {back} of {len(paths)} packings; pairs at the last strain "
            f"{paths[0].strain[-1]:g}: {', '.join(f'{p.pairs[-1]:.0f}' for p in paths)}", quantifier=CAN,
        ),
    ]  # fmt: skip


def _zero_modes(rattlers: int, dim: int) -> int:
    """Number of zero modes at zero slip: translations, and all coordinates of every rattler."""
    return dim + (6 if dim == 3 else 3) * rattlers


class Stretch(NamedTuple):
    """Part of a run in which M follows the predicted exponential."""

    decades: float  # decades of M between its ends
    first: float  # M where it leaves its initial level [length²]
    last: float  # M where it leaves the exponential [length²]
    ended: bool  # False if M was still following the exponential when the run ended


def exponential_stretch(run: Released) -> Stretch | None:
    """Find the part of a run in which M follows exp(2 ω_i t) with the predicted ω_i.

    In this part, the running maximum of M lies within a factor of two of the line that meets it in the fit window.
    Before this part, M is at its initial level; after it, the spectrum changes. Returns None if M did not cross the fit
    window.
    """
    if run.growth is None:
        return None
    envelope = np.maximum.accumulate(run.msd)
    there = envelope > 0
    time, decade = run.time[there], np.log10(envelope[there])
    line = decade - 2 * run.growth_rate / np.log(10) * time
    inside = np.flatnonzero((time >= run.growth.start) & (time <= run.growth.stop))
    near = np.abs(line - np.median(line[inside])) < MISFIT
    middle = int(inside[len(inside) // 2])
    before, after = np.flatnonzero(~near[:middle]), np.flatnonzero(~near[middle:])
    first = int(before[-1]) + 1 if len(before) else 0
    last = middle + int(after[0]) - 1 if len(after) else len(near) - 1
    return Stretch(float(decade[last] - decade[first]), 10 ** decade[first], 10 ** decade[last], bool(len(after)))


def _growth_claims(main: ShearResult) -> list[Claim]:
    runs = main.single
    fitted = [r if r and r.growth else None for r in runs]
    rates = [r and r.growth.growth_rate / r.corrected_rate for r in fitted]
    frequencies = [r and r.growth.frequency / r.corrected_frequency for r in fitted]
    constant = [r.constant[0] if r and np.isfinite(r.constant[1]) else None for r in runs]
    changed = [r.constant[1] if r else None for r in runs]
    rate = describe_range([r.growth_rate if r else None for r in runs], "{:.2e}")
    said = 'Fig 3: "fitted ω_r and ω_i correspond perfectly to those expected"'
    return [
        median_claim(
            "growth-rate-ratio", said, 1.0, rates, "1", "rate",
            f"from states with one pair, predicted rates {rate}; ratio after Verlet's correction "
            f"1 + (omega_r dt)^2/8: {describe_range(rates, '{:.6f}')}",
        ),
        median_claim(
            "frequency-ratio", said, 1.0, frequencies, "1", "frequency",
            f"ratio after Verlet's correction 1 + (omega_r dt)^2/24: {describe_range(frequencies, '{:.8f}')}",
        ),
        *_decade_claims(main),
        median_claim(
            "spectrum-constant-until", 'Fig 2: "eigenvalues remain constant for a period of time"; no M is printed',
            None, constant, "(2 sigma_1)^2", "constant",
            f"M at the last spectrum before the fastest Im lambda had changed by 1 %: {describe_range(constant)}; at "
            f"the next one: {describe_range(changed)}",
        ),
    ]  # fmt: skip


def _decade_claims(main: ShearResult) -> list[Claim]:
    """Claims about the number of decades over which M follows the prediction."""
    stretches = [exponential_stretch(r) if r else None for r in main.single]
    known = [s for s in stretches if s]
    decades, growing = [s and s.decades for s in stretches], sum(not s.ended for s in known)
    said = 'Fig 3: "an increase in time of about 10 orders of magnitude following an oscillatory exponential growth"'
    ends = "; M " + ", ".join(f"{s.first:.0e} to {s.last:.0e}" for s in known) if known else ""
    note = f"M within a factor of two of exp(2 omega_i t), omega_i predicted: {describe_range(decades, '{:.1f}')}{ends}"
    note += f"; {growing} still grew when the run ended" if growing else ""
    return [
        claim(
            "growth-follows-prediction", said, True, all(s.decades >= DECADES for s in known) if known else None, "",
            0.0, f"over at least ten decades; {note}",
        ),
        claim(
            "decades-of-growth", said, DECADES, known_median(decades), "decades of M", TOLERANCE["decades"],
            f"{note}; the number depends on the initial perturbation, velocities of "
            f"{main.scenario.release.seed_velocity:g} here; the paper does not print the size of its own",
        ),
    ]  # fmt: skip


def _ended_runs(runs: list[Released | None]) -> list[Released]:
    """Select the runs whose exponential growth ended before the run did; only these can have failed."""
    stretches = [(r, exponential_stretch(r)) for r in runs if r]
    return [r for r, stretch in stretches if stretch and stretch.ended]


def _failure_claims(main: ShearResult) -> list[Claim]:
    lost = [r.contacts_lost for r in _ended_runs(main.later)]
    first = [r.contacts_lost for r in _ended_runs(main.single)]
    return [
        _stress_drop(
            "stress-drop-one-pair", main.single, 'Fig 5: "a macroscopic drop, in the present case of 22%"', 0.22, {}
        ),
        _stress_drop(
            "stress-drop-later", main.later, "Fig 5: none is printed for states with many pairs", None,
            {"reference": 0.22, "reference_source": "the paper's single run, from a state with one pair"},
        ),
        median_claim(
            "contacts-lost", 'Fig 5: "induced by granules losing contacts"; no number is printed', None, lost,
            "contacts", "contacts",
            f"from later states {describe_range(lost)}; from one-pair states {describe_range(first)}",
        ),
    ]  # fmt: skip


def _stress_drop(
    id: str, source_runs: list[Released | None], source: str, paper: float | None, reference: dict
) -> Claim:
    """Claim about the loss of shear stress relative to its initial value.

    The note gives the loss relative to the pressure.
    """
    there = _ended_runs(source_runs)
    relative = [r.drop / abs(r.shear_stress[0]) for r in there]
    to_pressure = [r.drop / r.pressure[0] for r in there]
    listed = ", ".join(
        f"{pluralize(r.pairs, 'pair')} at {r.strain:.2g}: {a:.3g} ({b:.3g} of p), M {r.msd[-1]:.0e}, "
        f"{r.contacts_lost} lost"
        for r, a, b in zip(there, relative, to_pressure, strict=True)
    )
    note = (
        f"the paper's 22 % is from one run; fraction of the initial shear stress, which may be near zero; relative to "
        f"pressure {describe_range(to_pressure)}; {listed or 'in no run did the exponential growth end'}"
    )
    if paper is None:
        note += f"; {LEAST_DURATION}"
    return median_claim(id, source, paper, relative, "1", "drop", note, **reference)


def shows() -> dict[str, tuple[str, str]]:
    """Figures of the paper, each with its content and the identifier of the claim to quote."""
    return SHOWS
