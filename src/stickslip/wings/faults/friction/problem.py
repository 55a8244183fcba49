"""Least-squares problem of a fit: initial guesses, residuals, search for the best minimum, and identifiability."""

from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from ....kit import Report, silent, within
from .model import DEFAULTS, LINEAR, LOGARITHMIC, PLAIN, WHITE, Prepared, linear_column, model_friction, whitened

SEARCHED, FOUND = 0.5, 0.9  # shares of the progress bar filled once the guesses and the best minimum are found
SINGULAR = 1e-5  # relative size below which singular values of the scaled Jacobian are numerical errors
WIDEST = np.log(10.0)  # half width of a logarithm's interval above which the parameter is not determined
PART = 0.25  # relative size of a component above which a direction contains its parameter


class Estimates(NamedTuple):
    """Fitted values, with NaN for parameters that the data do not determine."""

    values: dict
    errors: dict
    intervals: dict
    covariance: np.ndarray  # (m, m), NaN for undetermined parameters
    identifiable: bool
    sentence: str
    gap: float  # a − b
    error: float  # half width of the 95 % interval of a − b


def covariance(jacobian) -> tuple[np.ndarray, np.ndarray]:
    """Covariance (JᵀJ)⁻¹ from singular values, and a mask of parameters that can change without effect on the model.

    Parameters
    ----------
    jacobian : (N, m) Jacobian of the filtered residuals over their size
    """
    size = np.linalg.norm(jacobian, axis=0)
    size = np.maximum(size, SINGULAR**2 * max(size.max(), 1e-300))
    _, singular, right = np.linalg.svd(jacobian / size, full_matrices=False)
    floor = np.maximum(singular, SINGULAR * singular[0])
    blind = np.zeros(len(size), bool)
    for row in right[singular < SINGULAR * singular[0]]:
        blind |= np.abs(row) > PART * np.abs(row).max()
    return (right.T / floor**2) @ right / np.outer(size, size), blind


def estimate(inner, blind, x, names, logs, reach: float, open_sides: dict) -> Estimates:
    """Estimate parameters with their intervals, and find those that the data do not determine.

    A parameter is not determined if it contributes to a direction that does not change the model, if the 95 % interval
    of its logarithm extends beyond a factor of 10, or if values far beyond that interval fit equally well.

    Parameters
    ----------
    inner, blind : from `covariance`
    x : (m,) logarithms where `logs` is True, values elsewhere
    reach : quantile of Student's t distribution
    open_sides : name → (limit, "above" or "below"), if all values above or below this limit fit equally well
    """
    half = reach * np.sqrt(np.diag(inner))
    unknown = blind | (logs & (half > WIDEST)) | np.array([name in open_sides for name in names])
    raw = np.where(logs, np.exp(np.where(logs, x, 0.0)), x)
    slope = np.where(logs, raw, 1.0)
    full = inner * np.outer(slope, slope)
    ratio = np.exp(np.minimum(half, 300.0) * logs)
    low, high = np.where(logs, raw / ratio, x - half), np.where(logs, raw * ratio, x + half)
    shown = [np.where(unknown, np.nan, column) for column in (raw, np.sqrt(np.diag(full)), low, high)]
    cover = full.copy()
    cover[unknown], cover[:, unknown] = np.nan, np.nan
    values, errors = dict(zip(names, shown[0].tolist(), strict=True)), dict(zip(names, shown[1].tolist(), strict=True))
    intervals = {name: (float(i), float(j)) for name, i, j in zip(names, shown[2], shown[3], strict=True)}
    gap, error = difference(names, raw, full, reach)
    pair = [k for k, name in enumerate(names) if name in ("a", "b")]
    if unknown.any() and (unknown[pair].sum() == 1 or not error < 0.5 * max(raw[pair], default=1.0)):
        gap, error = np.nan, np.nan
    sentence = _sentence(names, unknown, inner, open_sides, (gap, error))
    return Estimates(values, errors, intervals, cover, not unknown.any(), sentence, gap, error)


def without_intervals(estimates: Estimates, reason: str) -> Estimates:
    """Return the same values without errors and intervals, for use if the noise is unknown."""
    nothing = dict.fromkeys(estimates.errors, np.nan)
    sentence = reason if estimates.identifiable else f"{reason}; {estimates.sentence.partition(':')[0]}"
    return estimates._replace(
        errors=nothing, intervals=dict.fromkeys(nothing, (np.nan, np.nan)), sentence=sentence, error=np.nan,
        covariance=np.full_like(estimates.covariance, np.nan),
    )  # fmt: skip


def difference(names, raw, full, reach: float) -> tuple[float, float]:
    """Difference a − b of the free parameters (a fixed one counts as 0), and the half width of its interval."""
    weights = np.array([{"a": 1.0, "b": -1.0}.get(name, 0.0) for name in names])
    return float(weights @ raw), reach * float(np.sqrt(max(weights @ full @ weights, 0.0)))


def _sentence(names, unknown, inner, open_sides: dict, gap) -> str:
    if not unknown.any():
        return "these data determine all parameters"
    among = np.flatnonzero(unknown)
    lost = ", ".join(names[k] for k in among)
    _, vectors = np.linalg.eigh(inner[np.ix_(among, among)])
    part = among[np.abs(vectors[:, -1]) > PART * np.abs(vectors[:, -1]).max()]
    involved = [names[k] for k in part]
    if open_sides:
        limits = " and ".join(f"any {name} {side} {limit:.2g}" for name, (limit, side) in open_sides.items())
        hint = f"{limits} fits equally well: fix {' or '.join(open_sides)}, or add data that depend on it"
    elif len(part) == 1:
        hint = f"{involved[0]} hardly affects the data: fix it, or add data that depend on it"
    else:
        hint = f"{' and '.join(involved)} trade off against each other: fix one of them, or add data that separate them"
    if {"a", "b"} <= {names[k] for k in among} and np.isfinite(gap[1]):
        short = ", if dc is far below the slip at one velocity" if "dc" in lost else ""
        hint = f"only a − b = {gap[0]:.3g} ± {gap[1]:.1g} is known{short}; {hint}"
    return f"these data do not determine {lost}: {hint}"


RATIOS = (0.5, 0.8, 1.25, 2.0)  # b/a
SIZES = (0.3, 1.0, 3.0)  # ratios of a to its estimate from the range of friction
LENGTHS = 9  # number of values of D_c from 1/300 of the length of a leg to this length
BEYOND = 10.0  # ratio of a further D_c to the length of a leg, for a state that hardly evolves
STIFFNESSES = (0.6, 1.5, 4.0)  # ratios of the stiffness to the steepest slope of the record
SECOND = (10.0, 0.1)  # D_c of a second state over that of the first
SHARE = 0.3  # fraction of a second state in the evolution effect
FAST = 10.0  # cut-off velocities over the largest velocity
BEST = 5  # number of guesses that are returned


def initial_guesses(cases: list[Prepared], law: str, free, fixed: dict, report: Report = silent) -> list[dict]:
    """Points of a grid with the smallest misfit, best first, each with mu0, trend and drift from linear least squares.

    The search uses the logarithmic form, with one state and without cut-off velocities.
    """
    samples = sum(int(case.used.sum()) for case in cases)
    fixed = fixed | {name: value for name, value in PLAIN.items() if name in free}
    grid = {name: (fixed[name],) for name in ("a", "dc", "stiffness") if name not in free}
    if "a" in free:
        effect = _direct_effect(cases)
        grid["a"] = [effect * size for size in SIZES]
    if "dc" in free:
        longest = _slip_length(cases)
        grid["dc"] = (*np.geomspace(longest / 300, longest, LENGTHS), BEYOND * longest)
    if "stiffness" in free:
        slope = _steepest_slope(cases)
        grid["stiffness"] = [slope * factor for factor in STIFFNESSES]
    grid["b/a"] = RATIOS if "b" in free else (None,)
    points, nodes = [], list(product(*(grid[name] for name in ("a", "dc", "stiffness", "b/a"))))
    for number, (a, length, k, ratio) in enumerate(nodes, start=1):
        values = {**fixed, "a": a, "dc": length, "stiffness": k, "b": fixed["b"] if ratio is None else a * ratio}
        cost, linear = _cost(cases, law, values, free)
        if np.isfinite(cost):
            points.append((cost, values, linear))
        if points:
            least = min(point[0] for point in points)
            text = f"{number} of {len(nodes)} guesses, smallest misfit {np.sqrt(least / samples):.2e}"
            report("search", number / len(nodes), text)
    points.sort(key=lambda point: point[0])
    return [{**values, "linear": linear} for _, values, linear in points[:BEST]]


def extended_guesses(guess: dict, cases: list[Prepared], free) -> list[dict]:
    """Extend a guess to further parameters: a second state with longer or shorter D_c, and high cut-off velocities."""
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
    """Sum of squares for the best mu0, trend and drift of each data set, and these best values."""
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


def _direct_effect(cases) -> float:
    """Range of friction divided by that of ln V, which counts as 5 if the load point stops."""
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


BLANK = {"a": 1.0, "b": 0.0, "dc": 1.0, "mu0": 0.0, "stiffness": 1.0, **DEFAULTS}  # values before the coarse search
STEP = 1e-5  # step of logarithms for finite differences; the model is accurate to 1e-9
RUNAWAY_RESIDUAL = 1e3  # residual, over the scatter of friction, if the slider runs away
SAME = 1e-4  # relative difference of sums of squares that belong to the same minimum
MAX_SHIFT = 7.0  # largest change of a logarithm from its initial guess: a factor of a thousand
WIDE = 0.3  # half width of a logarithm's interval above which the ends of the interval are checked


class Task(NamedTuple):
    """Task of a fit: records, law, and the mapping from the vector x to the parameters of each record."""

    cases: list[Prepared]
    law: str
    names: tuple[str, ...]  # one for each entry of x
    slots: list[dict]  # for each record: name → index in x
    fixed: dict
    scatter: float  # scatter of friction in the records
    form: str = "logarithmic"
    report: Report = silent  # called as report(stage, share done, text with the misfit and the parameters)

    @property
    def logs(self) -> np.ndarray:
        """Mask of the entries of x that are logarithms."""
        return np.array([label.split("[")[0] in LOGARITHMIC for label in self.names])


def parameters_of(task: Task, x, number: int) -> dict:
    """Parameters of one record, by name."""
    values = {name: float(x[k]) for name, k in task.slots[number].items()}
    return task.fixed | {k: float(np.exp(v)) if k in LOGARITHMIC else v for k, v in values.items()}


def residual(task: Task, x) -> np.ndarray:
    """Residuals (data − model)/sigma of all fitted samples."""
    out = []
    for number, case in enumerate(task.cases):
        model = model_friction(case, parameters_of(task, x, number), task.law, task.form)
        rest = np.full(len(case.time), RUNAWAY_RESIDUAL * task.scatter) if model is None else case.friction - model
        out.append((rest / case.sigma)[case.used])
    return np.concatenate(out)


def jacobian(task: Task, x, *, central: bool = False) -> np.ndarray:
    """Jacobian d residual/dx: exact for trend and drift, by finite differences otherwise.

    It is also exact for μ0 at constant normal stress in the logarithmic form, where friction is linear in μ0.
    """
    base = None if central else residual(task, x)
    out = np.zeros((sum(int(c.used.sum()) for c in task.cases), len(x)))
    for k, label in enumerate(task.names):
        name, row = label.split("[")[0], 0
        simple = (name == "drift" or (name == "trend" and task.fixed.get("trend_length") == np.inf)) or (
            name == "mu0"
            and task.form == "logarithmic"
            and all(c.legs is None or np.ptp(c.legs[2]) == 0 for c in task.cases)
        )
        if not simple:
            step = STEP * (10 if central else 1) * np.eye(len(x))[k]
            ahead = residual(task, x + step)
            out[:, k] = (ahead - residual(task, x - step)) / (2 * step[k]) if central else (ahead - base) / step[k]
            continue
        for case, slot in zip(task.cases, task.slots, strict=True):
            column = linear_column(case, name)
            piece = slice(row, row + int(case.used.sum()))
            if slot[name] == k:
                out[piece, k] = -(column / case.sigma)[case.used]
            row = piece.stop
    return out


def pieces(task: Task) -> list[slice]:
    """Contiguous runs of fitted samples of all records, as slices into the residuals."""
    out, row = [], 0
    for case in task.cases:
        out += [slice(row + piece.start, row + piece.stop) for piece in case.pieces]
        row += int(case.used.sum())
    return out


def filtered_residual(task: Task, x, filters) -> np.ndarray:
    """Residuals of all records after whitening of the noise."""
    return whitened(residual(task, x), filters, pieces(task))


def solve(task: Task, x, filters, most: int = 60, held: int | None = None, close: float = 1e-10):
    """Solve the least-squares problem from x, optionally with one entry held fixed."""
    runs = pieces(task)
    moves = np.array([k != held for k in range(len(x))])
    span = np.array([MAX_SHIFT if label.split("[")[0] in LOGARITHMIC else np.inf for label in task.names])[moves]

    def whole(y):
        return np.where(moves, np.insert(y, held, 0.0) if held is not None else y, x)

    number = 0

    def rest(y):
        nonlocal number
        out, number = residual(task, whole(y)), number + 1
        task.report("fit", min(number / most, 1.0), describe(task, whole(y), out))
        return whitened(out, filters, runs)

    return least_squares(
        rest,
        x[moves],
        jac=lambda y: whitened(jacobian(task, whole(y)), filters, runs)[:, moves],
        bounds=(x[moves] - span, x[moves] + span),
        x_scale="jac",
        ftol=close,
        xtol=1e-9,
        gtol=1e-14,
        max_nfev=most,
    )


def describe(task: Task, x, rest) -> str:
    """Progress text: misfit (root mean square of the residuals) and the first parameters."""
    values = parameters_of(task, x, 0)
    shown = (f"{name} {values[name]:.3g}" for name in ("a", "b", "dc", "stiffness") if name in task.slots[0])
    return ", ".join((f"misfit {np.sqrt(np.mean(rest**2)):.2e}", *shown))


def find_best(task: Task) -> tuple[np.ndarray, int]:
    """Best minimum reached from the initial guesses, and the number of evaluations."""
    free = {label.split("[")[0] for label in task.names}
    minima, count = [], 0
    fixed, report = {**BLANK, **task.fixed}, task.report
    guesses = initial_guesses(task.cases, task.law, free, fixed, within(report, end=SEARCHED))
    starts = [more for guess in guesses for more in extended_guesses(guess, task.cases, free)]
    for number, start in enumerate(starts):
        shares = (SEARCHED + (FOUND - SEARCHED) * (number + k) / len(starts) for k in (0, 1))
        task = task._replace(report=within(report, *shares))
        begin = _start_vector(task, start, free)
        there = [(case, parameters_of(task, begin, k)) for k, case in enumerate(task.cases)]
        if any(model_friction(case, values, task.law, task.form) is None for case, values in there):
            continue  # the slider runs away
        solved = solve(task, begin, WHITE, most=25, close=1e-6)
        count += solved.nfev
        again = any(abs(solved.cost - cost) < SAME * cost for cost, _ in minima)
        minima.append((solved.cost, solved.x))
        if again and solved.cost <= min(cost for cost, _ in minima) * (1 + SAME):
            break  # two guesses have led to the best minimum
    if not minima:
        raise RuntimeError("the slider runs away for all parameters tried: give the damping, or the stiffness")
    x = min(minima, key=lambda minimum: minimum[0])[1]
    task = task._replace(report=within(report, FOUND, 1.0))
    solved = solve(task, with_states_in_order(task, x), WHITE)
    return solved.x, count + solved.nfev


def _start_vector(task: Task, start: dict, free) -> np.ndarray:
    x = np.zeros(len(task.names))
    for slot, linear in zip(task.slots, start["linear"], strict=True):
        extra = dict(zip([n for n in LINEAR if n in free], linear, strict=True))
        for name, k in slot.items():
            x[k] = np.log(start.get(name) or 0.01) if name in LOGARITHMIC else extra[name]
    return x


def with_states_in_order(task: Task, x) -> np.ndarray:
    """Return x with D_c < D_c2 if both states are free and interchangeable."""
    pairs = (("b", "b2"), ("dc", "dc2"))
    if not {name for pair in pairs for name in pair} <= set(task.names):
        return x
    (b, b2), (dc, dc2) = ((task.names.index(first), task.names.index(second)) for first, second in pairs)
    x = x.copy()
    if x[dc] > x[dc2]:
        x[[b, b2, dc, dc2]] = x[[b2, b, dc2, dc]]
    return x


def find_open_sides(task: Task, x, filters, worst: float, half) -> dict:
    """Find sides on which wide intervals have no bound: distant values fit equally well if all others are refitted.

    Intervals derived from derivatives at the best point miss these: as k → ∞, for example, the derivatives vanish while
    the sum of squares stays finite.
    """
    out, runs = {}, pieces(task)
    cost = float(np.sum(whitened(residual(task, x), filters, runs) ** 2))
    for k in np.flatnonzero((half > WIDE) & (half < WIDEST)):
        for side, word in ((1.0, "above"), (-1.0, "below")):
            there = x.copy()
            there[k] += side * max(3 * half[k], WIDEST)
            solved = solve(task, there, filters, most=15, held=int(k), close=1e-4)
            if 2 * solved.cost - cost < worst**2:
                out[task.names[k]] = (float(np.exp(x[k] - side * half[k])), word)
    return out
