"""Properties that any contact law can have: lever arms R − δ/2."""

from ..arguments import checked
from ..text import quoted
from .builtin import LEVER, Law
from .kinds import USER_LAWS, Kind, own_memory

ARMS = {"radius": 0, "overlap": LEVER}
COLUMNS = 7  # of `Contacts.rolling`: ψ; angle_i − angle_j at which it was committed; 1 if it was at the cap


@checked
def with_lever(law: Law, arm: str) -> Law:
    """Law with other lever arms of the tangential force, T_i = −a_i n × F_t.

    The surfaces move relative to each other with v_t = P v − (a_i ω_i + a_j ω_j) × n. With a_i = R_i − δ/2 the arms of
    two grains add up to their distance, so that contacts conserve angular momentum, and two grains that rotate as one
    body do not slip.

    Parameters
    ----------
    arm : "radius" (a_i = R_i, as in the papers and in LAMMPS `gran/hooke/history`) or "overlap" (a_i = R_i − δ/2 of
        grains on grains, R_i at walls). LAMMPS `pair_style granular` uses R_i − δ/2 for torques but R_i for the slip,
        and so does a run with `slip_update="rate"`

    Source
    ------
    LAMMPS, `GranularModel::calculate_forces`; Luding, doi:10.1007/s10035-008-0099-x, Eqs 5–8.

    Examples
    --------
    >>> import stickslip as ss
    >>> ss.laws.with_lever(ss.laws.linear(mu=0.5), "overlap")
    Law: linear, sharp Coulomb, kn = 1, kt = 0.285714, mu = 0.5, lever arms R - δ/2
    """
    if arm not in ARMS:
        raise ValueError(f"arm={quoted(arm)} was given: 'radius' and 'overlap' are allowed")
    return law._replace(properties=law.properties & ~LEVER | ARMS[arm])


def resists_rolling(law: Law) -> bool:
    """Return True if a law has rolling resistance."""
    return isinstance(law.kind, Kind) and law.kind in USER_LAWS and "rolling_stiffness" in USER_LAWS[law.kind].functions


def needs_rows(law: Law) -> bool:
    """Return True if only rows evaluate a law: blocks know neither moments nor a law's own memory."""
    return resists_rolling(law) or bool(own_memory(law.kind))


def angular_columns(law: Law) -> int:
    """Number of columns of `Contacts.rolling` for rotations; those of a law's own memory follow."""
    return COLUMNS if resists_rolling(law) or law.properties else 0
