"""Output of the disk array: files in the run folder and the summary on the terminal."""

from functools import partial

import numpy as np

from .... import Outcome
from .... import figures as common_figures
from ....kit import Family, Fields, archive_fields, console, new_table, run_files
from ....results import Spectrum
from . import figures as figures_of
from .claims import Reproduction
from .claims_of_motion import FRONT_LOADS, IM_LAMBDA, LINE_TOP, MODE_LOAD, V2_THRESHOLD
from .measures import backward_front, forward_front, velocity_line, y_mode
from .simulate import DiskArrayResult, point_at_load

FIGURES = (
    "fig2_complex_pairs.png",
    "fig3_mean_square_displacement.png",
    "fig4_trajectory.png",
    "fig5_fronts.png",
    "fig6_y_mode.png",
    "fig7_center_of_mass.png",
    "fig8_static_and_kinetic.png",
)


def figures(result: DiskArrayResult):
    """Yield (file name, Figure) for each figure of a run."""
    slid = [load for load, free in result.free_runs.items() if free.slid] or list(result.free_runs)
    if result.trajectory:
        slid = [result.trajectory.load]
    yield FIGURES[0], figures_of.complex_pairs({"": result})
    point = point_at_load(result.path, slid[0]) if slid else result.path[-1]
    loads, line = list(result.sliding)[:4], velocity_line(result)
    yield from _figures(result, point, loads, line, center_load=slid[0] if slid else None)


def files(result: DiskArrayResult):
    """Yield (file name, function that writes it) for the animation of the transition."""
    if result.trajectory:
        yield run_files.MOVIE, partial(figures_of.transition_movie, result)


def failures(result: DiskArrayResult) -> tuple[str, ...]:
    """One sentence for each failed realization."""
    return tuple(sentence for ensemble in result.sliding.values() for sentence in ensemble.failures)


def paper_figures(reproduction: Reproduction):
    """Yield (file name, Figure) for each figure of the paper's reproduction."""
    main, quarter = reproduction.main, reproduction.quarter
    both = {"printed model, $I_0$ = 1/2": main, "hypothesis: disk–disk stiffness $k_n$/4, $I_0$ = 1": quarter}
    yield FIGURES[0], figures_of.complex_pairs(both, IM_LAMBDA)
    point, line = point_at_load(main.path, MODE_LOAD), velocity_line(main, LINE_TOP)
    yield from _figures(main, point, FRONT_LOADS, line, center_load=0.087, printed=(4.5e-4, -1.3e-5))
    yield FIGURES[6], common_figures.static_and_kinetic(reproduction.threshold, label="$F_x$")


def paper_numbers(reproduction: Reproduction) -> dict:
    """Return the contents of the archive of the paper's reproduction."""
    return {
        "main": _numbers(reproduction.main), "quarter": _numbers(reproduction.quarter),
        "arrests": {f"{arrest.load:.6f}": archive_fields(arrest) for arrest in reproduction.arrests},
        "threshold": archive_fields(reproduction.threshold),
    }  # fmt: skip


def paper_failures(reproduction: Reproduction) -> tuple[str, ...]:
    """One sentence for each failed realization of either model."""
    return failures(reproduction.main) + failures(reproduction.quarter)


def _figures(result: DiskArrayResult, point, front_loads, line, *, center_load: float | None, printed=None):
    if result.free_runs:
        yield FIGURES[1], figures_of.mean_square_displacement(result)
    if result.trajectory:
        yield FIGURES[2], figures_of.trajectory(result, min(3, result.scenario.array.disks - 1))
    if front_loads:
        thresholds = result.scenario.sliding.thresholds
        threshold = V2_THRESHOLD if V2_THRESHOLD in thresholds else thresholds[0]
        forward = {load: forward_front(result, result.sliding[load]) for load in front_loads}
        backward = backward_front(result, threshold, front_loads)
        yield FIGURES[3], figures_of.traveling_fronts(forward, backward, threshold)
    yield FIGURES[4], figures_of.mode_shape(point.spectrum, y_mode(point.spectrum))
    if center_load is not None:
        yield FIGURES[5], figures_of.center_of_mass(result, center_load, line, printed)


def numbers(result: DiskArrayResult) -> dict:
    """Return the contents of the archive of a user's scenario."""
    return {"main": _numbers(result)}


def _numbers(result: DiskArrayResult) -> dict:
    path = result.path
    most = max(len(p.spectrum.eigenvalues) for p in path)
    eigenvalues = np.full((len(path), most), np.nan, complex)
    for k, point in enumerate(path):
        eigenvalues[k, : len(point.spectrum.eigenvalues)] = point.spectrum.eigenvalues
    kept = sorted({0.0, *result.free_runs, *result.sliding, path[-1].load})
    frames = {f"{load:.6f}": point_at_load(path, load).state for load in kept}
    return {
        "scenario": result.scenario.text,
        "law": result.law,
        "pressed": result.pressed,
        "ramp": Fields(
            {
                "load": np.array([p.load for p in path]),
                "eigenvalues": eigenvalues,
                "residual": np.array([p.outcome.residual for p in path]),
            },
            Spectrum,
            Outcome,
        ),
        "families": {
            f"{k:02d}": Fields(
                {
                    "load": f.loads,
                    "eigenvalues": f.eigenvalues,
                    "birth": f.birth.load if f.birth else np.nan,
                    "death": f.death.load if f.death else np.nan,
                },
                Family,
            )
            for k, f in enumerate(result.families)
        },
        "frames": frames,
        "free_runs": {f"{load:.6f}": archive_fields(free) for load, free in result.free_runs.items()},
        "trajectory": archive_fields(result.trajectory) if result.trajectory else {},
        "sliding": {f"{load:.6f}": archive_fields(ensemble) for load, ensemble in result.sliding.items()},
        "units": "2R = m = k_n = 1; loads in the scenario's numbers",
    }


def show(result: DiskArrayResult) -> None:
    """Print a summary of a run on the terminal."""
    names = ("pair", "born at", "by load step", "dies at", "largest Im λ", "at push")
    pairs = new_table(*names, title="Complex pairs along the load path", units={"largest Im λ": "1/time^2"})
    coarse = np.array([f.birth.load for f in result.coarse_families if f.birth])
    for k, f in enumerate(result.families):
        top = int(np.argmax(f.eigenvalues.imag))
        birth = f"{f.birth.load:.6g}" if f.birth else "the start"
        shift = "–"
        if f.birth and len(coarse):
            bracket = abs(f.birth.above - f.birth.below)
            shift = f"± {max(np.abs(coarse - f.birth.load).min(), bracket):.0e}"
        death = f"{f.death.load:.6g}" if f.death else "lives"
        pairs.add_row(str(k + 1), birth, shift, death, f"{f.eigenvalues.imag[top]:.3e}", f"{f.loads[top]:.6g}")
    console.print(pairs if result.families else "No complex pair along the path: no oscillatory instability.")
    if result.families:
        console.print("  by load step: distance to the nearest birth on the same path with twice the load step")
    if result.free_runs:
        units = {"predicted growth rate": "1/time", "fitted": "1/time", "M at the end": "length^2"}
        runs = new_table("push", *units, "verdict", title="Free runs", units=units)
        for load, f in result.free_runs.items():
            fitted = f"{f.growth.growth_rate:.4e}" if f.growth else "–"
            outcome = "slides" if f.slid else "unstable, arrested" if f.predicted_growth > 0 else "stable"
            runs.add_row(f"{load:g}", f"{f.predicted_growth:.4e}", fitted, f"{f.msd[-1]:.2e}", outcome)
        console.print(runs)
    if result.sliding:
        units = {"velocity": "length/time", "forward front": "length/time"}
        slides = new_table("push", "realizations", "slid in time", *units, title="Sliding", units=units)
        for load, e in result.sliding.items():
            good = e.velocity[np.isfinite(e.velocity)]
            fit = forward_front(result, e)
            error = good.std(ddof=1) / np.sqrt(len(good)) if len(good) > 1 else np.nan
            speed = f"{good.mean():.2e} ± {error:.0e}" if len(good) else "–"
            front = f"{fit.speed:.2e} ± {fit.speed_error:.0e}" if fit else "–"
            slides.add_row(f"{load:g}", str(len(e.velocity)), str(len(good)), speed, front)
            for failure in e.failures:
                console.print(f"push {load:g}, {failure}", style="yellow")
        console.print(slides)


def measures(result: DiskArrayResult) -> dict[str, tuple[float, str]]:
    """Return the measures of a run for sweeps as {name: (value, unit)}; loads are in the scenario's numbers."""
    pushed, eigenvalues = "load", [f.eigenvalues.imag.max() for f in result.families]
    births = sorted(f.birth.load for f in result.families if f.birth)
    slid = [load for load, free in result.free_runs.items() if free.slid]
    out = {
        "pairs": (len(result.families), "1"),
        "first_birth": (births[0] if births else np.nan, pushed),
        "last_birth": (births[-1] if births else np.nan, pushed),
        "largest_im_lambda": (max(eigenvalues, default=0.0), "1/time^2"),
        "largest_growth_rate": (max(p.spectrum.growth_rate.max(initial=0.0) for p in result.path), "1/time"),
    }
    if result.free_runs:
        out["first_load_that_slides"] = min(slid, default=np.nan), pushed
        fitted = {load: free.growth.growth_rate for load, free in result.free_runs.items() if free.growth}
        out["fitted_growth_rate"] = fitted[max(fitted)] if fitted else np.nan, "1/time"  # at the largest load
    for load, ensemble in result.sliding.items():
        good = ensemble.velocity[np.isfinite(ensemble.velocity)]
        out[f"sliding_velocity@{load:g}"] = good.mean() if len(good) else np.nan, "length/time"
    return out
