"""First complex pairs under several contact laws: a summary of many packings."""

from itertools import groupby
from typing import NamedTuple

import numpy as np

DRAWS = 4000  # bootstrap draws; the ends of an interval vary by a few per cent of its width
UNLIMITED = 1e6  # μ above which no contact reaches the limit


class Births(NamedTuple):
    """First pairs of packings under one law; strains are medians over all packings, infinite if no pair is born."""

    kind: str
    coulomb: str
    mu: float
    packings: int
    born: int  # number of packings with a pair
    limited: int  # number of births with at least one contact at the Coulomb limit
    strain: float  # median strain of the first pair
    low: float  # lower end of the 95 % interval of the median, from a bootstrap over packings
    high: float
    share: float  # median fraction of contacts at the limit at birth
    mobilisation: float  # median over births of the largest |F_t|/(μ F_n)
    pairs: float  # median number of pairs at the last strain

    @property
    def sources(self) -> str:
        """Sources of the asymmetry of J other than the rotation of contacts: k_t, the limit, sliding."""
        limited = self.mu < UNLIMITED
        parts = ("k_t" if self.kind != "linear" else "", "limit" if limited and self.coulomb == "smooth" else "",
                 "sliding" if limited else "")  # fmt: skip
        return ", ".join(filter(None, parts)) or "geometry alone"


def law_words(one: Births) -> str:
    """Name of a law, as in "Hertz, sharp, μ = 10"."""
    name = {"hertz_mindlin": "Hertz"}.get(one.kind, one.kind)
    return f"{name}, {one.coulomb}, μ = {one.mu:g}" if one.mu < UNLIMITED else f"{name}, no limit"


def births_by_law(rows: list[dict]) -> list[Births]:
    """Summarise packings, given as dictionaries with kind, coulomb, mu, strain (NaN: no pair), at_limit etc."""
    return [_summary(*law, list(group)) for law, group in groupby(rows, lambda r: (r["kind"], r["coulomb"], r["mu"]))]


def _summary(kind: str, coulomb: str, mu: float, rows: list[dict]) -> Births:
    def column(name, only_born=True):
        values = np.array([r[name] for r in rows if np.isfinite(r["strain"]) or not only_born])
        return values if len(values) else np.array([np.nan])

    strain = np.nan_to_num(column("strain", only_born=False), nan=np.inf)
    born = int(np.isfinite(strain).sum())
    picks = np.random.default_rng(0).integers(0, len(rows), (DRAWS, len(rows)))
    low, high = np.quantile(_median(strain[picks]), [0.025, 0.975], method="nearest")
    return Births(
        kind, coulomb, mu, len(rows), born, int((column("at_limit") > 0).sum()), float(_median(strain)), float(low),
        float(high), float(np.median(column("at_limit"))), float(np.median(column("mobilisation"))),
        float(np.median(column("pairs", only_born=False))),
    )  # fmt: skip


def _median(values: np.ndarray) -> np.ndarray:
    """Lower median along the last axis; values may be infinite."""
    return np.sort(values, axis=-1)[..., (values.shape[-1] - 1) // 2]
