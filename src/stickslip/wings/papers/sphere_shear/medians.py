"""Claims about medians over packings, with the tolerances of Bonfanti et al. 2020."""

import numpy as np

from ....kit import Claim, claim, median_error

TOLERANCE = {
    "onset": 1.0,  # nothing is printed, and the packing fraction is not given: a factor of two
    "exponent": 0.05,  # the next term of the expansion is of the order of the distance to the birth, some per cent
    "pairs": 0.0,  # counts
    "rate": 1e-3,  # linear theory with Verlet's correction is exact; the ends of the fit window are not
    "frequency": 1e-4,  # the phase is known to a fraction of a turn over some thousand turns
    "decades": 0.2,  # the paper says "about 10": two more or less
    "constant": 1.0,  # nothing is printed; M grows by a factor of two between two evaluations of the spectrum
    "drop": 1.0,  # one run of one packing: a factor of two either way
    "contacts": 1.0,  # nothing is printed
    "im-lambda": 1.0,  # one state, chosen by the authors among those with a single pair: a factor of two
    "later": 1.0,  # nothing is printed
    "drag": np.sqrt(10) - 1,  # "of the order of": the nearest power of ten
    "stress": 0.1,  # a tenth of the exponent: M oscillates by a factor of two or so about its exponential
}


def _finite(values) -> list[float]:
    return [float(v) for v in values if v is not None and np.isfinite(v)]


def known_median(values) -> float | None:
    """Median of the values that are known; None without any."""
    known = _finite(values)
    return float(np.median(known)) if known else None


def describe_range(values, form: str = "{:.3g}") -> str:
    """Say between which values those of the packings lie, and how many packings have one."""
    known = _finite(values)
    if not known:
        return f"none of {len(values)} packings"
    if len(known) == 1:
        return f"{form.format(known[0])} in one of {len(values)} packings"
    return f"{form.format(min(known))} to {form.format(max(known))} over {len(known)} of {len(values)} packings"


def median_claim(id: str, source: str, paper, values, unit: str, tolerance: str, note: str, **more) -> Claim:
    """Claim about the median over packings, with its error."""
    error = median_error(_finite(values))
    return claim(id, source, paper, known_median(values), unit, TOLERANCE[tolerance], note, error=error, **more)
