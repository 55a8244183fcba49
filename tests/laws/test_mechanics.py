"""The two example laws, cohesive and rolling: forces, memory, exact Jacobian, runs, energy, on disk."""

from pathlib import Path

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.forces import FREE, HELD
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.dynamics import driver as integrate
from stickslip.solve.balance import with_modes_under
from tests.conftest import make_packing, stirred

EXAMPLES = Path(__file__).parents[2] / "examples"
SLOW = pytest.mark.slow


def example(name, **parameters):
    """An example's law with other values at the wall, bridges that matter, and caps that are reached.

    Normal dashpots only: that along a sliding contact has two one-sided derivatives.
    """
    more = {"cohesive": {"tension": 5e-3}, "rolling": {"mu_r": 1.5}}[name]
    given = more | {"damping_n": 0.1} | parameters
    return ss.laws.for_pair(ss.laws.from_file(EXAMPLES / f"{name}_law.py", **given), 0, 1, mu=0.3, kn=1.3)


def packed(name, dim):
    """A packing with committed memory: some contacts slide, some roll at their cap, some act across gaps.

    None is so near a kink, or slides or rolls with so little memory, that differences would see a curvature.
    """
    law = example(name)
    for seed in range(300):
        state = stirred(make_packing(dim, seed=seed), law, np.random.default_rng(seed), size=0.05)
        count = int(state.contacts.count[0])
        mode, gap = state.contacts.mode[:count], -ss.measure.overlaps(state)
        slips = np.linalg.norm(state.contacts.slip[:count], axis=1)[(mode == ss.SLIDE) & (gap < 0)]
        good = len(slips) and slips.min() > 0.02 and (mode == ss.STICK).any() and np.abs(gap).min() > 2e-3
        if name == "cohesive":
            good = good and ((gap > 0) & (mode > 0)).any() and np.abs(gap - 0.05).min() > 2e-3
        else:
            rolling = state.contacts.rolling[:count][mode > 0]
            turned, at_cap = np.linalg.norm(rolling[:, :3], axis=1), rolling[:, 6] > 0
            good = good and at_cap.any() and not at_cap.all() and turned[at_cap].min() > 0.02
        if good:
            return state, law
    raise AssertionError("no suitable packing")


@pytest.mark.parametrize("n", [3, 60])  # by rows, and in blocks
def test_a_bridge_across_a_gap_does_not_slide(n):
    """Grains in pairs: the bridge of the first pulls across a gap, the others touch."""
    law = ss.laws.from_file(EXAMPLES / "cohesive_law.py", tension=1e-4)
    distance = np.full(n, 0.99)
    distance[0] = 1.02
    first = np.stack([np.arange(n) * 3.0, np.zeros(n)], axis=1)
    place = np.concatenate([first, first + np.stack([np.zeros(n), distance], axis=1)])
    state = ss.packings.from_arrays(place, np.full(2 * n, 0.5), law, dim=2)
    end, record, _ = ss.run(state, law, 3, 1e-3, every=1, events=True)
    for here in (state, end, with_modes_under(end, law)):
        rows = ss.measure.touching(here)
        assert len(rows) == n and (ss.measure.overlaps(here)[rows] < 0).sum() == 1
        assert (here.contacts.mode[rows] == ss.STICK).all()
    assert record.touching[-1] == n and record.sliding[-1] == 0 and not len(record.events)
    assert not np.isclose(end.grains.velocity[0], 0).all()  # the bridge pulls
    known = " ".join(ss.measure.likely_causes(state, law))
    assert f"all {n - 1} contacts are treated as never sheared" in known


def differences(state, law, free, memory, step, ways=None):
    """∂(generalised force)/∂q by central differences along the columns of `ways`, or the coordinates."""

    columns = []
    for way in np.eye(len(free)) if ways is None else ways.T:
        sides = []
        for sign in (1, -1):
            moved = ss.modes.displaced(state, free, sign * step * way)
            sides.append(ss.modes.residual_vector(moved, ss.forces(moved, law, memory=memory)[0], free))
        columns.append((sides[0] - sides[1]) / (2 * step))
    return np.stack(columns, axis=1)


def rate_differences(state, law, free, step, ways=None):
    """∂(generalised force)/∂q̇ by central differences along the columns of `ways`, or the coordinates."""
    columns, n = [], len(state.grains.radius)
    for way in np.eye(len(free)) if ways is None else ways.T:
        sides = []
        for sign in (1, -1):
            v = free.spread(sign * step * way)
            spin = v[:n, 3:] / state.grains.radius[:, None]
            moving = state._replace(
                grains=state.grains._replace(velocity=v[:n, :3], spin=spin),
                walls=state.walls._replace(velocity=v[n:, :3]),
            )
            sides.append(ss.modes.residual_vector(moving, ss.forces(moving, law, memory=HELD)[0], free))
        columns.append((sides[0] - sides[1]) / (2 * step))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize(
    ("name", "dim"),
    [("cohesive", 2), pytest.param("cohesive", 3, marks=SLOW), ("rolling", 3), pytest.param("rolling", 2, marks=SLOW)],
)
def test_jacobian_and_damping_matrix_are_exact(name, dim):
    state, law = packed(name, dim)
    free = ss.freedom(state)
    for memory, step in ((HELD, 1e-6), (FREE, 1e-7)):
        if memory == FREE:  # as in a solver: what is not committed moves on
            state = with_neighbor_list(
                ss.modes.displaced(state, free, np.random.default_rng(3).normal(0, 3e-4, len(free)))
            )
        exact = ss.modes.assembled(state, ss.modes.contact_blocks(state, law, memory=memory)[0], free).toarray()
        numerical = differences(state, law, free, memory, step)
        # h² f''' with lengths of 0.02 and round-off over h are both of order 1e-9
        np.testing.assert_allclose(exact, numerical, atol=3e-8 * np.abs(exact).max())
    state, _ = packed(name, dim)
    rub = ss.modes.assembled(state, ss.modes.contact_blocks(state, law)[1], free).toarray()
    np.testing.assert_allclose(rub, rate_differences(state, law, free, 1e-7), atol=1e-8 * np.abs(rub).max())


def test_a_bridge_pulls_across_its_gap_and_opens_beyond():
    law = example("cohesive")
    tension, decay, rupture = law.table[0, 0, 5:]
    for gap, open_ in ((-0.01, False), (0.0, False), (0.02, False), (0.0499, False), (0.0501, True)):
        pair = ss.assembly(ss.disks([[0, 0], [1.0 + gap, 0]], 0.5), cell=ss.box(dim=2))
        loads, trial = ss.forces(pair, law)
        fading = (np.exp(-max(gap, 0) / decay) - np.exp(-rupture / decay)) / (1 - np.exp(-rupture / decay))
        expected = 0.0 if open_ else tension * 0.5 * fading - max(-gap, 0.0) ** 1.5  # 2 r_eff = 1/2
        assert loads.force[0, 0] == pytest.approx(expected, rel=1e-12, abs=1e-15)
        assert (trial.mode[: trial.count[0]] == ss.OPEN).all() == open_


def test_rolling_is_resisted_up_to_the_cap_and_common_rotation_is_free():
    law = example("rolling", mu_r=0.2, damping_n=0.0)
    kn, mu_r, overlap, r = 1.0, 0.2, 0.02, 0.25
    pair = ss.assembly(ss.spheres([[0, 0, 0], [1.0 - overlap, 0, 0]], 0.5))
    pair = ss.accept(with_neighbor_list(pair, law), ss.forces(pair, law)[1])
    stiffness, most = 2.25 * kn * (mu_r * r) ** 2, mu_r * r * kn * overlap

    def torques(first, second):
        grains = pair.grains._replace(angle=np.array([first, second], float))
        return ss.forces(pair._replace(grains=grains), law)[0].torque

    np.testing.assert_allclose(
        torques([0, 0, 0.05], [0, 0, -0.05]), np.outer([-1, 1], [0, 0, 0.1 * stiffness]), atol=1e-17
    )
    np.testing.assert_allclose(torques([0, 2, 0], [0, -2, 0]), np.outer([-1, 1], [0, most, 0]), atol=1e-17)
    np.testing.assert_allclose(torques([0.3, 0, 0], [-0.4, 0, 0]), 0.0, atol=1e-17)  # twisting
    turned = ss.forces(pair._replace(grains=pair.grains._replace(angle=np.full((2, 3), [0, 0, 0.1]))), law)[0].torque
    np.testing.assert_allclose(turned[0], turned[1], atol=1e-17)  # friction alone, which turns both alike


def test_lists_know_pairs_across_gaps_and_say_when_they_do_not():
    law = example("cohesive")
    narrow = with_neighbor_list(make_packing(2))
    with pytest.raises(ValueError, match="the list of contacts does not match these positions"):
        ss.modes.contact_blocks(narrow, law, memory=FREE)
    wide = with_neighbor_list(narrow, law)
    assert (wide.contacts.skin, wide.contacts.gap) == (narrow.contacts.skin, 0.05)
    slack = wide.contacts.skin + wide.contacts.gap
    n, count, radius = len(wide.grains.radius), int(wide.contacts.count[0]), wide.grains.radius
    grains = wide.contacts.j[:count] < n
    listed = set(zip(wide.contacts.i[:count][grains], wide.contacts.j[:count][grains],
                    map(tuple, wide.contacts.image[:count][grains].tolist()), strict=True))  # fmt: skip
    for i in range(n):
        for j in range(i, n):
            for k in range(-3, 4):
                gap = np.linalg.norm(wide.grains.position[i] - wide.grains.position[j] + k * wide.cell.vectors[0])
                near = gap < radius[i] + radius[j] + slack and not (i == j and k <= 0)
                assert near == ((i, j, (k, 0, 0)) in listed)


def test_rolling_memory_is_trial_until_accepted_and_kept_by_new_lists():
    state, law = packed("rolling", 3)
    before = state.contacts.rolling.copy()
    grains = state.grains
    turned = state._replace(grains=grains._replace(angle=grains.angle + 0.05))
    ss.forces(turned, law)
    np.testing.assert_array_equal(state.contacts.rolling, before)
    renewed = with_neighbor_list(state._replace(contacts=state.contacts._replace(stale=True)))
    assert renewed.contacts is not state.contacts
    count = int(state.contacts.count[0])
    np.testing.assert_array_equal(renewed.contacts.rolling[:count], state.contacts.rolling[:count])


@SLOW
def test_a_run_goes_on_to_the_last_bit_through_an_archive(tmp_path):
    from stickslip.data import archive

    state, law = packed("rolling", 3)
    whole, _, _ = ss.run(state, law, 400, 0.02)
    half, _, _ = ss.run(state, law, 200, 0.02, threads=2)
    archive.write(tmp_path / "half.h5", {"state": half, "law": law})
    back = archive.read(tmp_path / "half.h5")
    assert back["law"].kind == law.kind and isinstance(back["law"].kind, type(law.kind))
    rest, _, _ = ss.run(back["state"], back["law"], 200, 0.02)
    np.testing.assert_array_equal(rest.grains.position, whole.grains.position)
    np.testing.assert_array_equal(rest.contacts.rolling, whole.contacts.rolling[: len(rest.contacts.rolling)])


@SLOW
@pytest.mark.parametrize(("name", "dim", "more"), [("cohesive", 2, {}), ("rolling", 3, {"mu_r": 0.5})])
def test_a_run_swings_as_the_spectrum_says(name, dim, more):
    law = ss.laws.from_file(EXAMPLES / f"{name}_law.py", mu=10.0, **more)  # no contact slides
    state, _ = ss.packings.jammed(8, dim=dim, packing_fraction={2: 0.95, 3: 0.75}[dim], seed=3, law=law)
    state, _ = ss.equilibrate(state, law, tolerance=1e-13, check="nothing")
    modes = ss.spectrum(state, law)
    real = (modes.eigenvalues.imag == 0) & (modes.eigenvalues.real > 1e-3 * modes.eigenvalues.real.max())
    k = np.flatnonzero(real)[np.argmin(modes.eigenvalues.real[real])]
    shape, omega = modes.modes[:, k].real, np.sqrt(modes.eigenvalues[k].real)
    size = 1e-7 / np.abs(shape).max()
    start, quarter = ss.modes.displaced(state, modes.free, size * shape), 0.5 * np.pi / omega
    start = start._replace(grains=start.grains._replace(velocity=0 * start.grains.velocity))
    end, _, _ = ss.run(start, law, 2000, 2 * quarter / 2000)
    turn = state.grains.radius[:, None] * (end.grains.angle - state.grains.angle)
    moved = np.hstack([end.grains.position - state.grains.position, turn]).ravel()[modes.free.component]
    # after half a period the mode is where it was, mirrored; amplitudes of 1e-7 leave 1e-5 for what is not linear
    np.testing.assert_allclose(moved, -size * shape, atol=1e-4 * size * np.abs(shape).max())


@SLOW
@pytest.mark.parametrize(("name", "dim"), [("cohesive", 2), ("rolling", 3)])
def test_energy_is_conserved_as_the_time_step_goes_to_zero(name, dim):
    state, law = packed(name, dim)[0], example(name, damping_n=0.0)
    rng, n = np.random.default_rng(0), len(state.grains.radius)
    move, turn = rng.normal(0, 0.03, (2, n, 3))
    if dim == 2:
        move[:, 2] = turn[:, :2] = 0
    state = state._replace(grains=state.grains._replace(velocity=move, spin=6 * turn))
    defect = []
    for dt in (0.02, 0.005):
        _, record, _ = ss.run(state, law, round(4 / dt), dt, every=round(0.2 / dt), ledger=True)
        defect.append(np.abs(record.ledger.defect).max() / record.ledger.kinetic[0])
    assert record.ledger.tangential.max() > 1e-3 * record.ledger.kinetic[0] and record.ledger.coulomb[-1] > 0
    # second order but for the instants at which contacts close, open and slide, each of them of first order
    assert defect[1] < 0.5 * defect[0] and defect[1] < 2e-3


@SLOW
def test_many_grains_in_blocks_move_as_by_rows_on_any_number_of_threads(monkeypatch):
    law, rng, side = example("cohesive"), np.random.default_rng(0), 10
    place = np.stack(np.meshgrid(*2 * [np.arange(side)]), axis=-1).reshape(-1, 2) * 1.03
    grains = ss.disks(place + rng.normal(0, 0.01, place.shape), rng.uniform(0.48, 0.52, side**2))
    grains = grains._replace(velocity=np.pad(rng.normal(0, 0.05, place.shape), ((0, 0), (0, 1))))
    state = ss.assembly(grains, cell=ss.box([side * 1.03, side * 1.03, 1], [True, True, False], 2))
    single, _, _ = ss.run(state, law, 300, 0.02, threads=1)
    double, _, _ = ss.run(state, law, 300, 0.02, threads=2)
    np.testing.assert_array_equal(single.grains.position, double.grains.position)
    monkeypatch.setattr(integrate, "MIN_BODIES", 10**9)
    plain, _, _ = ss.run(state, law, 300, 0.02)
    assert (ss.measure.overlaps(plain)[plain.contacts.mode[: plain.contacts.count[0]] > 0] < 0).any()
    # one way of summing against another, over 300 steps without a change of contacts that would amplify it much
    np.testing.assert_allclose(single.grains.position, plain.grains.position, atol=1e-11)


def test_collisions_of_a_user_defined_law_are_refused():
    law = example("rolling")
    with pytest.raises(ValueError, match="supports the normal forces k δ and k δ"):
        ss.laws.collision(law, radius=0.5, mass=1.0, speed=0.1)
