"""Numbers of cyclic shear: secant modulus, damping ratio, G′ and G″, split of the work, and return of the grains.

With the amplitudes γ_a and τ_a = G γ_a between the turns of a loop, the damping ratio is D = ΔW/(4π W) with the area ΔW
of the loop and W = ½ τ_a γ_a. ΔW is the work of the shear stress, which the ledger also adds up within steps in which
grains rearrange. G′ and G″ are the first Fourier coefficients of τ over γ₀, for γ = γ₀ sin θ, so that ΔW = π γ₀² G″ up
to the trapezia between equilibria.
"""

import numpy as np

from ....results import Ledger
from ..element_test.measures import Estimate, estimate
from .sands import band
from .scenario import CyclicShearScenario
from .simulate import CyclicRun, CyclicShearResult, Response

ELASTIC = 1e-3  # damping ratio below which cycles that return are elastic
RETURNED = 1e-2  # rms displacement over γ₀ D, below which a sample has returned
CLEAR = 1e-5  # damping ratio from which the work is split: the area of a loop below is lost in round-off
KINDS = ("elastic", "reversible", "periodic", "irreversible", "undecided")
OFF = 0.02  # relative difference of G at the smallest amplitude from the tangent modulus, above which it is said
NAN = float("nan")

STRESS, WORK = "force/length^(dim-1)", "energy/length^dim"
PARTS = ("sliding", "rolling", "dashpots", "drag", "nonpotential", "stored", "normal", "residual")
CYCLE_UNITS = {
    "amplitude": "1", "cycle": "1", "G": STRESS, "G_ratio": "1", "damping": "1", "storage": STRESS, "loss": STRESS,
    "area": WORK, **dict.fromkeys(PARTS, "1"), "drawn": "1", "in_rearrangements": "1", "busiest": "1", "strong": "1",
    "rearranged": "1", "pressure": STRESS, "volumetric_strain": "1", "returned": "1",
}  # fmt: skip
UNITS = {
    "G0": STRESS, "G_smallest": STRESS, "gamma_half": "1", "gamma_elastic": "1", "gamma_returns": "1",
    "residual": "1", "in_band": "1",
}  # fmt: skip
MEANING = {
    "G0": "tangent modulus of the sample, from its elastic moduli", "G_smallest": "G at the smallest amplitude",
    "gamma_half": "amplitude at which G is half of Gmax",
    "gamma_elastic": "largest amplitude up to which cycles are elastic",
    "gamma_returns": "largest amplitude up to which grains return",
    "residual": "largest residual of a loop, over its area",
    "in_band": "share of amplitudes with G/Gmax and damping of sands",
    "G_ratio": "G/Gmax at an amplitude", "damping": "damping ratio at an amplitude",
}  # fmt: skip


def units_of(scenario: CyclicShearScenario) -> dict[str, str]:
    """Units of the numbers of a sample, with those at each amplitude, such as `damping@0.001`."""
    at = [f"@{amplitude:g}" for amplitude in scenario.cycles.amplitudes]
    return UNITS | {f"{name}{place}": "1" for name in ("G_ratio", "damping") for place in at}


def largest_modulus(run: CyclicRun) -> float:
    """Gmax of a sample: its tangent modulus or, if that is not known, G at the smallest amplitude."""
    return run.modulus if np.isfinite(run.modulus) else secant(run.responses[0], -1)[0]


def secant(response: Response, k: int) -> tuple[float, float]:
    """G and γ_a of cycle k, between its turns [force/length^(dim−1), 1]."""
    quarter = (response.gamma.shape[1] - 1) // 4
    turns = [quarter, 3 * quarter]
    tau, gamma = (-np.diff(values[k][turns])[0] / 2 for values in (response.tau, response.gamma))
    return float(tau / gamma), float(gamma)


def harmonics(response: Response, k: int) -> tuple[float, float]:
    """G′ and G″ of cycle k [force/length^(dim−1)]."""
    tau = response.tau[k]
    theta = np.linspace(0, 2 * np.pi, len(tau))
    return tuple(
        float(np.trapezoid(tau * wave(theta), theta)) / (np.pi * response.amplitude) for wave in (np.sin, np.cos)
    )


def split(response: Response, k: int) -> dict[str, float]:
    """Shares of the area of loop k: what is dissipated and stored, less the work of σ_yy, and the residual.

    `drawn` is the excess of the polygon through the equilibria.
    """
    area, book, moved = area_of(response, k), Ledger(*response.energies[k].T), response.rearranged[k][1:]
    spent = {name: float(column[-1] - column[0]) for name, column in book._asdict().items()}
    dissipated = np.diff(book.coulomb + book.rolling + book.viscous + book.drag)
    shares = {
        "sliding": spent["coulomb"], "rolling": spent["rolling"], "dashpots": spent["viscous"], "drag": spent["drag"],
        "nonpotential": -spent["nonpotential"], "stored": spent["normal"] + spent["tangential"],
        "normal": -_normal_work(response, k),
    }  # fmt: skip
    shares["residual"] = area - sum(shares.values())
    shares["drawn"] = float(np.trapezoid(response.tau[k], response.gamma[k])) - area
    shares = {name: value / area for name, value in shares.items()}
    total = dissipated.sum()
    return shares | {"in_rearrangements": float(dissipated[moved].sum() / total) if total else NAN}


def period(response: Response) -> int:
    """Number of cycles after which grains return at the end, 0 if they do not."""
    back = response.distance[-1][-2::-1]
    returned = np.flatnonzero(back < RETURNED)
    return int(returned[0]) + 1 if len(returned) else 0


def kind_of(response: Response) -> str:
    """Kind of cycles that an amplitude ends in.

    elastic: grains return after a cycle, and the damping ratio is below `ELASTIC`; reversible: they return, and the
    loop has an area, so that what slides, slides back; periodic: they return after several cycles; irreversible: they
    have not returned. Grains return if their rms displacement is below `RETURNED` times γ₀ times the mean diameter.
    """
    if len(response.gamma) < 2:
        return "undecided"
    n = period(response)
    if n == 1:
        return "elastic" if abs(damping(response, -1)) < ELASTIC else "reversible"
    return "periodic" if n else "irreversible"


def area_of(response: Response, k: int) -> float:
    """Area of loop k: work of the shear stress [energy/length^dim]."""
    external = Ledger(*response.energies[k].T).external
    return float(external[-1] - external[0]) - _normal_work(response, k)


def _normal_work(response: Response, k: int) -> float:
    """Work of σ_yy in cycle k [energy/length^dim]."""
    height = response.height[k]
    return float(np.trapezoid(response.normal[k] * np.exp(-height), height))


def damping(response: Response, k: int) -> float:
    """Damping ratio D of cycle k."""
    g, amplitude = secant(response, k)
    return area_of(response, k) / (2 * np.pi * g * amplitude**2)


def cycle_numbers(run: CyclicRun, response: Response, k: int) -> dict[str, float]:
    """Numbers of cycle k by name."""
    (g, _), (storage, loss) = secant(response, k), harmonics(response, k)
    d, number = damping(response, k), k % len(response.gamma) + 1
    clear = abs(d) >= CLEAR
    shares = split(response, k) if clear else {}
    return dict.fromkeys(CYCLE_UNITS, NAN) | shares | {
        "amplitude": response.amplitude, "cycle": number, "G": g, "G_ratio": g / largest_modulus(run), "damping": d,
        "storage": storage, "loss": loss, "area": area_of(response, k),
        "busiest": response.busiest[k] if clear else NAN, "strong": response.strong[k] if clear else NAN,
        "rearranged": float(response.rearranged[k][1:].mean()),
        "pressure": float(response.pressure[k][-1]), "volumetric_strain": float(response.height[k][-1]),
        "returned": float(response.distance[number][number - 1]),
    }  # fmt: skip


def last_cycles(run: CyclicRun) -> dict[str, np.ndarray]:
    """Numbers of the last cycle at each amplitude: columns by name."""
    rows = [cycle_numbers(run, response, -1) for response in run.responses]
    return {name: np.array([row[name] for row in rows]) for name in CYCLE_UNITS}


def numbers_of(run: CyclicRun, result: CyclicShearResult) -> dict[str, float]:
    """Numbers of one sample by name; NaN where its cycles do not give them."""
    table, kinds = last_cycles(run), [kind_of(response) for response in run.responses]
    residual = np.abs(table["residual"])
    each = {
        f"{name}@{amplitude:g}": value
        for name in ("G_ratio", "damping")
        for amplitude, value in zip(table["amplitude"], table[name], strict=True)
    }
    return dict.fromkeys(units_of(result.scenario), NAN) | each | {
        "G0": run.modulus, "G_smallest": table["G"][0], "gamma_half": _crossing(table, 0.5),
        "gamma_elastic": _up_to(run, kinds, ("elastic",)),
        "gamma_returns": _up_to(run, kinds, ("elastic", "reversible", "periodic")),
        "residual": float(np.nanmax(residual)) if np.isfinite(residual).any() else NAN,
        "in_band": float(in_band(result, table).mean()),
    }  # fmt: skip


def _crossing(table: dict[str, np.ndarray], level: float) -> float:
    """Amplitude at which G/Gmax first falls to a level, between two amplitudes on a logarithmic axis."""
    gamma, ratio = np.log(table["amplitude"]), table["G_ratio"]
    below = np.flatnonzero(ratio <= level)
    if not len(below) or below[0] == 0:
        return NAN
    k = below[0]
    return float(np.exp(np.interp(-level, -ratio[k - 1 : k + 1], gamma[k - 1 : k + 1])))


def _up_to(run: CyclicRun, kinds: list[str], allowed: tuple[str, ...]) -> float:
    """Largest amplitude up to which cycles are of some kinds; NaN if the first is not."""
    count = next((k for k, kind in enumerate(kinds) if kind not in allowed), len(kinds))
    return run.responses[count - 1].amplitude if count else NAN


def in_band(result: CyclicShearResult, table: dict[str, np.ndarray]) -> np.ndarray:
    """(2, A) for G/Gmax and damping, 1 where a sample of spheres lies in the band of sands; NaN for disks."""
    sample, gamma = result.scenario.sample, table["amplitude"]
    if sample.dim == 2 or result.scenario.units != "SI":
        return np.full((2, len(gamma)), NAN)
    limits = band(sample.pressure, gamma)
    return np.array([(low <= table[name]) & (table[name] <= high) for name, (low, high) in limits.items()], float)


def estimates(result: CyclicShearResult) -> dict[str, Estimate]:
    """Estimates of all numbers that the cycles of every sample give."""
    rows = [numbers_of(run, result) for run in result.runs]
    numbers = {name: estimate(np.array([row[name] for row in rows])) for name in units_of(result.scenario)}
    return {name: number for name, number in numbers.items() if np.isfinite(number.mean)}


def measures(result: CyclicShearResult) -> dict[str, tuple[float, str]]:
    """Return {name: (value, unit)} for sweeps: means over samples, and halves of their 95 % intervals."""
    numbers, nothing = estimates(result), Estimate(NAN, NAN, NAN)
    out = {}
    for name, unit in units_of(result.scenario).items():
        number = numbers.get(name, nothing)
        out |= {name: (number.mean, unit), f"{name}_error": (number.half_width, unit)}
    return out


def sentences(result: CyclicShearResult) -> list[str]:
    """Remarks for readers of the numbers: kinds of cycles, residual, band of sands, and finer steps."""
    return [*_kinds(result), *_missing(result), *_band(result), *_finer(result)]


def _kinds(result: CyclicShearResult) -> list[str]:
    kinds = ", ".join(f"{response.amplitude:g} {kind_of(response)}" for response in result.runs[0].responses)
    return [
        f"Cycles of sample {result.runs[0].seed}: {kinds}. Grains return if their rms displacement is below "
        f"{RETURNED:g} γ₀ D; cycles that return are elastic if the damping ratio is below {ELASTIC:g}."
    ]


def _missing(result: CyclicShearResult) -> list[str]:
    out = [f"Sample {run.seed}: {run.ended}." for run in result.runs if run.ended]
    if any(not np.isfinite(run.modulus) for run in result.runs):
        out.append("Samples without elastic moduli take G at the smallest amplitude as Gmax.")
    off = [abs(secant(run.responses[0], -1)[0] / run.modulus - 1) for run in result.runs if np.isfinite(run.modulus)]
    if max(off, default=0.0) > OFF:
        out.append(
            f"G at the smallest amplitude differs by {max(off):.1%} from the tangent modulus: contacts slide or open "
            f"there, as in samples that hardly bear their pressure; use smaller amplitudes, or less sample.friction."
        )
    return out


def _band(result: CyclicShearResult) -> list[str]:
    tables = [last_cycles(run) for run in result.runs]
    inside = np.concatenate([in_band(result, table) for table in tables], axis=1)
    if not np.isfinite(inside).all():
        return ["Curves of sands are for spheres in SI units."]
    ratio, d = (f"{int(row.sum())} of {len(row)}" for row in inside)
    return [f"G/Gmax lies in the band of sands at {ratio} amplitudes, the damping ratio at {d}."]


def _finer(result: CyclicShearResult) -> list[str]:
    if result.checked is None:
        return ["It was not checked whether twice as many steps give the same: use check = true."]
    one, two = (last_cycles(run) for run in (result.runs[0], result.checked))
    count = min(len(one["G"]), len(two["G"]))
    g, d = (np.abs(two[name][:count] - one[name][:count]) for name in ("G_ratio", "damping"))
    return [f"Twice as many steps change G/Gmax of the first sample by at most {g.max():.2g}, and D by {d.max():.2g}."]
