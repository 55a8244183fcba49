"""Comparison of two fits to the same data."""

from typing import NamedTuple

import numpy as np

from ....kit import checked, readable
from .fitting import Fit

STRONG = 6.0  # smallest significant difference of AIC: a likelihood ratio of 20
FAR = 1.96  # smallest significant value of Vuong's statistic, two-sided 95 %


@readable
class LawComparison(NamedTuple):
    """Result of a comparison of two fits."""

    preferred: str | None  # law, or None if the data do not discriminate
    delta_aic: float  # AIC of the other minus that of the better one, ≥ 0
    evidence: float  # exp(ΔAIC/2)
    vuong: float  # positive if the first fit is better
    sentence: str


@checked
def compare_laws(first: Fit, second: Fit) -> LawComparison:
    """Test whether the data discriminate between two fits.

    ΔAIC shows which fit is closer to the data. The laws are not nested and both may be wrong, so the difference must
    also exceed its own scatter: Vuong's z = Σ d/(√N s_d), with d the difference in log-likelihood per sample
    (doi:10.2307/1912557). A preference requires ΔAIC ≥ 6 and |z| ≥ 1.96, and that the better fit describes the record
    (`Fit.adequate`).

    Raises
    ------
    ValueError
        if the fits do not use the same samples.
    """
    same = len(first.models) == len(second.models) and first.samples == second.samples
    for own, other in zip(first.residuals, second.residuals, strict=False):
        same = same and len(own) == len(other)
    data = [[r + m for r, m in zip(f.residuals, f.models, strict=True)] for f in (first, second)] if same else [[], []]
    if not same or not all(np.allclose(p, q, rtol=0, atol=1e-9) for p, q in zip(*data, strict=True)):
        raise ValueError("the two fits are to different data: compare fits to the same records and windows")
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
    if abs(gap) < STRONG or abs(z) < FAR or (z > 0) != (gap > 0):
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
