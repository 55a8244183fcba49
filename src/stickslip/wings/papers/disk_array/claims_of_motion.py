"""Evaluation of statements of Charan et al. 2020 on the way to the Coulomb limit and on sliding after it."""

import numpy as np

from ....core.contacts.jacobian import linearise
from ....kit import Claim, claim, standard_error
from .arrest import Arrest
from .measures import exceeds, velocity_line
from .printed import FRONT_LOADS, LINE_TOP, TOLERANCE, V2_THRESHOLD
from .simulate import DiskArrayResult, point_at_load

TRANSITION = 0.083  # push of Figs 3 and 4 at which the array slides


def evaluate_motion(main: DiskArrayResult, arrests: list[Arrest]) -> list[Claim]:
    """Evaluate the statements for the main scenario."""
    return [
        *(_charging(arrest) for arrest in arrests), _msd_at_breach(main), _where_first(main), _power(main),
        *_spiral(main), *_center(main), *sliding_claims(main, ""),
    ]  # fmt: skip


def _charging(arrest: Arrest) -> Claim:
    """Claim that the slip at the substrate is charged; it must grow by more than the tolerance."""
    mean, error = float(arrest.charge.mean()), standard_error(arrest.charge)
    return claim(
        f"charging-{arrest.load:.3f}", 'Fig 3: "static friction with charging of t_iw" at 0.03 and 0.04', True,
        exceeds(mean, error, 1 + TOLERANCE["charging"]), "", 0.0,
        f"mean |t_iw| of {len(arrest.charge)} late states over that before the run: {mean:.3f} ± {error:.3f}; at rest "
        f"the forces of the substrate add up to F_x, so that t_iw can change sign or place, but not its sum",
    )  # fmt: skip


def _msd_at_breach(main: DiskArrayResult) -> Claim:
    values = main.sliding[TRANSITION].msd_at_breach
    values = values[np.isfinite(values)]
    root = 2 * np.sqrt(values)  # in units of R
    return claim(
        "root-msd-at-breach-0.083", 'Fig 3: at 0.083 "bringing M(t) to about 10^-2 R where for the first time the '
        'Coulomb law is breached at the contact with the substrate"', 1e-2, float(root.mean()) if len(root) else None,
        "R", TOLERANCE["saturation"],
        f"√M, as M is an area, when the first contact with the substrate reaches the limit in {len(root)} "
        f"realizations; M itself is {4 * values.mean() if len(values) else np.nan:.1e} R²", error=standard_error(root),
    )  # fmt: skip


def _where_first(main: DiskArrayResult) -> Claim:
    first = np.concatenate([main.sliding[load].wall_first for load in FRONT_LOADS])
    first = first[np.isfinite(first)]
    share = float(first.mean()) if len(first) else np.nan
    return claim(
        "substrate-first", 'Fig 3: at 0.083 "for the first time the Coulomb law is breached at the contact with the '
        'substrate"', True, exceeds(share, _share_error(first), 0.5), "", 0.0,
        f"in {int(first.sum())} of {len(first)} realizations the first contact at the limit is with the substrate; in "
        f"the others it is between two disks",
    )  # fmt: skip


def _share_error(yes: np.ndarray) -> float:
    """Standard error of the share of realizations with an outcome; infinite without realizations."""
    return float(np.sqrt(yes.mean() * (1 - yes.mean()) / len(yes))) if len(yes) else np.inf


def _power(main: DiskArrayResult) -> Claim:
    power = main.sliding[TRANSITION].power
    power = power[np.isfinite(power)]
    return claim(
        "msd-exponent", 'Fig 3: "subsequently M(t) increases linearly in time with a fixed average velocity"', 1.0,
        float(power.mean()) if len(power) else None, "1", TOLERANCE["power"],
        f"p in M ∝ (t − t_b)^p, t_b the first breach at the substrate, over the last third of {len(power)} "
        f"realizations that slide; the sentence contradicts itself", error=standard_error(power), reference=2.0,
        reference_source="a fixed velocity V: M = N V² (t − t_b)²",
    )  # fmt: skip


def _spiral(main: DiskArrayResult) -> list[Claim]:
    """Claims that disks are lifted before they reach the limit, and that this is so for each of them."""
    left = main.sliding[TRANSITION].unloading
    reached, start = np.isfinite(left), point_at_load(main.path, TRANSITION).state
    lifted = left[reached] < 1
    here = linearise(start, main.law).mobilisation[start.contacts.j[: start.contacts.count[0]] >= left.shape[1]]
    used, overlap = float(np.nanmedian(here)), float(np.median(left[reached])) if reached.any() else np.nan
    each = [exceeds(float(np.mean(row)), _share_error(row), 0.5) for row in _columns(left < 1, reached)]
    whole = None if None in each else all(each)
    reached_at = main.free_runs[TRANSITION].breach
    return [
        claim(
            "spiral-lifts-disks", 'Fig 4: "A spiral in the x-y plane leads in time to an increase in y_i to the point '
            'that breaching the Coulomb law at the contact with the substrate becomes inevitable"', True,
            exceeds(float(lifted.mean()) if len(lifted) else np.nan, _share_error(lifted), 0.5), "", 0.0,
            f"{lifted.sum()} of {len(lifted)} disks have risen when their contact with the substrate first reaches the "
            f"limit; by the median F_n has then fallen to {overlap**1.5:.2g} of its value before the run, and F_t from "
            f"{used:.2g} to {overlap**1.5:.2g} of mu times that value: the limit falls to F_t",
        ),
        claim(
            "spiral-is-representative", 'Fig 4: the trajectory of the fourth disk "is representative for all the other '
            'disks"', True, whole, "", 0.0,
            f"median overlap with the substrate at the limit, over that before the run, disk by disk: "
            f"{', '.join(f'{np.median(column):.2f}' for column in _columns(left, reached))}",
        ),
        claim(
            "time-of-trajectory", 'Fig 4: "The actual trajectory (for t ≈ 17500) that is induced by the instability"',
            17500.0, None, "time", TOLERANCE["saturation"],
            f"from velocities of {main.scenario.dynamics.seed_velocity:g} all contacts with the substrate have reached "
            f"the limit after {np.max(reached_at):.0f}; the time changes with the logarithm of the first velocities, "
            f"which are not printed: they would decide it",
        ),
    ]  # fmt: skip


def _columns(values: np.ndarray, there: np.ndarray) -> list[np.ndarray]:
    """The entries of each column that are there."""
    return [column[mask] for column, mask in zip(values.T, there.T, strict=True)]


def _center(main: DiskArrayResult) -> list[Claim]:
    """Claims about the center of mass while the array slides: constant velocity, steady height, and abrupt onset."""
    groups = [main.sliding[load] for load in FRONT_LOADS]
    k = main.scenario.sliding.thresholds.index(V2_THRESHOLD)
    velocity, height = (np.concatenate([getattr(g, name) for g in groups]) for name in ("late_velocity", "late_height"))
    onset = np.concatenate([np.column_stack([g.velocity, g.drift[:, k]]) for g in groups])
    rows = (
        ("fixed-velocity", '"a simple first order transition from static to dynamics with a fixed velocity"', velocity,
         "steady", "velocity of the center in the last sixth of the runs over that in the sixth before"),
        ("height-without-growth", '"the y component of the center of mass that oscillates without growth"', height,
         "steady", "standard deviation of the height of the center in the last sixth over that in the sixth before"),
        ("first-order-onset", '"appears like a simple first order transition"', onset, "front",
         f"velocity when the center has moved by {V2_THRESHOLD:g} over that in the last third of the runs: one if "
         f"the velocity jumps"),
    )  # fmt: skip
    return [_ratio(name, f"Fig 7: {said}", values, TOLERANCE[kind], note) for name, said, values, kind, note in rows]


def _ratio(name: str, source: str, values: np.ndarray, tolerance: float, note: str) -> Claim:
    """Claim that the mean of the second column equals that of the first one; its error is a jackknife's."""
    before, after = values[np.isfinite(values).all(axis=1)].T
    n = len(before)
    left_out = (after.sum() - after) / (before.sum() - before) if n > 1 else np.zeros(0)
    error = float(np.sqrt((n - 1) * left_out.var())) if n > 1 else None
    measured = float(after.mean() / before.mean()) if n else None
    return claim(name, source, 1.0, measured, "1", tolerance, f"{note}, ratio of means over {n} runs", error=error)


def sliding_claims(result: DiskArrayResult, suffix: str) -> list[Claim]:
    """Claims about Eq 10; the intercept for the printed model only."""
    line = velocity_line(result, LINE_TOP)
    slope, error, note = None, None, "fewer than three loads at which realizations slide before the run ends"
    if line:
        slope, error = line.slope, line.slope_error
        wider = {top: velocity_line(result, top).slope for top in line.push if top > LINE_TOP}
        slid = [int(np.isfinite(result.sliding[load].velocity).sum()) for load in FRONT_LOADS]
        note = (
            f"fitted to the loads named in the paper, where {'+'.join(map(str, slid))} realizations slide before "
            f"the run ends; V is convex: slopes from fits up to larger loads are "
            f"{', '.join(f'{value:.2e} up to {top:g}' for top, value in wider.items())}"
        )
    out = [claim(
        f"sliding-velocity-slope{suffix}", "Fig 7: Eq 10, 4.5e-4", 4.5e-4, slope, "velocity per F_x",
        TOLERANCE["slope"], note, error=error,
    )]  # fmt: skip
    if not suffix:
        out.append(claim(
            "sliding-velocity-intercept", "Fig 7: Eq 10, -1.3e-3", -1.3e-3, line.intercept if line else None,
            "velocity", TOLERANCE["intercept"], "as printed, every velocity up to F_x = 2.9 would be negative",
            error=line.intercept_error if line else None, reference=-1.3e-5,
            reference_source="Eq 10 with the intercept corrected by two decades: V > 0 from F_x = 0.029 upwards",
        ))  # fmt: skip
    return out
