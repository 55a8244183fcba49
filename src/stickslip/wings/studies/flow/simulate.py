"""Simulation of a flow: grains are poured, and the stages run in chunks between samples, with progress reports."""

import time
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .... import FROZEN, SLIDE, Law, State, forces
from ....kit import (
    ArchiveError,
    Checkpoint,
    Engine,
    Fields,
    Report,
    checked,
    checkpoint_in,
    least_supports,
    own_engine,
    readable,
    result_of,
    silent,
)
from ....measure import contact_forces, coordination, elastic_energy, touching, unbalanced_forces
from ....packings import without_walls
from . import EXPERIMENT
from .pouring import Poured, poured, sample_count
from .scenario import FlowScenario, Stage
from .stages import lammps_of, stage_conditions, stage_leg, with_controls

BINS = 24  # number of bins of the profile along y
SAVE_EVERY = 20.0  # time after which a piece is saved even if no frame is due [s]
ENCLOSED = 0.99  # fraction of the grains below `high`, and of those above `low`


@readable
class FlowSeries(NamedTuple):
    """Time series with T rows for the poured grains, W walls and P plates, in the order of the scenario."""

    time: np.ndarray  # (T,) [time]
    stage: np.ndarray  # (T,) index of the stage that the sample belongs to
    kinetic_energy: np.ndarray  # (T,) translations and rotations [energy]
    elastic_energy: np.ndarray  # (T,) stored in normal springs, plates included [energy]
    speed: np.ndarray  # (T,) mean [length/time]
    unbalanced: np.ndarray  # (T,) mean unbalanced force over mean contact force; infinite without contacts [1]
    coordination: np.ndarray  # (T,) mean number of contacts of grains that are not rattlers [1]
    sliding_fraction: np.ndarray  # (T,) fraction of contacts at the Coulomb limit [1]
    center: np.ndarray  # (T, 3) centre of mass [length]
    low: np.ndarray  # (T, 3) position along each axis below which 1 % of the grains' centres lie [length]
    high: np.ndarray  # (T, 3) position above which 1 % of the grains' centres lie [length]
    wall_point: np.ndarray  # (T, W, 3) [length], NaN after removal
    wall_force: np.ndarray  # (T, W, 3) force of the grains on the wall [force], NaN after removal
    plate_position: np.ndarray  # (T, P, 3) position of the plate's centre [length]
    plate_force: np.ndarray  # (T, P, 3) force of the grains on the plate [force]
    profile_count: np.ndarray  # (T, BINS) number of grains by height
    profile_velocity: np.ndarray  # (T, BINS, 3) mean velocity by height, NaN without grains [length/time]


class StageEnd(NamedTuple):
    """End of a stage."""

    name: str
    start: float  # [time]
    end: float  # [time]
    rested: bool | None  # True if rest was reached; None if not requested


@result_of(EXPERIMENT)
class FlowResult(NamedTuple):
    """Result of a flow scenario."""

    scenario: FlowScenario
    law: Law
    poured: Poured
    stages: tuple[StageEnd, ...]
    series: FlowSeries
    edges: np.ndarray  # (BINS + 1,) heights of the bin edges of the profile [length]
    frames: tuple[State, ...]  # at the start, at the ends of stages, and in between
    frame_walls: tuple[tuple[str, ...], ...]  # names of the walls that remain in each frame


class Piece(NamedTuple):
    """Part of a run after the previous piece, and the state needed to continue."""

    stage: int
    begin: float  # start of the stage [time]
    samples: int  # number of finished samples of the stage
    rows: dict[str, np.ndarray]  # columns of `FlowSeries`
    state: State
    frame: bool  # True if the state is a frame of the result
    end: StageEnd | None  # end of the stage, if it is finished


@checked
def simulate_flow(
    scenario: FlowScenario, *, folder: Path | None = None, threads: int | None = None, report: Report = silent
) -> FlowResult:
    """Pour the grains of a scenario and run its stages.

    Parameters
    ----------
    folder : folder in which frames are saved during the run. An interrupted run resumes from them, with a result
        bitwise identical to that of an uninterrupted run
    threads : as in `run`
    report : called as report(stage, share done, text) after every sample

    Raises
    ------
    ScenarioError
        If grains, walls, plates and dt are incompatible; raised before the run.
    RuntimeError
        If a grain moves more than a radius in one step or a position is not a number.
    """
    start, checkpoint = poured(scenario), checkpoint_in(folder, scenario, Piece, StageEnd)
    chosen = find_engine(scenario, start, folder, threads)
    pieces = _load_pieces(checkpoint) if checkpoint else []

    def keep(piece):
        if checkpoint:
            checkpoint.save(f"{len(pieces):06d}", piece)
        pieces.append(piece)

    for number in range(len(scenario.stages)):
        if not any(piece.end for piece in pieces if piece.stage == number):
            _run_stage(scenario, start, number, pieces, keep, chosen, report)
    series = FlowSeries(*(np.concatenate([piece.rows[name] for piece in pieces]) for name in FlowSeries._fields))
    shown = [piece for piece in pieces if piece.frame]
    walls = [stage_conditions(scenario, [0.0] * (piece.stage + 1)).walls for piece in shown]
    return FlowResult(
        scenario, start.law, start, tuple(piece.end for piece in pieces if piece.end), series, _bin_edges(start),
        (start.state, *(piece.state for piece in shown)), (start.walls, *walls),
    )  # fmt: skip


def _load_pieces(checkpoint: Checkpoint) -> list[Piece]:
    """Load the saved pieces of a run; raise ArchiveError if one is missing."""
    for k, name in enumerate(checkpoint.names):
        if name != f"{k:06d}":
            raise ArchiveError(f"piece {k:06d} is missing from {checkpoint.folder}: start again with --overwrite")
    return [checkpoint.load(name, Piece) for name in checkpoint.names]


def _run_stage(
    scenario: FlowScenario, start: Poured, number: int, pieces: list[Piece], keep, engine: Engine, report: Report
) -> None:
    """Run the rest of a stage; `keep` appends to the pieces."""
    stage, edges = scenario.stages[number], _bin_edges(start)
    state, begin, done, conditions = _enter_stage(scenario, start, number, pieces)
    count = sample_count(stage, scenario)
    every = max(1, round(scenario.samples / scenario.frames))
    total, rows, saved = sum(len(piece.rows["time"]) for piece in pieces), [], time.monotonic()
    leg = stage_leg(scenario, start, number, conditions, state, begin, done)
    with closing(engine.pieces(leg)) as states:
        for k, (state, _) in enumerate(states, start=done):
            rows.append(_measure(state, start, conditions.walls, number, edges))
            summary, rests = _describe_row(rows[-1]), stage.until == "rest" and _is_at_rest(rows[-1], stage)
            over = (rests and engine.stops) or k + 1 == count
            frame = over or (total + k + 1 - done) % every == 0
            if frame or time.monotonic() - saved > SAVE_EVERY:
                end = StageEnd(stage.name, begin, state.time, rests if stage.until else None) if over else None
                columns = Fields(
                    {name: np.array([row[name] for row in rows]) for name in FlowSeries._fields}, FlowSeries
                )
                keep(Piece(number, begin, k + 1, columns, state, frame, end))
                rows, saved = [], time.monotonic()
            report(stage.name, (k + 1) / count, f"{summary}, {sum(piece.frame for piece in pieces)} frames saved")
            if over:
                return


def _enter_stage(scenario: FlowScenario, start: Poured, number: int, pieces: list[Piece]):
    """Return the state, the start time of the stage, its finished samples and its conditions."""
    last = pieces[-1] if pieces else None
    begins = [piece.end.start for piece in pieces if piece.end]
    if last and last.stage == number:
        return last.state, last.begin, last.samples, stage_conditions(scenario, [*begins, last.begin])
    state = last.state if last else start.state
    before, conditions = stage_conditions(scenario, begins), stage_conditions(scenario, [*begins, state.time])
    begin, stage = state.time, scenario.stages[number]
    state = without_walls(state, [k for k, name in enumerate(before.walls) if name in stage.remove])
    return with_controls(state, start, conditions, begin + stage.duration), begin, 0, conditions


def _bin_edges(start: Poured) -> np.ndarray:
    """Return the (BINS + 1,) edges between the bins of the profile [length]."""
    height = start.state.grains.position[:, 1]
    return np.linspace(height.min(), height.max(), BINS + 1)


def find_engine(scenario: FlowScenario, start: Poured, folder: Path | None, threads: int | None) -> Engine:
    """Return the engine for a scenario.

    Raises
    ------
    ScenarioError
        If the engine cannot run this scenario.
    MissingExtraError
        If the engine is not installed. The message contains the installation command.
    """
    if scenario.engine == "stickslip":
        return own_engine(threads)
    return lammps_of(scenario, start, folder)


def _measure(state: State, start: Poured, walls: tuple[str, ...], number: int, edges) -> dict:
    """Return one row of the time series."""
    grains, loose, n = state.grains, start.loose, len(state.grains.radius)
    loads, _ = forces(state, start.law, memory=FROZEN)
    velocity, position, mass = grains.velocity[loose], grains.position[loose], grains.mass[loose]
    rows = touching(state)
    between = np.linalg.norm(contact_forces(state, start.law)[rows], axis=1)
    pull = np.linalg.norm(unbalanced_forces(state, loads)[loose, :3], axis=1).mean()
    energy = 0.5 * (mass @ (velocity**2).sum(axis=1) + grains.inertia[loose] @ (grains.spin[loose] ** 2).sum(axis=1))
    bins = np.searchsorted(edges, position[:, 1], side="right") - 1
    inside = (bins >= 0) & (bins < BINS)
    count = np.bincount(bins[inside], minlength=BINS)
    sums = np.stack([np.bincount(bins[inside], velocity[inside, k], BINS) for k in range(3)], axis=1)
    here = [walls.index(name) if name in walls else -1 for name in start.walls]
    nothing = np.full(3, np.nan)
    plates = list(start.plates.values())
    return {
        "time": state.time,
        "stage": number,
        "kinetic_energy": energy,
        "elastic_energy": elastic_energy(state, start.law),
        "speed": np.linalg.norm(velocity, axis=1).mean(),
        "unbalanced": pull / between.mean() if len(rows) and between.mean() > 0 else np.inf,
        "coordination": coordination(state, least_supports(start.law, state.cell.dim)),
        "sliding_fraction": (state.contacts.mode[rows] == SLIDE).mean() if len(rows) else 0.0,
        "center": mass @ position / mass.sum(),
        "low": np.quantile(position, 1 - ENCLOSED, axis=0),
        "high": np.quantile(position, ENCLOSED, axis=0),
        "wall_point": np.array([state.walls.point[w] if w >= 0 else nothing for w in here]).reshape(-1, 3),
        "wall_force": np.array([loads.force[n + w] if w >= 0 else nothing for w in here]).reshape(-1, 3),
        "plate_position": np.array([grains.position[p].mean(axis=0) for p in plates]).reshape(-1, 3),
        "plate_force": np.array([loads.force[p].sum(axis=0) for p in plates]).reshape(-1, 3),
        "profile_count": count,
        "profile_velocity": np.where(count[:, None] > 0, sums / np.maximum(count, 1)[:, None], np.nan),
    }


def _is_at_rest(row: dict, stage: Stage) -> bool:
    return row["unbalanced"] < stage.unbalanced and row["kinetic_energy"] < stage.kinetic * row["elastic_energy"]


def _describe_row(row: dict) -> str:
    """Describe a row for progress reports."""
    return (
        f"t = {row['time']:.4g}, kinetic {row['kinetic_energy']:.1e}, unbalanced {row['unbalanced']:.0e}, "
        f"z {row['coordination']:.1f}, {row['sliding_fraction']:.0%} sliding, speed {row['speed']:.1e}"
    )


def simulate_on_workers(scenario: FlowScenario, *, workers: int | None = None, **options) -> FlowResult:
    """Run a scenario, with the signature of all experiments; `workers` is the number of threads of the single run."""
    return simulate_flow(scenario, threads=workers, **options)
