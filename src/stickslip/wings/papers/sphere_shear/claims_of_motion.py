"""Statements of Bonfanti et al. 2020 on numbers of pairs, on the blocks of J, on trajectories and on the stress."""

import numpy as np

from ....kit import Claim, claim, pluralize
from .medians import describe_range, median_claim
from .motion import axis_ratios, block_asymmetry, stress_oscillation
from .simulate import ShearPath, ShearResult

MANY = 10  # pairs that count as many: ten times the number at the onset
PLANE = 0.01  # third over first singular value below which a trajectory is plane: thinner than its line in a plot
CENTRED = 0.1  # mean over amplitude below which the stress oscillates around zero: not visible in a plot
SYMMETRIC = 1e-12  # relative difference of blocks that are equal: round-off, with a margin for sums over contacts


def number_claims(main: ShearResult) -> list[Claim]:
    """Claims about how many pairs there are, and how large the first one becomes."""
    im = [run.eigenvalue.imag if run and run.pairs == 1 else None for run in main.single]
    last, births = [int(path.pairs[-1]) for path in main.paths], [late_births(path) for path in main.paths]
    many = sum(n >= MANY for n in last)
    return [
        median_claim(
            "im-lambda-one-pair", 'Fig 2: "only a pair of complex eigenvalues, with large lambda_i = 5.87e-5"',
            5.87e-5, im, "1/time^2", "im-lambda", f"the state with one pair and the fastest growth of each path: "
            f"{describe_range(im)}; it depends on pressure and strain, which are not printed",
        ),
        claim(
            "many-pairs-at-larger-strain",
            'Fig 1: "at higher values of gamma one can easily obtain the simultaneous existence of many complex '
            'eigenpairs"', True, 2 * many > len(last), "", 0.0,
            f"at least {MANY} pairs at the last strain in {many} of {len(last)} packings: {', '.join(map(str, last))}",
        ),
        median_claim(
            "births-at-larger-strain",
            'Sec. V: whether the instability "remains macroscopically relevant also for larger strains"; left open',
            None, births, "1", "later", f"births in the second half of the path over those in the first, counted "
            f"between its states: {describe_range(births)}",
        ),
    ]  # fmt: skip


def late_births(path: ShearPath) -> float:
    """Births of pairs in the second half of a path over those in the first, by strain; NaN without any there."""
    late = path.strain[1:] > 0.5 * path.strain[-1]
    born = np.maximum(np.diff(path.pairs), 0)
    return float(born[late].sum() / born[~late].sum()) if born[~late].sum() else np.nan


def matrix_claim(main: ShearResult) -> Claim:
    """Claim about the blocks of J at the last state of each path."""
    differences = [block_asymmetry(path.last, main.law) for path in main.paths]
    worst = {name: max(d[name] for d in differences) for name in "ABCD"}
    axes = min(d["axes"] for d in differences)
    return claim(
        "symmetries-of-blocks",
        "App. B: A_ij = A_ji, B_ij = -B_ji, C_ij = -C_ji, D_ij = D_ji; not under exchange of the axes of A", True,
        max(worst.values()) < SYMMETRIC < axes, "", 0.0,
        f"largest violation in the last state of {pluralize(len(differences), 'path')}, over the largest entry: "
        f"{', '.join(f'{name} {value:.0e}' for name, value in worst.items())}; of A under exchange of its "
        f"axes: at least {axes:.0e}",
    )  # fmt: skip


def motion_claims(main: ShearResult) -> list[Claim]:
    """Claims about trajectories and stress while M grows exponentially."""
    runs = [run for run in main.single if run and run.pairs == 1]
    ratios = [np.median(axis_ratios(run.turns), axis=(1, 2)) for run in runs if len(run.turns)]
    wide, flat = zip(*ratios, strict=True) if ratios else ((), ())
    waves = [wave for wave in map(stress_oscillation, runs) if wave]
    offsets, slopes = [abs(wave.offset) for wave in waves], [wave.exponent for wave in waves]
    return [
        claim(
            "trajectories-spiral", 'Fig 4: Sec. IV, "induce a spiral motion in three dimensions"', True,
            bool(np.median(wide) > PLANE) if wide else None, "", 0.0,
            f"second over first singular value of a turn, 0 on a line and 1 on a circle, median over grains and turns: "
            f"{describe_range(wide)}; by Eq 9 as printed every grain would move on a line",
        ),
        claim(
            "trajectories-three-dimensional", 'Fig 4: "the particle trajectories [...] display a 3D funnel motion"',
            True, bool(np.median(flat) > PLANE) if flat else None, "", 0.0,
            f"with one pair every grain spirals in a plane, that of Re c and Im c, another one for every grain; third "
            f"over first singular value of a turn, median over grains and turns: {describe_range(flat, '{:.1e}')}; "
            f"against time, or with a drift, a plane spiral looks like a funnel",
        ),
        claim(
            "stress-around-zero", 'Fig 5: "during the linear stage [...] the stress oscillates around zero"', True,
            bool(np.median(offsets) < CENTRED) if offsets else None, "", 0.0,
            f"change of the stress: mean over root mean square, both of δσ exp(-omega_i t): {describe_range(offsets)}",
        ),
        median_claim(
            "stress-amplitude-exponent", "Fig 5: amplitude of the stress; no exponent is printed", None, slopes, "1",
            "stress", f"amplitude against M: {describe_range(slopes, '{:.3f}')}", reference=0.5,
            reference_source="the stress is linear in small displacements",
        ),
    ]  # fmt: skip
