"""Laws whose slip is shortened as the overlap falls, in closed form, and wherever a law's kind is asked for."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.builtin_laws import BY_NAME, NAMES
from stickslip.core.contacts.forces import FREE
from stickslip.core.contacts.jacobian import contact_blocks
from stickslip.core.laws import builtin as laws
from stickslip.core.laws.compiled import evaluate
from stickslip.data.exchange.frame import law_from_dict, law_to_dict
from stickslip.data.sample import LAWS
from stickslip.data.schema import ScenarioError
from stickslip.loading.packing import jammed
from stickslip.solve.stability import UNLOADED, stability
from stickslip.wings.studies.flow.pouring import flow_law
from tests.conftest import make_law, make_packing, stirred

PLAIN = {"hertz_mindlin_rescaled": "hertz_mindlin", "hertz_mindlin_reff_rescaled": "hertz_mindlin_reff"}
KT, MU = 0.8, 100.0


def one_contact(overlap=1e-2, wall=False, rescaled=True):
    """A grain above another, or on a wall, sheared by a hundredth of its diameter; z is along the normal."""
    law = ss.laws.hertz_mindlin(1.0, KT, MU, rescaled=rescaled)
    places = [[0, 0, 0.5 - overlap]] if wall else [[0, 0, 1.0 - overlap], [0, 0, 0]]
    walls = ss.flat_walls([0, 0, 0], [0, 0, 1]) if wall else ss.flat_walls()
    state = ss.assembly(ss.spheres(places, 0.5), walls, skin=0.5)
    state = ss.accept(state, ss.forces(state, law)[1])
    turned = state.grains.angle.copy()
    turned[0, 1] = -0.02  # rolling alone leaves the pair vector as it is
    state = state._replace(grains=state.grains._replace(angle=turned))
    return ss.accept(state, ss.forces(state, law)[1]), law


def moved(state, up):
    position = state.grains.position.copy()
    position[0, 2] += up
    return state._replace(grains=state.grains._replace(position=position))


def slip(contacts):
    return np.linalg.norm(contacts.slip[0])


@pytest.mark.parametrize("wall", [False, True])
def test_slip_falls_with_the_root_of_the_overlap_and_stays_as_it_grows(wall):
    state, law = one_contact(wall=wall)
    start = slip(state.contacts)
    assert start == pytest.approx(1e-2)
    for up in (4e-3, 2e-3, 1e-3):  # in three increments to three tenths of the overlap
        state = moved(state, up)
        state = ss.accept(state, ss.forces(state, law)[1])
    assert slip(state.contacts) == pytest.approx(start * np.sqrt(0.3), rel=1e-12)
    state = moved(state, -5e-3)
    loads, trial = ss.forces(state, law)
    assert slip(trial) == pytest.approx(start * np.sqrt(0.3), rel=1e-12)
    assert np.abs(loads.force[0, 0]) == pytest.approx(KT * np.sqrt(8e-3) * start * np.sqrt(0.3), rel=1e-12)


def test_what_has_not_moved_keeps_its_slip_to_the_last_bit():
    state = stirred(make_packing(3), law := make_law("hertz_mindlin_rescaled", "sharp"), np.random.default_rng(0))
    plain = make_law("hertz_mindlin", "sharp")
    assert state.contacts.slip.any()
    mine, other = (ss.forces(state, kind, memory=FREE)[1].slip for kind in (law, plain))
    assert np.array_equal(mine, other)


def test_the_slip_is_cut_at_the_limit_after_it_was_shortened():
    """k_t s falls with δ as the limit does if s does with √δ: a contact at the limit of one overlap slides on."""
    state, law = one_contact()
    law = laws.with_values(law, mu=KT * slip(state.contacts) / 1e-2 * 0.9)
    state = ss.accept(state, ss.forces(moved(state, 1e-9), law)[1])
    limit = 0.9 * 1e-2
    assert slip(state.contacts) == pytest.approx(limit, rel=1e-6)
    _, trial = ss.forces(moved(state, 5e-3), law)
    assert slip(trial) == pytest.approx(limit / 2, rel=1e-6)  # μ (k_n/k_t) δ, below √½ of it
    assert trial.mode[0] == ss.SLIDE


@pytest.mark.parametrize("cell", ["still", "flowing"])
@pytest.mark.parametrize("walls", [False, True])
def test_a_step_in_blocks_shortens_as_one_evaluation_does(cell, walls):
    if walls and cell == "flowing":
        pytest.skip("walls do not deform with a cell")
    law, n = make_law("hertz_mindlin_rescaled", "sharp", mu=0.3), 60
    state = jammed(n, packing_fraction=0.66, seed=0)[0]
    velocity = np.random.default_rng(0).normal(0, 0.01, (n, 3))
    grains, box = state.grains._replace(velocity=velocity), state.cell
    floor = ss.flat_walls()
    if walls:
        size = box.vectors[0, 0]
        grains = grains._replace(position=np.mod(grains.position, size))
        box = box._replace(periodic=np.array([True, True, False]))
        floor = ss.flat_walls([[0, 0, 0], [0, 0, size]], [[0, 0, 1], [0, 0, -1]], material=1)
    state = ss.assembly(grains, floor, box, skin=0.1)
    if cell == "flowing":
        state = state._replace(control=ss.control.strained_at(state.control, [[0, 2e-2, 0], [0, 0, 0], [0, 0, -1e-2]]))
    state, _, _ = ss.run(state, law, 40, 0.05)
    end, _, _ = ss.run(state, law, 1, 0.05)
    trial = ss.forces(end._replace(contacts=state.contacts), law)[1]
    closed = [set(c.key[: c.count[0]][c.mode[: c.count[0]] != ss.OPEN]) for c in (state.contacts, trial, end.contacts)]
    both = sorted(set.intersection(*closed))
    rows = [np.searchsorted(c.key[: c.count[0]], both) for c in (trial, end.contacts)]
    assert len(rows[0]) > 100
    first, two = trial.slip[rows[0]], end.contacts.slip[rows[1]]
    # displacements of a step are v dt here and differences of positions there: round-off of 1e-16 over overlaps
    np.testing.assert_allclose(two, first, atol=1e-13)
    plain = ss.forces(end._replace(contacts=state.contacts), make_law("hertz_mindlin", "sharp", mu=0.3))[1].slip
    assert np.abs(plain[rows[0]] - first).max() > 1e-6


def test_the_tangent_is_that_of_a_growing_overlap():
    """At an accepted state the Jacobian is that of the plain law, and of a falling one it has k_t s nᵀ/(2δ) more."""
    state, law = one_contact()
    plain = ss.laws.hertz_mindlin(1.0, KT, MU)
    exact = contact_blocks(state, law)[0]
    assert np.array_equal(exact, contact_blocks(state, plain)[0])
    h, at_rest = 1e-7, ss.forces(state, law)[0].force[0]
    grows, falls = ((ss.forces(moved(state, sign * h), law)[0].force[0] - at_rest) / h * sign for sign in (-1, 1))
    tangential = np.array([state.contacts.slip[0, 0] * KT * np.sqrt(1e-2), 0, 0])
    # one-sided differences miss h times the second derivative, about 1/(8 δ) of the slope
    np.testing.assert_allclose(grows, exact[0, :3, 2], atol=1e-5)
    np.testing.assert_allclose(falls - grows, tangential / (2 * 1e-2), atol=2e-6)


@pytest.mark.parametrize("name", PLAIN)
def test_the_jacobian_of_a_packing_is_that_of_growing_overlaps(name):
    """Four spheres that touch each other move towards their centre, or away from it, which shortens all slips."""
    law = LAWS[name](1.0, 0.5, 10.0, coulomb="smooth")
    corner = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(8)
    state = ss.packings.from_arrays(0.99 * corner, np.full(4, 0.5), law)
    turned = 0.01 * np.random.default_rng(0).normal(size=(4, 3))
    state = state._replace(grains=state.grains._replace(angle=turned))
    state = ss.accept(state, ss.forces(state, law)[1])
    assert len(ss.measure.touching(state)) == 6 and (state.contacts.mode[:6] == ss.STICK).all()
    free = ss.freedom(state)
    way = np.zeros((4, 6))
    way[:, :3] = -corner
    way = way.ravel()

    def slope(h):
        here, there = (ss.modes.displaced(state, free, x * way) for x in (0.0, h))
        before, after = (ss.modes.residual_vector(x, ss.forces(x, law)[0], free) for x in (here, there))
        return (after - before) / h

    tangent = ss.jacobian(state, law) @ way
    scale = np.abs(tangent).max()
    # steps of 1e-4 of the overlap, whose root curves by a quarter of that
    assert np.abs(slope(1e-6) - tangent).max() < 1e-4 * scale
    assert np.abs(slope(-1e-6) - tangent).max() > 1e-2 * scale


@pytest.mark.parametrize("rescaled", [True, False])
def test_what_rescaling_takes_stands_under_nonpotential(rescaled):
    """U = ½ k_t s² falls with δ^(3/2) as s does with √δ, and with √δ at constant s; nothing slides."""
    state, law = one_contact(rescaled=rescaled)
    control = ss.control.driven(state.control, [0], [0, 0, 1e-3, 0, 0, 0])
    state = state._replace(control=ss.control.fixed(control, [1]))
    start = 0.5 * KT * np.sqrt(1e-2) * slip(state.contacts) ** 2
    _, record, _ = ss.run(state, law, 700, 1e-2, every=700, ledger=True)
    left = 0.3**1.5 if rescaled else 0.3**0.5
    book = record.ledger
    assert book.tangential[-1] == pytest.approx(start * left, rel=1e-9)
    assert book.nonpotential[-1] == pytest.approx(start * (left - 1), rel=1e-5)  # trapezia of 1/700
    assert abs(book.coulomb[-1]) < 1e-11 * start  # round-off of 700 slips
    assert abs(book.defect[-1]) < 1e-5 * start


@pytest.mark.parametrize(("name", "plain"), PLAIN.items())
def test_other_scalars_are_those_of_the_plain_law(name, plain):
    rescaled, other = LAWS[name](2.0, 0.7), LAWS[plain](2.0, 0.7)
    values = [evaluate(law, "force", "energy", "stiffness", overlap=0.01, r_eff=0.3) for law in (rescaled, other)]
    assert values[0] == values[1]
    assert laws.rescales(rescaled) and not laws.rescales(other)
    assert not laws.laws_equal(rescaled, other)
    at = {"radius": 0.5, "mass": 1.0, "speed": 0.1}
    assert ss.laws.collision(rescaled, **at) == ss.laws.collision(other, **at)


@pytest.mark.parametrize("name", NAMES)
def test_every_kind_is_named_written_and_read(name):
    law = LAWS[name](2.0, 0.7, 0.3, **{p.name: 3.0 for p in BY_NAME[name].parameters})
    assert NAMES[law.kind] == name
    assert laws.laws_equal(law_from_dict(law_to_dict(law)), law)
    law.check_entries()


def test_flows_take_the_law_by_name():
    tables = {"experiment": "flow", "stages": [{"name": "settle", "duration": 1.0}], "gravity": [0.0, -1.0]}
    grains = {"number": 4, "mass": 1.0, "low": [0.0, 0.0], "high": [6.0, 16.0]}
    law = {"kind": "hertz_mindlin_reff_rescaled", "young": 1e5, "poisson": 0.3, "damping_n": 1.0}
    chosen = flow_law(ss.scenario(grains=grains, law=law, **tables), [0.5], [1.0])
    assert NAMES[chosen.kind] == law["kind"]
    assert chosen.damping & 3 == laws.VISCOELASTIC
    with pytest.raises(ScenarioError, match="hertz_mindlin_reff"):
        ss.scenario(grains=grains, law=law | {"kind": "hertz_mindlin_rescaled"}, **tables)


def test_spectra_say_that_unloading_was_not_looked_at():
    state, _ = jammed(12, dim=2, pressure=1e-2, seed=1)
    values = [stability(state, LAWS[name](1.0, 0.5, 10.0, coulomb="smooth"), method="all") for name in PLAIN]
    assert all(UNLOADED in result.scope for result in values)
    law = LAWS["hertz_mindlin_rescaled"](1.0, 0.5, 10.0, coulomb="smooth", damping_n=0.1)
    assert UNLOADED in stability(state, law, method="all").scope
    assert UNLOADED not in stability(state, ss.laws.hertz_mindlin(1.0, 0.5, 10.0, coulomb="smooth"), method="all").scope
