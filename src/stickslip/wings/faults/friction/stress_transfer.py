"""Stress on a straight fault due to slip, with or without a free surface, and imposed changes of normal stress.

Between the centres of N cells of length h, slip is a sum of terms sin(πx/h)/(πx/h): the band-limited function that has
the values of the cells and no wavelength below 2h. A sinusoid then has its exact stiffness G*|k|/2, with G* = G for
antiplane and G/(1 − ν) for in-plane shear, and errors arise only from slip that such a sum cannot represent. Slip of 1
at one centre stresses the centre m cells away by (G*/πh) [−π²/4 for m = 0, 1/m² for odd m, 0 for even m]. A free
surface adds mirrored slip. Stress is a discrete convolution, evaluated by Fourier transforms in O(N log N) operations;
`stress_matrix` returns the same operator as a dense matrix.

In a half-space, points are ζ = x + iz, with x horizontal and the depth z ≥ 0. The fault is ζ = ξ t with t = e^{iψ}, dip
ψ and distance ξ down dip; its hanging wall is at larger x. Slip δ > 0 is that of a thrust: the foot wall moves along t
relative to the hanging wall. A fault that slips by δ from the end s₁ down to s₂ has the potentials φ(s₁) − φ(s₂) and
ψ(s₁) − ψ(s₂) of two edge dislocations (N. I. Muskhelishvili, Some Basic Problems of the Mathematical Theory of
Elasticity, 1953),

    φ = γ ln(ζ − s) − γ ln(ζ − s*) − γ* (s* − s)/(ζ − s*),   γ = i G t δ/[4π (1 − ν)],

where * denotes the conjugate. The first term is that of an infinite body; the others remove the tractions at the
surface. The solution is due to A. K. Head, Proc. Phys. Soc. B 66, 793 (1953); P. Segall (2010), chapter 3, gives it for
faults. The contribution of the surface depends on ξ of the stressed cell and ξ' of the slipping one, and is smooth in ξ
except at ξ = ξ' = 0. Between ξ and 2ξ, it is a polynomial in ξ to within round-off.

Imposed changes of normal stress (injected fluid, an oscillation, a table) have a method `change(depth, time)`, whose
value is added to the normal stress of the fault, and times `breaks`, at which the change is extreme or not smooth, and
at which time steps end.
"""

import csv
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander
from scipy import fft, sparse
from scipy.special import erfc

from ....kit import Array, Series, check_types, checked, core, read_text, readable
from .ranges import Bounded, NotNegative, Positive


def half_space_stress(at, ends, dip: float, *, image: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Stress due to unit slip of cells, over G/(1 − ν); tension is positive.

    Parameters
    ----------
    at : (P,) complex points x + iz
    ends : (N + 1,) distances down dip between which the N cells slip
    dip : ψ [degrees]
    image : True to return only the part that the free surface adds to the stress in an infinite body

    Returns
    -------
    (σ_xx + σ_zz)/2 and (σ_zz − σ_xx)/2 + i σ_xz, each (P, N) [1/length]. On a plane of dip ψ, the normal stress σ_n and
    the shear stress τ that drives a thrust are σ_n + i τ = first + e^{2iψ} second.

    Examples
    --------
    >>> mean, deviator = half_space_stress([3.0 + 0j], [1.0, 2.0], 30.0)
    >>> surface = mean + deviator  # σ_zz + i σ_xz at the surface
    >>> print(abs(surface).max() < 1e-15)
    True
    """
    zeta, t = np.asarray(at, complex)[:, None], np.exp(1j * np.radians(dip))
    s, gamma = np.asarray(ends) * t, 0.25j / np.pi * t
    away = zeta - s.conj()
    drop = gamma.conj() * (s.conj() - s)
    first = -gamma / away + drop / away**2  # φ'
    deviator = (zeta.conj() - zeta) * (gamma / away**2 - 2 * drop / away**3) - gamma.conj() / away - first
    if not image:
        near = zeta - s
        first = first + gamma / near
        deviator = deviator + gamma.conj() / near - gamma * near.conj() / near**2
    return -np.diff(2 * first.real, axis=1), -np.diff(deviator, axis=1)


def surface_displacement(x, ends, dip: float) -> np.ndarray:
    """Displacement of surface points due to unit slip of cells: horizontal plus i times downward (P, N).

    The displacement does not depend on Poisson's ratio.

    Parameters
    ----------
    x : (P,) distances from the trace, not 0, positive above the hanging wall
    ends, dip : as in `half_space_stress`

    Examples
    --------
    A vertical fault that slips by 1 down to a great depth moves each side by a half:

    >>> print(np.round(surface_displacement([1.0, -1.0], [0.0, 1e9], 90.0).imag.ravel(), 3))
    [-0.5  0.5]
    """
    x, t = np.asarray(x, float)[:, None], np.exp(1j * np.radians(dip))
    s = np.asarray(ends) * t
    turn = np.angle((x - s[:-1]) / (x - s[1:]))
    return (-t * turn - t.conj() * np.diff(s.imag / (x - s.conj()), axis=1)) / np.pi


KERNEL = "band-limited"  # continuation of slip between the centres of cells
Boundary = Literal["surface", "infinite", "periodic"]


class StressTransfer(NamedTuple):
    """Linear map from slip to shear stress for N cells: a convolution, plus one with slip mirrored in the surface.

    The product of two polynomials, slip by cell and stress by lag, is evaluated at the L roots of x^L = i. Powers
    outside the range 0 to L − 1 become imaginary there, so L ≥ N values are enough. For mirrored slip, x is
    replaced by x⁻¹, which conjugates the values.
    """

    number: int  # N
    phases: np.ndarray  # (2, N) cosine and sine of πj/(2L)
    roots: np.ndarray  # (2, M) cosine and sine of −2πj/M, with M the longer side of the table of L = R × C places
    turns: np.ndarray  # (2, R, C) factors between transforms along both sides of the table
    symbol: np.ndarray  # (L,) values for the convolution, divided by L, in the order of the transforms [stress/length]
    reflected: np.ndarray | None  # (2, L) real and imaginary values for mirrored slip; None without a surface
    image: tuple | None = None  # effect of a free surface on in-plane slip, see `_image`
    sense: int = 1  # −1 for a normal fault

    def __call__(self, slip: np.ndarray) -> np.ndarray:
        """Shear stress (N,) due to slip (N,)."""
        return self.tractions(slip)[0]

    def tractions(self, slip: np.ndarray) -> tuple[np.ndarray, np.ndarray | float]:
        """Shear and normal stress (N,) due to slip (N,); the latter is positive in compression, 0 without an image."""
        shear = np.empty(self.number)
        core.fault_stress(self.struct(), np.ascontiguousarray(slip, float), shear)
        added, normal = self.of_image(slip)
        return shear if added is None else shear + added, normal

    def of_image(self, slip: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | float]:
        """Shear stress (or None) and normal stress (N,) due to the surface, beyond those of mirrored slip."""
        if self.image is None:
            return None, 0.0
        spread, table = self.image
        sheared, clamped = (table @ slip).reshape(2, -1)
        return spread @ sheared, self.sense * (spread @ clamped)

    def struct(self):
        """Struct for the compiled core, with its own working memory."""
        sides = dict(zip(("rows", "columns"), self.turns.shape[1:], strict=True))
        return core.fill("Transfer", self._asdict() | sides | {"work": np.empty(4 * len(self.symbol))})


@lru_cache(maxsize=8)
def stress_transfer(
    number: int, cell: float, modulus: float, boundary: str, thickness: float = np.inf, *, dip: float | None = None,
    sense: int = 1,
) -> StressTransfer:  # fmt: skip
    """Return the StressTransfer of a fault.

    Parameters
    ----------
    number : N
    cell : h [length]
    modulus : G* [stress]
    boundary : "surface": from a free surface downwards; "infinite": a segment in an infinite body; "periodic": period
        N h, where slip e^{ikz} gives the stress −(G*/2) |k| coth(|k| W) e^{ikz} between plates of thickness W with
        fixed far sides
    thickness : W of each plate, for a periodic fault [length]
    dip : dip of a fault with in-plane slip and `boundary` "surface" [degrees]
    sense : 1 if positive slip is that of a thrust, −1 if it is that of a normal fault
    """
    size = max(4, 1 << (number - 1).bit_length())
    rows = 1 << (size.bit_length() // 2)
    columns, most = size // rows, max(rows, size // rows)
    phase = 0.5j * np.pi / size * np.arange(size)
    order = (_reversed_bits(rows) + rows * _reversed_bits(columns)[:, None]).ravel()
    if boundary == "periodic":  # stress due to unit slip of every Nth cell of a fault between plates
        k = 2 * np.pi * np.arange(number // 2 + 1) / (number * cell)
        rest = np.divide(1.0, thickness)  # limit of k coth(kW) for k → 0
        with np.errstate(invalid="ignore"):
            symbol = np.where(k > 0, k / np.tanh(np.where(k > 0, k * thickness, 1.0)), rest)
        kernel = -0.5 * modulus * fft.irfft(symbol, number)
    else:
        kernel = _influence(np.arange(2 * number), cell, modulus)
    ahead = np.where(np.arange(number) > 0, 2.0, 1.0) * kernel[:number]  # lags of both signs
    symbol = fft.fft(ahead * np.exp(phase[:number]), size).real[order] / size
    reflected = None
    if boundary == "surface":  # mirrored cells are i + j + 1 cells away; x^(L + n) = i x^n
        away = np.append(kernel[1:], np.zeros(2 * (size - number) + 1)).reshape(2, size)
        values = fft.fft((away[0] + 1j * away[1]) * np.exp(phase))[order] / size
        reflected = np.array([values.real, values.imag])
    turns = -2j * np.pi / size * _reversed_bits(rows)[:, None] * np.arange(columns)
    return StressTransfer(
        number, *(_parts(power) for power in (phase[:number], -2j * np.pi / most * np.arange(most), turns)), symbol,
        reflected, None if dip is None else _image(number, cell, modulus, dip), sense,
    )  # fmt: skip


def _parts(power: np.ndarray) -> np.ndarray:
    """Cosine and sine of the imaginary parts: the real and imaginary parts of exp(`power`)."""
    return np.array([np.cos(power.imag), np.sin(power.imag)])


def _reversed_bits(number: int) -> np.ndarray:
    """Order of frequencies after a transform whose length is a power of two (number,)."""
    order = np.zeros(1, int)
    while len(order) < number:
        order = np.concatenate([2 * order, 2 * order + 1])
    return order


def image_nodes(number: int, dip: float) -> int:
    """Largest number of points down dip from which the effect of the surface on N cells is interpolated."""
    order = min(_order(dip), number)
    return min(number, order * (2 + max(0, int(np.ceil(np.log2(number / (2 * order)))))))


def _order(dip: float) -> int:
    """Number n of Chebyshev nodes between ξ and 2ξ with which the error ρ^−n is round-off.

    ρ is the parameter of the ellipse around the interval that passes through the nearest singularity, at ξ' e^{2iψ}.
    """
    poles = 2 * np.geomspace(0.2, 5.0, 200) * np.exp(2j * np.radians(dip)) - 3  # the interval is mapped to −1 to 1
    growth = np.log(np.abs(poles + np.sqrt(poles - 1) * np.sqrt(poles + 1)).min())
    return int(np.ceil(np.log(1e16) / max(growth, 1e-3))) + 2


@lru_cache(maxsize=4)
def _image(number: int, cell: float, modulus: float, dip: float) -> tuple[sparse.csr_array, np.ndarray]:
    """Interpolation from R nodes to the cells (N, R), and shear and normal stress at the nodes due to slip (2R, N).

    This is the stress that the surface adds, minus the stress of slip mirrored in the surface, both for uniform slip in
    cells. Between ξ and 2ξ, nodes are Chebyshev nodes; near the surface, they are cell centres.
    """
    t, places, order = np.exp(1j * np.radians(dip)), np.arange(number) + 0.5, _order(dip)
    nodes, blocks, high = [], [], number
    while high > 2 * order:
        here = places[high // 2 : high]
        middle, half = 0.5 * (here[0] + here[-1]), 0.5 * (here[-1] - here[0])
        points = chebpts1(order)
        basis = np.linalg.solve(chebvander(points, order - 1).T, chebvander((here - middle) / half, order - 1).T)
        nodes, blocks, high = [middle + half * points, *nodes], [basis.T, *blocks], high // 2
    at = np.concatenate([places[:high], *nodes])
    mean, deviator = half_space_stress(at * t * cell, np.arange(number + 1) * cell, dip, image=True)
    stress = modulus * (mean + t**2 * deviator)
    stress -= 0.5j * modulus / (np.pi * cell) / ((at[:, None] + places) ** 2 - 0.25)  # mirrored cells
    spread = sparse.csr_array(sparse.block_diag([sparse.eye_array(high), *blocks]))
    return spread, np.concatenate([stress.imag, -stress.real])


def _influence(lag: np.ndarray, cell: float, modulus: float) -> np.ndarray:
    """Stress at a cell centre due to band-limited slip that is 1 at the centre `lag` cells away and 0 at the others."""
    far = np.where(lag % 2 == 1, 1 / np.maximum(lag, 1) ** 2, 0.0)
    return modulus / (np.pi * cell) * np.where(lag == 0, -0.25 * np.pi**2, far)


def stress_matrix(number: int, cell: float, modulus: float, boundary: str) -> np.ndarray:
    """Dense matrix (N, N) of the stress due to slip; boundary "surface" or "infinite".

    Examples
    --------
    >>> stress = stress_matrix(4, 1.0, 1.0, "infinite")
    >>> print(np.round(np.pi * stress[0], 4))
    [-2.4674  1.      0.      0.1111]
    """
    i = np.arange(number)
    out = _influence(np.abs(i[:, None] - i), cell, modulus)
    if boundary == "surface":
        out = out + _influence(i[:, None] + i + 1, cell, modulus)  # images above the surface
    return out


INSTANTS = 400  # number of times at which the normal stress is checked before a simulation


@readable
class Injection(NamedTuple):
    """Fluid that enters a fault at one point at a constant rate, and spreads along it by one-dimensional diffusion.

    For the fluid, the fault is infinitely long, with a constant diffusivity c and without losses. At a distance x, the
    pressure after a time t of injection is p = q √(t/c) ierfc[x/√(4ct)]/S, with ierfc(y) = exp(−y²)/√π − y erfc(y).
    After the end of injection, the pressure of a second source −q is added. This is the pressure of the SEAS benchmark
    problem BP6-QD (Lambert et al. 2025, doi:10.1029/2024JB030601).

    Examples
    --------
    >>> source = Injection(flux=1.25e-6, storage=1e-9, diffusivity=0.1, stop=8.64e6)
    >>> print(f"{source.pressure(np.array([0.0]), 8.64e6)[0] / 1e6:.3f} MPa")
    6.555 MPa
    """

    flux: Positive  # q, volume per time and cross-sectional area of the fault; half of it flows to each side [m/s]
    storage: Positive  # S = φ β, porosity × compressibility of pores and fluid [1/Pa]
    diffusivity: Positive  # c, hydraulic diffusivity [m²/s]
    stop: float = np.inf  # end of the injection [s]
    start: NotNegative = 0.0  # [s]
    at: Bounded = 0.0  # depth of the source, or its position along the fault [m]

    def check_entries(self) -> None:
        """Raise an error if a field is not valid."""
        check_types(self)
        if not self.start < self.stop:
            raise ValueError(f"an injection must end after its start, got {self.start:g} to {self.stop:g} s")

    @property
    def breaks(self) -> tuple[float, ...]:
        """Start and end of the injection [s]."""
        return float(self.start), float(self.stop)

    def pressure(self, depth: np.ndarray, time: float) -> np.ndarray:
        """Pore pressure in excess of that before the injection (N,) [Pa]."""
        return self._spread(depth, time - self.start) - self._spread(depth, time - self.stop)

    def change(self, depth: np.ndarray, time: float) -> np.ndarray:
        """Change of the normal stress: minus the pressure (N,) [Pa]."""
        return -self.pressure(depth, time)

    def _spread(self, depth: np.ndarray, time: float) -> np.ndarray:
        if time <= 0:
            return np.zeros(len(depth))
        y = np.abs(depth - self.at) / np.sqrt(4 * self.diffusivity * time)
        shape = np.exp(-y * y) / np.sqrt(np.pi) - y * erfc(y)
        return self.flux / self.storage * np.sqrt(time / self.diffusivity) * shape


@readable
class Oscillation(NamedTuple):
    """Oscillation A sin(2πt/T) added to the normal stress everywhere, such as that due to tides."""

    amplitude: Positive  # A [Pa]
    period: Positive  # T [s]

    check_entries = check_types

    @property
    def breaks(self) -> tuple[float, ...]:
        """Times of the first maximum and minimum [s]."""
        return 0.25 * self.period, 0.75 * self.period

    def change(self, depth: np.ndarray, time: float) -> np.ndarray:
        """Change of the normal stress (N,) [Pa]."""
        return np.full(len(depth), self.amplitude * np.sin(2 * np.pi * time / self.period))


@readable
class StressTable(NamedTuple):
    """Changes of the effective normal stress at times and depths, interpolated linearly and constant beyond them.

    Examples
    --------
    A decrease of 2 MPa at all depths within one day, after a year:

    >>> table = StressTable([3.15e7, 3.15e7 + 86400], [0.0], [[0.0], [-2e6]])
    >>> table.change(np.array([5e3]), 3.2e7)
    array([-2000000.])
    """

    time: Series  # (K,) increasing [s]
    depth: Series  # (D,) increasing [m]
    values: Annotated[Any, Array((2,))]  # (K, D) changes of normal stress; a pore pressure counts as negative [Pa]

    def check_entries(self) -> None:
        """Raise an error if the table is not valid."""
        check_types(self)
        for name, axis in (("times", self.time), ("depths", self.depth)):
            if (np.diff(axis) <= 0).any():
                raise ValueError(f"the {name} of a table of normal stress do not increase: sort the {name}")

    @property
    def breaks(self) -> tuple[float, ...]:
        """All times of the table [s]."""
        return tuple(np.asarray(self.time, float).tolist())

    def change(self, depth: np.ndarray, time: float) -> np.ndarray:
        """Change of the normal stress (N,) [Pa]."""
        times, values = np.asarray(self.time, float), np.asarray(self.values, float)
        last = min(int(np.searchsorted(times, time)), len(times) - 1)
        first = max(last - 1, 0)
        share = np.clip((time - times[first]) / (times[last] - times[first]), 0.0, 1.0) if last > first else 1.0
        return np.interp(depth, self.depth, (1 - share) * values[first] + share * values[last])


@checked
def read_stress_table(path: str | Path) -> StressTable:
    """Read a table of changes of the normal stress: depths [m] in the first row, times [s] in the first column.

    Parameters
    ----------
    path : CSV file; the content of the first cell is ignored

    Raises
    ------
    ValueError
        If the file is not such a table.
    """
    try:
        text = read_text(path, remedy="give a CSV file")
    except OSError as problem:
        raise ValueError(f"{path} cannot be read: {problem.strerror}") from None
    try:
        head, *rows = [row for row in csv.reader(text.splitlines()) if row]
        depth, body = np.array(head[1:], float), np.array(rows, float)
        table = StressTable(body[:, 0], depth, body[:, 1:])
    except (ValueError, IndexError, csv.Error):
        raise ValueError(
            f"{path} is not a table of numbers: give depths in m in the first row, after a first cell with any "
            f"text, then rows with a time in s and changes of normal stress in Pa"
        ) from None
    try:
        table.check_entries()
    except ValueError as problem:
        raise ValueError(f"{path}: {problem}") from None
    return table
