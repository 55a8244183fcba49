"""A slider's history: what it leaves in its folder and on the terminal."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.table import Table

from ..data.ratestate_scenario import RateStateScenario
from ..figures import rate_state as figures
from ..figures.style import save as save_figure
from ..friction.laboratory import Record, write_csv
from ..friction.loads import Leg
from ..friction.ratestate import History, RateState, Spring, slide
from ..friction.stability import Sliding, steady_sliding
from .report import SERIES, STYLE, complete, console, files_of, plain, save

EARLY = 1e-4  # share of a leg from which on its first samples are spaced evenly in ln t


class Slid(NamedTuple):
    """A scenario and what came of it."""

    scenario: RateStateScenario
    legs: tuple[Leg, ...]
    history: History
    recorded: np.ndarray  # friction with noise, (N,)
    sliding: tuple[Sliding, ...]  # stability of steady sliding, one for each leg that moves


def simulate(scenario: RateStateScenario, *, folder: Path, workers: int | None, report) -> Slid:
    """Run a scenario; one slider needs one process."""
    surface, spring = RateState(**scenario.surface.model_dump()), Spring(**scenario.spring.model_dump())
    legs = tuple(Leg(leg.time, leg.velocity, leg.normal) for leg in scenario.legs)
    sliding = tuple(steady_sliding(surface, spring, leg.velocity) for leg in legs if leg.velocity > 0)
    rate = f"stiffness {spring.stiffness:g}, growth rate {max(one.growth_rate for one in sliding):.2e}"
    report("slider", 0.0, f"{len(legs)} legs of the load point, {rate}")
    history = slide(surface, spring, legs, times=_times(legs, scenario.samples.number))
    report("slider", 1.0, f"{rate}, friction {history.friction[-1]:.4f} at {history.velocity[-1]:.1e} m/s")
    return Slid(scenario, legs, history, history.friction + _noise(scenario, len(history.time)), sliding)


def _times(legs, number: int) -> np.ndarray:
    """Samples of each leg: a third evenly in ln t, the others evenly in t, its end among them."""
    few = number // 3
    share = np.unique(np.r_[np.geomspace(EARLY, 1.0, few), np.linspace(0, 1, number - few + 1)[1:]])
    ends = np.cumsum([leg.duration for leg in legs])
    return np.unique(
        np.r_[0.0, np.concatenate([e - g.duration * (1 - share) for e, g in zip(ends, legs, strict=True)])]
    )


def _noise(scenario: RateStateScenario, number: int) -> np.ndarray:
    rng, rho = np.random.default_rng(scenario.seed), scenario.samples.correlation
    out = rng.normal(size=number)
    for k in range(1, number):
        out[k] = rho * out[k - 1] + np.sqrt(1 - rho**2) * out[k]
    return scenario.samples.noise * out


def write_result(folder: Path, result: Slid) -> list[Path]:
    """Figure, series as CSV (which `stickslip fit` reads), scenario and raw numbers; returns their paths."""
    with complete(folder) as room:
        save(room, result.scenario, numbers(result))
        h = result.history
        record = Record(h.time, result.recorded, h.load_point, slip=h.slip, velocity=h.velocity, theta=h.theta)
        said = (
            f"noise of {result.scenario.samples.noise:g} is in friction"
            if result.scenario.samples.noise
            else "no noise"
        )
        write_csv(room / SERIES, record, (f"stickslip, experiment rate-state: {said}",))
        save_figure(figures.slid(h, result.recorded, result.legs), room / "fig1_history.png")
    return files_of(folder)


def numbers(result: Slid) -> dict:
    """What the archive holds besides scenario and version."""
    history = plain(result.history._replace(end=result.history.end.value))
    return {"history": history, "recorded": result.recorded, "units": "m, s"}


def show_result(result: Slid) -> None:
    """Stability of each leg and how the history ended, on the terminal."""
    h, table = result.history, Table(title="Legs of the load point", **STYLE)
    for name in ("velocity [m/s]", "until [s]", "friction at its end", "least", "greatest"):
        table.add_column(name, justify="right", no_wrap=True)
    ends = np.cumsum([leg.duration for leg in result.legs])
    for leg, end in zip(result.legs, ends, strict=True):
        within = (h.time > end - leg.duration) & (h.time <= end)
        if within.any():
            part = h.friction[within]
            cells = (f"{leg.velocity:.4g}", f"{end:.6g}", f"{part[-1]:.5f}", f"{part.min():.5f}", f"{part.max():.5f}")
            table.add_row(*cells)
    console.print(table)
    for sentence in dict.fromkeys(one.sentence for one in result.sliding):
        console.print(f"  {sentence}")
    if not h.ok:
        console.print(f"{h.end.value} (after {h.reached:.6g} s)", style="yellow")


def scalars(result: Slid) -> dict[str, tuple[float, str]]:
    """{name: (value, unit)} of a run, for sweeps; stability is that of the last leg that moves."""
    h, surface = result.history, result.scenario.surface
    velocity = [leg.velocity for leg in result.legs if leg.velocity > 0][-1]
    return {
        "final_friction": (h.friction[-1], "1"),
        "final_velocity": (h.velocity[-1], "m/s"),
        "least_friction": (h.friction.min(), "1"),
        "greatest_friction": (h.friction.max(), "1"),
        "steady_friction": (surface.mu0 + (surface.a - surface.b) * np.log(velocity / surface.v0), "1"),
        "critical_stiffness": (result.sliding[-1].critical, "1/m"),
        "growth_rate": (result.sliding[-1].growth_rate, "1/s"),
        "stable": (result.sliding[-1].stable, "1"),
        "reached": (h.reached, "s"),
    }
