"""Quantities of cyclic shear, and curves of sands: modulus, damping ratio, G′ and G″, split of the work, return.

γ_a and τ_a = G γ_a are the amplitudes between the turns of a loop. The damping ratio is D = ΔW/(4π W), with the area ΔW
of the loop and W = ½ τ_a γ_a. ΔW is the work of the shear stress, including work within steps in which grains
rearrange. G′ and G″ are the first Fourier coefficients of τ over γ₀, for γ = γ₀ sin θ, so ΔW = π γ₀² G″ except for
the trapezoidal rule between equilibria.

For sands G/Gmax = 1/(1 + (γ/γ_r)^a), and the damping is b (G/Gmax)^0.1 times that of Masing's rule. The small-strain
part is left out, because rate-independent steps cannot produce it. The coefficients are those of Darendeli (2001, PI =
0, OCR = 1) and Menq (2003) as implemented in pystrata (github.com/arkottke/pystrata, `site.py`, commit 020a5c3), not
taken from the theses themselves.
"""

from functools import cached_property
from typing import NamedTuple

import numpy as np

from ....kit import Measures, Quantities, Quantity, estimate
from ....results import Ledger
from .scenario import CyclicShearScenario
from .simulate import CyclicRun, CyclicShearResult, Response

ATMOSPHERE = 101.325e3  # [Pa]
CYCLES = 10  # number of cycles assumed for the curves, which hardly depend on it
UNIFORMITY = (1.0, 10.0)  # D60/D10 of uniform and of well-graded sands


class Curve(NamedTuple):
    """Reference strain and curvature of a modified hyperbola."""

    reference: float  # γ_r, at which G is half of Gmax
    curvature: float  # a

    def ratio(self, gamma: np.ndarray) -> np.ndarray:
        """G/Gmax at amplitudes.

        Examples
        --------
        >>> Curve(1e-3, 0.9).ratio(np.array([1e-3]))
        array([0.5])
        """
        return 1 / (1 + (gamma / self.reference) ** self.curvature)

    def damping(self, gamma: np.ndarray) -> np.ndarray:
        """Damping ratio of loops at amplitudes."""
        a, x = self.curvature, gamma / self.reference
        masing = 100 / np.pi * (4 * (x - np.log1p(x)) * (1 + x) / x**2 - 2)  # [%] of a hyperbola with a = 1
        powers = (-1.1143 * a**2 + 1.8618 * a + 0.2523, 0.0805 * a**2 - 0.0710 * a - 0.0095,
                  -0.0005 * a**2 + 0.0002 * a + 0.0003)  # fmt: skip
        masing = sum(c * masing**k for k, c in enumerate(powers, start=1))
        scaled = (0.6329 - 0.00566 * np.log(CYCLES)) * self.ratio(gamma) ** 0.1 * masing / 100
        return np.maximum.accumulate(scaled)


def darendeli(pressure: float) -> Curve:
    """Curve of Darendeli (2001) for soils without plasticity at a mean effective stress [Pa]."""
    return Curve(3.52e-4 * (pressure / ATMOSPHERE) ** 0.3483, 0.9190)


def menq(pressure: float, uniformity: float) -> Curve:
    """Curve of Menq (2003) for sands with a coefficient of uniformity D60/D10 at a mean effective stress [Pa]."""
    p = pressure / ATMOSPHERE
    reference = 1.2e-3 * uniformity**-0.6 * p ** (0.5 * uniformity**-0.15)
    return Curve(reference, 0.86 + 0.1 * float(np.log10(p)))


def band(pressure: float, gamma: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Range of G/Gmax and damping ratio of sands at amplitudes, from Darendeli's curve and those of Menq."""
    curves = [darendeli(pressure), *(menq(pressure, uniformity) for uniformity in UNIFORMITY)]
    values = {"G_ratio": [c.ratio(gamma) for c in curves], "damping": [c.damping(gamma) for c in curves]}
    return {name: (np.min(rows, axis=0), np.max(rows, axis=0)) for name, rows in values.items()}


ELASTIC = 1e-3  # damping ratio below which cycles that return are elastic
RETURNED = 1e-2  # rms displacement over γ₀ D below which a sample has returned
CLEAR = 1e-5  # damping ratio above which the work is split; the area of loops below is lost in round-off
OFF = 0.02  # relative difference between G at the smallest amplitude and the tangent modulus that is reported
NAN = float("nan")


class Loop:
    """Cycle k of a response, with the quantities of `CYCLE`."""

    def __init__(self, response: Response, k: int, run: CyclicRun | None = None):
        self.response, self.k, self.run = response, k % len(response.gamma), run

    @cached_property
    def turns(self) -> tuple[float, float]:
        """G and γ_a between the turns [force/length^(dim−1), 1]."""
        quarter = (self.response.gamma.shape[1] - 1) // 4
        turns = [quarter, 3 * quarter]
        tau, gamma = (-np.diff(v[self.k][turns])[0] / 2 for v in (self.response.tau, self.response.gamma))
        return float(tau / gamma), float(gamma)

    @cached_property
    def harmonics(self) -> tuple[float, float]:
        """G′ and G″ [force/length^(dim−1)]."""
        tau = self.response.tau[self.k]
        theta = np.linspace(0, 2 * np.pi, len(tau))
        return tuple(
            float(np.trapezoid(tau * wave(theta), theta)) / (np.pi * self.response.amplitude)
            for wave in (np.sin, np.cos)
        )

    @cached_property
    def book(self) -> Ledger:
        """Energies of the cycle, in columns (T + 1,) [energy/length^dim]."""
        return Ledger(*self.response.energies[self.k].T)

    @cached_property
    def normal_work(self) -> float:
        """Work of σ_yy [energy/length^dim]."""
        height = self.response.height[self.k]
        return float(np.trapezoid(self.response.normal[self.k] * np.exp(-height), height))

    @cached_property
    def area(self) -> float:
        """Area of the loop: work of the shear stress [energy/length^dim]."""
        return float(self.book.external[-1] - self.book.external[0]) - self.normal_work

    @cached_property
    def damping(self) -> float:
        """Damping ratio D."""
        g, amplitude = self.turns
        return self.area / (2 * np.pi * g * amplitude**2)

    @cached_property
    def shares(self) -> dict[str, float]:
        """Contributions to the area: dissipation and storage, minus the work of σ_yy, and the residual.

        `drawn` is the excess of the polygon through the equilibria.
        """
        spent = {name: float(column[-1] - column[0]) for name, column in self.book._asdict().items()}
        shares = {
            "sliding": spent["coulomb"], "rolling": spent["rolling"], "dashpots": spent["viscous"],
            "drag": spent["drag"], "nonpotential": -spent["nonpotential"],
            "stored": spent["normal"] + spent["tangential"], "normal": -self.normal_work,
        }  # fmt: skip
        shares["residual"] = self.area - sum(shares.values())
        shares["drawn"] = float(np.trapezoid(self.response.tau[self.k], self.response.gamma[self.k])) - self.area
        return {name: value / self.area for name, value in shares.items()}

    @property
    def in_rearrangements(self) -> float:
        """Share of the dissipation in steps in which grains rearrange; NaN without dissipation."""
        book, moved = self.book, self.response.rearranged[self.k][1:]
        dissipated = np.diff(book.coulomb + book.rolling + book.viscous + book.drag)
        total = dissipated.sum()
        return float(dissipated[moved].sum() / total) if total else NAN

    @property
    def clear(self) -> bool:
        """True if the work can be split."""
        return abs(self.damping) >= CLEAR


STRESS, WORK = "force/length^(dim-1)", "energy/length^dim"
PARTS = {
    "sliding": "sliding contacts", "rolling": "rolling friction", "dashpots": "dashpots", "drag": "drag",
    "nonpotential": "changes of the tangential springs", "stored": "energy stored in contacts",
    "normal": "work of σ_yy, negative", "residual": "remainder that the ledger does not explain",
}  # fmt: skip


def _share(name: str, meaning: str) -> Quantity:
    return Quantity(name, "1", meaning, lambda loop: loop.shares[name] if loop.clear else NAN)


CYCLE = Quantities([
    Quantity("sample", "1", "seed of the sample", "run.seed"),
    Quantity("kind", "1", "kind of the last cycles at the amplitude", lambda loop: kind_of(loop.response)),
    Quantity("amplitude", "1", "amplitude γ₀", "response.amplitude", r"amplitude of the shear strain $\gamma_0$"),
    Quantity("cycle", "1", "number of the cycle", lambda loop: loop.k + 1),
    Quantity("G", STRESS, "secant modulus between the turns", lambda loop: loop.turns[0]),
    Quantity("G_ratio", "1", "G/Gmax", lambda loop: loop.turns[0] / largest_modulus(loop.run), r"$G/G_\mathrm{max}$"),
    Quantity("damping", "1", "damping ratio", label="damping ratio $D$"),
    Quantity("storage", STRESS, "G′, storage modulus", lambda loop: loop.harmonics[0], "$G'$"),
    Quantity("loss", STRESS, "G″, loss modulus", lambda loop: loop.harmonics[1], "$G''$"),
    Quantity("area", WORK, "area of the loop, the work of the shear stress"),
    *(_share(name, f"fraction of the area: {words}") for name, words in PARTS.items()),
    _share("drawn", "excess of the polygon through the equilibria, over the area"),
    Quantity("in_rearrangements", "1", "fraction of the dissipation in steps with rearrangements",
             lambda loop: loop.in_rearrangements if loop.clear else NAN),
    Quantity("busiest", "1", "fraction of sliding work in the tenth of the contacts that dissipates most",
             lambda loop: loop.response.busiest[loop.k] if loop.clear else NAN),
    Quantity("strong", "1", "fraction of sliding work in contacts with more than the mean force",
             lambda loop: loop.response.strong[loop.k] if loop.clear else NAN),
    Quantity("rearranged", "1", "fraction of steps with rearrangements",
             lambda loop: float(loop.response.rearranged[loop.k][1:].mean())),
    Quantity("pressure", STRESS, "pressure at the end", lambda loop: float(loop.response.pressure[loop.k][-1])),
    Quantity("volumetric_strain", "1", "volumetric strain at the end, compression positive",
             lambda loop: float(loop.response.height[loop.k][-1])),
    Quantity("returned", "1", "rms displacement of grains in the cycle, over γ₀ D",
             lambda loop: float(loop.response.distance[loop.k + 1][loop.k])),
])  # fmt: skip

LOOP = Quantities([
    *(CYCLE[name] for name in ("sample", "amplitude", "cycle")),
    Quantity("gamma", "1", "shear strain", lambda loop: loop.response.gamma[loop.k], r"$\gamma/\gamma_0$"),
    Quantity("tau", STRESS, "shear stress, −σ_xy", lambda loop: loop.response.tau[loop.k]),
    Quantity("normal", STRESS, "σ_yy", lambda loop: loop.response.normal[loop.k]),
    Quantity("pressure", STRESS, "pressure", lambda loop: loop.response.pressure[loop.k]),
    Quantity("height", "1", "ε_yy, compression positive", lambda loop: loop.response.height[loop.k]),
    Quantity("rearranged", "1", "1 where grains rearranged", lambda loop: loop.response.rearranged[loop.k]),
])  # fmt: skip


def loops_of(result: CyclicShearResult) -> list[Loop]:
    """All cycles of all samples."""
    return [
        Loop(response, k, run)
        for run in result.runs
        for response in run.responses
        for k in range(len(response.gamma))
    ]  # fmt: skip


def last_cycles(run: CyclicRun) -> dict[str, np.ndarray]:
    """Quantities of the last cycle at each amplitude: columns by name."""
    return CYCLE.columns(Loop(response, -1, run) for response in run.responses)


def largest_modulus(run: CyclicRun) -> float:
    """Gmax of a sample: its tangent modulus or, if that is not known, G at the smallest amplitude."""
    return run.modulus if np.isfinite(run.modulus) else Loop(run.responses[0], -1).turns[0]


def period(response: Response) -> int:
    """Number of cycles after which grains return, in the last cycles; 0 if they do not."""
    back = response.distance[-1][-2::-1]
    returned = np.flatnonzero(back < RETURNED)
    return int(returned[0]) + 1 if len(returned) else 0


def kind_of(response: Response) -> str:
    """Kind of the final cycles at an amplitude.

    elastic: grains return after a cycle, and the damping ratio is below `ELASTIC`; reversible: grains return, but the
    loop has an area, so sliding is reversed; periodic: grains return after several cycles; irreversible: grains
    do not return. Grains return if their rms displacement is below `RETURNED` times γ₀ times the mean diameter.
    """
    if len(response.gamma) < 2:
        return "undecided"
    n = period(response)
    if n == 1:
        return "elastic" if abs(Loop(response, -1).damping) < ELASTIC else "reversible"
    return "periodic" if n else "irreversible"


class Sample(NamedTuple):
    """Cycles of a sample, and their scenario."""

    run: CyclicRun
    scenario: CyclicShearScenario
    table: dict[str, np.ndarray]  # quantities of the last cycles

    def at_amplitudes(self, name: str) -> dict[float, float]:
        """Values of the last cycles by amplitude; NaN at amplitudes not reached."""
        known = dict(zip(self.table["amplitude"], self.table[name], strict=True))
        return {amplitude: known.get(amplitude, NAN) for amplitude in self.scenario.cycles.amplitudes}

    def up_to(self, *kinds: str) -> float:
        """Largest amplitude up to which cycles are of the given kinds; NaN if those at the first amplitude are not."""
        count = next((k for k, kind in enumerate(self.table["kind"]) if kind not in kinds), len(self.table["kind"]))
        return self.run.responses[count - 1].amplitude if count else NAN

    @property
    def gamma_half(self) -> float:
        """Amplitude at which G/Gmax first falls to 1/2, interpolated on a logarithmic axis."""
        gamma, ratio = np.log(self.table["amplitude"]), self.table["G_ratio"]
        below = np.flatnonzero(ratio <= 0.5)
        if not len(below) or below[0] == 0:
            return NAN
        k = below[0]
        return float(np.exp(np.interp(-0.5, -ratio[k - 1 : k + 1], gamma[k - 1 : k + 1])))

    @property
    def residual(self) -> float:
        """Largest residual of a loop; NaN if no work can be split."""
        residual = np.abs(self.table["residual"])
        return float(np.nanmax(residual)) if np.isfinite(residual).any() else NAN


MEASURES = Measures(
    [
        Quantity("G0", STRESS, "tangent modulus of the sample, from its elastic moduli", "run.modulus"),
        Quantity("G_smallest", STRESS, "G at the smallest amplitude", lambda sample: sample.table["G"][0]),
        Quantity("gamma_half", "1", "amplitude at which G is half of Gmax"),
        Quantity("gamma_elastic", "1", "largest amplitude up to which cycles are elastic",
                 lambda sample: sample.up_to("elastic")),
        Quantity("gamma_returns", "1", "largest amplitude up to which grains return",
                 lambda sample: sample.up_to("elastic", "reversible", "periodic")),
        Quantity("residual", "1", "largest residual of a loop, over its area"),
        Quantity("in_band", "1", "fraction of amplitudes with G/Gmax and damping of sands",
                 lambda sample: float(in_band(sample.scenario, sample.table).mean())),
        Quantity("G_ratio", "1", "G/Gmax at an amplitude", lambda sample: sample.at_amplitudes("G_ratio")),
        Quantity("damping", "1", "damping ratio at an amplitude", lambda sample: sample.at_amplitudes("damping")),
    ],
    samples=lambda result: [Sample(run, result.scenario, last_cycles(run)) for run in result.runs],
    over=estimate,
)  # fmt: skip


def in_band(scenario: CyclicShearScenario, table: dict[str, np.ndarray]) -> np.ndarray:
    """Array (2, A) for G/Gmax and damping: 1 where a sample of spheres lies in the band of sands; NaN for disks."""
    gamma = table["amplitude"]
    if scenario.sample.dim == 2 or scenario.units != "SI":
        return np.full((2, len(gamma)), NAN)
    limits = band(scenario.sample.pressure, gamma)
    return np.array([(low <= table[name]) & (table[name] <= high) for name, (low, high) in limits.items()], float)


def sentences(result: CyclicShearResult) -> list[str]:
    """Remarks on the numbers: kinds of cycles, residual, band of sands, and finer steps."""
    return [*_kinds(result), *_missing(result), *_band(result), *_finer(result)]


def _kinds(result: CyclicShearResult) -> list[str]:
    kinds = ", ".join(f"{response.amplitude:g} {kind_of(response)}" for response in result.runs[0].responses)
    return [
        f"Cycles of sample {result.runs[0].seed}: {kinds}. Grains return if their rms displacement is below "
        f"{RETURNED:g} γ₀ D; cycles that return are elastic if the damping ratio is below {ELASTIC:g}."
    ]


def _missing(result: CyclicShearResult) -> list[str]:
    out = [f"Sample {run.seed}: {run.ended}." for run in result.runs if run.ended]
    measured = [run for run in result.runs if np.isfinite(run.modulus)]
    if len(measured) < len(result.runs):
        out.append("Samples without elastic moduli use G at the smallest amplitude as Gmax.")
    off = max((abs(Loop(run.responses[0], -1).turns[0] / run.modulus - 1) for run in measured), default=0.0)
    if off > OFF:
        out.append(
            f"G at the smallest amplitude differs by {off:.1%} from the tangent modulus: contacts slide or open "
            f"there, as in samples that barely support their pressure; use smaller amplitudes, or less sample.friction."
        )
    return out


def _band(result: CyclicShearResult) -> list[str]:
    inside = np.concatenate([in_band(result.scenario, last_cycles(run)) for run in result.runs], axis=1)
    if not np.isfinite(inside).all():
        return ["Curves of sands are for spheres in SI units."]
    ratio, d = (f"{int(row.sum())} of {len(row)}" for row in inside)
    return [f"G/Gmax lies in the band of sands at {ratio} amplitudes, the damping ratio at {d}."]


def _finer(result: CyclicShearResult) -> list[str]:
    if result.checked is None:
        return ["Convergence with twice as many steps was not checked: use check = true."]
    one, two = (last_cycles(run) for run in (result.runs[0], result.checked))
    count = min(len(one["G"]), len(two["G"]))
    g, d = (np.abs(two[name][:count] - one[name][:count]) for name in ("G_ratio", "damping"))
    change = f"G/Gmax of the first sample by at most {g.max():.2g}, and D by {d.max():.2g}"
    return [f"Doubling the number of steps changes {change}."]
