"""What the disk array leaves in its folder and on the terminal."""

from pathlib import Path

import numpy as np
from rich.table import Table

from ..ensemble import Workers
from ..figures import disk_array as figures
from ..figures.style import save as save_figure
from ..loading.run import Result, at_load
from ..loading.run import simulate as simulate_array
from .claims_report import write_claims
from .disk_array import Reproduction
from .disk_claims import FRONT_LOADS, IM_LAMBDA, LINE_TOP, MODE_LOAD, SHOWS, V2_THRESHOLD
from .disk_measures import backward_front, forward_front, velocity_line, y_mode
from .report import MOVIE, STYLE, complete, console, files_of, plain, save

FIGURES = (
    "fig2_complex_pairs.png",
    "fig3_mean_square_displacement.png",
    "fig4_trajectory.png",
    "fig5_fronts.png",
    "fig6_y_mode.png",
    "fig7_center_of_mass.png",
)


def simulate(scenario, *, folder: Path, workers: Workers, report) -> Result:
    """Run a user's scenario, births again at twice the load step."""
    return simulate_array(scenario, folder=folder, workers=workers, sensitivity=True, report=report)


def write_reproduction(folder: Path, found: Reproduction) -> list[Path]:
    """Figures, animation, claims, scenario and raw numbers of the disk array; returns their paths."""
    main = found.main
    both = {"printed model, $I_0$ = 1/2": main, "hypothesis: disk–disk stiffness $k_n$/4, $I_0$ = 1": found.quarter}
    with complete(folder) as room:
        save(room, main.scenario, {"main": _numbers(main), "quarter": _numbers(found.quarter)})
        save_figure(figures.complex_pairs(both, IM_LAMBDA), room / FIGURES[0])
        line = velocity_line(main, LINE_TOP)
        point = at_load(main.path, MODE_LOAD)
        _figures(room, main, point, FRONT_LOADS, line, center_load=0.087, printed=(4.5e-4, -1.3e-5))
        write_claims(room, found.claims, SHOWS, "Paper 000: an array of frictional disks")
    return files_of(folder)


def write_result(folder: Path, result: Result) -> list[Path]:
    """Figures, animation, scenario and raw numbers of a user's scenario; returns their paths."""
    slid = [load for load, free in result.free_runs.items() if free.slid] or list(result.free_runs)
    if result.trajectory:
        slid = [result.trajectory.load]
    loads, line = list(result.sliding)[:4], velocity_line(result)
    failed = [words for ensemble in result.sliding.values() for words in ensemble.failures]
    with complete(folder, failures=failed) as room:
        save(room, result.scenario, numbers(result))
        save_figure(figures.complex_pairs({"": result}), room / FIGURES[0])
        point = at_load(result.path, slid[0]) if slid else result.path[-1]
        _figures(room, result, point, loads, line, center_load=slid[0] if slid else None)
    return files_of(folder)


def _figures(room: Path, result: Result, point, front_loads, line, *, center_load: float | None, printed=None) -> None:
    if result.free_runs:
        save_figure(figures.mean_square_displacement(result), room / FIGURES[1])
    if result.trajectory:
        save_figure(figures.trajectory(result, min(3, result.scenario.array.disks - 1)), room / FIGURES[2])
        figures.transition_movie(result, room / MOVIE)
    if front_loads:
        thresholds = result.scenario.sliding.thresholds
        threshold = V2_THRESHOLD if V2_THRESHOLD in thresholds else thresholds[0]
        forward = {load: forward_front(result, result.sliding[load]) for load in front_loads}
        backward = backward_front(result, threshold, front_loads)
        save_figure(figures.traveling_fronts(forward, backward, threshold), room / FIGURES[3])
    save_figure(figures.mode_shape(point.spectrum, y_mode(point.spectrum)), room / FIGURES[4])
    if center_load is not None:
        save_figure(figures.center_of_mass(result, center_load, line, printed), room / FIGURES[5])


def numbers(result: Result) -> dict:
    """What the archive of a user's scenario holds."""
    return {"main": _numbers(result)}


def _numbers(result: Result) -> dict:
    path = result.path
    most = max(len(p.spectrum.eigenvalues) for p in path)
    eigenvalues = np.full((len(path), most), np.nan, complex)
    for k, point in enumerate(path):
        eigenvalues[k, : len(point.spectrum.eigenvalues)] = point.spectrum.eigenvalues
    kept = sorted({0.0, *result.free_runs, *result.sliding, path[-1].load})
    frames = {f"{load:.6f}": at_load(path, load).state for load in kept}
    return {
        "scenario": result.scenario.text,
        "law": result.law,
        "pressed": result.pressed,
        "ramp": {
            "load": np.array([p.load for p in path]),
            "eigenvalues": eigenvalues,
            "residual": np.array([p.outcome.residual for p in path]),
        },
        "families": {
            f"{k:02d}": {
                "load": f.loads,
                "eigenvalues": f.eigenvalues,
                "birth": f.birth.load if f.birth else np.nan,
                "death": f.death.load if f.death else np.nan,
            }
            for k, f in enumerate(result.families)
        },
        "frames": frames,
        "free_runs": {f"{load:.6f}": plain(free) for load, free in result.free_runs.items()},
        "trajectory": plain(result.trajectory) if result.trajectory else {},
        "sliding": {f"{load:.6f}": plain(ensemble) for load, ensemble in result.sliding.items()},
        "units": "2R = m = k_n = 1; loads in the scenario's numbers",
    }


def show_result(result: Result) -> None:
    """What a user's scenario led to, on the terminal."""
    pairs = Table(title="Complex pairs along the path of pushes", **STYLE)
    for name in ("pair", "born at", "by load step", "dies at", "largest Im λ", "at push"):
        pairs.add_column(name, justify="right", overflow="fold")
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
        runs = Table(title="Free runs", **STYLE)
        for name in ("push", "predicted growth rate", "fitted", "M at the end", "verdict"):
            runs.add_column(name, justify="right", overflow="fold")
        for load, f in result.free_runs.items():
            fitted = f"{f.growth.growth_rate:.4e}" if f.growth else "–"
            words = "slides" if f.slid else "unstable, arrested" if f.predicted_growth > 0 else "stable"
            runs.add_row(f"{load:g}", f"{f.predicted_growth:.4e}", fitted, f"{f.msd[-1]:.2e}", words)
        console.print(runs)
    if result.sliding:
        slides = Table(title="Sliding", **STYLE)
        for name in ("push", "realizations", "slid in time", "velocity", "forward front"):
            slides.add_column(name, justify="right", overflow="fold")
        for load, e in result.sliding.items():
            good = e.velocity[np.isfinite(e.velocity)]
            found = forward_front(result, e)
            error = good.std(ddof=1) / np.sqrt(len(good)) if len(good) > 1 else np.nan
            speed = f"{good.mean():.2e} ± {error:.0e}" if len(good) else "–"
            front = f"{found.speed:.2e} ± {found.speed_error:.0e}" if found else "–"
            slides.add_row(f"{load:g}", str(len(e.velocity)), str(len(good)), speed, front)
            for failure in e.failures:
                console.print(f"push {load:g}, {failure}", style="yellow")
        console.print(slides)


def scalars(result: Result) -> dict[str, tuple[float, str]]:
    """{name: (value, unit)} of a run, for sweeps; loads are in the scenario's numbers."""
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
        out["fitted_growth_rate"] = _last_fitted(result), "1/time"
    for load, ensemble in result.sliding.items():
        good = ensemble.velocity[np.isfinite(ensemble.velocity)]
        out[f"sliding_velocity@{load:g}"] = good.mean() if len(good) else np.nan, "length/time"
    return out


def _last_fitted(result: Result) -> float:
    """Growth rate of the free run at the largest load at which one could be fitted."""
    fitted = {load: free.growth.growth_rate for load, free in result.free_runs.items() if free.growth}
    return fitted[max(fitted)] if fitted else np.nan
