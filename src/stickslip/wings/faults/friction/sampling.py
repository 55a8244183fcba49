"""Posterior distribution of fit parameters, sampled by Markov chains with emcee.

The priors are uniform in the coordinates of the fit: logarithms of positive parameters, and the others themselves.
The likelihood is that of the filtered residuals, with the autoregressive noise found by the fit. The size of the noise
is integrated out. S is the sum of squares of the filtered residuals, S₀ its minimum and m the number of parameters;
the degrees of freedom ν and the variance s² are those of the intervals of `fit`. Then

    p(x) ∝ [1 + (S(x) − S₀)/(ν s²)]^{−(ν + m)/2},

which is Student's t distribution where friction is linear in x. Percentiles then agree with the intervals.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ....kit import Report, Seed, Size, checked, readable, require, require_options, require_sizes, silent, within
from .fitting import Fit, Solution, build_fit, noise_size, solve_fit
from .model import Data, whitened
from .problem import MAX_SHIFT, covariance, filtered_residual, jacobian, pieces, residual, solve, with_states_in_order

PERCENTS = (2.5, 16.0, 50.0, 84.0, 97.5)
LONG = 50.0  # required length of a chain in autocorrelation times
BURN = 5.0  # number of initial autocorrelation times that are discarded
FITTED = 0.1  # fraction of the work after which the best fit is known
LEAST = 300  # fewest steps of a chain, even for short autocorrelation times
BLOCK = 50  # steps between two estimates of the autocorrelation time
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
    steps: int  # length of the chain without its start
    acceptance: float  # fraction of proposals accepted

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Draws of each parameter, as for `draws` of a sweep."""
        return dict(zip(self.names, self.draws.T, strict=True))


@checked
def posterior(
    data: Data | list[Data], *, walkers: int = 32, steps: int = 4000, seed: Seed = 0, report: Report = silent, **options
) -> Posterior:
    """Sample the posterior distribution of fit parameters.

    Half of the steps propose points from Student's t distribution around the best fit, independent of the current
    point. The others are stretch moves (Goodman and Weare 2010, doi:10.2140/camcos.2010.5.65; Foreman-Mackey et al.
    2013, doi:10.1086/670067). Sampling ends as soon as the chain, without its start, has 50 autocorrelation times and
    at least 300 steps.

    Parameters
    ----------
    data, options : as for `fit`
    walkers : number of parallel chains, even and at least twice the number of parameters
    steps : largest number of steps of each chain
    seed : seed of the random numbers
    report : called as report(stage, share done, text with acceptance and autocorrelation time)

    Raises
    ------
    ValueError
        If the input is not valid.
    RuntimeError
        If the data do not determine all parameters, if residuals vary as slowly as the signal, or if the chain is
        shorter than 50 autocorrelation times; draws would not represent the posterior.
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
    require_sizes(Size("the chains are of", number, kind, "use fewer") for number, kind in sizes)
    require_options(solve_fit, options)
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
    """Return three functions: log-density, proposal of the sampler with its log-ratio, and random points.

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
