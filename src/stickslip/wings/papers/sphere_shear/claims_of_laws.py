"""Statements of Bonfanti et al. 2020 on the contact law, from a stored study of packings under several laws."""

import csv
from pathlib import Path
from typing import NamedTuple

from scipy.stats import binomtest

from ....kit import Claim, claim
from ....reports.claims import ALWAYS

BIRTHS = Path(__file__).with_name("births_by_law.csv")  # written by benchmarks/pairs_by_law.py
MU, UNLIMITED = 10.0, 1e6  # the paper's friction; μ from which on no contact reaches the limit
STUDY = "stored study of examples/pairs_by_law.toml"


class Births(NamedTuple):
    """First pairs of sheared packings under one law."""

    kind: str
    coulomb: str
    mu: float
    packings: int
    born: int  # packings with a pair
    limited: int  # births at which a contact is at the Coulomb limit
    mobilisation: float  # median over births of the largest |F_t|/(μ F_n)

    def __str__(self) -> str:
        limit = f"{self.coulomb}, mu = {self.mu:g}" if self.mu < UNLIMITED else "no limit"
        low, high = share_interval(self.born, self.packings)
        return (
            f"{self.kind.removesuffix('_mindlin')}, {limit}: {self.born} of {self.packings} ({low:.2f} to {high:.2f})"
        )


def read_births() -> dict[tuple[str, str, float], Births]:
    """Births of the stored study, by kind of law, smoothing and friction."""
    with BIRTHS.open(encoding="utf-8", newline="") as file:
        rows = [Births(r[0], r[1], float(r[2]), *map(int, r[3:6]), float(r[6])) for r in list(csv.reader(file))[1:]]
    return {row[:3]: row for row in rows}


def law_claims() -> list[Claim]:
    """Claims about the form of the law, its smoothing, and the Coulomb limit."""
    births = read_births()
    smooth, sharp, unlimited = (
        births["hertz_mindlin", *law] for law in (("smooth", MU), ("sharp", MU), ("sharp", 1e9))
    )
    linear, cut, bare = (births["linear", *law] for law in (("smooth", MU), ("sharp", MU), ("sharp", 1e9)))
    at_limit = (
        f"{cut.kind}, sharp: a contact at the limit at {cut.limited} of {cut.born} births, smooth: {linear.limited}"
    )
    few = [law for law in births.values() if not law.born]
    free = smooth.born - smooth.limited
    rows = (
        ("pairs-under-a-linear-law", 'Sec. II: "changing the analytic forms of the interaction forces [...] does not '
         'affect [the] appearance of the instability"', _mostly(linear.born, linear.packings),
         f"packings with a pair: {linear}; {smooth}; the strains of the first pairs differ, and so does their cause: "
         f"{at_limit}"),
        ("pairs-without-smoothing", 'Sec. II: "do not depend on this smoothing of the tangential force"',
         _mostly(sharp.born, sharp.packings), f"packings with a pair: {sharp}; {smooth}; "
         f"with a linear law the smoothing decides: {at_limit}"),
        ("pairs-before-the-limit", 'Sec. II: "instabilities are often seen before any Coulomb limit is reached"',
         _mostly(free, smooth.born), f"no contact at the limit at {free} of {smooth.born} births, where the largest "
         f"F_t/(mu F_n) is {smooth.mobilisation:.2g} at the median; {at_limit}"),
        ("threshold-not-responsible", 'Sec. II: "the existence of a Coulomb threshold is not responsible for the '
         'reported phenomenology"', _mostly(unlimited.born, unlimited.packings),
         f"packings with a pair: {unlimited}; with a linear law the limit is responsible: {bare}"),
    )  # fmt: skip
    generic = claim(
        "generic-without-hamiltonian", 'Sec. V: "as long as the dynamics is describable by forces which are not '
        'derivable from a Hamiltonian, this instability should be generic"', True, not few, "", 0.0,
        f"packings with a pair under {len(births)} laws: the fewest are {min(births.values(), key=lambda b: b.born)}, "
        f"where only the rotation of the normal makes J asymmetric. This law has a U(delta, t), and is Hamiltonian by "
        f"App. A; under all others at least {min(b.born for b in births.values() if b != bare)} have one; {STUDY}",
        quantifier=ALWAYS,
    )  # fmt: skip
    return [*(claim(id, said, True, value, "", 0.0, f"{note}; {STUDY}")
              for id, said, value, note in rows), generic]  # fmt: skip


def share_interval(count: int, total: int) -> tuple[float, float]:
    """95 % interval of a share.

    Source
    ------
    Wilson, doi:10.1080/01621459.1927.10502953.
    """
    low, high = binomtest(count, total).proportion_ci(method="wilson")
    return float(low), float(high)


def _mostly(count: int, total: int) -> bool | None:
    """Whether more than half of all cases are so; None if the 95 % interval of the share contains a half."""
    low, high = share_interval(count, total)
    return None if low <= 0.5 <= high else bool(low > 0.5)
