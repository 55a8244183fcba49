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
        if known.exists() and known.read_text(encoding="utf-8") != scenario.text and not overwrite:
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
    _save(folder, found.main.scenario, {"main": _numbers(found.main), "quarter": _numbers(found.quarter)})
    paper = {0.083: 2.4e-4, 0.087: 7.7e-4, 0.090: 1.0e-3}
    both = {
        "printed model, $I_0$ = 1/2": found.main,
        "hypothesis: disk–disk stiffness $k_n$/4, $I_0$ = 1": found.quarter,
    }
    line = disk_array.velocity_line(found.main, disk_array.LINE_TOP)
    paths = [figures.save(figures.complex_pairs(both, paper), folder / "fig2_complex_pairs.png")]
    paths += _figures(folder, found.main, line, printed=(4.5e-4, -1.3e-5), center_load=0.087)
    claims_table.write(folder / CLAIMS, found.claims)
    return [*paths, folder / CLAIMS, folder / NUMBERS, folder / SCENARIO]


def write_result(folder: Path, result: Result) -> list[Path]:
    """Figures, animation, scenario and raw numbers of a user's scenario; returns their paths."""
    _save(folder, result.scenario, {"main": _numbers(result)})
    paths = [figures.save(figures.complex_pairs({"": result}), folder / "fig2_complex_pairs.png")]
    loads = [load for load, free in result.free_runs.items() if free.slid] or list(result.free_runs)
    paths += _figures(folder, result, disk_array.velocity_line(result), center_load=loads[0] if loads else None)
    return [*paths, folder / NUMBERS, folder / SCENARIO]


def _save(folder: Path, scenario: Scenario, numbers: dict) -> None:
    """Raw numbers and scenario, in the place of whatever an earlier run left."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in (*folder.glob("fig[0-9]_*.png"), folder / MOVIE, folder / CLAIMS):
        old.unlink(missing_ok=True)
    archive.write(folder / NUMBERS, numbers, scenario=scenario.text, version=__version__)
    (folder / SCENARIO).write_text(scenario.text, encoding="utf-8")


def _figures(folder: Path, result: Result, line, *, center_load: float | None, printed=None) -> list[Path]:
    paths = []
    if result.free_runs:
        paths.append(
            figures.save(figures.mean_square_displacement(result), folder / "fig3_mean_square_displacement.png")
        )
    if result.trajectory:
        grain = min(3, result.scenario.array.disks - 1)
        paths.append(figures.save(figures.trajectory(result, grain), folder / "fig4_trajectory.png"))
    if result.sliding:
        shown = [load for load in result.sliding if load in disk_array.FRONT_LOADS] or list(result.sliding)[:3]
        forward = {load: disk_array.forward_front(result, result.sliding[load]) for load in shown}
        threshold = disk_array.front_threshold(result)
        backward = disk_array.backward_front(result, threshold)
        paths.append(figures.save(figures.traveling_fronts(forward, backward, threshold), folder / "fig5_fronts.png"))
    point = disk_array.mode_point(result)
    figure = figures.mode_shape(point.spectrum, disk_array.y_mode(point.spectrum))
    paths.append(figures.save(figure, folder / "fig6_y_mode.png"))
    if center_load is not None:
        paths.append(
            figures.save(figures.center_of_mass(result, center_load, line, printed), folder / "fig7_center_of_mass.png")
        )
    if result.trajectory:
        paths.append(figures.transition_movie(result, folder / MOVIE))
    return paths


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
    for name in ("pair", "born at", "dies at", "largest Im λ", "at push"):
        pairs.add_column(name, justify="right")
    for k, f in enumerate(result.families):
        top = int(np.argmax(f.eigenvalues.imag))
        birth = f"{f.birth.load:.6g}" if f.birth else "the start"
        death = f"{f.death.load:.6g}" if f.death else "lives"
        pairs.add_row(str(k + 1), birth, death, f"{f.eigenvalues.imag[top]:.3e}", f"{f.loads[top]:.6g}")
    console.print(pairs if result.families else "No complex pair along the path: no oscillatory instability.")
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
