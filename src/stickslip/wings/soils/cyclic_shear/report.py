"""Output of cyclic shear: comparison with curves of sands, tables of cycles and loops, figures, archive and summary.

For sands, G/Gmax = 1/(1 + (γ/γ_r)^a), and the damping is b (G/Gmax)^0.1 times that of Masing's rule. The small-strain
part is left out, because rate-independent steps cannot produce it. The coefficients are those of Darendeli (2001, PI =
0, OCR = 1) and Menq (2003) as implemented in pystrata (github.com/arkottke/pystrata, `site.py`, commit 020a5c3), not
taken from the theses themselves.
"""

from typing import NamedTuple

import numpy as np

from ....kit import Measures, Quantity, archive_fields, console, estimate, new_table, pluralize, show_table, unit_name
from ..element_test.report import for_engineers
from .scenario import CyclicShearScenario
from .simulate import (
    CYCLE,
    ELASTIC,
    LOOP,
    NAN,
    RETURNED,
    STRESS,
    CyclicRun,
    CyclicShearResult,
    Loop,
    kind_of,
    largest_modulus,
    last_cycles,
    loops_of,
)

SHOWN = ("G", "G_ratio", "damping", "storage", "loss", "sliding", "residual", "returned")
OFF = 0.02  # relative difference between G at the smallest amplitude and the tangent modulus above which it is reported
ATMOSPHERE = 101.325e3  # [Pa]
CYCLES = 10  # number of cycles assumed for the curves, which hardly depend on it
UNIFORMITY = (1.0, 10.0)  # D60/D10 of uniform and of well-graded sands


class Curve(NamedTuple):
    """Reference strain and curvature of a modified hyperbola."""

    reference: float  # γ_r, at which G is half of Gmax
    curvature: float  # a

    def ratio(self, gamma: np.ndarray) -> np.ndarray:
        """Return G/Gmax at given amplitudes.

        Examples
        --------
        >>> Curve(1e-3, 0.9).ratio(np.array([1e-3]))
        array([0.5])
        """
        return 1 / (1 + (gamma / self.reference) ** self.curvature)

    def damping(self, gamma: np.ndarray) -> np.ndarray:
        """Return the damping ratio of loops at given amplitudes."""
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
    """Return the range of G/Gmax and damping ratio of sands at given amplitudes, from Darendeli's and Menq's curves."""
    curves = [darendeli(pressure), *(menq(pressure, uniformity) for uniformity in UNIFORMITY)]
    values = {"G_ratio": [c.ratio(gamma) for c in curves], "damping": [c.damping(gamma) for c in curves]}
    return {name: (np.min(rows, axis=0), np.max(rows, axis=0)) for name, rows in values.items()}


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
        """Largest residual of a loop after the split of its work; NaN if no work can be split."""
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
        Quantity("in_band", "1", "fraction of amplitudes at which G/Gmax and damping lie in the bands of sands",
                 lambda sample: float(in_band(sample.scenario, sample.table).mean())),
        Quantity("G_ratio", "1", "G/Gmax at an amplitude", lambda sample: sample.at_amplitudes("G_ratio")),
        Quantity("damping", "1", "damping ratio at an amplitude", lambda sample: sample.at_amplitudes("damping")),
    ],
    samples=lambda result: [Sample(run, result.scenario, last_cycles(run)) for run in result.runs],
    over=estimate,
)  # fmt: skip


def in_band(scenario: CyclicShearScenario, table: dict[str, np.ndarray]) -> np.ndarray:
    """Return, for G/Gmax and damping (2, A), 1 where spheres lie in the band of sands, 0 elsewhere; NaN for disks."""
    gamma = table["amplitude"]
    if scenario.sample.dim == 2 or scenario.units != "SI":
        return np.full((2, len(gamma)), NAN)
    limits = band(scenario.sample.pressure, gamma)
    return np.array([(low <= table[name]) & (table[name] <= high) for name, (low, high) in limits.items()], float)


def sentences(result: CyclicShearResult) -> list[str]:
    """Remarks on the numbers: kinds of cycles, residual, band of sands, and finer steps."""
    kinds = ", ".join(f"{response.amplitude:g} {kind_of(response)}" for response in result.runs[0].responses)
    cycles = (
        f"Cycles of sample {result.runs[0].seed}: {kinds}. Grains return if their rms displacement is below "
        f"{RETURNED:g} γ₀ D; cycles that return are elastic if the damping ratio is below {ELASTIC:g}."
    )
    inside = np.concatenate([in_band(result.scenario, last_cycles(run)) for run in result.runs], axis=1)
    ratio, d = (f"{np.nansum(row):.0f} of {len(row)}" for row in inside)
    sands = f"G/Gmax lies in the band of sands at {ratio} amplitudes, the damping ratio at {d}."
    if not np.isfinite(inside).all():
        sands = "Curves of sands are for spheres in SI units."
    return [cycles, *_missing(result), sands, *_finer(result)]


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


def _finer(result: CyclicShearResult) -> list[str]:
    if result.checked is None:
        return ["Convergence with twice as many steps was not checked: use check = true."]
    one, two = (last_cycles(run) for run in (result.runs[0], result.checked))
    count = min(len(one["G"]), len(two["G"]))
    g, d = (np.abs(two[name][:count] - one[name][:count]) for name in ("G_ratio", "damping"))
    change = f"G/Gmax of the first sample by at most {g.max():.2g}, and D by {d.max():.2g}"
    return [f"Doubling the number of steps changes {change}."]


def files(result: CyclicShearResult):
    """Yield (file name, function that writes it) for the cycles and the loops of all samples."""
    yield "cycles.csv", lambda path: CYCLE.write(path, loops_of(result))
    yield "series.csv", lambda path: LOOP.write(path, loops_of(result))


def figures(result: CyclicShearResult):
    """Yield (file name, Figure) of a run."""
    from . import figures as figures_of

    first, tables, sample = result.runs[0], [last_cycles(run) for run in result.runs], result.scenario.sample
    scale = largest_modulus(first)
    loops = {r.amplitude: (r.gamma / r.amplitude, r.tau / (scale * r.amplitude)) for r in first.responses}
    yield "fig1_loops.png", figures_of.loops(loops)
    gamma, sands = np.geomspace(1e-6, 1e-2, 200), None
    if sample.dim == 3 and result.scenario.units == "SI":
        sands = {"amplitude": gamma} | band(sample.pressure, gamma)
    yield "fig2_modulus_and_damping.png", figures_of.modulus_and_damping(tables, sands)
    yield "fig3_moduli.png", figures_of.complex_modulus(tables, [largest_modulus(run) for run in result.runs])
    yield "fig4_work.png", figures_of.work(tables[0])
    returns = {r.amplitude: np.diagonal(r.distance, 1) for r in first.responses}
    kinds = {r.amplitude: kind_of(r) for r in first.responses}
    yield "fig5_return.png", figures_of.returns(returns, kinds)


def numbers(result: CyclicShearResult) -> dict:
    """Return the contents of the archive, besides scenario and version."""
    runs = {f"{run.seed:04d}": run for run in result.runs} | ({"finer": result.checked} if result.checked else {})
    return {
        "law": result.law,
        "samples": {
            name: {
                "packed": archive_fields(run.packed), "modulus": run.modulus, "end": run.end, "ended": run.ended,
                "responses": {f"{k:03d}": archive_fields(each) for k, each in enumerate(run.responses)},
            }
            for name, run in runs.items()
        },
        "failures": "\n".join(result.failures),
    }  # fmt: skip


def show(result: CyclicShearResult) -> None:
    """Print the last cycle at each amplitude of the first sample, the numbers of all samples, and remarks."""
    scenario, first = result.scenario, result.runs[0]
    title = f"cyclic shear of {pluralize(len(result.runs), 'sample')} of {scenario.sample.grains} grains"
    columns, unit = last_cycles(first), for_engineers(0, unit_name(STRESS))[1]
    words = [f"{name} [{unit}]" if CYCLE[name].unit == STRESS else name for name in SHOWN]
    table = new_table("γ₀", *words, "", title=f"{title}: last cycles of sample {first.seed}", left=("",))
    for k, kind in enumerate(columns["kind"]):
        values = [for_engineers(columns[name][k], unit_name(CYCLE[name].unit))[0] for name in SHOWN]
        cells = [f"{value:.3g}" if np.isfinite(value) else "–" for value in values]
        table.add_row(f"{columns['amplitude'][k]:g}", *cells, kind)
    show_table(table)
    above = [name for name in MEASURES.of(result) if "@" in name] if len(result.runs) < 2 else []
    MEASURES.show(result, title=title, readable=for_engineers, without=above)
    for sentence in (*sentences(result), *result.failures):
        console.print(f"  {sentence}", soft_wrap=True)
