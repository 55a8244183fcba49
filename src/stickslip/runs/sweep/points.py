"""Random points of a sweep: quantiles of distributions, Latin hypercubes, Sobol' sequences, and refused points."""

import math
import warnings
import zlib
from collections.abc import Iterator

import numpy as np

from ...data.schema import ScenarioError

FEWEST = 0.01  # share of accepted points below which drawing is given up
LEAST_TRIED, MOST_TRIED = 1000, 10_000_000  # points drawn before that, and in all


def generator(seed: int, name: str) -> np.random.Generator:
    """Return the random generator of one key."""
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def latin_hypercubes(names, number: int, seed: int) -> Iterator[dict[str, np.ndarray]]:
    """Yield Latin hypercubes of `number` points in the unit cube, {name: coordinates}, without end.

    Each coordinate has `number` intervals of equal probability, with one point in each (McKay, Beckman and Conover
    1979, doi:10.1080/00401706.1979.10489755).
    """
    generators = {name: generator(seed, name) for name in names}
    while True:
        yield {name: (rng.permutation(number) + rng.random(number)) / number for name, rng in generators.items()}


def sobol_points(names, number: int, seed: int) -> Iterator[dict[str, np.ndarray]]:
    """Yield successive `number` points of a scrambled Sobol' sequence in the unit cube, {name: coordinates}.

    Each coordinate is scrambled by its own generator, so that it depends only on the seed, its name and its place
    among the names (Owen 1998, doi:10.1006/jcom.1998.0487; Matoušek 1998, doi:10.1006/jcom.1998.0489).
    """
    from scipy.stats import qmc

    sequences = [qmc.Sobol(k + 1, seed=generator(seed, name)) for k, name in enumerate(names)]
    while True:
        with warnings.catch_warnings():  # SciPy's advice on powers of two is in the documentation
            warnings.simplefilter("ignore", UserWarning)
            yield {name: sobol.random(number)[:, -1] for name, sobol in zip(names, sequences, strict=True)}


BATCHES = {"latin-hypercube": latin_hypercubes, "sobol": sobol_points}


def quantiles(kind: str, parameters, share: np.ndarray) -> tuple:
    """Return the quantiles of a distribution at given probabilities; its parameters are two ends, or `Normal`."""
    if kind == "normal":
        from scipy.special import ndtri

        return tuple((parameters.mean + parameters.sd * ndtri(np.clip(share, 1e-16, 1 - 1e-16))).tolist())
    low, high = parameters
    if kind == "integers":
        return tuple(np.minimum(low + np.floor(share * (high - low + 1)), high).astype(int).tolist())
    if kind in ("loguniform", "geomspace"):
        return tuple(np.exp(math.log(low) + share * math.log(high / low)).tolist())
    return tuple((low + share * (high - low)).tolist())


def check_effort(accepted: int, tried: int, refused: dict[str, int]) -> None:
    """Raise ScenarioError if conditions refuse so many points that drawing more is hopeless."""
    few = accepted < FEWEST * tried and tried >= LEAST_TRIED
    if few or tried > MOST_TRIED:
        raise ScenarioError(
            f"sweep.where refuses {tried - accepted} of {tried} points ({describe_refusals(refused)}): use a weaker "
            "condition, or narrower distributions"
        )


def describe_refusals(refused: dict[str, int]) -> str:
    """Return the conditions with the number of points that each of them refuses."""
    return ", ".join(f"{count} by {text}" for text, count in refused.items() if count)
