"""Initial guesses for fits: a coarse search over a, b, D_c and the spring, to avoid inferior local minima."""

from itertools import product

import numpy as np

from .model import LINEAR, PLAIN, Prepared, linear_column, model_friction

RATIOS = (0.5, 0.8, 1.25, 2.0)  # b/a
SIZES = (0.3, 1.0, 3.0)  # a over the estimate from the record's range
LENGTHS = 9  # number of values of D_c, the smallest 1/300 of the length of a leg
STIFFNESSES = (0.6, 1.5, 4.0)  # stiffness over the steepest slope of the record
SECOND = (10.0, 0.1)  # D_c of a second state over that of the first
SHARE = 0.3  # share of a second state in the evolution effect
FAST = 10.0  # cut-off velocities over the greatest velocity
BEST = 5  # number of guesses that are returned


def initial_guesses(cases: list[Prepared], law: str, free, fixed: dict) -> list[dict]:
    """Best points of a grid, each with mu0, trend and drift from linear least squares, best first.

    The search uses the logarithmic form, with one state and without cut-off velocities.
    """
    fixed = fixed | {name: value for name, value in PLAIN.items() if name in free}
    grid = {name: _grid(name, cases) if name in free else (fixed[name],) for name in ("a", "dc", "stiffness")}
    grid["b/a"] = RATIOS if "b" in free else (None,)
    points = []
    for a, length, k, ratio in product(grid["a"], grid["dc"], grid["stiffness"], grid["b/a"]):
        values = {**fixed, "a": a, "dc": length, "stiffness": k, "b": fixed["b"] if ratio is None else a * ratio}
        cost, linear = _cost(cases, law, values, free)
        if np.isfinite(cost):
            points.append((cost, values, linear))
    points.sort(key=lambda point: point[0])
    return [{**values, "linear": linear} for _, values, linear in points[:BEST]]


def extended_guesses(guess: dict, cases: list[Prepared], free) -> list[dict]:
    """Guesses for further parameters: a second state with a longer or a shorter D_c, and high cut-off velocities."""
    fastest = max(float(np.abs(case.velocity if case.legs is None else case.legs[1]).max()) for case in cases)
    more = {name: FAST * fastest for name in ("v1", "v2") if name in free}
    if "trend_length" in free:
        more["trend_length"] = max(float(np.ptp(case.place)) for case in cases) / 3
    if not {"b2", "dc2"} & set(free):
        return [{**guess, **more}]
    if {"b", "b2"} <= set(free):
        more |= {"b": (1 - SHARE) * guess["b"], "b2": SHARE * guess["b"]}
    return [{**guess, **more} | ({"dc2": guess["dc"] * ratio} if "dc2" in free else {}) for ratio in SECOND]


def _cost(cases, law: str, values: dict, free) -> tuple[float, list]:
    """Sum of squares for the best mu0, trend and drift of each data set."""
    cost, linear = 0.0, []
    for case in cases:
        model = model_friction(case, values, law, tolerance=1e-5)
        if model is None:
            return np.inf, []
        use, weight = case.used, 1 / case.sigma[case.used]
        basis = [linear_column(case, name)[use] for name in LINEAR if name in free]
        rest = (case.friction[use] - model[use]) * weight
        coefficients = np.zeros(0)
        if basis:
            columns = np.stack(basis, axis=1) * weight[:, None]
            size = np.linalg.norm(columns, axis=0)
            coefficients = np.linalg.lstsq(columns / size, rest, rcond=None)[0] / size
            rest = rest - columns @ coefficients
        linear.append(coefficients)
        cost += float(rest @ rest)
    return cost, linear


def _grid(name: str, cases) -> tuple[float, ...]:
    if name == "a":
        return tuple(_direct_effect(cases) * size for size in SIZES)
    if name == "dc":
        longest = _slip_length(cases)
        return tuple(np.geomspace(longest / 300, longest, LENGTHS))
    return tuple(_steepest_slope(cases) * factor for factor in STIFFNESSES)


def _direct_effect(cases) -> float:
    """Range of friction divided by that of ln V, which is about 5 if the load point stops."""
    sizes = []
    for case in cases:
        speed = np.abs(case.velocity if case.legs is None else np.r_[case.before, case.legs[1]])
        spread = np.log(speed.max() / max(speed.min(), speed.max() * np.exp(-5.0)))
        low, high = np.quantile(case.friction[case.used], (0.005, 0.995))
        sizes.append((high - low) / max(spread, 0.5))
    return max(float(np.median(sizes)), 1e-9)


def _slip_length(cases) -> float:
    """Typical displacement at one velocity: the median over moving legs, or a third of the total slip."""
    longest = []
    for case in cases:
        if case.legs is None:
            longest.append(case.place[-1] / 3)
            continue
        run = np.abs(case.legs[0] * case.legs[1])
        whole = float(run.sum())
        runs = run[run > 1e-3 * whole]
        longest.append(float(np.median(runs)) if len(runs) else whole / 3)
    return float(np.median(longest))


def _steepest_slope(cases) -> float:
    """Steepest slope of friction against load-point displacement, over five samples to suppress noise."""
    steepest = []
    for case in cases:
        x, y = case.place, case.friction
        span = np.abs(x[4:] - x[:-4])
        moves = span > 1e-9 * max(span.max(), 1e-300)
        slopes = np.abs(y[4:] - y[:-4])[moves] / span[moves]
        slopes = slopes[np.isfinite(slopes)]
        steepest.append(float(np.quantile(slopes, 0.98)) if len(slopes) else 1.0)
    return max(float(np.median(steepest)), 1e-12)
