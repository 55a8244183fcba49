"""Packings that the tests of exchange write and read."""

import numpy as np

import stickslip as ss
from stickslip.core.state import OPEN, PER_PAIR

SHARP = ss.laws.hertz_mindlin_reff(2.0, 1.5, 0.2, damping_n=0.3, damping_t=0.2)


def spheres(seed=0, *, law=SHARP, motion=True) -> ss.State:
    """Some 40 spheres in a sheared periodic box, positions outside of it, with slip, sliding contacts and motion."""
    rng = np.random.default_rng(seed)
    cell = np.array([[3.6, 0, 0], [0.5, 3.6, 0], [0.2, -0.3, 3.6]])
    place = (np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) / 4
    place = place @ cell + rng.normal(0, 0.03, place.shape) + rng.integers(-2, 3, place.shape) @ cell
    n = len(place)
    given = {"radius": rng.uniform(0.45, 0.55, n), "mass": rng.uniform(0.5, 2, n), "cell": cell}
    if motion:
        given |= dict(zip(("velocity", "spin"), rng.normal(0, 1e-3, (2, n, 3)), strict=True))
    return with_slip(ss.packings.from_arrays(place, law=law, **given), law, rng)


def disks(seed=0, *, law=SHARP, motion=True) -> ss.State:
    """Disks in the plane, periodic along x and y, with slip and motion."""
    rng = np.random.default_rng(seed)
    place = (np.stack(np.meshgrid(np.arange(6), np.arange(6), indexing="ij"), axis=-1).reshape(-1, 2) + 0.5) * 0.95
    place += rng.normal(0, 0.03, place.shape)
    turn = np.zeros((2, len(place), 3))
    turn[..., 2] = rng.normal(0, 1e-3, (2, len(place)))
    given = {"cell": [5.7, 5.7], "angle": turn[1], "dim": 2}
    if motion:
        given |= {"velocity": rng.normal(0, 1e-3, place.shape), "spin": turn[0]}
    return with_slip(ss.packings.from_arrays(place, rng.uniform(0.48, 0.55, len(place)), law, **given), law, rng)


def walled() -> tuple[ss.State, ss.Law]:
    """Ten disks between walls, pushed: walls, loads, two materials, nothing periodic."""
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(kn=1.0, kt=2 / 7, mu=10.0, coulomb="smooth"), 0, 1)
    state, _ = ss.relax(ss.packings.disk_array(10, press=5e-5), law)
    return state, law


def with_slip(state: ss.State, law: ss.Law, rng) -> ss.State:
    """Random slip at every contact, some beyond the Coulomb limit, accepted."""
    c = state.contacts
    slip = np.where((c.mode != OPEN)[:, None], rng.normal(0, 5e-3, c.slip.shape), 0.0)
    if state.cell.dim == 2:
        slip[:, 2] = 0.0
    moved = state._replace(contacts=c._replace(slip=slip))
    return ss.accept(state, ss.forces(moved, law)[1])


def assert_same(a: ss.State, b: ss.State) -> None:
    """Every array of two states is the same, to the last bit."""
    count = int(a.contacts.count[0])
    for noun in ("grains", "walls", "cell", "contacts", "control"):
        for name, x in getattr(a, noun)._asdict().items():
            y = np.asarray(getattr(getattr(b, noun), name))
            x = np.asarray(x)
            if noun == "contacts" and name in PER_PAIR and x.ndim:
                x, y = x[:count], y[:count]
            assert x.dtype == y.dtype, (noun, name)
            assert np.array_equal(x, y), (noun, name)
    assert a.time == b.time
