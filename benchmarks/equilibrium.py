"""Reliability of verdicts off equilibrium: three measurements that justify `BALANCED_BELOW`; takes ten minutes.

    python -m benchmarks equilibrium

Packings of 15 to 60 disks and spheres are jammed without friction and then sheared quasi-statically with friction, with
smooth and sharp laws and friction coefficients of 0.3 and 10. For the first table, grains are moved at random. For the
second, slips are removed, also from packings of 500 disks. For the third, positions and slips are rounded as in text
files.
"""

import itertools
import time
import warnings

import numpy as np

import stickslip as ss
from stickslip.core.contacts.neighbors import with_neighbor_list

LEVELS = 10.0 ** np.arange(-8, 1)
STEPS = (1e-6, 1e-4, 1e-3, 2e-3, 5e-3, 1e-2, 1e-1, 1e1)
DIGITS = (6, 7, 8, 10)


def packings(seconds: float, sizes=(15, 61), strains=(-5, -2), dims=(2, 3)):
    """Yield packings at rest under friction, with their laws, for some seconds; `strains` are limits of log10 γ."""
    rng, end, seed = np.random.default_rng(0), time.monotonic() + seconds, 0
    while time.monotonic() < end:
        seed += 1
        law = ss.laws.hertz_mindlin(1.0, 2 / 7, rng.choice([0.3, 10.0]), coulomb=rng.choice(["smooth", "sharp"]))
        n, pressure, most = int(rng.integers(*sizes)), 10 ** rng.uniform(-4, -2), 10 ** rng.uniform(*strains)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ss.modes.UnstableEquilibriumWarning)
            try:
                state, _ = ss.packings.jammed(n, pressure=pressure, dim=dims[seed % len(dims)], seed=seed)
                rest = ss.protocols.ramp(state, np.linspace(0, most, 6), ss.protocols.aqs(law))[-1].state
            except (ss.NotInEquilibriumError, ValueError):  # the pressure was not reached
                continue
        yield rest, law, rng


def stirred(state, law, level: float, rng):
    """Return the state with grains moved at random until the residual is about `level`, and with memory committed."""
    move, grains, tiny = rng.normal(size=state.grains.position.shape), state.grains, 1e-9
    move[:, state.cell.dim :] = 0

    def at(size):
        moved = with_neighbor_list(state._replace(grains=grains._replace(position=grains.position + size * move)), law)
        return ss.accept(moved, ss.forces(moved, law)[1])

    return at(tiny * level / max(ss.measure.imbalance(at(tiny), law) - ss.measure.imbalance(state, law), 1e-15))


def bare(state):
    """Return the state without its slips."""
    contacts = state.contacts
    return state._replace(contacts=contacts._replace(slip=0 * contacts.slip, mode=np.minimum(contacts.mode, ss.STICK)))


def rounded(state, law, digits: int):
    """Return the state after its positions and slips have been written and read as text."""

    def text(values):
        return np.reshape([float(f"{v:.{digits}g}") for v in values.ravel()], values.shape)

    rows, c = ss.measure.touching(state), state.contacts
    return ss.packings.from_arrays(
        text(state.grains.position), state.grains.radius, law, mass=state.grains.mass, cell=state.cell.vectors,
        dim=state.cell.dim, pair_i=c.i[rows], pair_j=c.j[rows], image=c.image[rows], slip=text(c.slip[rows]),
        mode=c.mode[rows],
    )  # fmt: skip


def without_slips(found):
    """Lines with fractions of packings unstable with and without slips, by the residual without slips."""
    residual, with_them, forgotten = np.array(found, float).reshape(-1, 3).T
    for low, high in itertools.pairwise(STEPS):
        here = (residual >= low) & (residual < high)
        if here.any():
            yield (
                f"  {low:.0e} to {high:.0e}  {with_them[here].mean():.2f}  {forgotten[here].mean():.2f}  {here.sum()}"
            )


def rows(seconds: str = "300", *, smallest: bool = False):
    """Measure everything; takes twice `seconds`."""
    seconds = 0.01 if smallest else float(seconds)
    warnings.simplefilter("ignore", ss.packings.PackingWarning)
    moved, small, large, texts = {level: [] for level in LEVELS}, [], [], {digits: [] for digits in DIGITS}
    for state, law, rng in packings(seconds):
        truth = ss.stability(state, law).grows
        for level in LEVELS:
            moved[level].append(ss.stability(stirred(state, law, level, rng), law, method="all").grows != truth)
        forgotten = ss.stability(bare(state), law, method="all")
        small.append((forgotten.residual, truth, forgotten.grows))
        for digits in DIGITS:
            try:
                texts[digits].append(ss.measure.imbalance(rounded(state, law, digits), law))
            except ss.packings.PackingError:  # rounding has removed a contact
                texts[digits].append(np.inf)
    for state, law, _ in packings(0 if smallest else seconds, (500, 501), (-4.6, -3.6), (2,)):
        forgotten = ss.stability(bare(state), law, method="all")
        large.append((forgotten.residual, ss.stability(state, law).grows, forgotten.grows))
    yield ("grains moved at random: residual, share of changed verdicts, packings")
    for level, changed in moved.items():
        yield (f"  {level:.0e}  {np.mean(changed):.3f}  {len(changed)}")
    for words, found in (("15 to 60 grains", small), ("500 disks", large)):
        yield f"slips removed, {words}: residual, share unstable with slips, without slips, packings"
        yield from without_slips(found)
    yield ("text: digits, median and largest residual")
    for digits, found in texts.items():
        yield (f"  {digits}  {np.median(found):.1e}  {np.max(found):.1e}")
