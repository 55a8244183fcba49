"""Grain steps per second of a graphics processor, and of this package's engine on all cores of the same machine.

    python -m benchmarks device [ROUNDS]

First, the results of a short run are compared bitwise with those of the same functions on the CPU. Then batches of
sheared gouge run on the device, alternating with one system per core on the engine; the best of several rounds counts.
Large samples are side-by-side copies of a small sample.
"""

import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np

import stickslip as ss
from stickslip.core.dynamics.batch import Device, Processor, run_legs
from stickslip.core.dynamics.device import open_device
from stickslip.core.dynamics.run import Leg
from stickslip.ensemble.pool import default_workers
from stickslip.extras import MissingExtraError
from stickslip.wings.papers.gouge.protocol import slide_leg
from stickslip.wings.papers.gouge.sample import BOTTOM, TOP, Gouge, prepare_sample
from stickslip.wings.papers.gouge.scenario import GougeScenario

CASES = ((3, 1), (3, 8), (3, 24), (3, 48), (1, 80), (1, 800))  # copies along each side, and number of systems
STEPS, OWN_STEPS, VELOCITY = 10_000, 1000, 0.02


def scenario() -> GougeScenario:
    """Small sample with the paper's grains."""
    return ss.scenario(
        experiment="gouge", dt=2e-7, sample_every=1000, grains={"number": 450, "diameter": (1e-3, 5e-3)},
        cell={"length": 0.03, "width": 0.02}, law={"restitution": 0.98, "reading": "eq8", "size": 3e-3, "speed": 25.0},
        protocol=[{"kind": "slide", "velocity": VELOCITY, "slip": 1.0}],
    )  # fmt: skip


def tiled(gouge: Gouge, sides: int) -> Gouge:
    """Copies of a sample side by side, along x and z; contacts begin without memory."""
    state = gouge.state
    vectors, grains, control = state.cell.vectors, state.grains, state.control
    offsets = [a * vectors[0] + b * vectors[2] for a in range(sides) for b in range(sides)]
    copies = len(offsets)
    position = np.concatenate([grains.position + offset for offset in offsets])
    more = {name: np.tile(getattr(grains, name).T, copies).T for name in grains._fields if name != "position"}
    group = np.tile(control.group, copies)
    top, bottom = np.flatnonzero(group == TOP), np.flatnonzero(group == BOTTOM)
    loads = ss.control.rigid(ss.control.rigid(ss.control.loads(len(position)), bottom), top)
    loads = ss.control.driven(loads, bottom, 0.0)
    loads.free[top, 0] = loads.free[top, 2] = False
    area = gouge.area * copies
    loads = ss.control.force_controlled(loads, top, [0, -gouge.normal_stress * area / len(top)])
    cell = ss.box(np.diag(vectors) * [sides, 1, sides], [True, False, True])
    whole = ss.assembly(grains._replace(position=position, **more), cell=cell, control=loads)
    return gouge._replace(state=whole, area=area)


def device_rate(device: Device, legs: list[Leg]) -> float:
    """Grain steps per second on the device, without the preparation of samples."""
    inside, run = 0.0, device.run

    def timed(steps: int) -> np.ndarray:
        nonlocal inside
        start = time.perf_counter()
        number = run(steps)
        inside += time.perf_counter() - start
        return number

    device.run = timed
    try:
        run_legs(legs, device)
    finally:
        device.run = run
    return sum(len(leg.state.grains.radius) * leg.steps for leg in legs) / inside


def own_rate(leg: Leg) -> float:
    """Grain steps per second of the engine on one core."""
    start = time.perf_counter()
    ss.run(leg.state, leg.law, leg.steps, leg.dt, threads=1)
    return len(leg.state.grains.radius) * leg.steps / (time.perf_counter() - start)


def rows(rounds: str = "3", *, smallest: bool = False):
    """Yield the rows that compare the device with the engine."""
    try:
        device, cores = open_device("cuda"), default_workers()
    except (MissingExtraError, RuntimeError) as problem:
        yield f"device skipped: {problem}"
        return
    sample = prepare_sample(scenario(), 0)
    short = slide_leg(scenario(), sample, VELOCITY, 500)
    (mine, _), (known, _) = (run_legs([short], where)[0] for where in (device, Processor()))
    same = all(np.array_equal(getattr(mine.grains, name), getattr(known.grains, name)) for name in mine.grains._fields)
    yield f"bits after {short.steps} steps are those of this processor: {same}"
    for sides, systems in CASES[:1] if smallest else CASES:
        leg = slide_leg(scenario(), tiled(sample, sides), VELOCITY, STEPS)
        rates, own = [], []
        for _ in range(1 if smallest else int(rounds)):
            rates.append(device_rate(device, [leg] * systems))
            with ProcessPoolExecutor(cores) as pool:
                own.append(sum(pool.map(own_rate, [leg._replace(steps=OWN_STEPS)] * cores)))
        best, ours = max(rates), max(own)
        size = len(leg.state.grains.radius)
        yield {
            "case": f"gouge, {systems} systems, on the device", "n": size, "threads": 1, "ours": best, "peer": ours,
            "peer_name": f"engine on {cores} cores", "ratio": best / ours, "unit": "grain-steps/s",
        }  # fmt: skip
