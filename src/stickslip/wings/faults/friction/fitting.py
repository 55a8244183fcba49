"""Least-squares fits of rate-and-state parameters to records, with correlated noise, intervals and identifiability.

Correlated residuals are modelled as an autoregressive process, whose order is selected by BIC. The correlation is
filtered out of both data and model (generalised least squares). Intervals and likelihood refer to the filtered problem.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from ....kit import Report, checked, readable, silent, within
from .laws import EVOLUTIONS, FORMS, RateState
from .model import (
    DEFAULTS,
    FIT,
    LINEAR,
    NAMES,
    OWN,
    PLAIN,
    TO_DEVIATION,
    WHITE,
    Data,
    autoregression,
    effective_samples,
    find_spikes,
    log_head_volume,
    model_friction,
    noise_level,
    prepare,
    whitened,
    without,
)
from .problem import (
    Estimates,
    Task,
    covariance,
    estimate,
    filtered_residual,
    find_best,
    find_open_sides,
    jacobian,
    parameters_of,
    pieces,
    residual,
    solve,
    without_intervals,
)
from .ranges import Number

MIN_INDEPENDENT = 3.0  # independent samples per parameter; with fewer, residuals do not count as noise
MISFIT = (
    "the residuals vary as slowly as the signal: either the law does not describe these data, or their noise is "
    "equally slow, and the data cannot distinguish the two; the values are the best fit, but without intervals"
)
UNLIKE = (
    "the residuals are not noise: filtered for their correlation, they are {:.2g} times the noise of the record, so "
    "the law, the stiffness or the motion of the load point does not describe these data; the values are the best fit, "
    "but intervals cannot be given"
)
# relative excess of the sum of squares, in units of m/n_eff: at most 0.54 in 240 fits of the right law, 1.4 to 3.7 with
# a wrong law; if noise is correlated over much of a leg, even the right law may exceed this limit
MAX_EXCESS = 1.0
# filtered residuals over noise: 0.8 to 1.1 for the right law, even with correlated noise, and up to 1.31 with
# long-tailed noise (Student's t, 3 degrees of freedom); at least 1.4 if a stiffness is wrong by a factor of three
MOST_REDUCED = 1.35
SHARE_OF_SEARCH = 0.8  # fraction of a fit's work done before noise is modelled
ROUNDS = 3  # number of times that noise and parameters are estimated in turn
EXACT = 1e-7  # ratio of residuals to the scatter of friction below which the residuals are integration errors
TINY = 1e-15  # smallest size of noise


@readable
class Fit(NamedTuple):
    """Fitted parameters of one law. Undetermined parameters are NaN; `sentence` then suggests a remedy."""

    law: str
    names: tuple[str, ...]  # names of the m free parameters; "mu0[2]" belongs to the second data set
    values: dict  # name → value
    errors: dict  # name → standard error
    intervals: dict  # name → (low, high) of the 95 % interval
    covariance: np.ndarray  # (m, m), in the order of names; NaN for undetermined parameters
    fixed: dict  # name → value, including v0
    difference: tuple[float, float, float]  # a − b and its 95 % interval
    identifiable: bool  # True if the data determine all parameters
    adequate: bool  # True if the fit describes the record: residuals are as fast and small as its noise
    sentence: str
    residuals: tuple[np.ndarray, ...]  # data − model, one array per data set
    models: tuple[np.ndarray, ...]  # friction of the model at all samples
    sigma: float  # standard deviation of the noise, relative to `Data.sigma` if that is given
    noise: np.ndarray  # autoregressive coefficients; empty for white noise
    effective: float  # number of independent samples
    innovations: np.ndarray  # filtered residuals divided by their size, for `compare_laws`
    log_likelihood: float
    aic: float
    bic: float
    evaluations: int
    reduced: float = 1.0  # size of the filtered residuals over that of the record's noise
    form: str = "logarithmic"
    spikes: tuple[np.ndarray, ...] = ()  # indices of the samples excluded as spikes, for each data set

    @property
    def samples(self) -> int:
        """Number of samples used."""
        return len(self.innovations)

    def rate_state(self, number: int = 1) -> RateState:
        """Fitted parameters as a `RateState`, with mu0 of one of the data sets (counted from 1)."""
        both = {**self.fixed, **self.values}
        names = ("a", "b", "dc", "mu0", "v0", "alpha", *(name for name in PLAIN if name in both))
        values = {name: both.get(name, both.get(f"{name}[{number}]")) for name in names}
        return RateState(**values, law=self.law, form=self.form)


@checked
def fit(
    data: Data | list[Data],
    *,
    law: str = "aging",
    form: str = "logarithmic",
    fixed: dict[str, Number] | None = None,
    free: Iterable[str] = (),
    own: Iterable[str] = OWN,
    windows=None,
    noise: str = "correlated",
    report: Report = silent,
) -> Fit:
    """Fit a, b, D_c, μ0 and other free parameters to one or several records.

    The model is a law of `RateState`, plus trend × displacement and drift × time. Slider and state are integrated over
    complete records, from the first leg to the last. Positive parameters are fitted as logarithms; starting values come
    from a coarse search. Compare Reinen and Weeks 1993, doi:10.1029/93JB00780.

    Parameters
    ----------
    data : one record, or several that share all parameters except those in `own`
    law : "aging" or "slip"
    form : "logarithmic" or "regularized", see `RateState`
    fixed : known parameters, such as {"stiffness": 1e4}; any of a, b, dc, mu0, v0, b2 and dc2 (second state, default:
        none), v1 and v2 (cut-off velocities, default: none), stiffness, damping, alpha, theta (ratio of initial to
        steady state, default: 1), trend (default: 0), trend_length, over which the trend decays (default: it never
        decays), and drift [1/time] (default: 0)
    free : parameters to fit in addition to a, b, dc and mu0, such as ("stiffness", "trend"), ("trend", "trend_length")
        for a trend that decays exponentially, or ("b2", "dc2") for two states
    own : parameters with a separate value for each of several records
    windows : pairs (start, end) of times; only samples within them are fitted, but slip continues between them.
        None: all samples
    noise : "correlated", or "white" if neighbouring samples are known to be independent
    report : called as report(stage, share done, text with the misfit and the parameters)

    Returns
    -------
    Fit
        Parameters that the data do not determine are NaN, and `sentence` explains why. Spikes, which are the same for
        every law, are excluded. Intervals are missing if the fit does not describe the record (`Fit.adequate`):
        residuals vary as slowly as the signal, or, filtered for their correlation, exceed 1.35 times the noise. This
        noise is the larger of two estimates, from neighbouring samples and from the bulk of the residuals.

    Raises
    ------
    RuntimeError
        If the slider runs away with all parameters that were tried.

    Examples
    --------
    >>> from stickslip import friction
    >>> legs = friction.velocity_steps([1e-6, 1e-5], distance=2e-4)
    >>> h = friction.spring_slider(
    ...     friction.RateState(0.010, 0.006, 1e-5), friction.Spring(1e4), legs
    ... )
    >>> found = friction.fit(
    ...     friction.Data(h.time, h.friction, legs), fixed={"stiffness": 1e4}
    ... )
    >>> print(round(found.values["a"], 6), round(found.values["b"], 6))
    0.01 0.006
    """
    options = {"own": own, "windows": windows, "noise": noise, "report": report}
    return build_fit(solve_fit(data, law=law, form=form, fixed=fixed, free=free, **options))


class Solution(NamedTuple):
    """Best parameters of a task, and its noise."""

    task: Task
    x: np.ndarray
    filters: tuple
    evaluations: int
    adequate: bool
    reduced: float = 1.0
    spikes: tuple[np.ndarray, ...] = ()


@checked
def solve_fit(
    data: Data | list[Data], *, law: str = "aging", form: str = "logarithmic", fixed: dict[str, Number] | None = None,
    free: Iterable[str] = (), own: Iterable[str] = OWN, windows=None, noise: str = "correlated",
    report: Report = silent,
) -> Solution:  # fmt: skip
    """Find the best parameters; the arguments are those of `fit`."""
    records = [data] if isinstance(data, Data) else list(data)
    if not records:
        raise ValueError("there are no data: give one record, or a list of records")
    for name in own:
        if name not in NAMES:
            raise ValueError(f"own contains the unknown parameter {name!r}; parameters are {', '.join(NAMES)}")
    cases = [prepare(record, windows) for record in records]
    spikes = tuple(map(find_spikes, cases))
    cases = [case._replace(used=without(case.used, left)) for case, left in zip(cases, spikes, strict=True)]
    fixed = {name: np.asarray(value).item() for name, value in (fixed or {}).items()}
    fixed, names = _check_parameters(cases, (law, form), fixed, tuple(free), noise)
    task = _build_task(cases, (law, form), names, fixed, own)
    x, evaluations = find_best(task._replace(report=within(report, end=SHARE_OF_SEARCH)))
    task = task._replace(report=within(report, SHARE_OF_SEARCH, 1.0))
    filters, adequate, least = WHITE, True, x
    if noise == "correlated":
        x, filters, adequate, more = _fit_correlated(task, x)
        evaluations += more
    rest = filtered_residual(task, x, filters)
    # the larger of two estimates of the noise: between neighbouring samples, and from the bulk of the residuals
    level = max(noise_level(task.cases), TO_DEVIATION * float(np.median(np.abs(rest))))
    reduced = float(np.sqrt(np.mean(rest**2))) / max(level, TINY)
    if reduced > MOST_REDUCED:
        x, adequate = least, False
    return Solution(task, x, filters, evaluations, adequate, reduced, spikes)


def _fit_correlated(task: Task, start) -> tuple[np.ndarray, tuple, bool, int]:
    """Estimate parameters and noise alternately; return x, filters, True if residuals are noise, and evaluation count.

    Residuals are not noise if fewer than MIN_INDEPENDENT independent samples per parameter are left, or if filtering
    moves the estimate away from that of ordinary least squares. (Under the correct law, the sum of squares exceeds its
    minimum only by a fraction of order m/n_eff.) The residuals then vary as slowly as the signal. Filtering would
    remove the signal as well, so the ordinary least-squares estimate is returned.
    """
    x, evaluations = start, 0
    rest = residual(task, x)
    least = float(rest @ rest)
    if np.sqrt(least / len(rest)) < EXACT * task.scatter:
        return start, WHITE, True, 0
    runs = pieces(task)
    first = filters = autoregression([rest[run] for run in runs])
    report = task.report
    for number in range(ROUNDS):
        task = task._replace(report=within(report, number / ROUNDS, (number + 1) / ROUNDS))
        if effective_samples(filters, len(rest)) < MIN_INDEPENDENT * len(x):
            return start, first, False, evaluations
        solved = solve(task, x, filters)
        x, evaluations = solved.x, evaluations + solved.nfev
        rest = residual(task, x)
        # rows g (m, N) with Σ g gᵀ = J C Jᵀ: noise absorbed by the fit; C = (JᵀΣ⁻¹J)⁻¹ is the parameters' covariance
        noise, slopes = filtered_residual(task, x, filters), jacobian(task, x)
        size, vectors = np.linalg.eigh(covariance(whitened(slopes, filters, runs))[0])
        variance = float(noise @ noise) / (len(noise) - len(x))
        absorbed = (slopes @ (vectors * np.sqrt(variance * np.maximum(size, 0.0)))).T
        taken = [[column[run] for run in runs] for column in absorbed]
        filters = autoregression([rest[run] for run in runs], taken=taken)
    if (float(rest @ rest) / max(least, TINY) - 1) * effective_samples(filters, len(rest)) / len(x) > MAX_EXCESS:
        return start, first, False, evaluations
    return x, filters, True, evaluations


def _check_parameters(cases, laws: tuple[str, str], fixed: dict, free, noise: str) -> tuple[dict, tuple[str, ...]]:
    """Check the options; return all fixed values and the names of the free parameters."""
    for name, value, allowed in zip(("law", "form"), laws, (EVOLUTIONS, FORMS), strict=True):
        if value not in allowed:
            raise ValueError(f"{name} must be {' or '.join(map(repr, allowed))}, got {value!r}")
    if noise not in ("correlated", "white"):
        raise ValueError(f"noise must be 'correlated' or 'white', got {noise!r}")
    for name in (*fixed, *free):
        if name not in (*NAMES, "v0") or (name == "v0" and name in free):
            raise ValueError(
                f"{name!r} is not a parameter; parameters are {', '.join(NAMES)}, and v0, which is always fixed"
            )
    for name in set(fixed) & set(free):
        raise ValueError(f"{name} cannot be both fixed and free: choose one")
    for name, value in fixed.items():
        least = -np.inf if name in LINEAR else 0.0
        if (
            not np.isfinite(value)
            or value < least
            or (value == 0 and name in ("a", "dc", "v0", "dc2", "v1", "v2", "stiffness", "theta", "trend_length"))
        ):
            raise ValueError(f"{name} = {value} was fixed: use a finite{'' if least < 0 else ', positive'} number")
    names = tuple(name for name in NAMES if (name in FIT or name in free) and name not in fixed)
    with_spring = any(case.legs is not None for case in cases)
    if with_spring and "stiffness" not in (*fixed, *names):
        raise ValueError("the stiffness is missing: give fixed={'stiffness': …} [1/length] or free=('stiffness',)")
    if not with_spring and {"stiffness", "damping"} & set(free):
        raise ValueError("the slip velocity was measured, so there is no spring: leave stiffness and damping out")
    if "alpha" in names and not any(case.legs is not None and np.ptp(case.legs[2]) > 0 for case in cases):
        raise ValueError("alpha cannot be fitted because the normal stress never changes in these data: leave it out")
    if laws[1] == "regularized" and {"v1", "v2"} & {*fixed, *names}:
        raise ValueError("cut-off velocities require the logarithmic form, not the regularized one")
    if len({"b2", "dc2"} & {*fixed, *names}) == 1:
        raise ValueError("a second state has two parameters, b2 and dc2: give both, each fixed or free")
    if "trend_length" in {*fixed, *names} and "trend" not in {*fixed, *names}:
        raise ValueError("trend_length requires a trend: fit the trend as well (--detrend)")
    if not names:
        raise ValueError("there is nothing to fit: remove some of a, b, dc and mu0 from `fixed`")
    return {"v0": cases[0].before, "stiffness": 1.0, **DEFAULTS, **fixed}, names


def _build_task(cases, laws: tuple[str, str], names, fixed: dict, own) -> Task:
    several, slots, labels = len(cases) > 1, [{} for _ in cases], []
    for name in names:
        for number, slot in enumerate(slots):
            if number == 0 or (several and name in own):
                labels.append(f"{name}[{number + 1}]" if several and name in own else name)
            slot[name] = len(labels) - 1
    scatter = float(np.mean([np.std(case.friction[case.used]) for case in cases]))
    samples = sum(int(case.used.sum()) for case in cases)
    if samples < len(labels) + 4:
        raise ValueError(f"{samples} samples cannot determine {len(labels)} parameters: use more data or fix some")
    if all(np.ptp(case.friction[case.used]) == 0 for case in cases):
        raise ValueError("friction never changes in these data: there is nothing to fit")
    law, form = laws
    return Task(cases, law, tuple(labels), slots, {k: v for k, v in fixed.items() if k not in names}, scatter, form)


def noise_size(task: Task, x, filters) -> tuple[float, float, float]:
    """Size of the filtered noise, its degrees of freedom, and a factor by which intervals are widened.

    If the noise is slow, the fit uses up a larger part of its degrees of freedom; the factor corrects for this.
    """
    rest, m = filtered_residual(task, x, filters), len(x)
    n, independent = len(rest), effective_samples(filters, len(rest))
    spare = max(independent - m, 1.0)
    widening = float(np.sqrt(max(independent / spare * (n - m) / n, 1.0)))
    return max(float(np.sqrt(rest @ rest / (n - m))), TINY), spare, widening


def _evaluate(task: Task, x, filters) -> Estimates:
    """Estimate parameters, intervals and identifiability for the noise described by the filters."""
    size, spare, widening = noise_size(task, x, filters)
    reach = float(stdtrit(spare, 0.975)) * widening
    inner, blind = covariance(whitened(jacobian(task, x, central=True), filters, pieces(task)) / size)
    wide = np.where(task.logs & ~blind, reach * np.sqrt(np.diag(inner)), 0.0)
    sides = find_open_sides(task, x, filters, size * reach, wide)
    return estimate(inner, blind, x, task.names, task.logs, reach, sides)


def build_fit(solution: Solution) -> Fit:
    """Compute intervals, likelihood and information criteria for the best parameters."""
    task, x, filters, evaluations, adequate, reduced, spikes = solution
    reason = UNLIKE.format(reduced) if reduced > MOST_REDUCED else MISFIT
    estimates = _evaluate(task, x, filters) if adequate else without_intervals(_evaluate(task, x, WHITE), reason)
    rest = filtered_residual(task, x, filters)
    n, peak = len(rest), max(float(np.sqrt(np.mean(rest**2))), TINY)
    weights = sum(float(np.log(case.sigma[case.used]).sum()) for case in task.cases)
    likelihood = -n * (0.5 * np.log(2 * np.pi) + 0.5 + np.log(peak)) - weights - log_head_volume(filters, pieces(task))
    count = len(x) + 1 + len(filters[0])
    models = tuple(
        model_friction(case, parameters_of(task, x, k), task.law, task.form) for k, case in enumerate(task.cases)
    )
    spring = any(case.legs is not None for case in task.cases)
    idle = {k for k, v in PLAIN.items() if task.fixed.get(k) == v and (k != "dc2" or task.fixed.get("b2") == 0)}
    idle |= set() if spring else {"stiffness", "damping"}
    gap = estimates.gap + task.fixed.get("a", 0.0) - task.fixed.get("b", 0.0)
    return Fit(
        law=task.law, names=task.names, values=estimates.values, errors=estimates.errors, intervals=estimates.intervals,
        covariance=estimates.covariance, fixed={k: v for k, v in task.fixed.items() if k not in idle},
        difference=(gap, gap - estimates.error, gap + estimates.error),
        identifiable=estimates.identifiable, adequate=adequate, sentence=estimates.sentence,
        residuals=tuple(case.friction - model for case, model in zip(task.cases, models, strict=True)), models=models,
        sigma=peak * float(np.sqrt(n / (n - len(x)))) / (filters[1][0, 0] if len(filters[0]) else 1.0),
        noise=filters[0], effective=effective_samples(filters, n), innovations=rest / peak, log_likelihood=likelihood,
        aic=2 * count - 2 * likelihood, bic=count * np.log(n) - 2 * likelihood, evaluations=evaluations, form=task.form,
        reduced=reduced, spikes=spikes,
    )  # fmt: skip
