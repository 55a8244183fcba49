"""What a run leaves in its folder and on the terminal: figures, raw numbers, tables, progress."""

import tempfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.padding import Padding
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from .. import __version__, figures
from ..data import archive
from ..data.scenario import Scenario
from ..loading.run import Result, at_load
from . import claims as claims_table
from . import disk_array

console = Console(soft_wrap=False)
FIGURES = (
    "fig2_complex_pairs.png",
    "fig3_mean_square_displacement.png",
    "fig4_trajectory.png",
    "fig5_fronts.png",
    "fig6_y_mode.png",
    "fig7_center_of_mass.png",
)
SCENARIO, NUMBERS, CLAIMS, MOVIE = "scenario.json", "results.h5", "claims.json", "transition.gif"
COLORS = {claims_table.REPRODUCED: "green", claims_table.PARTLY: "yellow", claims_table.NOT_REPRODUCED: "red"}


def claim_folder(folder: Path, scenario: Scenario, *, overwrite: bool = False) -> None:
    """Make sure that results can go to a folder before anything is computed.

    Raises
    ------
    ValueError
        if it is a file, cannot be written, or holds results of another scenario.
    """
    known = folder / SCENARIO
    try:
        if known.exists() and known.read_bytes() != scenario.text.encode() and not overwrite:
            raise ValueError(
                f"{folder} holds the results of another scenario: choose another --out, or add --overwrite"
            )
        if folder.exists() and not folder.is_dir():
            raise ValueError(f"{folder} is a file, not a folder: choose another --out")
        _probe(folder)
    except OSError as problem:
        raise ValueError(f"the folder {folder} cannot be written ({problem.strerror}): choose another --out") from None


def _probe(folder: Path) -> None:
    """Write and remove a file there, and every folder that this needed."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    finally:
        for path in missing:
            if path.exists():
                path.rmdir()


@contextmanager
def progress():
    """A live line for each stage, with the quantities that matter; a plain line a stage where there is no terminal."""
    columns = (
        TextColumn("{task.description:<34}"),
        BarColumn(bar_width=20),
        TimeElapsedColumn(),
        TextColumn("{task.fields[words]}"),
    )
    stages: dict[str, int] = {}
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:

        def tell(stage: str, share: float, words: str) -> None:
            if stage not in stages:
                if not console.is_terminal:
                    console.print(f"{stage} …")
                for task in stages.values():
                    bar.update(task, completed=1.0)
                stages[stage] = bar.add_task(stage, total=1.0, words=words)
            bar.update(stages[stage], completed=share, words=words)

        yield tell
        for task in stages.values():
            bar.update(task, completed=1.0)


def write_reproduction(folder: Path, found: disk_array.Reproduction) -> list[Path]:
    """Figures, animation, claims.json, scenario and raw numbers of the disk array; returns their paths."""
    main, paper = found.main, {0.083: 2.4e-4, 0.087: 7.7e-4, 0.090: 1.0e-3}
    both = {"printed model, $I_0$ = 1/2": main, "hypothesis: disk–disk stiffness $k_n$/4, $I_0$ = 1": found.quarter}
    with _complete(folder) as room:
        _save(room, main.scenario, {"main": _numbers(main), "quarter": _numbers(found.quarter)})
        figures.save(figures.complex_pairs(both, paper), room / FIGURES[0])
        line = disk_array.velocity_line(main, disk_array.LINE_TOP)
        point = at_load(main.path, disk_array.MODE_LOAD)
        _figures(room, main, point, disk_array.FRONT_LOADS, line, center_load=0.087, printed=(4.5e-4, -1.3e-5))
        claims_table.write(room / CLAIMS, found.claims)
    return sorted(folder / name for name in _names(folder))


def write_result(folder: Path, result: Result) -> list[Path]:
    """Figures, animation, scenario and raw numbers of a user's scenario; returns their paths."""
    slid = [load for load, free in result.free_runs.items() if free.slid] or list(result.free_runs)
    if result.trajectory:
        slid = [result.trajectory.load]
    loads, line = list(result.sliding)[:4], disk_array.velocity_line(result)
    with _complete(folder) as room:
        _save(room, result.scenario, {"main": _numbers(result)})
        figures.save(figures.complex_pairs({"": result}), room / FIGURES[0])
        point = at_load(result.path, slid[0]) if slid else result.path[-1]
        _figures(room, result, point, loads, line, center_load=slid[0] if slid else None)
    return sorted(folder / name for name in _names(folder))


@contextmanager
def _complete(folder: Path):
    """A room beside the folder, whose files go there all at once at the end, in the place of an earlier run's."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f".{folder.name}-", dir=folder.parent) as room:
        yield Path(room)
        for name in _names(folder):
            if not (Path(room) / name).exists():
                (folder / name).unlink()
        for path in Path(room).iterdir():
            path.replace(folder / path.name)


def _names(folder: Path) -> list[str]:
    """Files of ours that a folder holds."""
    return [name for name in (*FIGURES, MOVIE, CLAIMS, NUMBERS, SCENARIO) if (folder / name).exists()]


def _save(room: Path, scenario: Scenario, numbers: dict) -> None:
    archive.write(room / NUMBERS, numbers, scenario=scenario.text, version=__version__)
    (room / SCENARIO).write_text(scenario.text, encoding="utf-8")


def _figures(room: Path, result: Result, point, front_loads, line, *, center_load: float | None, printed=None) -> None:
    if result.free_runs:
        figures.save(figures.mean_square_displacement(result), room / FIGURES[1])
    if result.trajectory:
        figures.save(figures.trajectory(result, min(3, result.scenario.array.disks - 1)), room / FIGURES[2])
        figures.transition_movie(result, room / MOVIE)
    if front_loads:
        thresholds = result.scenario.sliding.thresholds
        threshold = disk_array.V2_THRESHOLD if disk_array.V2_THRESHOLD in thresholds else thresholds[0]
        forward = {load: disk_array.forward_front(result, result.sliding[load]) for load in front_loads}
        backward = disk_array.backward_front(result, threshold, front_loads)
        figures.save(figures.traveling_fronts(forward, backward, threshold), room / FIGURES[3])
    figures.save(figures.mode_shape(point.spectrum, disk_array.y_mode(point.spectrum)), room / FIGURES[4])
    if center_load is not None:
        figures.save(figures.center_of_mass(result, center_load, line, printed), room / FIGURES[5])


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
        "free_runs": {f"{load:.6f}": _plain(free) for load, free in result.free_runs.items()},
        "trajectory": _plain(result.trajectory) if result.trajectory else {},
        "sliding": {f"{load:.6f}": _plain(ensemble) for load, ensemble in result.sliding.items()},
        "units": "2R = m = k_n = 1; loads in the scenario's numbers",
    }


def _plain(record) -> dict:
    """Fields of a NamedTuple that a file can hold: None is left out, tuples of words become lines."""
    out = {}
    for name, value in record._asdict().items():
        if value is None:
            continue
        if hasattr(value, "_asdict"):
            value = value._asdict()
        out[name] = "\n".join(value) if isinstance(value, tuple) else value
    return out


def show_claims(claims: list[claims_table.Claim]) -> None:
    """The claims table on the terminal, then the reasons where the paper's number was not met."""
    table = Table(
        title="Claims of the paper", title_justify="left", header_style="bold", box=SIMPLE_HEAD, pad_edge=False
    )
    table.add_column("claim", no_wrap=True)
    if console.width >= 100:
        table.add_column("source", no_wrap=True)
    for name in ("paper", "measured"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("verdict", no_wrap=True)
    for c in claims:
        source = [c.source] if console.width >= 100 else []
        values = claims_table.shown(c.paper), claims_table.shown(c.measured)
        table.add_row(c.id, *source, *values, f"[{COLORS[c.verdict]}]{c.verdict}[/]")
    console.print(table)
    missed = [c for c in claims if c.verdict != claims_table.REPRODUCED]
    if missed:
        console.print("[bold]Why not, or not quite[/] (all notes are in claims.json)")
    for c in missed:
        console.print(Padding(f"[{COLORS[c.verdict]}]{c.id}[/]: {c.note}", (0, 0, 0, 2)), highlight=False)
    count = {v: sum(c.verdict == v for c in claims) for v in COLORS}
    console.print(", ".join(f"{n} {verdict}" for verdict, n in count.items()) + ".")


def show_result(result: Result) -> None:
    """What a user's scenario led to, on the terminal."""
    pairs = Table(
        title="Complex pairs along the path of pushes", title_justify="left", header_style="bold", box=SIMPLE_HEAD
    )
    for name in ("pair", "born at", "by load step", "dies at", "largest Im λ", "at push"):
        pairs.add_column(name, justify="right")
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
        runs = Table(title="Free runs", title_justify="left", header_style="bold", box=SIMPLE_HEAD)
        for name in ("push", "predicted growth rate", "fitted", "M at the end", "verdict"):
            runs.add_column(name, justify="right")
        for load, f in result.free_runs.items():
            fitted = f"{f.growth.growth_rate:.4e}" if f.growth else "–"
            words = "slides" if f.slid else "unstable, arrested" if f.predicted_growth > 0 else "stable"
            runs.add_row(f"{load:g}", f"{f.predicted_growth:.4e}", fitted, f"{f.msd[-1]:.2e}", words)
        console.print(runs)
    if result.sliding:
        slides = Table(title="Sliding", title_justify="left", header_style="bold", box=SIMPLE_HEAD)
        for name in ("push", "realizations", "slid in time", "velocity", "forward front"):
            slides.add_column(name, justify="right")
        for load, e in result.sliding.items():
            good = e.velocity[np.isfinite(e.velocity)]
            found = disk_array.forward_front(result, e)
            error = good.std(ddof=1) / np.sqrt(len(good)) if len(good) > 1 else np.nan
            speed = f"{good.mean():.2e} ± {error:.0e}" if len(good) else "–"
            front = f"{found.speed:.2e} ± {found.speed_error:.0e}" if found else "–"
            slides.add_row(f"{load:g}", str(len(e.velocity)), str(len(good)), speed, front)
            for failure in e.failures:
                console.print(f"[yellow]push {load:g}, {failure}[/]")
        console.print(slides)


def show_paths(paths: list[Path]) -> None:
    """Where everything is, one path a line."""
    console.print("Written:")
    for path in paths:
        console.print(f"  {path}", soft_wrap=True, highlight=False)
