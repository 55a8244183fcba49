"""Contacts that decide: derivatives against differences, changes against independent twins of the changed packing."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.arguments import checked
from stickslip.core.contacts.jacobian import linearise
from stickslip.solve import sensitivity as module
from stickslip.solve.balance import linearised
from tests.modes.conftest import LAW, sheared, triangular

eigenvalues_after = checked(module._eigenvalues_after)  # as within a public function: states are not checked again


def between_two(state, i, j, **parameters):
    """The packing with its own materials for bodies i and j, whose contact alone has other parameters."""
    material = state.grains.material.copy()
    material[i], material[j] = 1, 2
    law = ss.laws.for_pair(LAW, 1, 2, **parameters)
    return state._replace(grains=state.grains._replace(material=material)), law


def alone(state, sensitivity):
    """Changes of contacts whose two grains touch once, and which neither needs: no rattler is made."""
    rows = ss.measure.touching(state)
    pairs = [tuple(p) for p in zip(state.contacts.i[rows], state.contacts.j[rows], strict=True)]
    number = np.bincount(np.array(pairs).ravel(), minlength=state.n_bodies)
    return [
        k
        for k in range(len(sensitivity.contact))
        if pairs.count((sensitivity.i[k], sensitivity.j[k])) == 1
        and min(number[sensitivity.i[k]], number[sensitivity.j[k]]) > 3
    ]


def test_derivatives_add_up_and_are_those_of_differences(swinging):
    sensitivity = ss.modes.contact_sensitivity(swinging, LAW, most=0)
    assert sensitivity.verdict == "oscillates"
    # −J is the sum over contacts of their blocks: scaling all of them scales λ
    assert sensitivity.derivative.sum() == pytest.approx(sensitivity.eigenvalue, rel=1e-10)
    h = 1e-6
    for k in np.argsort(-np.abs(sensitivity.derivative))[:6]:
        row = sensitivity.contacts[k]
        i, j = swinging.contacts.i[row], swinging.contacts.j[row]
        values = []
        for s in (1 + h, 1 - h):
            state, law = between_two(swinging, i, j, kn=s, kt=2 / 7 * s)
            values.append(ss.stability(state, law).pairs[0])
        together = (swinging.contacts.i[sensitivity.contacts] == i) & (swinging.contacts.j[sensitivity.contacts] == j)
        # λ near a birth curves as 1/Im λ: h² of that beside round-off/h
        truth = sensitivity.derivative[together].sum()
        assert (values[0] - values[1]) / 2 / h == pytest.approx(truth, rel=1e-4, abs=1e-5)
        growth = np.sqrt(values).imag
        assert abs(growth[0] - growth[1]) / 2 / h == pytest.approx(
            abs(sensitivity.growth_derivative[together].sum()), rel=1e-3, abs=1e-5
        )


def assert_twins_agree(state, sensitivity, chosen):
    """Each change against a packing whose contact has lost its stiffness, or slides at the Coulomb limit."""
    linear = linearise(state, LAW)
    for k in chosen:
        row = sensitivity.contact[k]
        if sensitivity.what[k] == "opens":
            twin = ss.stability(
                *between_two(state, sensitivity.i[k], sensitivity.j[k], kn=1e-14, kt=0.0), method="dense"
            )
        else:
            slip, mode = state.contacts.slip.copy(), state.contacts.mode.copy()
            limit = linear.mu[row] * linear.force_n[row] / linear.stiffness_t[row]
            slip[row] *= limit / np.linalg.norm(slip[row])
            mode[row] = ss.SLIDE
            changed = state._replace(contacts=state.contacts._replace(slip=slip, mode=mode))
            twin = ss.stability(changed, LAW, method="dense")
        rates = np.concatenate([twin.growth_rate, np.sqrt(np.maximum(-twin.negative, 0))])
        assert rates.max(initial=0.0) == pytest.approx(sensitivity.after[k], rel=1e-7, abs=1e-9)
        assert sensitivity.turns[k] == (twin.grows == (sensitivity.verdict == "stable"))


def test_every_change_is_that_of_an_independent_twin(calm):
    sensitivity = ss.modes.contact_sensitivity(calm, LAW)
    assert (
        sensitivity.verdict == "stable"
        and sensitivity.eigenvalue is None
        and sensitivity.verified.all()
        and not sensitivity.scope
    )
    chosen = alone(calm, sensitivity)
    assert {str(sensitivity.what[k]) for k in chosen} == {"slides", "opens"}
    assert {bool(sensitivity.turns[k]) for k in chosen} == {True, False}
    assert_twins_agree(calm, sensitivity, chosen)


def test_changes_of_spheres():
    """In three dimensions the direction of sliding matters, and how far the slip is from the Coulomb limit."""
    state = sheared(12, 3, 0.7, 2e-3, seed=2)
    sensitivity = ss.modes.contact_sensitivity(state, LAW)
    chosen = alone(state, sensitivity)
    slides, opens = ([k for k in chosen if sensitivity.what[k] == what] for what in ("slides", "opens"))
    assert len(slides) > 3 and len(opens) > 3
    assert_twins_agree(state, sensitivity, [*slides[:10], *opens[:10]])


def test_rows_are_sorted_and_the_unverified_are_last(calm):
    sensitivity = ss.modes.contact_sensitivity(calm, LAW, most=5)
    assert sensitivity.verified.sum() == 5
    assert sensitivity.verified[:5].all() and not sensitivity.turns[5:].any()
    assert list(sensitivity.turns[:5]) == sorted(sensitivity.turns[:5], reverse=True)
    assert (sensitivity.verdict_after[5:] == "").all()
    assert "first-order shifts only" in sensitivity.scope
    whole = ss.modes.contact_sensitivity(calm, LAW)
    key = {(c, w): a for c, w, a in zip(whole.contact, whole.what, whole.after, strict=True)}
    for c, w, a in zip(sensitivity.contact[:5], sensitivity.what[:5], sensitivity.after[:5], strict=True):
        assert key[c, w] == a


def test_a_grain_that_is_let_go_is_left_out():
    """A small disk between two of a lattice: without one of its contacts it is as if it were not there."""
    law, overlap = ss.laws.linear(1.0, 0.02, 0.5), 0.06
    lattice = triangular(law)
    keep, hole = np.arange(16) != 3, lattice.grains.position[3, :2]
    ends = np.array([[0.5, -(0.75**0.5)], [1.0, 0.0]]) + hole
    inwards = (hole - ends.mean(axis=0)) / np.linalg.norm(hole - ends.mean(axis=0))
    small = ends.mean(axis=0) + inwards * (0.69**2 - 0.25) ** 0.5
    place, radius, cell = lattice.grains.position[keep, :2], np.full(15, 0.5 + overlap / 2), [4, 2 * 3**0.5]
    without = ss.packings.from_arrays(place, radius, law, cell=cell, dim=2)
    state = ss.packings.from_arrays(np.vstack([place, small]), np.append(radius, 0.17), law, cell=cell, dim=2)
    truth = np.sort(np.linalg.eigvals(ss.modes.dynamical_matrix(without, law, ss.freedom(without)).toarray()).real)
    free = ss.modes.backbone(state, law)
    modes = module._compute_modes(linearised(state, law), free)
    opened = [
        c for c in module._list_changes(linearised(state, law), modes, ss.measure.touching(state)) if c[1] == "opens"
    ]
    mine = [change for change in opened if 15 in (state.contacts.i[change[0]], state.contacts.j[change[0]])]
    assert len(mine) == 2 and len(free) == len(truth) + 3
    for change in mine:
        values = np.sort(eigenvalues_after(linearised(state, law), modes, free, *change).real)
        np.testing.assert_allclose(values, truth, atol=1e-12 * truth.max())


@pytest.mark.slow
def test_first_order_shifts_correlate_with_computed_ones():
    """What the page says of them."""
    sensitivity = ss.modes.contact_sensitivity(sheared(30, 3, 0.68, 3e-3, seed=3), LAW, most=1000)
    order = np.argsort(sensitivity.predicted, kind="stable")
    assert np.corrcoef(sensitivity.predicted, sensitivity.after)[0, 1] == pytest.approx(0.70, abs=0.02)
    assert (sensitivity.turns.sum(), sensitivity.turns[order][:20].sum()) == (26, 4)


def test_a_cell_that_follows_the_stress_is_changed_with_its_contact(calm):
    """Without a contact the cell's rows of J are those of the packing in which its force has vanished."""
    (xx, _, _), (_, yy, _), _ = ss.measure.stress(calm, LAW)
    state = calm._replace(control=ss.control.stress_controlled(calm.control, {"xx": xx, "yy": yy}))
    sensitivity, free = ss.modes.contact_sensitivity(state, LAW), ss.modes.backbone(state, LAW)
    assert (free.axis == 6).sum() == 2
    modes = module._compute_modes(linearised(state, LAW), free)
    changes = {
        c[0]: c
        for c in module._list_changes(linearised(state, LAW), modes, ss.measure.touching(state))
        if c[1] == "opens"
    }
    opened = [k for k in alone(state, sensitivity) if sensitivity.what[k] == "opens"]
    assert len(opened) > 5
    for k in opened:
        twin, law = between_two(state, sensitivity.i[k], sensitivity.j[k], kn=1e-14, kt=0.0)
        truth = np.sort(np.linalg.eigvals(ss.modes.dynamical_matrix(twin, law, free).toarray()).real)
        values = eigenvalues_after(linearised(state, LAW), modes, free, *changes[sensitivity.contact[k]])
        # the twin's contact carries 1e-14 still; nearly equal eigenvalues of J amplify round-off
        np.testing.assert_allclose(np.sort(values.real), truth, atol=1e-10 * truth.max())


def test_bad_input_is_reported(calm, swinging):
    with pytest.raises(ValueError, match="zero or positive"):
        ss.modes.contact_sensitivity(calm, LAW, most=-1)
    with pytest.raises(ValueError, match="this packing has 1 pairs, numbered from 0"):
        ss.modes.contact_sensitivity(swinging, LAW, pair=1, most=0)
    law = ss.laws.linear()
    with pytest.raises(ValueError, match="only rattlers"):
        ss.modes.contact_sensitivity(ss.packings.from_arrays([[0, 0, 0], [3, 0, 0]], [0.5, 0.5], law), law)


def test_off_equilibrium_no_contact_decides(calm):
    moved = calm._replace(control=ss.control.stress_controlled(calm.control, {"xx": 0.1, "yy": 0.1}))
    with pytest.raises(ValueError, match=r"not in equilibrium .* equilibrate the packing first"):
        ss.modes.contact_sensitivity(moved, LAW)


def test_a_frictionless_packing_can_only_open():
    law = ss.laws.hertz_mindlin(1.0, 0.0, 0.0)
    state = sheared(16, 2, 0.9, 0.0, seed=1, law=law, steps=1)
    sensitivity = ss.modes.contact_sensitivity(state, law, most=3)
    assert set(sensitivity.what) == {"opens"}
    assert np.isnan(sensitivity.mobilised).all()
