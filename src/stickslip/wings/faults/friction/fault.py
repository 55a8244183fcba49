"""Straight faults with rate-and-state friction, loaded by plate motion, and nucleation of earthquakes on them.

Friction depends on depth. The body is linear elastic, and its inertia is approximated by radiation damping
(quasi-dynamic; J. R. Rice, J. Geophys. Res. 98, 9885 (1993), doi:10.1029/93JB00191).
"""

from typing import Annotated, Literal, NamedTuple

import numpy as np

from ....kit import check_types, checked, quoted, readable
from .laws import EvolutionLaw, Form, check_variant, form_code
from .ranges import ALL_NOT_NEGATIVE, ALL_POSITIVE, Bounded, NotNegative, Positive, Unbounded, allowed
from .stress_transfer import (
    INSTANTS,
    Boundary,
    Injection,
    Oscillation,
    StressTable,
    StressTransfer,
    image_nodes,
    stress_transfer,
)

Shear = Literal["antiplane", "in-plane"]
Slip = Literal["thrust", "normal"]
PositiveValues = Annotated[np.ndarray, ALL_POSITIVE]
NotNegativeValues = Annotated[np.ndarray, ALL_NOT_NEGATIVE]
Poisson = Annotated[float, allowed("between −1 and 0.5", lambda nu: (nu > -1) & (nu < 0.5))]
Dip = Annotated[float, allowed("above 0 and at most 90 degrees", lambda dip: (dip > 0) & (dip <= 90))]
MOST_CELLS = 1_000_000
MOST_ENTRIES = 1e7  # largest number of entries in the table of surface effects on a dipping fault
LONGEST_CELL = 1 / 3  # length of the longest allowed cell, relative to the cohesive length
SEISMIC = 1.0  # slip velocity typical of an earthquake [m/s]


def _head(fault) -> str:
    kind = f"{fault.slip} with a dip of {fault.dip:g}°" if fault.dips else fault.shear
    return f"{kind}, {len(fault.depth)} cells of {fault.cell:g} m, {fault.law} law"


@readable(head=_head)
class Fault(NamedTuple):
    """A straight fault of N cells of equal length; see `line_fault`. Units are SI."""

    MADE_BY = "friction.line_fault"

    depth: np.ndarray  # (N,) depths of cell centres, distances down dip, or positions along the fault [m]
    a: PositiveValues  # (N,) direct effect
    b: NotNegativeValues  # (N,) evolution effect
    dc: PositiveValues  # (N,) characteristic slip [m]
    normal: PositiveValues  # (N,) effective normal stress, compression is positive [Pa]
    cell: Positive  # length of a cell [m]
    mu0: Bounded = 0.6  # steady friction at v0
    v0: Positive = 1e-6  # [m/s]
    law: EvolutionLaw = "aging"
    form: Form = "regularized"
    shear: Shear = "antiplane"
    shear_modulus: Positive = 32.04e9  # [Pa]
    wave_speed: Unbounded = 3464.0  # speed of shear waves; infinite: no radiation damping [m/s]
    poisson: Poisson = 0.25  # Poisson's ratio, for in-plane shear
    plate_rate: NotNegative = 1e-9  # slip velocity of the plane outside the cells, or of the plates [m/s]
    boundary: Boundary = "surface"
    thickness: Unbounded = np.inf  # thickness of each plate, for a periodic fault [m]
    v1: Unbounded = np.inf  # cut-off velocity of the direct effect, for the logarithmic form [m/s]
    v2: Unbounded = np.inf  # cut-off velocity of the evolution effect, for the logarithmic form [m/s]
    b2: np.ndarray | float = 0.0  # (N,) or a number, evolution effect of a second state
    dc2: np.ndarray | float = 1.0  # (N,) or a number, characteristic slip of this state; has no effect if b2 = 0 [m]
    alpha: NotNegative = 0.0  # effect of changes of the normal stress on the states
    changes: tuple[Injection | Oscillation | StressTable, ...] = ()  # imposed changes of the normal stress over time
    dip: Dip = 90.0  # dip of a fault that reaches the surface, for in-plane shear [degrees]
    slip: Slip = "thrust"  # direction of in-plane slip at the surface

    def check_entries(self) -> None:
        """Raise an error if an entry, or a combination of entries, is not allowed, or if cells are too long."""
        check_types(self)
        ALL_NOT_NEGATIVE.check("b2", self.b2)
        ALL_POSITIVE.check("dc2", self.dc2)
        check_variant(self, self.evolution)
        _check_geometry(self)
        _check_cells(self)

    @property
    def modulus(self) -> float:
        """Effective shear modulus: G for antiplane shear, and G/(1 − ν) for in-plane shear [Pa]."""
        return self.shear_modulus / (1 - self.poisson) if self.shear == "in-plane" else self.shear_modulus

    @property
    def damping(self) -> float:
        """Radiation damping η = G/(2 c_s) [Pa s/m]."""
        return self.shear_modulus / (2 * self.wave_speed)

    @property
    def cuts(self) -> tuple[float, float]:
        """Ratios of the reference velocity to the cut-off velocities; 0 if there is no cut-off."""
        return self.v0 / self.v1, self.v0 / self.v2

    @property
    def form_code(self) -> int:
        """Code of the friction form, for the compiled core."""
        return form_code(self.form, *self.cuts)

    @property
    def states(self) -> int:
        """Number of state variables of a cell: 2 with `b2`, else 1."""
        return 2 if np.any(np.asarray(self.b2) > 0) else 1

    @property
    def evolution(self) -> np.ndarray:
        """Sum of the evolution effects of all states, b + b2 (N,)."""
        return self.b + self.b2

    @property
    def weakening(self) -> np.ndarray:
        """Rate at which friction falls with slip behind a rupture tip, b/D_c + b2/D_c2 (N,) [1/m]."""
        return self.b / self.dc + self.b2 / np.asarray(self.dc2)

    def sliding_at(self, velocity: float) -> "Fault":
        """Equivalent fault without cut-off velocities, with the same slopes of friction in steady sliding at V [m/s].

        Its direct effect is A = ∂μ/∂ln V = a/(1 + V/V1); its evolution effects are B = ∂μ/∂ln θ = b/(1 + V/V2) and
        b2/(1 + V/V2).
        """
        direct, state = 1 + velocity / self.v1, 1 + velocity / self.v2
        return self._replace(a=self.a / direct, b=self.b / state, b2=self.b2 / state, v1=np.inf, v2=np.inf)

    @property
    def dips(self) -> bool:
        """True if slip is in-plane and reaches a free surface, so it changes the normal stress."""
        return self.shear == "in-plane" and self.boundary == "surface"

    @property
    def sense(self) -> int:
        """1 for a thrust fault, −1 for a normal fault."""
        return 1 if self.slip == "thrust" else -1

    def normal_at(self, time: float, excess_slip: np.ndarray | None = None) -> np.ndarray:
        """Effective normal stress (N,) [Pa] at a time [s], including effects of slip in excess of plate motion [m]."""
        slipped = 0.0 if excess_slip is None else self.transfer.tractions(excess_slip)[1]
        return sum((change.change(self.depth, time) for change in self.changes), self.normal + slipped)

    def state_shift(self, normal: np.ndarray) -> np.ndarray:
        """Decrease (N,) of ln θ due to a change of the normal stress from its initial values σ₀ to σ.

        (α/b) ln(σ/σ₀), from θ' = … − (α/b) θ σ'/σ (Linker and Dieterich 1992, doi:10.1029/92JB00017).
        """
        if not self.alpha:
            return np.zeros(len(self.depth))
        effect = np.where(self.evolution > 0, self.evolution, np.inf)
        return self.alpha / effect * np.log(normal / self.normal)

    @property
    def width(self) -> float:
        """Total length of the cells [m]."""
        return self.cell * len(self.depth)

    @property
    def transfer(self) -> StressTransfer:
        """Map from slip to shear and normal stress."""
        cell, modulus, thickness = float(self.cell), float(self.modulus), float(self.thickness)
        dip = float(self.dip) if self.dips else None
        return stress_transfer(len(self.depth), cell, modulus, self.boundary, thickness, dip=dip, sense=self.sense)


@checked
def line_fault(width: Positive, cell: Positive, *, a, b, dc, normal, b2=0.0, dc2=None, **more) -> Fault:
    """Fault whose properties vary piecewise linearly with depth.

    Parameters
    ----------
    width : length of the part with rate-and-state friction; the rest of the plane slips at the plate rate [m]
    cell : length of a cell; the width must be a multiple of it [m]
    a, b, dc, normal, b2, dc2 : a number, or pairs (depth, value) in order of depth, between which values are
        interpolated linearly; beyond the first and last depth they are constant. `dc` and `dc2` in m, `normal` in Pa;
        `b2` and `dc2`, which must be given together, belong to a second state variable (see `RateState`)
    more : the other fields of `Fault`

    Raises
    ------
    ValueError
        If cells are longer than a third of the cohesive length.

    Examples
    --------
    The first benchmark problem of the SEAS initiative (Erickson et al. 2020, doi:10.1785/0220190248):

    >>> a = [(15e3, 0.010), (18e3, 0.025)]
    >>> fault = line_fault(40e3, 100.0, a=a, b=0.015, dc=8e-3, normal=50e6)
    >>> fault
    Fault: antiplane, 400 cells of 100 m, aging law
    """
    if not width / cell <= MOST_CELLS:
        raise ValueError(f"width = {width:g} and cell = {cell:g} give too many cells: use at most {MOST_CELLS:,}")
    number = round(width / cell)
    if number < 3 or abs(number * cell - width) > 1e-6 * width:
        raise ValueError(
            f"width must be a whole number of cells, at least three, got width = {width:g} and cell = {cell:g}"
        )
    if unknown := set(more) - set(Fault._fields):
        raise ValueError(
            f"{min(unknown)!r} is not a field of a fault; the other fields are {', '.join(Fault._fields[6:])}"
        )
    if isinstance(more.get("changes"), list):
        more["changes"] = tuple(more["changes"])
    depth = (np.arange(number) + 0.5) * cell
    given = {"a": a, "b": b, "dc": dc, "normal": normal, "b2": b2, "dc2": 1.0 if dc2 is None else dc2}
    profiles = {name: profile(name, value, depth) for name, value in given.items()}
    if dc2 is None and (profiles["b2"] > 0).any():
        raise ValueError("b2 requires dc2, the characteristic slip of the second state")
    fault = Fault(depth, cell=cell, **profiles, **more)
    fault.check_entries()
    return fault


def profile(name: str, value, depth: np.ndarray) -> np.ndarray:
    """Values of a property at depths, from a number or from pairs (depth, value)."""
    try:
        points = np.asarray(value, float) if np.asarray(value).dtype.kind in "buifO" else None
    except OverflowError:
        raise ValueError(f"{name} contains a whole number beyond the range of floats: give a float") from None
    except (TypeError, ValueError):
        points = None
    if points is None or value is None:
        raise ValueError(f"{name} must be a number, or pairs of depth and value, got {quoted(value)}")
    if points.ndim == 0:
        points = np.array([[0.0, float(points)]])
    if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
        raise ValueError(f"{name} has shape {points.shape}: use a number, or pairs of depth and value")
    if not np.isfinite(points).all():
        raise ValueError(f"{name} contains {points[~np.isfinite(points)][0]}: use finite depths and values")
    if (points[:, 0] < 0).any():
        raise ValueError(f"{name} has a depth of {points[:, 0].min():g}: depths are counted from 0 downwards")
    if (np.diff(points[:, 0]) < 0).any():
        wrong = points[1:, 0][np.diff(points[:, 0]) < 0][0]
        raise ValueError(f"the depths of {name} are not in order at {wrong:g}: sort them from the surface downwards")
    return np.interp(depth, points[:, 0], points[:, 1])


def check_normal(fault: Fault, until: float) -> None:
    """Raise ValueError if, before `until` [s], normal stress falls to 0 or becomes too large for the cell length."""
    breaks = [time for change in fault.changes for time in change.breaks if time <= until]
    for time in sorted([*np.linspace(0.0, until, INSTANTS), *breaks]) if fault.changes else ():
        normal = fault.normal_at(time)
        if not normal.min() > 0:
            raise ValueError(
                f"the effective normal stress falls to {normal.min():.4g} Pa at {fault.depth[normal.argmin()]:g} m "
                f"after {time:.4g} s: use smaller changes, or a larger normal stress"
            )
        _check_cells(fault._replace(normal=normal))


def _check_geometry(fault: Fault) -> None:
    if fault.shear == "in-plane" and fault.boundary == "periodic":
        raise ValueError("boundary must be 'surface' or 'infinite' for in-plane shear, got 'periodic'")
    if not fault.dips and (fault.dip != 90 or fault.slip != "thrust"):
        raise ValueError(
            f"dip = {fault.dip:g} and slip = {fault.slip!r} require in-plane shear and boundary = 'surface', got "
            f"{fault.shear} shear and boundary = {fault.boundary!r}"
        )
    number = len(fault.depth)
    if fault.dips and image_nodes(number, fault.dip) * number > MOST_ENTRIES:
        raise ValueError(
            f"{number:,} cells of a fault with a dip of {fault.dip:g}° need too much memory: use longer cells"
        )
    if fault.boundary == "periodic" and not (fault.thickness > 0 and np.isfinite(fault.thickness)):
        raise ValueError(
            "a periodic fault is loaded through plates, whose thickness must be positive and finite, got "
            f"{fault.thickness}"
        )


def _check_cells(fault: Fault) -> None:
    """Raise ValueError if cells do not resolve the tip of a rupture where friction weakens at low or high velocity.

    With cut-off velocities, A/B changes monotonically with velocity, so checks at both ends suffice.
    """
    fast = fault.sliding_at(SEISMIC)
    weak = (fault.a < fault.evolution) | (fast.a < fast.evolution)
    if not weak.any():
        return
    length = fault.modulus / (fault.weakening * fault.normal)[weak]
    name = "G D_c/(b σ)" if fault.states == 1 else "G/[(b/D_c + b2/D_c2) σ]"
    if fault.cell > LONGEST_CELL * length.min() * (1 + 1e-9):
        raise ValueError(
            f"cell = {fault.cell:g} m does not resolve the cohesive length {name} = {length.min():.4g} m: use cells "
            f"of at most a third of it, {LONGEST_CELL * length.min():.4g} m"
        )


LOCALIZED = 0.3781  # a/b below which nucleation zones have a fixed length
FIXED = 1.3774  # fixed half-length of nucleation zones, over L_b


@checked
def cohesive_length(modulus: Positive, b: Positive, dc: Positive, normal: Positive) -> float:
    """Length L_b = G D_c/(b σ) over which stress drops behind the tip of a rupture.

    Rubin and Ampuero 2005, doi:10.1029/2005JB003686, equation 7. For in-plane shear, G is divided by 1 − ν.

    Examples
    --------
    >>> print(round(cohesive_length(32.04e9, 0.015, 8e-3, 50e6), 1))
    341.8
    """
    return modulus * dc / (b * normal)


@checked
def critical_wavelength(modulus: Positive, a: Positive, b: Bounded, dc: Positive, normal: Positive) -> float:
    """Wavelength 2π/k above which steady slip of an infinite fault is unstable; infinite if a ≥ b.

    At this wavelength, the stiffness G k/2 of sinusoidal slip equals the critical stiffness (b − a) σ/D_c (see
    `critical_stiffness`). The wavelength is π G D_c/[(b − a) σ] for both laws (J. R. Rice and A. L. Ruina 1983,
    doi:10.1115/1.3167042). With cut-off velocities, A = a/(1 + V/V1) and B = b/(1 + V/V2) at the velocity of sliding
    replace a and b (see `Fault.sliding_at`).

    Examples
    --------
    >>> print(round(critical_wavelength(32.04e9, 0.010, 0.015, 8e-3, 50e6), 1))
    3221.0
    """
    return np.pi * modulus * dc / ((b - a) * normal) if b > a else np.inf


@checked
def nucleation_half_length(modulus: Positive, a: Positive, b: Bounded, dc: Positive, normal: Positive) -> float:
    """Half-length of the nucleation zone with the aging law; infinite if a ≥ b.

    For a/b < 0.3781, it is 1.3774 L_b, and zones keep this length while they accelerate. Otherwise they grow towards
    the length L_b/[π (1 − a/b)²], which is used if it is larger (Rubin and Ampuero 2005, doi:10.1029/2005JB003686,
    equations 13 and 31). With the slip law, zones become shorter as they accelerate (Ampuero and Rubin 2008,
    doi:10.1029/2007JB005082). With cut-off velocities, A = a/(1 + V/V1) and B = b/(1 + V/V2) at the slip velocity of
    the zone replace a and b (see `Fault.sliding_at`).

    Examples
    --------
    >>> print(round(nucleation_half_length(32.04e9, 0.010, 0.015, 8e-3, 50e6), 1))
    979.1
    """
    return _half_length(modulus, a, b, dc, dc, normal)


def _half_length(modulus: float, a: float, b: float, fast: float, mean: float, normal: float) -> float:
    """Half-length of the nucleation zone. With two states, b is the sum of both evolution effects.

    The characteristic slip is `fast` = b/(b1/D_1 + b2/D_2) at a rupture tip, where friction falls at the combined rate
    of both states. In the fracture energy, which determines long zones, it is `mean` = (b1 D_1 + b2 D_2)/b.
    """
    if a >= b:
        return np.inf
    ratio = a / b
    short = FIXED * cohesive_length(modulus, b, fast, normal)
    if ratio < LOCALIZED:
        return short
    return max(short, cohesive_length(modulus, b, mean, normal) / (np.pi * (1 - ratio) ** 2))


@readable
class Nucleation(NamedTuple):
    """Possibility of earthquake nucleation on a fault. Zone lengths are the smallest among weakening cells [m]."""

    possible: bool
    weakening: float  # length of the longest velocity-weakening part [m]
    cohesive_length: float
    half_length: float  # half-length of a nucleation zone
    sentence: str


@checked
def nucleation(fault: Fault, velocity: Positive | None = None) -> Nucleation:
    """Compare the velocity-weakening part of a fault with the length required for nucleation of an earthquake.

    The comparison is a guide: it uses the length of nucleation zones in an infinite body, and counts a zone at the free
    surface as half a zone. With two states, for which we know of no published theory, the estimate is rough: it is the
    shortest of three zones, one for both states together and one for each state alone.

    With cut-off velocities, the effects are A = a/(1 + V/V1) and B = b/(1 + V/V2), those of steady sliding at the given
    velocity. The sentence also states whether the sign of the rate dependence changes at velocities up to 1 m/s. If so,
    earthquakes also depend on disturbances of the plate motion, and slip may stay slow. Far above V1, where the
    direct effect vanishes, zones are shorter than with constant effects, 0.579 L_b instead of 1.3774 L_b
    (K. Uenishi and J. R. Rice 2003, doi:10.1029/2001JB001681).

    Parameters
    ----------
    velocity : V, relevant only with cut-off velocities; default: the plate rate, or v0 without plate motion [m/s]

    Examples
    --------
    >>> from stickslip import friction
    >>> strong = friction.line_fault(10e3, 100.0, a=0.02, b=0.015, dc=8e-3, normal=50e6)
    >>> print(nucleation(strong).sentence)
    no earthquake can nucleate: the fault is velocity-strengthening (a ≥ b) everywhere
    """
    velocity = fault.plate_rate or fault.v0 if velocity is None else velocity
    slow, effects = _lengths(fault.sliding_at(velocity)), "b" if fault.states == 1 else "b + b2"
    if any(fault.cuts):
        sentence = _sentence_with_cuts(fault, velocity, slow, f"a ≥ {effects}")
    elif slow.longest == 0:
        sentence = f"no earthquake can nucleate: the fault is velocity-strengthening (a ≥ {effects}) everywhere"
    else:
        sentence = f"{'earthquakes can nucleate' if slow.possible else 'no earthquake is expected'}: {slow.ratio('')}"
    return Nucleation(slow.possible, slow.longest, slow.cohesive, slow.half, sentence)


class _Lengths(NamedTuple):
    longest: float
    cohesive: float = np.inf
    half: float = np.inf

    @property
    def possible(self) -> bool:
        return self.longest > 2 * self.half

    def ratio(self, place: str) -> str:
        zone = 2 * self.half
        return (
            f"its longest velocity-weakening part{place} is {self.longest / zone:.3g} times a nucleation zone of "
            f"{zone:.4g} m"
        )


def _lengths(fault: Fault) -> _Lengths:
    """Longest weakening part, and smallest half-length of a nucleation zone, of a fault without cut-off velocities."""
    weak = fault.a < fault.evolution
    if not weak.any():
        return _Lengths(0.0)
    edges = np.flatnonzero(np.diff(np.r_[0, weak.astype(int), 0]))
    spans = (edges[1::2] - edges[::2]) * fault.cell
    if fault.boundary == "surface" and weak[0]:
        spans[0] *= 2  # including its image
    cohesive = float((fault.modulus / (fault.weakening * fault.normal)[weak]).min())
    b, slip = fault.evolution[weak], (fault.b * fault.dc + fault.b2 * np.asarray(fault.dc2))[weak]
    rows = np.stack([fault.a[weak], b, b / fault.weakening[weak], slip / b, fault.normal[weak]])
    half = min(_half_length(fault.modulus, *row) for row in np.unique(rows.T, axis=0).tolist())
    if fault.states > 1:  # a state hardly changes while slip is smaller than its characteristic slip
        first = fault.a, fault.b, fault.dc, fault.normal
        second = fault.a, *np.broadcast_arrays(fault.b2, fault.dc2, fault.normal)
        for rows in (np.stack(first), np.stack(second)):
            alone = np.unique(rows[:, rows[0] < rows[1]].T, axis=0).tolist()
            half = min([half, *(nucleation_half_length(fault.modulus, *row) for row in alone)])
    return _Lengths(float(spans.max()), cohesive, half)


def _sentence_with_cuts(fault: Fault, velocity: float, slow: _Lengths, strengthens: str) -> str:
    """Sentence on steady slip at `velocity`, and on the change of its stability up to 1 m/s."""
    location, fast = f" at {velocity:.3g} m/s", _lengths(fault.sliding_at(max(SEISMIC, velocity)))
    if slow.longest == fast.longest == 0:
        ends = f"from {velocity:.3g} to {SEISMIC:g} m/s"
        return f"no earthquake can nucleate: the fault is velocity-strengthening everywhere at all velocities {ends}"
    if slow.longest == 0:
        sentence = f"the fault is velocity-strengthening ({strengthens} with the cut-offs) everywhere{location}"
    else:
        sentence = slow.ratio(location)
    if slow.possible:
        slows = "" if fast.longest else f"; slip above {_transition(fault, max):.3g} m/s strengthens and may stay slow"
        return f"earthquakes can nucleate: {sentence}{slows}"
    sentence = f"no earthquake is expected from steady slip: {sentence}"
    if not fast.possible:
        return sentence
    above = "" if slow.longest else f" weakens above {_transition(fault, min):.3g} m/s, and"
    zone = f"slip{above} has a zone of {2 * fast.half:.4g} m at {SEISMIC:g} m/s"
    return f"{sentence}; {zone}: a disturbance can turn it into an earthquake"


def _transition(fault: Fault, of) -> float:
    """Smallest or largest velocity at which a cell changes between weakening and strengthening.

    A = B at V = (B0 − a)/(a/V2 − B0/V1), with B0 = b + b2.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        values = (fault.evolution - fault.a) / (fault.a / fault.v2 - fault.evolution / fault.v1)
    return float(of(values[np.isfinite(values) & (values > 0)]))
