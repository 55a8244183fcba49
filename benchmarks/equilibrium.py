"""How far from equilibrium a verdict means something: three measurements behind `BALANCED_BELOW`; some ten minutes.

    python -m benchmarks.equilibrium

Packings of 15 to 60 disks and spheres, jammed without friction and then sheared quasi-statically under it, by smooth
and sharp laws with a friction coefficient of 0.3 and 10. The first table moves grains at random; the second takes the
slips away; the third rounds positions and slips as text does.
"""

import sys
import time
import warnings

import numpy as np

import stickslip as ss
from stickslip.core.neighbors import updated

LEVELS = 10.0 ** np.arange(-8, 1)
DIGITS = (6, 7, 8, 10)


def packings(seconds: float):
    """Packings at rest under friction, with their laws, one after the other until the time is spent."""
    rng, end, seed = np.random.default_rng(0), time.monotonic() + seconds, 0
    while time.monotonic() < end:
        seed += 1
        law = ss.hertz_mindlin(1.0, 2 / 7, rng.choice([0.3, 10.0]), coulomb=rng.choice(["smooth", "sharp"]))
        n, pressure, most = int(rng.integers(15, 61)), 10 ** rng.uniform(-4, -2), 10 ** rng.uniform(-5, -2)
        state, _ = ss.jammed(n, pressure=pressure, dim=2 + seed % 2, seed=seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ss.UnstableEquilibriumWarning)
            try:
                rest = ss.ramp(state, np.linspace(0, most, 6), ss.aqs(law))[-1].state
            except ss.NotInEquilibriumError:
                continue
        yield rest, law, rng


def stirred(state, law, level: float, rng):
    """The state with grains moved at random so far that its residual is about `level`, and its memory committed."""
    move, grains, tiny = rng.normal(size=state.grains.position.shape), state.grains, 1e-9
    move[:, state.cell.dim :] = 0

    def at(size):
        moved = updated(state._replace(grains=grains._replace(position=grains.position + size * move)), law)
        return ss.accept(moved, ss.forces(moved, law)[1])

    return at(tiny * level / max(ss.imbalance(at(tiny), law) - ss.imbalance(state, law), 1e-15))


def bare(state):
    """The state without its slips."""
    contacts = state.contacts
    return state._replace(contacts=contacts._replace(slip=0 * contacts.slip, mode=np.minimum(contacts.mode, ss.STICK)))


def rounded(state, law, digits: int):
    """The state after its positions and slips went through text."""

    def text(values):
        return np.reshape([float(f"{v:.{digits}g}") for v in values.ravel()], values.shape)

    rows, c = ss.touching(state), state.contacts
    return ss.sample(
        text(state.grains.position), state.grains.radius, law, mass=state.grains.mass, cell=state.cell.vectors,
        dim=state.cell.dim, pair_i=c.i[rows], pair_j=c.j[rows], image=c.image[rows], slip=text(c.slip[rows]),
        mode=c.mode[rows],
    )  # fmt: skip


def main(seconds: float = 500.0) -> None:
    """Measure and print."""
    warnings.simplefilter("ignore", ss.SampleWarning)
    moved, without, texts = {level: [] for level in LEVELS}, [], {digits: [] for digits in DIGITS}
    for state, law, rng in packings(seconds):
        truth = ss.stability(state, law).grows
        for level in LEVELS:
            moved[level].append(ss.stability(stirred(state, law, level, rng), law).grows != truth)
        forgotten = ss.stability(bare(state), law)
        without.append((forgotten.residual, truth, forgotten.grows))
        for digits in DIGITS:
            texts[digits].append(ss.imbalance(rounded(state, law, digits), law))
    print("grains moved at random: residual, verdicts that change, packings")
    for level, changed in moved.items():
        print(f"  {level:.0e}  {np.mean(changed):.3f}  {len(changed)}")
    print("slips left out: residual, share unstable with slips, without, packings")
    residual, unstable, still = np.array(without, float).T
    for low in 10.0 ** np.arange(-6, 1):
        here = (residual >= low) & (residual < 10 * low)
        if here.any():
            print(f"  {low:.0e} to {10 * low:.0e}  {unstable[here].mean():.2f}  {still[here].mean():.2f}  {here.sum()}")
    print("text: digits, median and greatest residual")
    for digits, found in texts.items():
        print(f"  {digits}  {np.median(found):.1e}  {np.max(found):.1e}")


if __name__ == "__main__":
    main(*map(float, sys.argv[1:]))
