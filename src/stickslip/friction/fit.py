"""Fits of rate-and-state parameters to records: least squares with noise that remembers, intervals, and a verdict.

The residuals' correlation from sample to sample is modelled as autoregressive, of an order that BIC chooses, and
filtered out of data and model alike (generalised least squares); intervals and likelihood are those of the filtered
problem.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import t as student

from .identify import WIDEST, Known, known, spread
from .model import LOGARITHMIC, NAMES, OWN, Data, Prepared, modelled, prepared
from .noise import autoregression, effective, log_head, whitened
from .ratestate import LAWS, RateState
from .starts import starts

FIT = ("a", "b", "dc", "mu0")  # free unless fixed
DEFAULTS = {"damping": 0.0, "alpha": 0.0, "theta": 1.0, "trend": 0.0}
BLANK = {"a": 1.0, "b": 0.0, "dc": 1.0, "mu0": 0.0, "stiffness": 1.0, **DEFAULTS}  # before the coarse search
STEP = 1e-5  # of logarithms, in differences; the model is exact to 1e-9
FAR = 1e3  # residual over the record's scatter where the slider runs away
FARTHEST = 7.0  # that a logarithm moves from where it starts: a factor of a thousand
WIDE = 0.3  # half width of an interval of a logarithm from which on its ends are looked at
SLOW = 3.0  # independent samples for each parameter, below which residuals are no noise
MISFIT = "residuals are as slow as the signal: the law does not describe these data, or their noise is too slow to tell"
ROUNDS = 3  # of noise and parameters in turn
WHITE = (np.zeros(0), np.zeros((0, 0)))


class Fit(NamedTuple):
    """Parameters of one law. What the data cannot tell is NaN, and `sentence` says so and what to fix."""

    law: str
    names: tuple[str, ...]  # of the m free parameters; "mu0[2]" is that of the second data set
    values: dict  # name → value
    errors: dict  # name → standard error
    intervals: dict  # name → (low, high), 95 %
    covariance: np.ndarray  # (m, m), in the order of names; NaN for what is not known
    fixed: dict  # name → value, with v0
    difference: tuple[float, float, float]  # a − b and its 95 % interval
    identifiable: bool  # whether the data tell all parameters
    adequate: bool  # whether the residuals are faster than the signal, as noise is
    sentence: str
    residuals: tuple[np.ndarray, ...]  # data − model, one array for each data set
    models: tuple[np.ndarray, ...]  # friction of the model at all samples
    sigma: float  # standard deviation of the noise (for sigma = 1 where sigma was given)
    noise: np.ndarray  # autoregressive coefficients; empty for white noise
    effective: float  # number of independent samples
    innovations: np.ndarray  # filtered residuals over their size, for `compare`
    log_likelihood: float
    aic: float
    bic: float
    evaluations: int

    @property
    def samples(self) -> int:
        """How many samples were used."""
        return len(self.innovations)

    def rate_state(self, number: int = 1) -> RateState:
        """The surface that was found, with mu0 of one of the data sets (counted from 1)."""
        both = {**self.fixed, **self.values}
        one = {name: both.get(name, both.get(f"{name}[{number}]")) for name in ("a", "b", "dc", "mu0", "v0", "alpha")}
        return RateState(**one, law=self.law)


def fit(
    data: Data | list[Data],
    *,
    law: str = "aging",
    fixed: dict | None = None,
    free: tuple[str, ...] = (),
    own: tuple[str, ...] = OWN,
    windows=None,
    noise: str = "correlated",
) -> Fit:
    """Fit a, b, D_c, μ0 and what else is free to one record or to several at once.

    Least squares of μ0 + a ln(V/V0) + b ln(V0 θ/D_c) + trend × displacement over whole records: slider and state are
    followed from the first leg to the last. Positive parameters are fitted as logarithms; starting values come from a
    coarse search, so that no guess is needed. Compare Reinen and Weeks 1993, doi:10.1029/93JB00780.

    Parameters
    ----------
    data : one record, or several that share all parameters but those in `own`
    law : "aging" or "slip"
    fixed : values of parameters that are known, as {"stiffness": 1e4}; of a, b, dc, mu0, v0, stiffness, damping, alpha,
        theta (state at the start over the steady one, 1 if not given) and trend (0 if not given)
    free : parameters to fit beside a, b, dc and mu0, as ("stiffness", "trend")
    own : parameters of which each of several records has its own
    windows : pairs (start, end) of times; only samples within them count, while slip goes on between. None for all
    noise : "correlated", or "white" where neighbouring samples are known to be independent

    Returns
    -------
    Fit
        with NaN and a sentence for what these data cannot tell.

    Raises
    ------
    ValueError
        if the input makes no sense.
    RuntimeError
        if the slider runs away with all parameters that were tried.

    Examples
    --------
    >>> from stickslip.friction.loads import velocity_steps
    >>> from stickslip.friction.ratestate import Spring, slide
    >>> legs = velocity_steps([1e-6, 1e-5], distance=2e-4)
    >>> h = slide(RateState(0.010, 0.006, 1e-5), Spring(1e4), legs)
    >>> found = fit(Data(h.time, h.friction, legs), fixed={"stiffness": 1e4})
    >>> print(round(found.values["a"], 6), round(found.values["b"], 6))
    0.01 0.006
    """
    records = [data] if isinstance(data, Data) else list(data)
    cases = [prepared(one, windows) for one in records]
    fixed, names = _chosen(cases, law, dict(fixed or {}), tuple(free), noise)
    task = _task(cases, law, names, fixed, own)
    x, evaluations = _best(task)
    filters, adequate = WHITE, True
    for _ in range(ROUNDS if noise == "correlated" else 0):
        filters = autoregression(_split(task, _residual(task, x)))
        adequate = effective(filters, len(_residual(task, x))) >= SLOW * len(x)
        if not adequate:
            break  # what is left over is as slow as the signal: filtered out, it would take the signal along
        solved = _solve(task, x, filters)
        x, evaluations = solved.x, evaluations + solved.nfev
    return _finished(task, x, filters, evaluations, adequate)


class Task(NamedTuple):
    """A fit: which numbers of the vector x are which parameter of which record."""

    cases: list[Prepared]
    law: str
    names: tuple[str, ...]  # one for each number
    slots: list[dict]  # for each record: name → place in x
    fixed: dict
    scatter: float  # of friction in the records


def _chosen(cases, law: str, fixed: dict, free, noise: str) -> tuple[dict, tuple[str, ...]]:
    """All fixed values, and the names of what is free."""
    if law not in LAWS:
        raise ValueError(f"law = {law!r} was given: use 'aging' or 'slip'")
    if noise not in ("correlated", "white"):
        raise ValueError(f"noise = {noise!r} was given: use 'correlated' or 'white'")
    for name in (*fixed, *free):
        if name not in (*NAMES, "v0") or (name == "v0" and name in free):
            raise ValueError(f"{name!r} was given: parameters are {', '.join(NAMES)}, and v0, which is always fixed")
    for name in set(fixed) & set(free):
        raise ValueError(f"{name} was given as fixed and as free: choose one")
    for name, value in fixed.items():
        least = -np.inf if name in ("mu0", "trend") else 0.0
        if not np.isfinite(value) or value < least or (value == 0 and name in ("a", "dc", "v0", "stiffness", "theta")):
            raise ValueError(f"{name} = {value} was fixed: use a finite{'' if least < 0 else ', positive'} number")
    names = tuple(name for name in NAMES if (name in FIT or name in free) and name not in fixed)
    with_spring = any(case.legs is not None for case in cases)
    if with_spring and "stiffness" not in (*fixed, *names):
        raise ValueError("the stiffness is not known: give fixed={'stiffness': …} [1/length] or free=('stiffness',)")
    if not with_spring and {"stiffness", "damping"} & set(free):
        raise ValueError("slip was measured, so that no spring enters: leave stiffness and damping out")
    if "alpha" in names and not any(case.legs is not None and np.ptp(case.legs[2]) > 0 for case in cases):
        raise ValueError("alpha cannot be fitted: the normal stress never changes in these data")
    if not names:
        raise ValueError("nothing is left to fit: leave some of a, b, dc and mu0 out of `fixed`")
    return {"v0": cases[0].before, "stiffness": 1.0, **DEFAULTS, **fixed}, names


def _task(cases, law: str, names, fixed: dict, own) -> Task:
    several, slots, labels = len(cases) > 1, [{} for _ in cases], []
    for name in names:
        for number, slot in enumerate(slots):
            if number == 0 or (several and name in own):
                labels.append(f"{name}[{number + 1}]" if several and name in own else name)
            slot[name] = len(labels) - 1
    scatter = float(np.mean([np.std(case.friction[case.used]) for case in cases]))
    samples = sum(int(case.used.sum()) for case in cases)
    if samples < len(labels) + 4:
        raise ValueError(f"{samples} samples cannot tell {len(labels)} parameters: use more data or fix some")
    if scatter == 0:
        raise ValueError("friction never changes in these data: there is nothing to fit")
    return Task(cases, law, tuple(labels), slots, {k: v for k, v in fixed.items() if k not in names}, scatter)


def _values(task: Task, x, number: int) -> dict:
    found = {name: float(x[k]) for name, k in task.slots[number].items()}
    return task.fixed | {k: float(np.exp(v)) if k in LOGARITHMIC else v for k, v in found.items()}


def _residual(task: Task, x) -> np.ndarray:
    """(data − model)/sigma of all samples that count."""
    out = []
    for number, case in enumerate(task.cases):
        model = modelled(case, _values(task, x, number), task.law)
        rest = np.full(len(case.time), FAR * task.scatter) if model is None else case.friction - model
        out.append((rest / case.sigma)[case.used])
    return np.concatenate(out)


def _jacobian(task: Task, x, *, central: bool = False) -> np.ndarray:
    """d residual/dx: exact for the trend, and for μ0 where normal stress is constant, else by differences."""
    base = None if central else _residual(task, x)
    out = np.zeros((sum(int(c.used.sum()) for c in task.cases), len(x)))
    for k, label in enumerate(task.names):
        name, row = label.split("[")[0], 0
        simple = name == "trend" or (
            name == "mu0" and all(c.legs is None or np.ptp(c.legs[2]) == 0 for c in task.cases)
        )
        if not simple:
            step = STEP * (10 if central else 1) * np.eye(len(x))[k]
            ahead = _residual(task, x + step)
            out[:, k] = (ahead - _residual(task, x - step)) / (2 * step[k]) if central else (ahead - base) / step[k]
            continue
        for case, slot in zip(task.cases, task.slots, strict=True):
            column = case.place if name == "trend" else np.ones(len(case.time))
            piece = slice(row, row + int(case.used.sum()))
            if slot[name] == k:
                out[piece, k] = -(column / case.sigma)[case.used]
            row = piece.stop
    return out


def _pieces(task: Task) -> list[slice]:
    """Runs of samples without gaps, over all records."""
    out, row = [], 0
    for case in task.cases:
        out += [slice(row + piece.start, row + piece.stop) for piece in case.pieces]
        row += int(case.used.sum())
    return out


def _split(task: Task, residual) -> list[np.ndarray]:
    return [residual[piece] for piece in _pieces(task)]


def _solve(task: Task, x, filters, most: int = 60, held: int | None = None):
    """Least squares from x on, with one number held where it is if asked for."""
    pieces = _pieces(task)
    moves = np.array([k != held for k in range(len(x))])
    span = np.array([FARTHEST if label.split("[")[0] in LOGARITHMIC else np.inf for label in task.names])[moves]

    def whole(y):
        return np.where(moves, np.insert(y, held, 0.0) if held is not None else y, x)

    return least_squares(
        lambda y: whitened(_residual(task, whole(y)), filters, pieces),
        x[moves],
        jac=lambda y: whitened(_jacobian(task, whole(y)), filters, pieces)[:, moves],
        bounds=(x[moves] - span, x[moves] + span),
        x_scale="jac",
        ftol=1e-10,
        xtol=1e-9,
        gtol=1e-14,
        max_nfev=most,
    )


def _best(task: Task) -> tuple[np.ndarray, int]:
    """The lowest of the valleys that the coarse search leads to."""
    free = {label.split("[")[0] for label in task.names}
    found, count = [], 0
    for start in starts(task.cases, task.law, free, {**BLANK, **task.fixed}):
        x = np.zeros(len(task.names))
        for slot, linear in zip(task.slots, start["linear"], strict=True):
            extra = dict(zip([n for n in ("mu0", "trend") if n in free], linear, strict=True))
            for name, k in slot.items():
                x[k] = np.log(start.get(name) or 0.01) if name in LOGARITHMIC else extra[name]
        solved = _solve(task, x, WHITE, most=25)
        count += solved.nfev
        again = any(abs(solved.cost - cost) < 1e-6 * cost for cost, _ in found)
        found.append((solved.cost, solved.x))
        if again and solved.cost <= min(cost for cost, _ in found) * (1 + 1e-6):
            break  # two ways led to the lowest valley
    if not found:
        raise RuntimeError(
            "the slider runs away with all parameters that were tried: give the damping, or the stiffness"
        )
    x = min(found, key=lambda one: one[0])[1]
    solved = _solve(task, x, WHITE)
    return solved.x, count + solved.nfev


def _finished(task: Task, x, filters, evaluations: int, adequate: bool) -> Fit:
    pieces, m = _pieces(task), len(x)
    rest = whitened(_residual(task, x), filters, pieces)
    n = len(rest)
    size = max(float(np.sqrt(rest @ rest / (n - m))), 1e-15)
    independent = effective(filters, n)
    spare = max(independent - m, 1.0)
    # what a fit takes out of n_eff samples is lost to the estimate of slow noise, too
    reach = float(student.ppf(0.975, spare)) * float(np.sqrt(max(independent / spare * (n - m) / n, 1.0)))
    logs = np.array([label.split("[")[0] in LOGARITHMIC for label in task.names])
    inner, blind = spread(whitened(_jacobian(task, x, central=True), filters, pieces) / size)
    sides = _open_sides(task, x, filters, size * reach, np.where(logs & ~blind, reach * np.sqrt(np.diag(inner)), 0.0))
    told = known(inner, blind, x, task.names, logs, reach, sides)
    peak = max(float(np.sqrt(rest @ rest / n)), 1e-15)
    weights = sum(float(np.log(case.sigma[case.used]).sum()) for case in task.cases)
    likelihood = -n * (0.5 * np.log(2 * np.pi) + 0.5 + np.log(peak)) - weights - log_head(filters, pieces)
    count = m + 1 + len(filters[0])
    models = tuple(modelled(case, _values(task, x, k), task.law) for k, case in enumerate(task.cases))
    rests = tuple(case.friction - one for case, one in zip(task.cases, models, strict=True))
    head = filters[1][0, 0] if len(filters[0]) else 1.0
    return Fit(
        law=task.law, names=task.names, values=told.values, errors=told.errors, intervals=told.intervals,
        covariance=told.covariance, fixed=_kept(task), difference=_difference(told, task),
        identifiable=told.identifiable, adequate=adequate,
        sentence=told.sentence if adequate else f"{MISFIT}; {told.sentence}",
        residuals=rests, models=models, sigma=size * head,
        noise=filters[0], effective=independent, innovations=rest / peak, log_likelihood=likelihood,
        aic=2 * count - 2 * likelihood, bic=count * np.log(n) - 2 * likelihood, evaluations=evaluations,
    )  # fmt: skip


def _kept(task: Task) -> dict:
    spring = any(case.legs is not None for case in task.cases)
    return {k: v for k, v in task.fixed.items() if spring or k not in ("stiffness", "damping")}


def _difference(told: Known, task: Task) -> tuple[float, float, float]:
    gap = told.gap + task.fixed.get("a", 0.0) - task.fixed.get("b", 0.0)
    return gap, gap - told.error, gap + told.error


def _open_sides(task: Task, x, filters, worst: float, half) -> dict:
    """Where a wide interval does not end: far beyond it, with all else fitted again, the data are met as well.

    Intervals follow from slopes at the best point. As k → ∞, say, those vanish while the sum of squares stays finite.
    """
    out, pieces = {}, _pieces(task)
    cost = float(np.sum(whitened(_residual(task, x), filters, pieces) ** 2))
    for k in np.flatnonzero((half > WIDE) & (half < WIDEST)):
        for side, word in ((1.0, "above"), (-1.0, "below")):
            there = x.copy()
            there[k] += side * max(3 * half[k], WIDEST)
            solved = _solve(task, there, filters, most=15, held=int(k))
            if 2 * solved.cost - cost < worst**2:
                out[task.names[k]] = (float(np.exp(x[k] - side * half[k])), word)
    return out
