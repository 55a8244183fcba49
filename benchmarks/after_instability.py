"""What follows an instability: predictions of `birth_form` against free runs of many states.

    python -m benchmarks.after_instability [seconds] [grains of disks, of spheres]

Packings of disks and of spheres are jammed without friction and sheared quasi-statically with smooth friction, and arrays
of disks on a substrate are pushed. States are kept in which one complex pair dominates: nothing else grows at half its
rate or faster. Each is run twice without damping: from the growing mode at a small share of the predicted amplitude, and
from random velocities. The first contact that opens or reaches the Coulomb limit is compared with the predicted one.
"""

import sys
import time
import warnings
from typing import NamedTuple

import numpy as np

import stickslip as ss
from stickslip.solve import birth

SHARE = 0.05  # of the predicted amplitude, at which a run on the mode begins
NOISE = 1e-5  # of the predicted displacement, in a run from random velocities
DOMINATES = 2.0  # smallest ratio of the growth rate of the pair to that of anything else
MOST_STEPS = 1_000_000
BEYOND = 4.0  # e-folding times in which an event is awaited, beyond the time of linear growth


class Seen(NamedTuple):
    """First contact that was lost in a run."""

    kind: str  # "limit", "opened", or "none"
    contact: tuple[int, int]
    amplitude: float  # largest one so far
    closed: int  # contacts that closed before


class Row(NamedTuple):
    """One state: prediction and two runs."""

    dim: int
    n: int
    mu: float
    ratio: float  # growth rate over that of the second-fastest growth
    form: ss.results.BirthForm
    on_mode: Seen
    random: Seen


def growing(found) -> np.ndarray:
    """Growth rates of everything that grows, fastest first."""
    return -np.sort(-np.concatenate([found.growth_rate, np.sqrt(-found.negative)]))


def dominated(state, law) -> float:
    """Ratio of the growth rate of the fastest pair to that of the next growth; zero if no pair is the fastest."""
    found = ss.stability(state, law)
    rates = growing(found)
    if not len(found.pairs) or found.growth_rate[0] < rates[0] or not found.pairs[0].real > 0:
        return 0.0
    return rates[0] / rates[1] if len(rates) > 1 else np.inf


def sheared_packings(dim: int, sizes, rng):
    """Yield sheared packings dominated by one pair, at most one for each packing; None after each that has none."""
    while True:
        n, mu = int(rng.integers(*sizes)), float(10 ** rng.uniform(np.log10(0.3), 1))
        law = ss.laws.hertz_mindlin(mu=mu, coulomb="smooth")
        pressure, step = 10 ** rng.uniform(-4, -2), 10 ** rng.uniform(-4, -2.5)
        kept = []
        try:
            state, _ = ss.packings.jammed(n, pressure=pressure, dim=dim, seed=int(rng.integers(2**31)))
            protocol = ss.protocols.aqs(law)
            point = protocol.step(state, 0.0)
            for k in range(40):
                point = protocol.step(point.state, (k + 1) * step)
                if len(point.spectrum.pairs) and dominated(point.state, law) >= DOMINATES:
                    kept.append(point.state)
        except (ss.NotInEquilibriumError, ValueError):
            pass
        yield (kept[int(rng.integers(len(kept)))], law) if kept else None


def pushed_arrays(rng):
    """Yield pushed arrays dominated by one pair."""
    while True:
        n, mu, press = int(rng.integers(5, 16)), float(10 ** rng.uniform(np.log10(2), 1)), 10 ** rng.uniform(-5, -4)
        law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=mu, coulomb="smooth"), 0, 1)
        state = ss.packings.disk_array(
            n, press=press, gap=-(10 ** rng.uniform(-7, -5)), i0=rng.uniform(0.4, 0.6), disk=int(rng.integers(n))
        )
        disk, most, kept = int(rng.integers(n)), press * rng.uniform(0.1, 1.0), []
        try:
            for push in np.linspace(0, most, 20):
                state, outcome = ss.relax(ss.packings.with_push(state, push, disk), law, tolerance=1e-13)
                if not outcome.ok:
                    break
                if len(ss.stability(state, law).pairs) and dominated(state, law) >= DOMINATES:
                    kept.append(state)
        except (ss.NotInEquilibriumError, ValueError):
            pass
        yield (kept[int(rng.integers(len(kept)))], law) if kept else None


def on_mode(state, form, plane, amplitude: float):
    """State on the growing mode at an amplitude, with the velocities of linear growth."""
    free, exponent, grains = form.free, np.sqrt(-plane.value + 0j), state.grains
    exponent *= np.sign(exponent.real)
    u = (plane.u0 + 1j * plane.value.imag * plane.u1) / np.sqrt(free.mass)
    moved = ss.modes.displaced(state, free, 2 * amplitude * u.real)
    speed = free.spread(2 * amplitude * (exponent * u).real)[: len(grains.radius)]
    return moved._replace(
        grains=moved.grains._replace(velocity=speed[:, :3].copy(), spin=speed[:, 3:] / grains.radius[:, None])
    )


def first_loss(state, start, law, form, plane, e_foldings: float) -> Seen:
    """Run until a contact is lost, for at most a number of e-folding times; None if that takes too many steps."""
    dt = 0.25 * ss.measure.stable_time_step(state, law)
    steps, every = int(e_foldings / form.growth_rate / dt), max(1, int(0.2 / form.frequency / dt))
    if steps > MOST_STEPS:
        return None
    grains, free, leg = state.grains, form.free, max(every, -(-steps // 20 // every) * every)
    root, top, closed, turning = np.sqrt(free.mass), 0.0, 0, form.nearness > birth.NEAR_BIRTH
    rows = ss.measure.touching(state)
    touching = set(zip(state.contacts.i[rows].tolist(), state.contacts.j[rows].tolist(), strict=True))
    body = np.unique(free.body[free.body < len(grains.radius)])
    for _ in range(0, steps, leg):
        start, record, outcome = ss.run(
            start, law, leg, dt, every=every, probes=np.arange(len(grains.radius)), events=True
        )
        if outcome.broken:
            return None
        events = record.events
        events = events[
            (np.isin(events["i"], body)) & (np.isin(events["j"], body) | (events["j"] >= len(grains.radius)))
        ]
        lost = [e for e in events if e["kind"] != "closed" and (e["i"], e["j"]) in touching]
        way = np.concatenate(
            [record.position - grains.position, (record.angle - grains.angle) * grains.radius[:, None]], axis=2
        )
        way = np.concatenate([way, np.zeros((len(way), free.bodies - len(grains.radius), 6))], axis=1)
        y = way.reshape(len(way), -1)[:, free.component] * root
        size = np.hypot(y @ plane.w0, turning * (y @ plane.w1) / plane.value.imag) / 2
        until = record.time <= (lost[0]["time"] if len(lost) else np.inf)
        top = max(top, size[until].max(initial=0.0))
        shut = events[events["kind"] == "closed"]
        if len(lost):
            closed += int((shut["time"] < lost[0]["time"]).sum())
            return Seen(str(lost[0]["kind"]), (int(lost[0]["i"]), int(lost[0]["j"])), top, closed)
        closed += len(shut)
    return Seen("none", (-1, -1), top, closed)


def compare(state, law, seed: int) -> Row | str | None:
    """Prediction and runs of a state; None if there is no prediction or runs would take too long."""
    try:
        form = ss.modes.birth_form(state, law)
    except ValueError as problem:
        return str(problem)
    plane = birth.invariant_plane(ss.modes.dynamical_matrix(state, law, form.free), form.eigenvalue)
    target = min(form.first, form.peak)
    grown = first_loss(state, on_mode(state, form, plane, SHARE * target), law, form, plane, -np.log(SHARE) + BEYOND)
    kick = NOISE * form.displacement(target) * form.frequency
    moving = ss.packings.perturbed(state, velocity=kick, seed=seed)
    noisy = first_loss(state, moving, law, form, plane, -np.log(NOISE) + BEYOND)
    if grown is None or noisy is None:
        return "the runs need too many steps or blow up"
    return Row(state.cell.dim, len(state.grains.radius), float(law.table[..., 2].max()), dominated(state, law), form,
               grown, noisy)  # fmt: skip


def predicted(form):
    """Kind and contact of the predicted first loss."""
    return ("limit", form.limit_contact) if form.limit <= form.opening else ("open", form.opening_contact)


def main(seconds: float = 600.0, disks=(10, 41), spheres=(20, 51)) -> None:
    """Gather states of three kinds for a time, in turn, and print the tables."""
    import pickle

    out = sys.argv[2] if len(sys.argv) > 2 else None
    rng, end = np.random.default_rng(int(sys.argv[3]) if len(sys.argv) > 3 else 0), time.monotonic() + seconds
    kinds = {
        "disks": sheared_packings(2, disks, rng), "spheres": sheared_packings(3, spheres, rng),
        "arrays": pushed_arrays(rng),
    }  # fmt: skip
    pick = sys.argv[4].split(",") if len(sys.argv) > 4 else list(kinds)
    rows, turn = [], 0
    while time.monotonic() < end:
        name = pick[turn % len(pick)]
        turn += 1
        t = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ss.modes.UnstableEquilibriumWarning)
            got = next(kinds[name])
        t1 = time.process_time()
        if got is None:
            print(name, "none", f"{t1 - t:.1f}", flush=True)
            continue
        row = compare(*got, turn)
        if isinstance(row, str):
            print(name, row, flush=True)
            rows.append((name, got, row))
        else:
            f = row.form
            kind, contact = predicted(f)
            print(
                f"{name} n {row.n} mu {row.mu:.2f} near {f.nearness:.2f} ratio {row.ratio:.2g} {f.fate} beta {f.beta:.2g} det {f.detuned:.2g} sig/w {f.growth_rate / f.frequency:.1e}"
                f" pred {kind}{contact} {f.first:.2e} peak {f.peak:.2e} | mode {row.on_mode.kind}{row.on_mode.contact} {row.on_mode.amplitude / f.first:.2f} c{row.on_mode.closed}"
                f" | noise {row.random.kind}{row.random.contact} {row.random.amplitude / f.first:.2f} c{row.random.closed} | {t1 - t:.1f} {time.process_time() - t1:.1f}s",
                flush=True,
            )
            rows.append((name, got, row))
        if out:
            pickle.dump(rows, open(out, "wb"))


if __name__ == "__main__":
    main(*(float(word) for word in sys.argv[1:2]))
