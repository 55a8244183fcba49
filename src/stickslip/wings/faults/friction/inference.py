"""Conclusions from a fit: the posterior of its parameters, its comparison with another fit, and possible remedies.

The posterior is sampled by Markov chains with emcee. The priors are uniform in the coordinates of the fit: logarithms
of positive parameters, and values of all others. The likelihood is that of the filtered residuals, with the
autoregressive noise found by the fit. The size of the noise is integrated out. S is the sum of squares of the filtered
residuals, S₀ its minimum and m the number of parameters; the degrees of freedom ν and the variance s² are those of the
intervals of `fit`. Then

    p(x) ∝ [1 + (S(x) − S₀)/(ν s²)]^{−(ν + m)/2},

which is Student's t distribution where friction is linear in x. Percentiles then agree with the intervals.

Possible causes of a poor fit, such as a missing trend or a stiffness in another unit, are tested by fitting the record
again.
"""

import inspect
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ....kit import (
    Report,
    Seed,
    Size,
    check_value,
    checked,
    readable,
    require,
    require_options,
    require_sizes,
    silent,
    within,
)
from .fitting import EXACT, Fit, Solution, build_fit, noise_size, solve_fit
from .model import LOGARITHMIC, WHITE, Data, autoregression, effective_samples, whitened
from .problem import MAX_SHIFT, covariance, filtered_residual, jacobian, pieces, residual, solve, with_states_in_order

PERCENTS = (2.5, 16.0, 50.0, 84.0, 97.5)
LONG = 50.0  # required length of a chain in autocorrelation times
BURN = 5.0  # number of initial autocorrelation times that are discarded
FITTED = 0.1  # fraction of the work after which the best fit is known
LEAST = 300  # smallest number of steps of a chain, even for short autocorrelation times
BLOCK = 50  # number of steps between two estimates of the autocorrelation time
FREEDOM = 4.0  # degrees of freedom of the proposals; their tails must be wider than those of the posterior
MOST_DRAWS = 10_000


@readable(head=lambda value: f"{len(value.draws)} draws of {', '.join(value.names)}")
class Posterior(NamedTuple):
    """Draws from the posterior distribution of m parameters."""

    fit: Fit
    names: tuple[str, ...]
    draws: np.ndarray  # (K, m), nearly independent
    percentiles: dict  # name → values at 2.5, 16, 50, 84 and 97.5 %
    times: dict  # name → integrated autocorrelation time [steps]
    steps: int  # length of the chain without its discarded start
    acceptance: float  # fraction of proposals accepted

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Draws of each parameter, by name, as `draws` of a sweep expects them."""
        return dict(zip(self.names, self.draws.T, strict=True))


@checked
def posterior(
    data: Data | list[Data], *, walkers: int = 32, steps: int = 4000, seed: Seed = 0, report: Report = silent, **options
) -> Posterior:
    """Sample the posterior distribution of fit parameters.

    Half of the steps propose points from Student's t distribution around the best fit, independent of the current
    point. The others are stretch moves (Goodman and Weare 2010, doi:10.2140/camcos.2010.5.65; Foreman-Mackey et al.
    2013, doi:10.1086/670067). Sampling ends as soon as the chain, without its start, is at least 50 autocorrelation
    times and 300 steps long.

    Parameters
    ----------
    data, options : as for `fit`
    walkers : number of parallel chains, even and at least twice the number of parameters
    steps : largest number of steps of each chain
    seed : seed of the random numbers
    report : called as report(stage, share done, text with acceptance and autocorrelation time)

    Raises
    ------
    RuntimeError
        If draws would not represent the posterior: the data do not determine all parameters, residuals vary as slowly
        as the signal, or the chain is shorter than 50 autocorrelation times.
    MissingExtraError
        If emcee is not installed.

    Examples
    --------
    >>> from stickslip import friction
    >>> legs = friction.velocity_steps([1e-6, 1e-5, 1e-6], distance=5e-5)
    >>> h = friction.spring_slider(
    ...     friction.RateState(0.010, 0.006, 1e-5), friction.Spring(1e4), legs
    ... )
    >>> noisy = h.friction + np.random.default_rng(0).normal(0, 1e-4, len(h.time))
    >>> known = {"stiffness": 1e4, "a": 0.010, "dc": 1e-5}
    >>> data = friction.Data(h.time, noisy, legs)
    >>> found = friction.posterior(data, walkers=8, fixed=known)
    >>> found.names, bool(abs(found.percentiles["b"][2] - 0.006) < 1e-4)
    (('b', 'mu0'), True)
    """
    sizes = (walkers, "walkers"), (steps, "time steps"), (walkers * steps, "samples")
    require_sizes(Size("the chains have", number, kind, "use fewer") for number, kind in sizes)
    require_options(solve_fit, options)
    options = {name: list(value) if isinstance(value, Iterator) else value for name, value in options.items()}
    for name, value in options.items():
        check_value(name, value, inspect.signature(solve_fit).parameters[name].annotation, given=True)
    emcee = require("emcee", "posterior")
    solution = solve_fit(data, **options, report=within(report, end=FITTED))
    fit = build_fit(solution)
    m = len(fit.names)
    if walkers < 2 * m or walkers % 2:
        raise ValueError(f"walkers must be an even number, at least {2 * m} for {m} parameters, got {walkers}")
    if steps < 2 * BLOCK:
        raise ValueError(f"steps must be at least {2 * BLOCK}, got {steps}")
    if not (fit.identifiable and fit.adequate):
        raise RuntimeError(f"there is no posterior to sample: {fit.sentence}")
    density, proposal, draw = _target(solution)
    moves = [(emcee.moves.MHMove(proposal), 0.5), (emcee.moves.StretchMove(), 0.5)]
    sampler = emcee.EnsembleSampler(walkers, m, density, moves=moves)
    generator = np.random.RandomState(seed)
    state = emcee.State(draw(walkers, generator), random_state=generator.get_state())
    while True:
        state = sampler.run_mcmc(state, min(BLOCK, steps - sampler.iteration))
        tau = sampler.get_autocorr_time(tol=0)
        length = sampler.iteration - int(np.ceil(BURN * tau.max()))
        ratio, acceptance = length / tau.max(), float(np.mean(sampler.acceptance_fraction))
        words = f"acceptance {acceptance:.2f}, autocorrelation time τ = {tau.max():.1f} steps"
        done = min(max(ratio, 0.0) / LONG, 1.0)
        report("posterior", FITTED + (1 - FITTED) * done, f"{words}, {sampler.iteration} steps")
        if (ratio >= LONG and length >= LEAST) or sampler.iteration >= steps:
            break
    if not ratio >= LONG:
        slowest = f"τ = {tau.max():.1f} steps for {fit.names[int(tau.argmax())]}"
        raise RuntimeError(
            f"the posterior did not converge: the chain of {max(length, 0)} steps is {max(ratio, 0.0):.1f} "
            f"autocorrelation times long ({slowest}), and {LONG:g} are needed: allow more steps, or fix a parameter"
        )
    chain = sampler.get_chain(discard=sampler.iteration - length)
    return _summary(fit, solution, chain, tau, acceptance)


def _target(solution: Solution) -> tuple[Callable, Callable, Callable]:
    """Return three functions: the log-density, the sampler's proposal with its log-ratio, and random points.

    All three refer to the best fit under the final noise.
    """
    task, filters = solution.task, solution.filters
    best = solve(task, solution.x, filters).x
    size, spare, widening = noise_size(task, best, filters)
    scale = size * widening
    least, m = float(np.sum(filtered_residual(task, best, filters) ** 2)), len(best)
    rows = whitened(jacobian(task, best, central=True), filters, pieces(task)) / scale
    runs = pieces(task)
    root = np.linalg.cholesky(covariance(rows)[0])

    def density(x) -> float:
        if (np.abs(x - best)[task.logs] > MAX_SHIFT).any() or (with_states_in_order(task, x) != x).any():
            return -np.inf
        excess = float(np.sum(whitened(residual(task, x), filters, runs) ** 2)) - least
        return -0.5 * (spare + m) * np.log1p(max(excess / (spare * scale**2), -0.5))

    def draw(count: int, generator) -> np.ndarray:
        normal, chi = generator.normal(size=(count, m)), generator.chisquare(FREEDOM, size=(count, 1))
        return best + (normal / np.sqrt(chi / FREEDOM)) @ root.T

    def log_proposal(points) -> np.ndarray:
        offsets = np.linalg.solve(root, (points - best).T)
        return -0.5 * (FREEDOM + m) * np.log1p(np.sum(offsets**2, axis=0) / FREEDOM)

    def proposal(points, generator) -> tuple[np.ndarray, np.ndarray]:
        new = draw(len(points), generator)
        return new, log_proposal(points) - log_proposal(new)

    return density, proposal, draw


def _summary(fit: Fit, solution: Solution, chain: np.ndarray, tau: np.ndarray, acceptance: float) -> Posterior:
    """Thin the chain, and compute percentiles from the complete chain."""
    logs = solution.task.logs
    values = np.where(logs, np.exp(np.where(logs, chain, 0.0)), chain)
    steps, walkers = values.shape[:2]
    every = max(int(tau.max()), int(np.ceil(steps * walkers / MOST_DRAWS)), 1)
    flat = values.reshape(-1, len(fit.names))
    percentiles = {name: tuple(np.percentile(flat[:, k], PERCENTS).tolist()) for k, name in enumerate(fit.names)}
    times = dict(zip(fit.names, tau.tolist(), strict=True))
    return Posterior(fit, fit.names, values[::every].reshape(-1, flat.shape[1]), percentiles, times, steps, acceptance)


STRONG = 6.0  # smallest significant difference of AIC: a likelihood ratio of 20
SIGNIFICANT = 1.96  # smallest significant value of Vuong's statistic, two-sided 95 %


@readable
class LawComparison(NamedTuple):
    """Result of a comparison of two fits."""

    preferred: str | None  # law, or None if the data do not discriminate
    delta_aic: float  # AIC of the other law minus that of the better one, ≥ 0
    evidence: float  # exp(ΔAIC/2)
    vuong: float  # positive if the first fit is better
    sentence: str


@checked
def compare_laws(first: Fit, second: Fit) -> LawComparison:
    """Test whether the data discriminate between two fits.

    ΔAIC shows which fit is closer to the data. Because the laws are not nested and both may be wrong, the difference
    must also exceed its own scatter: Vuong's z = Σ d/(√N s_d), with d the difference in log-likelihood per sample
    (doi:10.2307/1912557). A fit is preferred if ΔAIC ≥ 6, |z| ≥ 1.96, and it describes the record (`Fit.adequate`).

    Raises
    ------
    ValueError
        If the fits do not use the same samples.
    """
    same = len(first.models) == len(second.models) and first.samples == second.samples
    for own, other in zip(first.residuals, second.residuals, strict=False):
        same = same and len(own) == len(other)
    data = [[r + m for r, m in zip(f.residuals, f.models, strict=True)] for f in (first, second)] if same else [[], []]
    if not same or not all(np.allclose(p, q, rtol=0, atol=1e-9) for p, q in zip(*data, strict=True)):
        raise ValueError("the two fits use different data: compare fits to the same records and windows")
    gap = second.aic - first.aic
    mean = (first.log_likelihood - second.log_likelihood) / first.samples
    each = 0.5 * (second.innovations**2 - first.innovations**2)
    scatter = float(np.std(each))
    z = mean * np.sqrt(first.samples) / scatter if scatter > 0 else 0.0
    names = [f"{f.law} law" for f in (first, second)]
    if names[0] == names[1]:
        names = ["first fit", "second fit"]
    ratio = float(np.exp(min(abs(gap) / 2, 700.0)))
    numbers = f"ΔAIC = {abs(gap):.3g}, Vuong's z = {abs(z):.2g}"
    better = 0 if gap > 0 else 1
    fails = "" if first.adequate or second.adequate else "; neither describes the record"
    if abs(gap) < STRONG or abs(z) < SIGNIFICANT or (z > 0) != (gap > 0):
        told = f"the data do not discriminate between the two{fails} ({numbers})"
        return LawComparison(None, abs(gap), ratio, z, told)
    if not (first, second)[better].adequate:
        told = f"no law is preferred: the {names[better]} is closer to the data"
        told += fails or ", but does not describe them"
        return LawComparison(None, abs(gap), ratio, z, f"{told} ({numbers})")
    law = (first, second)[better].law
    return LawComparison(
        law, abs(gap), ratio, z, f"the data prefer the {names[better]} to the {names[1 - better]} ({numbers})"
    )


LEAST_FALL = 0.05  # relative decrease of the residuals below which a trend matters little
SURE = 16.0  # smallest significant χ² of the trends: four standard errors for a single trend
STEEP = 3.0  # ratio of stiffness to steepest rise of friction, or its inverse, beyond which the record is fitted again
FAR, SURELY = 2.0, 1.1  # smallest ratio of stiffnesses that contradict each other, without and with an interval
CLEAR = 2.0  # distance in half widths of the 95 % interval at which a stiffness contradicts an adequate fit
NEAR = 1.3  # largest ratio of two stiffnesses that count as equal in the search for a unit
BY_LENGTH = {"1/cm": 1e2, "1/mm": 1e3, "1/um": 1e6}  # in 1/m
BY_STRESS = {"Pa/m": 1.0, "kPa/m": 1e3, "MPa/m": 1e6, "GPa/m": 1e9}  # in Pa/m; GPa/m = MPa/mm
NORMAL = 1e4, 1e9  # range of normal stress in laboratories [Pa]
USUAL = 1e7  # usual normal stress [Pa]
PLAUSIBLE = 0.03, 3.0  # range of plausible friction of faults


class Gain(NamedTuple):
    """Effect on a fit of one additional parameter per record."""

    values: tuple[float, ...]  # values of the parameter, one per record
    shifts: dict[str, float]  # change of each other parameter, relative for positive parameters
    before: float  # root mean square of the residuals without the parameter; `after` is that with it
    after: float
    helps: bool  # True if the residuals decrease noticeably and by more than noise explains

    @property
    def fall(self) -> float:
        """Relative decrease of the residuals."""
        return 1 - self.after / self.before


def gain_by(name: str, solution: Solution) -> Gain:
    """Fit an additional parameter for each record: "trend", or "theta" for a start away from steady state.

    The relative decrease of the sum of squares is multiplied by the number of independent samples in the remaining
    residuals, so slow noise is not mistaken for a trend.
    """
    task, start = solution.task, solution.x
    before = residual(task, start)
    size, scatter = float(np.sqrt(np.mean(before**2))), task.scatter
    if name in task.slots[0] or size < EXACT * scatter:
        return Gain((0.0,) * len(task.cases), {}, size, size, helps=False)
    count = len(start)
    more = task._replace(
        names=(*task.names, *(f"{name}[{k + 1}]" for k in range(len(task.cases)))),
        slots=[slot | {name: count + k} for k, slot in enumerate(task.slots)],
        fixed={key: value for key, value in task.fixed.items() if key != name},
    )
    x = solve(more, np.append(start, np.zeros(len(task.cases))), WHITE).x
    after = residual(more, x)
    independent = effective_samples(autoregression([after[run] for run in pieces(more)]), len(after))
    rest = float(np.sqrt(np.mean(after**2)))
    sure = (size**2 / max(rest, EXACT * scatter) ** 2 - 1) * independent > SURE
    moved = np.where(task.logs, np.expm1(x[:count] - start), x[:count] - start)
    values = np.exp(x[count:]) if name in LOGARITHMIC else x[count:]
    shifts = dict(zip(task.names, moved.tolist(), strict=True))
    return Gain(tuple(values.tolist()), shifts, size, rest, helps=sure and 1 - rest / size > LEAST_FALL)


class StiffnessDoubt(NamedTuple):
    """A given stiffness that contradicts the record, and the unit that it probably has."""

    given: float  # [1/m]
    shown: float  # stiffness that the record shows, from a fit with the stiffness free [1/m]
    interval: tuple[float, float]  # 95 % interval of `shown`; NaN if unknown
    unit: str  # likelier unit of the given number; "" if unknown
    value: float  # the given number converted from that unit [1/m]
    friction: float = np.nan  # median friction of the record
    normal: float = np.nan  # normal stress for which `unit` would be right, if none was recorded [Pa]

    def __str__(self) -> str:
        low, high = self.interval
        other = self.other_columns()
        between = f" (95 %: {low:.4g} to {high:.4g})" if np.isfinite(low) else ""
        doubt = f"a stiffness of {self.given:g} 1/m contradicts the record, which shows {self.shown:.4g} 1/m{between}"
        if not self.unit:
            return f"{doubt}: check the value, or fit it with --free-stiffness{other}"
        if np.isfinite(self.normal):
            return (
                f"{doubt}: is its unit right? {self.given:g} {self.unit} would be {self.shown:.4g} 1/m at a normal "
                f"stress of {self.normal / 1e6:.2g} MPa: divide it by the normal stress, or use --free-stiffness{other}"
            )
        return (
            f"{doubt}: is its unit right? {self.given:g} {self.unit} is {self.value:.6g} 1/m: give --stiffness "
            f"{self.value:.6g}, or use --free-stiffness{other}"
        )

    def other_columns(self) -> str:
        """Other explanations: as stiffness is friction over displacement, a column may have a wrong unit."""
        power = float(np.log10(self.shown / self.given))
        if round(power) == 0 or abs(power - round(power)) > np.log10(NEAR):
            return ""
        factor, small = f"{10.0 ** abs(round(power)):g}", power > 0
        size = "small" if small else "large"
        said = f"; or displacements are {factor} times too {size} (wrong unit of load_point, or of --velocity)"
        if np.isfinite(self.friction) and not PLAUSIBLE[0] < self.friction < PLAUSIBLE[1]:
            said += (
                f", or friction, {self.friction:.2g}, is {factor} times too {'large' if small else 'small'} (a stress)"
            )
        return f"{said}, with the correct stiffness"


def stiffness_doubt(data: Data, solution: Solution, normal: float | None = None) -> StiffnessDoubt | None:
    """Compare a fixed stiffness with the record; return None if they agree or the record does not determine it.

    Per unit of load-point displacement, friction rises by at most k (1 − V/V_l), which is k after a hold or a large
    step. If the steepest rise is far from k, or the fit does not describe the record, the record is fitted again with
    the stiffness free.

    Parameters
    ----------
    normal : recorded normal stress [Pa]; None if it is unknown
    """
    task = solution.task
    given = task.fixed.get("stiffness", np.nan)
    (case,) = task.cases
    if case.legs is None or "stiffness" in task.slots[0]:
        return None
    # slopes over five samples, to suppress noise
    run, rise = case.place[4:] - case.place[:-4], case.friction[4:] - case.friction[:-4]
    steepest = max(float(np.quantile(rise[run > 0] / run[run > 0], 0.98)), 1e-12) if (run > 0).any() else 1.0
    usual = _is_near(given, steepest, STEEP)
    fixed = {name: value for name, value in task.fixed.items() if name != "stiffness" and np.isfinite(value)}
    free = tuple(name for name in task.names if name not in ("a", "b", "dc", "mu0"))
    again = build_fit(
        solve_fit(data, law=task.law, form=task.form, fixed=fixed, free=(*free, "stiffness"), report=task.report)
    )
    shown, interval = again.values["stiffness"], again.intervals["stiffness"]
    if not np.isfinite(shown) or _is_near(given, shown, SURELY if again.adequate else FAR):
        return None
    if usual and not again.adequate:
        return None
    width = np.log(interval[1] / interval[0]) / 2
    if again.adequate and np.isfinite(width):
        if abs(np.log(given / shown)) < CLEAR * width:
            return None
    else:
        before = np.sqrt(np.mean(residual(solution.task, solution.x) ** 2))
        falls = np.std(again.residuals[0][case.used]) <= (1 - LEAST_FALL) * before
        if interval[0] <= given <= interval[1] or not falls:
            return None
    unit, value, needed = _likelier_unit(given, shown, normal)
    return StiffnessDoubt(given, shown, interval, unit, value, float(np.median(np.abs(case.friction))), needed)


def _is_near(value: float, other: float, ratio: float) -> bool:
    return abs(np.log(value / other)) < np.log(ratio)


def _likelier_unit(given: float, shown: float, normal: float | None) -> tuple[str, float, float]:
    """Unit with which the given number agrees with the record, its value in 1/m, and the normal stress needed."""
    known = dict(BY_LENGTH) | ({} if normal is None else {unit: size / normal for unit, size in BY_STRESS.items()})
    unit = min(known, key=lambda symbol: abs(np.log(given * known[symbol] / shown)))
    if _is_near(given * known[unit], shown, NEAR):
        return unit, given * known[unit], np.nan
    stresses = {unit: given * size / shown for unit, size in BY_STRESS.items()}
    unit = min(stresses, key=lambda symbol: abs(np.log(stresses[symbol] / USUAL)))
    if normal is None and not _is_near(given, shown, STEEP) and NORMAL[0] <= stresses[unit] <= NORMAL[1]:
        return unit, shown, stresses[unit]
    return "", np.nan, np.nan
