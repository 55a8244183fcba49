"""Output of the disk array: files in the run folder, and terminal summary."""

from functools import partial
from types import SimpleNamespace as Made

import numpy as np

from .... import Outcome
from .... import figures as common_figures
from ....kit import (
    Estimate,
    Family,
    Fields,
    Measures,
    Quantities,
    Quantity,
    archive_fields,
    console,
    estimate,
    quantities_of,
)
from ....results import Spectrum
from . import figures as figures_of
from .claims import Reproduction
from .claims_of_motion import FRONT_LOADS, IM_LAMBDA, LINE_TOP, MODE_LOAD, V2_THRESHOLD
from .fronts import FreeRun
from .measures import backward_front, forward_front, velocity_line, y_mode
from .simulate import DiskArrayResult, point_at_load


def figures(result: DiskArrayResult):
    """Yield (file name, Figure) for each figure of a run."""
    slid = [load for load, free in result.free_runs.items() if free.slid] or list(result.free_runs)
    if result.trajectory:
        slid = [result.trajectory.load]
    yield "fig2_complex_pairs.png", figures_of.complex_pairs({"": result})
    point = point_at_load(result.path, slid[0]) if slid else result.path[-1]
    loads, line = list(result.sliding)[:4], velocity_line(result)
    yield from _figures(result, point, loads, line, center_load=slid[0] if slid else None)


def files(result: DiskArrayResult):
    """Yield (file name, function that writes it) for the animation of the transition."""
    if result.trajectory:
        yield "transition.gif", partial(figures_of.transition_movie, result)


def failures(result: DiskArrayResult) -> tuple[str, ...]:
    """One sentence for each failed realisation."""
    return tuple(sentence for ensemble in result.sliding.values() for sentence in ensemble.failures)


def paper_figures(reproduction: Reproduction):
    """Yield (file name, Figure) for each figure of the reproduction of the paper."""
    main, quarter = reproduction.main, reproduction.quarter
    both = {"printed model, $I_0$ = 1/2": main, "hypothesis: disk–disk stiffness $k_n$/4, $I_0$ = 1": quarter}
    yield "fig2_complex_pairs.png", figures_of.complex_pairs(both, IM_LAMBDA)
    point, line = point_at_load(main.path, MODE_LOAD), velocity_line(main, LINE_TOP)
    yield from _figures(main, point, FRONT_LOADS, line, center_load=0.087, printed=(4.5e-4, -1.3e-5))
    yield (
        "fig8_static_and_kinetic.png",
        common_figures.static_and_kinetic(reproduction.threshold, label="push $F_x$ [units of force]"),
    )


def paper_numbers(reproduction: Reproduction) -> dict:
    """Return the contents of the archive of the reproduction of the paper."""
    return {
        "main": _numbers(reproduction.main), "quarter": _numbers(reproduction.quarter),
        "arrests": {f"{arrest.load:.6f}": archive_fields(arrest) for arrest in reproduction.arrests},
        "threshold": archive_fields(reproduction.threshold),
    }  # fmt: skip


def paper_failures(reproduction: Reproduction) -> tuple[str, ...]:
    """One sentence for each failed realisation of either model."""
    return failures(reproduction.main) + failures(reproduction.quarter)


def _figures(result: DiskArrayResult, point, front_loads, line, *, center_load: float | None, printed=None):
    if result.free_runs:
        yield "fig3_mean_square_displacement.png", figures_of.mean_square_displacement(result)
    if result.trajectory:
        yield "fig4_trajectory.png", figures_of.trajectory(result, min(3, result.scenario.array.disks - 1))
    if front_loads:
        thresholds = result.scenario.sliding.thresholds
        threshold = V2_THRESHOLD if V2_THRESHOLD in thresholds else thresholds[0]
        forward = {load: forward_front(result, result.sliding[load]) for load in front_loads}
        backward = backward_front(result, threshold, front_loads)
        yield "fig5_fronts.png", figures_of.traveling_fronts(forward, backward, threshold)
    yield "fig6_y_mode.png", figures_of.mode_shape(point.spectrum, y_mode(point.spectrum))
    if center_load is not None:
        yield "fig7_center_of_mass.png", figures_of.center_of_mass(result, center_load, line, printed)


def numbers(result: DiskArrayResult) -> dict:
    """Return the contents of the archive of a user's scenario."""
    return {"main": _numbers(result)}


def _numbers(result: DiskArrayResult) -> dict:
    path = result.path
    most = max(len(p.spectrum.eigenvalues) for p in path)
    eigenvalues = np.full((len(path), most), np.nan, complex)
    for k, point in enumerate(path):
        eigenvalues[k, : len(point.spectrum.eigenvalues)] = point.spectrum.eigenvalues
    ramp = {"load": np.array([p.load for p in path]), "eigenvalues": eigenvalues}
    ramp["residual"] = np.array([p.outcome.residual for p in path])
    families = {}
    for k, f in enumerate(result.families):
        birth, death = (change.load if change else np.nan for change in (f.birth, f.death))
        pair = {"load": f.loads, "eigenvalues": f.eigenvalues, "birth": birth, "death": death}
        families[f"{k:02d}"] = Fields(pair, Family)
    kept = sorted({0.0, *result.free_runs, *result.sliding, path[-1].load})
    frames = {f"{load:.6f}": point_at_load(path, load).state for load in kept}
    return {
        "scenario": result.scenario.text,
        "law": result.law,
        "pressed": result.pressed,
        "ramp": Fields(ramp, Spectrum, Outcome),
        "families": families,
        "frames": frames,
        "free_runs": {f"{load:.6f}": archive_fields(free) for load, free in result.free_runs.items()},
        "trajectory": archive_fields(result.trajectory) if result.trajectory else {},
        "sliding": {f"{load:.6f}": archive_fields(ensemble) for load, ensemble in result.sliding.items()},
        "units": "2R = m = k_n = 1; loads in the scenario's numbers",
    }


def _births(result: DiskArrayResult) -> list[float]:
    return [family.birth.load for family in result.families if family.birth]


def _velocity(ensemble) -> Estimate:
    return estimate(ensemble.velocity[np.isfinite(ensemble.velocity)])


NAN = float("nan")
PAIR = Quantities([
    Quantity("born at", "1", "push at its birth", lambda pair: f"{pair.birth.load:.6g}" if pair.birth else "the start"),
    Quantity("± by load step", "1", "distance to the nearest birth with twice the load step", lambda pair:
             max(np.abs(pair.coarse - pair.birth.load).min(), abs(pair.birth.above - pair.birth.below))
             if pair.birth and len(pair.coarse) else NAN),
    Quantity("dies at", "1", "push at its death", lambda pair: f"{pair.death.load:.6g}" if pair.death else "lives"),
    Quantity("largest Im λ", "1/time^2", "largest Im λ along the path", lambda pair: pair.eigenvalues.imag.max()),
    Quantity("at push", "1", "push at this largest Im λ", lambda pair: pair.loads[pair.eigenvalues.imag.argmax()]),
])  # fmt: skip
FREE_RUN = Quantities([
    Quantity("push", "1", "push", "load"), *quantities_of(FreeRun, "predicted_growth").values(),
    Quantity("fitted", "1/time", "growth rate fitted to M", "growth.growth_rate"),
    Quantity("M at the end", "length^2", "M at the end", lambda free: free.msd[-1]),
    Quantity("verdict", "1", "outcome of the run", lambda free:
             "slides" if free.slid else "unstable, arrested" if free.predicted_growth > 0 else "stable"),
])  # fmt: skip
SLIDING = Quantities([
    Quantity("push", "1", "push", "load"),
    Quantity("realizations", "1", "number of realisations", lambda one: len(one.velocity)),
    Quantity("slid in time", "1", "realisations that slid", lambda one: np.isfinite(one.velocity).sum()),
    Quantity("velocity", "length/time", "mean velocity of these, ± half of its 95 % interval", _velocity),
    Quantity("forward front", "length/time", "speed of the forward front, ± its standard error",
             lambda one: one.front and f"{one.front.speed:.3g} ± {one.front.speed_error:.2g}"),
])  # fmt: skip
MEASURES = Measures([
    Quantity("pairs", "1", "complex pairs along the load path", lambda result: len(result.families)),
    Quantity("first_birth", "load", "smallest push at which a pair is born", lambda r: min(_births(r), default=NAN)),
    Quantity("last_birth", "load", "largest push at which a pair is born", lambda r: max(_births(r), default=NAN)),
    Quantity("largest_im_lambda", "1/time^2", "largest Im λ along the path",
             lambda result: max((f.eigenvalues.imag.max() for f in result.families), default=0.0)),
    Quantity("largest_growth_rate", "1/time", "largest growth rate along the path",
             lambda result: max(point.spectrum.growth_rate.max(initial=0.0) for point in result.path)),
    Quantity("first_load_that_slides", "load", "smallest push at which a free run slides",
             lambda result: min((load for load, free in result.free_runs.items() if free.slid), default=NAN)),
    Quantity("fitted_growth_rate", "1/time", "growth rate fitted to the free run at the largest push",
             lambda result: next((result.free_runs[load].growth.growth_rate for load in sorted(result.free_runs)[::-1]
                                  if result.free_runs[load].growth), NAN)),
    Quantity("sliding_velocity", "length/time", "mean velocity of the realisations that slid at a push",
             lambda result: {load: _velocity(ensemble).mean for load, ensemble in result.sliding.items()}),
])  # fmt: skip


def show(result: DiskArrayResult) -> None:
    """Print a summary of a run on the terminal."""
    if result.families:
        coarse = np.array([f.birth.load for f in result.coarse_families if f.birth])
        pairs = [Made(coarse=coarse, **family._asdict()) for family in result.families]
        PAIR.show_rows(pairs, title="Complex pairs along the load path")
        console.print("  ± by load step: distance to the nearest birth on the same path with twice the load step")
    else:
        console.print("No complex pair along the path: no oscillatory instability.")
    if result.free_runs:
        FREE_RUN.show_rows(result.free_runs.values(), title="Free runs")
    if result.sliding:
        slides = [Made(front=forward_front(result, one), **one._asdict()) for one in result.sliding.values()]
        SLIDING.show_rows(slides, title="Sliding")
    for load, ensemble in result.sliding.items():
        for failure in ensemble.failures:
            console.print(f"push {load:g}, {failure}", style="yellow")
