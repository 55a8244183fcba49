"""Envelope of Mohr and Coulomb: Mohr circles of the members of a sweep over the confining pressure, and φ and c."""

from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from ....kit import Comparison, SweepMember, checked, format_table, heading_of
from . import figures as figures_of

PRESSURE, SEED = "sample.pressure", "seed"
STATES = {"peak": "peak", "critical": "critical state"}  # ends of the names of stresses, and words
FIGURE, TABLE = "mohr.png", "mohr.csv"
ROWS = 3  # envelopes that are drawn


class Envelope(NamedTuple):
    """Envelope τ = c + σ tan φ of Mohr circles, with halves of 95 % intervals; NaN with two circles."""

    phi: float  # [degrees]
    cohesion: float  # in the unit of the stresses
    phi_error: float
    cohesion_error: float

    def describe(self, factor: float = 1.0, unit: str = "") -> str:
        """φ and c with their errors; stresses are multiplied by a factor."""
        pairs = ((self.phi, self.phi_error), "°"), ((factor * self.cohesion, factor * self.cohesion_error), f" {unit}")
        texts = []
        for (value, error), end in pairs:
            digits = min(max(0, 1 - int(np.floor(np.log10(error)))), 3) if error > 0 else 0  # two of the error
            texts.append(f"({value:.{digits}f} ± {error:.{digits}f}){end}" if error > 0 else f"{value:.3g}{end}")
        return f"φ = {texts[0]}, c = {texts[1]}".rstrip().replace("-", "−")


@checked
def fit_envelope(sigma1: np.ndarray, sigma3: np.ndarray) -> Envelope:
    """Envelope of Mohr circles with major and minor principal stresses (K,), compression positive.

    All circles touch τ = c + σ tan φ if σ₁ = N σ₃ + 2 c √N with N = (1 + sin φ)/(1 − sin φ). The line is fitted by
    least squares with weights 1/(σ₁ + σ₃)², since the angle of samples scatters, and with it σ₁, in proportion to the
    stress. Errors are from the deviations, by Student's t with K − 2 degrees of freedom.

    Raises
    ------
    ValueError
        If there are fewer than two circles, or all have the same σ₃.

    Examples
    --------
    >>> fit_envelope(np.array([300.0, 600.0, 1200.0]), np.array([100.0, 200.0, 400.0])).phi.round(6)
    np.float64(30.0)
    """
    sigma1, sigma3 = np.asarray(sigma1, float), np.asarray(sigma3, float)
    count = len(sigma3)
    if count < 2 or not np.ptp(sigma3) > 1e-6 * np.abs(sigma3).max():
        raise ValueError(f"{count} Mohr circles with σ₃ from one pressure were given: an envelope needs two pressures")
    weight = 1 / (sigma1 + sigma3)
    basis = weight[:, None] * np.column_stack([sigma3, np.ones(count)])
    (n, b), *_ = np.linalg.lstsq(basis, weight * sigma1)
    rest = weight * sigma1 - basis @ (n, b)
    free = count - 2
    spread = np.full((2, 2), np.nan)
    if free:
        spread = np.linalg.inv(basis.T @ basis) * (rest @ rest) / free * stdtrit(free, 0.975) ** 2
    by_phi = np.array([1 / ((n + 1) * np.sqrt(n)), 0.0])  # derivatives by n and b
    by_c = np.array([-b / (4 * n**1.5), 1 / (2 * np.sqrt(n))])
    return Envelope(
        np.degrees(np.arcsin((n - 1) / (n + 1))),
        b / (2 * np.sqrt(n)),
        np.degrees(np.sqrt(by_phi @ spread @ by_phi)),
        np.sqrt(by_c @ spread @ by_c),
    )


class Circles(NamedTuple):
    """Mohr circles of members that differ in the pressure, and their envelope at one state."""

    group: str  # other swept values
    state: str
    sigma1: np.ndarray  # (K,)
    sigma3: np.ndarray  # (K,)
    members: int  # also those without this state
    envelope: Envelope


def compare(members: list[SweepMember]) -> Comparison:
    """Mohr circles at the peak and at the critical state of a sweep over `sample.pressure`, and their envelopes.

    Members that differ in other swept keys have envelopes of their own, unless these vary with the pressure alone.
    """
    members = [member for member in members if PRESSURE in member.values and "sigma1_peak" in member.measures]
    if not members:
        return Comparison()
    keys = _other_keys(members)
    groups: dict[str, list[SweepMember]] = {}
    for member in members:
        name = ", ".join(f"{key} = {_short(member.values[key])}" for key in keys)
        groups.setdefault(name, []).append(member)
    found = [each for name, group in groups.items() for state in STATES if (each := _circles(name, group, state))]
    if not found:
        return Comparison()
    unit = members[0].measures["sigma1_peak"][1]
    factor, shown = (1e-3, "kPa") if unit == "Pa" else (1.0, unit)
    remarks = tuple(
        f"Mohr circles at the {STATES[each.state]}{f' ({each.group})' * bool(each.group)}: "
        f"{each.envelope.describe(factor, shown)}, from {len(each.sigma1)} of {each.members} members."
        for each in found
    )
    drawn = [each for each in found if each.group in list(groups)[:ROWS]]
    if not any(each.state == "critical" for each in found):
        reached = sum(bool(np.isfinite(member.measures["sigma1_critical"][0])) for member in members)
        remarks += (f"{reached} of {len(members)} members reached a critical state, for which there is no envelope.",)
    figure = figures_of.mohr_circles(drawn, factor, shown)
    return Comparison({FIGURE: figure, TABLE: _table(members, remarks)}, remarks)


def _short(value) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _other_keys(members: list[SweepMember]) -> list[str]:
    """Swept keys that have several values at the same pressure."""
    keys = [key for key in members[0].values if key not in (PRESSURE, SEED)]
    pairs = {key: {(member.values[PRESSURE], str(member.values[key])) for member in members} for key in keys}
    pressures = len({member.values[PRESSURE] for member in members})
    return [key for key in keys if len(pairs[key]) > pressures]


def _circles(name: str, group: list[SweepMember], state: str) -> Circles | None:
    """Circles of the members that have a state; None if they have less than two pressures."""
    pairs = [[member.measures[f"sigma{k}_{state}"][0] for k in (1, 3)] for member in group]
    sigma1, sigma3 = np.array([pair for pair in pairs if np.isfinite(pair).all()]).reshape(-1, 2).T
    try:
        return Circles(name, state, sigma1, sigma3, len(group), fit_envelope(sigma1, sigma3))
    except ValueError:
        return None


def _table(members: list[SweepMember], remarks: tuple[str, ...]) -> str:
    """CSV with a row for each member: swept values, principal stresses and angles, with their errors if known."""
    names = [f"sigma{k}_{state}" for state in STATES for k in (3, 1)] + ["phi_peak", "phi_residual"]
    names = [part for name in names for part in (name, f"{name}_error")]
    units = {name: unit for name, (_, unit) in members[0].measures.items()}
    keys = list(members[0].values)
    stress = units["sigma1_peak"]
    headings = [heading_of(key, stress) if key == PRESSURE else key for key in keys]
    headings += [heading_of(name, units[name]) for name in names]
    rows = ([*member.values.values(), *(member.measures[name][0] for name in names)] for member in members)
    return format_table(headings, rows, comments=remarks)
