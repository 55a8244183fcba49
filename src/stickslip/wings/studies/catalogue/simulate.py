"""Simulation of an event catalogue: packings are sheared one after another until enough events are found."""

from itertools import accumulate
from math import ceil
from pathlib import Path
from typing import NamedTuple

from .... import Law
from ....kit import (
    Member,
    Report,
    Task,
    Workers,
    checked,
    checkpoint_in,
    make_law,
    make_packing,
    pluralize,
    reach,
    result_of,
    run_realizations,
    silent,
    within,
)
from ....measure import stable_time_step
from ....protocols import find_events
from ....results import Event, EventKind, Events, PackingInfo, StrainStep
from . import EXPERIMENT
from .scenario import CatalogueScenario


class Sample(NamedTuple):
    """Events of one packing."""

    seed: int
    packed: PackingInfo
    found: Events


@result_of(EXPERIMENT, head=lambda r: f"{pluralize(r.number, 'event')} of {pluralize(len(r.samples), 'packing')}")
class CatalogueResult(NamedTuple):
    """Events of all packings, in the order of their seeds."""

    scenario: CatalogueScenario
    law: Law
    samples: tuple[Sample, ...]
    failures: tuple[str, ...]  # one sentence per failed packing

    @property
    def number(self) -> int:
        """Number of events."""
        return sum(len(sample.found.events) for sample in self.samples)


@checked
def simulate_catalogue(
    scenario: CatalogueScenario, *, folder: Path | None = None, workers: Workers = None, report: Report = silent
) -> CatalogueResult:
    """Shear at most `packings` packings, with the seeds seed, seed + 1, …, until `events` events are found.

    Packings are sheared in batches of as many as can run simultaneously. Packings after the one that completes the
    number of events are excluded, so that the result does not depend on the number of workers.

    Parameters
    ----------
    folder : run folder, in which each packing is saved as soon as it is finished
    workers : number of processes, or the address of a Dask scheduler
    report : called as report(stage, share done, text)

    Raises
    ------
    RuntimeError
        If every packing failed.
    """
    kept = checkpoint_in(folder, scenario, Sample, PackingInfo, Events, Event, EventKind, StrainStep)
    slots = max(1, reach(workers).slots)
    results: list[Sample | None] = []
    sentences: list[str | None] = []
    while len(results) < scenario.packings and (count := _count(results)) < scenario.events:
        done, size = len(results), 1
        if slots > 1:  # all slots, or a multiple up to half of the number of packings that are expected to be needed
            needed = ceil((scenario.events - count) * done / count) if count else done
            size = min(max(slots, needed // 2 // slots * slots), scenario.packings - done)
        seeds = [scenario.seed + k for k in range(done, done + size)]
        tasks = [Task(f"packing {seed}", (scenario, seed), f"packing-{seed}", kept) for seed in seeds]
        batch = run_realizations(
            shear_sample,
            tasks,
            stage=f"packings {seeds[0]} to {seeds[-1]}" if size > 1 else f"packing {seeds[0]}",
            workers=workers,
            report=report,
            describe=lambda member, before=count: _describe(member, before, scenario.events),
        )
        results += batch.results
        sentences += batch.sentences
    totals = accumulate(0 if sample is None else len(sample.found.events) for sample in results)
    used = 1 + sum(total < scenario.events for total in totals)  # packings up to the one that completes the number
    samples = tuple(sample for sample in results[:used] if sample is not None)
    failures = tuple(failure for failure in sentences[:used] if failure)
    if not samples:
        raise RuntimeError(f"every packing failed, the first with {failures[0]}")
    return CatalogueResult(scenario, make_law(scenario.law), samples, failures)


def shear_sample(scenario: CatalogueScenario, seed: int, report: Report) -> Sample:
    """Pack one sample and find its events."""
    law, shear = make_law(scenario.law), scenario.shear
    report(f"packing {seed}", 0.0, f"packing {scenario.packing.grains} grains")
    state, packed = make_packing(scenario.packing, law, seed)
    events = find_events(
        state,
        law,
        to=shear.strain,
        drag=shear.drag * 2 / stable_time_step(state, law),
        step=shear.step,
        resolution=shear.resolution,
        most=scenario.events,
        report=within(report, stage=f"packing {seed}"),
    )
    return Sample(seed, packed, events)


def _count(results) -> int:
    return sum(len(sample.found.events) for sample in results if sample is not None)


def _describe(member: Member, before: int, wanted: int) -> str:
    """Describe the outcome of one packing."""
    if member.failure:
        return member.failure
    record = member.result.found
    return (
        f"packing {member.result.seed}: {pluralize(len(record.events), 'event')}, {record.end} "
        f"({before} of {wanted} events before this batch)"
    )
