"""Motion after an instability: predictions of `birth_form` compared with free runs of many states.

    python -m benchmarks after_instability [states of each kind, by default 24] [kinds: arrays mixed disks spheres]

24 states of each kind take seven minutes on one core. States in which a contact is predicted to close before another is
lost are summarised on their own.

Packings of disks and spheres are jammed without friction and sheared quasi-statically with smooth friction. Arrays of
disks on a substrate are pushed: equal disks that overlap at first, and mixed disks, some with gaps between them. States
are kept if one complex pair dominates: no other motion grows at half its rate or faster. Half of them are the states
nearest to a birth in their packing. Each state is run twice without damping: from the growing mode at a small fraction
of the predicted amplitude, and from random velocities. The first contact that opens or reaches the Coulomb limit is
compared with the predicted contact; contacts that close earlier are compared with the prediction of such closings.
Events of rattlers are ignored; all others count.
"""

import warnings
from collections import Counter
from itertools import pairwise
from typing import NamedTuple

import numpy as np

import stickslip as ss
from stickslip.solve import birth

SHARE = 0.05  # initial amplitude of a run on the mode, as a fraction of the predicted amplitude
NOISE = 1e-5  # initial displacement of a run from random velocities, as a fraction of the predicted displacement
DOMINATES = 2.0  # smallest ratio of the growth rate of the pair to that of any other motion
GROWTH = (0, 3e-4, 1e-3, np.inf)  # limits between classes of states, by the ratio of growth rate to frequency
MOST_STEPS = 1_000_000
TOO_LONG = "the runs would need more than a million steps"
BEYOND = 4.0  # e-folding times allowed for an event beyond the time of linear growth


class Seen(NamedTuple):
    """First contact lost in a run."""

    kind: str  # "limit", "opened", or "none"
    contact: tuple[int, int]
    amplitude: float  # largest amplitude up to that time
    closed: tuple[int, int]  # first contact that closed earlier; (−1, −1) if none did


class Row(NamedTuple):
    """Prediction for one state, and its two runs."""

    n: int
    mu: float
    form: ss.results.BirthForm
    on_mode: Seen
    random: Seen


def growing(found) -> np.ndarray:
    """Growth rates of all growing motions, fastest first."""
    return -np.sort(-np.concatenate([found.growth_rate, np.sqrt(-found.negative)]))


def dominated(state, law) -> float:
    """Growth rate of the fastest pair over that of the next motion; zero if the fastest motion is not a pair."""
    found = ss.stability(state, law)
    rates = growing(found)
    if not len(found.pairs) or found.growth_rate[0] < rates[0] or not found.pairs[0].real > 0:
        return 0.0
    return rates[0] / rates[1] if len(rates) > 1 else np.inf


def chosen(states: list, law, rng):
    """Choose, with equal probability, a random state or the state with the smallest Im λ/Re λ."""
    if rng.random() < 0.5:
        return states[int(rng.integers(len(states)))]
    return min(states, key=lambda state: (lambda pair: pair.imag / pair.real)(ss.stability(state, law).pairs[0]))


def sheared_packings(dim: int, sizes, rng):
    """Yield, for each sheared packing, a state dominated by one pair, or None if the packing has no such state."""
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
        yield (chosen(kept, law, rng), law) if kept else None


def pushed_arrays(rng, *, mixed: bool = False):
    """Yield pushed arrays dominated by one pair; mixed arrays have unequal disks, some with gaps between them."""
    while True:
        n, mu, press = int(rng.integers(5, 16)), float(10 ** rng.uniform(np.log10(2), 1)), 10 ** rng.uniform(-5, -4)
        law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=mu, coulomb="smooth"), 0, 1)
        overlap, radius = 10 ** rng.uniform(-7, -5), rng.uniform(0.4, 0.6, n) if mixed else np.full(n, 0.5)
        state = ss.packings.disk_array(
            n, radius, press=press, mass=(radius / 0.5) ** 2, gap=-overlap, i0=rng.uniform(0.4, 0.6),
            disk=int(rng.integers(n)),
        )  # fmt: skip
        if mixed:  # neighbours overlap by up to three times the mean, or leave a gap
            place = state.grains.position + overlap * rng.uniform(-1, 1, (n, 1)) * [1.0, 0.0, 0.0]
            state = state._replace(grains=state.grains._replace(position=place))
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
        yield (chosen(kept, law, rng), law) if kept else None


def on_mode(state, form, plane, amplitude: float):
    """State displaced along the growing mode by an amplitude, with the velocities of linear growth."""
    free, exponent, grains = form.free, np.sqrt(-plane.value + 0j), state.grains
    exponent *= np.sign(exponent.real)
    u = (plane.u0 + 1j * plane.value.imag * plane.u1) / np.sqrt(free.mass)
    moved = ss.modes.displaced(state, free, 2 * amplitude * u.real)
    speed = free.spread(2 * amplitude * (exponent * u).real)[: len(grains.radius)]
    return moved._replace(
        grains=moved.grains._replace(velocity=speed[:, :3].copy(), spin=speed[:, 3:] / grains.radius[:, None])
    )


def first_loss(state, start, law, form, plane, e_foldings: float) -> Seen | None:
    """Run until a contact is lost, for at most `e_foldings` e-folding times; None if the run fails."""
    dt = 0.25 * ss.measure.stable_time_step(state, law)
    steps, every = int(e_foldings / form.growth_rate / dt), max(1, int(0.2 / form.frequency / dt))
    grains, free, leg = state.grains, form.free, max(every, -(-steps // 20 // every) * every)
    root, top, closed, turning = np.sqrt(free.mass), 0.0, (-1, -1), form.nearness > birth.NEAR_BIRTH
    loose = np.append(ss.measure.rattlers(state), np.zeros(len(state.walls.mass), bool))
    for _ in range(0, steps, leg):
        start, record, outcome = ss.run(
            start, law, leg, dt, every=every, probes=np.arange(len(grains.radius)), events=True
        )
        if outcome.broken:
            return None
        events = record.events
        events = events[~loose[events["i"]] & ~loose[events["j"]]]
        shut, lost = events[events["kind"] == "closed"], events[events["kind"] != "closed"]
        way = np.concatenate(
            [record.position - grains.position, (record.angle - grains.angle) * grains.radius[:, None]], axis=2
        )
        way = np.concatenate([way, np.zeros((len(way), free.bodies - len(grains.radius), 6))], axis=1)
        y = way.reshape(len(way), -1)[:, free.component] * root
        size = np.hypot(y @ plane.w0, turning * (y @ plane.w1) / plane.value.imag) / 2
        until = record.time <= (lost[0]["time"] if len(lost) else np.inf)
        top = max(top, size[until].max(initial=0.0))
        if len(shut) and closed[0] < 0 and (not len(lost) or shut[0]["time"] <= lost[0]["time"]):
            closed = (int(shut[0]["i"]), int(shut[0]["j"]))
        if len(lost):
            return Seen(str(lost[0]["kind"]), (int(lost[0]["i"]), int(lost[0]["j"])), top, closed)
    return Seen("none", (-1, -1), top, closed)


def compare(state, law, seed: int) -> Row | str:
    """Prediction and runs of a state, or the reason for their absence."""
    try:
        form = ss.modes.birth_form(state, law)
    except ValueError as problem:
        return str(problem).split(":")[0].lstrip("0123456789 ")
    if (BEYOND - np.log(NOISE)) / form.growth_rate > MOST_STEPS * 0.25 * ss.measure.stable_time_step(state, law):
        return TOO_LONG
    plane = birth.invariant_plane(ss.modes.dynamical_matrix(state, law, form.free), form.eigenvalue)
    target = min(form.first, form.peak if form.fate == "bounded bursts" else np.inf)
    if not np.isfinite(target):
        return "no contact is predicted to be lost"
    grown = first_loss(state, on_mode(state, form, plane, SHARE * target), law, form, plane, -np.log(SHARE) + BEYOND)
    kick = NOISE * form.displacement(target) * form.frequency
    moving = ss.packings.perturbed(state, velocity=kick, seed=seed)
    noisy = first_loss(state, moving, law, form, plane, -np.log(NOISE) + BEYOND)
    if grown is None or noisy is None:
        return "a run broke down"
    return Row(len(state.grains.radius), float(law.table[..., 2].max()), form, grown, noisy)


def verdicts(row: Row, seen: Seen) -> tuple[bool | None, bool]:
    """Correctness of the first contact (None if no loss was predicted and none occurred), and of the fate."""
    form = row.form
    contact = form.limit_contact if form.limit <= form.opening else form.opening_contact
    lost, expected = seen.kind != "none", form.fate != "bounded bursts"
    return (seen.contact == contact if lost else False) if lost or expected else None, lost == expected


def foreseen(form) -> tuple[int, int]:
    """Contact predicted to close before another is lost and before the motion turns back; (−1, −1) if there is none."""
    before = form.closing < min(form.first, form.peak if form.fate == "bounded bursts" else np.inf)
    return form.closing_contact if before else (-1, -1)


def describe(name: str, row: Row) -> str:
    """Describe a state, its prediction and its runs in one line."""
    form, words = row.form, []
    for seen in (row.on_mode, row.random):
        right, fate = verdicts(row, seen)
        contact = {None: "no contact", True: "right", False: f"wrong ({seen.kind} {seen.contact})"}[right]
        closing = f", {seen.closed} closes before" if seen.closed[0] >= 0 else ""
        words.append(
            f"{contact}, fate {'right' if fate else 'wrong'}, amplitude {seen.amplitude / form.first:.2f}{closing}"
        )
    return (
        f"{name}: {row.n} grains, μ {row.mu:.2f}, |q|/|p| {form.nearness:.2f}, σ/ω "
        f"{form.growth_rate / form.frequency:.1e}, {form.fate}, peak {form.peak / form.first:.2f}, closing "
        f"{form.closing / form.first:.2f} of {form.closing_contact} | on the mode: {words[0]} | random: {words[1]}"
    )


def summarise(name: str, rows: list[Row]) -> str:
    """Summarise a group of states in one line."""
    if not rows:
        return f"{name}: no states"
    parts = []
    for word, run in (("on the mode", "on_mode"), ("random", "random")):
        found = [verdicts(row, getattr(row, run)) for row in rows]
        contacts = [right for right, _ in found if right is not None]
        ratios = [
            getattr(row, run).amplitude / row.form.first for row, (right, _) in zip(rows, found, strict=True) if right
        ]
        spread = ", ".join(f"{x:.2f}" for x in np.quantile(ratios, (0.1, 0.5, 0.9))) if ratios else "none"
        shut = [(foreseen(row.form), getattr(row, run).closed) for row in rows]
        known = [told == seen for told, seen in shut if told[0] >= 0]
        missed = [seen[0] >= 0 for told, seen in shut if told[0] < 0]
        parts.append(
            f"{word}: a contact closes as foreseen in {sum(known)} of {len(known)}, unforeseen in "
            f"{sum(missed)} of {len(missed)}, first contact right in {sum(contacts)} of {len(contacts)}, amplitude "
            f"over prediction (10, 50, 90 %) {spread}, fate right in {sum(fate for _, fate in found)} of {len(found)}"
        )
    return f"{name}: {len(rows)} states; " + "; ".join(parts)


KINDS = {
    "arrays": pushed_arrays,
    "mixed": lambda rng: pushed_arrays(rng, mixed=True),
    "disks": lambda rng: sheared_packings(2, (10, 41), rng),
    "spheres": lambda rng: sheared_packings(3, (20, 51), rng),
}


def rows(*words: str, smallest: bool = False):
    """Compare a number of states of each kind: one line per state, and fractions of correct predictions."""
    each = 1 if smallest else next((int(word) for word in words if word.isdigit()), 24)
    wanted = ["arrays"] if smallest else [word for word in words if not word.isdigit()] or list(KINDS)
    found_rows, without = {}, Counter()
    for name in wanted:
        states, found_rows[name], tried = KINDS[name](np.random.default_rng(0)), [], 0
        while len(found_rows[name]) < each:
            tried += 1
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ss.modes.UnstableEquilibriumWarning)
                found = next(states)
            if found is None:
                continue
            row = compare(*found, tried)
            if isinstance(row, str):
                without[f"{name}: {row}"] += 1
                continue
            found_rows[name].append(row)
            yield describe(name, row)
    for name, group in found_rows.items():
        closing = [row for row in group if foreseen(row.form)[0] >= 0]
        group = [row for row in group if foreseen(row.form)[0] < 0]
        for where, near in (("|q|/|p| ≤ 1/3", True), ("|q|/|p| > 1/3", False)):
            chosen_rows = [row for row in group if (row.form.nearness <= birth.NEAR_BIRTH) == near]
            yield summarise(f"{name}, {where}", chosen_rows)
        for low, high in pairwise(GROWTH):
            chosen_rows = [row for row in group if low <= row.form.growth_rate / row.form.frequency < high]
            yield summarise(f"{name}, {low:g} ≤ σ/ω < {high:g}", chosen_rows)
        yield summarise(f"{name}, in which a contact closes before", closing)
    every = [row for group in found_rows.values() for row in group]
    yield summarise("all", every)
    yield summarise("all in which no contact closes before", [r for r in every if foreseen(r.form)[0] < 0])
    for reason, count in without.items():
        yield f"left out, {reason}: {count}"
