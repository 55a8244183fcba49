"""Events made by formulas, in place of a simulation."""

from typing import NamedTuple

import numpy as np

from stickslip.loading.event_class import Event, EventKind, Events, StrainStep

KINDS = list(EventKind)
DISTANCES = 4e-4 * 8.0 ** -np.arange(6)


class Sample(NamedTuple):
    """As in the experiment, without a packing."""

    seed: int
    found: Events


def event(strain: float, k: int = 0, kind: EventKind | None = None) -> Event:
    """An event of any class; a saddle node has the exponent 1/2."""
    kind = kind or KINDS[k % len(KINDS)]
    saddle, sliding = kind is EventKind.SADDLE_NODE, kind is EventKind.SLIDING
    flat = np.full(len(DISTANCES), 0.02 + 0.001 * k)
    none = np.full(len(DISTANCES), np.nan)
    return Event(
        strain=strain, below=strain - 9e-7, kind=kind,
        exponent=0.5 if saddle else np.nan, exponent_error=0.01 if saddle else np.nan,
        distances=DISTANCES.copy(), softest=0.02 * np.sqrt(DISTANCES / DISTANCES[0]) if saddle else flat,
        re_pair=none, growth=np.zeros(len(DISTANCES)), trigger=(k, k + 1) if sliding else (-1, -1),
        mobilisation=0.999 if sliding else np.nan, switched=-0.3 - 0.1 * k if sliding else np.nan,
        growth_rate=1e-3 * (k + 1), stress_drop=10 ** (-3 + 0.1 * k), jump=10 ** (-2 + 0.07 * k), participation=0.3,
        opened=k, closed=2 * k, newton_distance=np.nan if k % 3 else 1e-3,
    )  # fmt: skip


def steps(strain: np.ndarray, rng, alarm: np.ndarray | None = None) -> StrainStep:
    """Steps with random predictors; the switch test falls where `alarm` is True."""
    noise = rng.normal(size=(5, len(strain)))
    alarm = np.zeros(len(strain), bool) if alarm is None else alarm
    return StrainStep(
        strain=strain, softest=noise[0], nonaffine_rate=noise[1] + 1.5 * alarm, growth=np.maximum(noise[2], 0),
        tangent_modulus=noise[3], switch=noise[4] - 6 * alarm, shear_stress=strain.copy(),
        pressure=np.ones(len(strain)), loss_ahead=np.where(alarm, 1e-4, np.inf),
    )  # fmt: skip


def events_of(seed: int, number: int, state=None, step: float = 4e-4) -> Events:
    """So many events of one packing, one every ten steps, in the second half of a step."""
    rng = np.random.default_rng(seed)
    strain = step * np.arange(10 * number + 6)
    at = step * (10 * np.arange(1, number + 1) + 0.6)
    alarm = np.isin(np.arange(len(strain)), 10 * np.arange(1, number + 1))
    made = tuple(event(x, k + seed) for k, x in enumerate(at))
    return Events(made, steps(strain, rng, alarm), state, 0.1, step, 1e-6, "the largest strain was reached")


def samples(number: int = 4, events: int = 5) -> list[Sample]:
    """Several packings with the same number of events."""
    return [Sample(seed, events_of(seed, events)) for seed in range(number)]
