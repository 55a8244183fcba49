"""Contacts that decide: derivatives against differences, changes against independent twins of the changed packing."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.jacobian import linearised
from tests.beyond.conftest import LAW, sheared


def between_two(state, i, j, **parameters):
    """The packing with its own materials for bodies i and j, whose contact alone has other parameters."""
    material = state.grains.material.copy()
    material[i], material[j] = 1, 2
    law = ss.between(LAW, 1, 2, **parameters)
    return state._replace(grains=state.grains._replace(material=material)), law


def alone(state, found):
    """Rows of changes whose two grains touch once, and each others."""
    rows = ss.touching(state)
    pairs = [tuple(p) for p in zip(state.contacts.i[rows], state.contacts.j[rows], strict=True)]
    number = ss.touching(state).size and np.bincount(
        np.concatenate([state.contacts.i[rows], state.contacts.j[rows]]), minlength=state.n_bodies
    )
    return [
        k
        for k in range(len(found.contact))
        if pairs.count((found.i[k], found.j[k])) == 1 and min(number[found.i[k]], number[found.j[k]]) > 3
    ]


def test_derivatives_add_up_and_are_those_of_differences(swinging):
    found = ss.contact_sensitivity(swinging, LAW, most=0)
    assert found.verdict == "oscillates"
    # −J is the sum over contacts of their blocks: scaling all of them scales λ
    assert found.derivative.sum() == pytest.approx(found.eigenvalue, rel=1e-10)
    h = 1e-6
    for k in np.argsort(-np.abs(found.derivative))[:6]:
        row = found.contacts[k]
        i, j = swinging.contacts.i[row], swinging.contacts.j[row]
        values = []
        for s in (1 + h, 1 - h):
            state, law = between_two(swinging, i, j, kn=s, kt=2 / 7 * s)
            values.append(ss.stability(state, law).pairs[0])
        together = (swinging.contacts.i[found.contacts] == i) & (swinging.contacts.j[found.contacts] == j)
        # λ near a birth curves as 1/Im λ: h² of that beside round-off/h
        truth = found.derivative[together].sum()
        assert (values[0] - values[1]) / 2 / h == pytest.approx(truth, rel=1e-4, abs=1e-5)
        growth = np.sqrt(values).imag
        assert abs(growth[0] - growth[1]) / 2 / h == pytest.approx(
            abs(found.growth_derivative[together].sum()), rel=1e-3, abs=1e-5
        )


def test_every_change_is_that_of_an_independent_twin(calm):
    found = ss.contact_sensitivity(calm, LAW)
    assert found.verdict == "stable" and found.eigenvalue is None and found.verified.all() and not found.scope
    chosen = alone(calm, found)
    linear, tried = linearised(calm, LAW), set()
    for k in chosen[:30]:
        row, what = found.contact[k], found.what[k]
        if what == "opens":
            # a contact without stiffness neither pushes nor holds
            twin = ss.stability(*between_two(calm, found.i[k], found.j[k], kn=1e-14, kt=0.0))
        else:
            slip, mode = calm.contacts.slip.copy(), calm.contacts.mode.copy()
            limit = linear.mu[row] * linear.force_n[row] / linear.stiffness_t[row]
            slip[row] *= limit / np.linalg.norm(slip[row])
            mode[row] = ss.SLIDE
            twin = ss.stability(calm._replace(contacts=calm.contacts._replace(slip=slip, mode=mode)), LAW)
        rates = np.concatenate([twin.growth_rate, np.sqrt(np.maximum(-twin.negative, 0))])
        assert rates.max(initial=0.0) == pytest.approx(found.after[k], rel=1e-7, abs=1e-9)
        assert found.turns[k] == (not twin.stable)
        tried.add((str(what), bool(found.turns[k])))
    assert {what for what, _ in tried} == {"slides", "opens"}
    assert {turns for _, turns in tried} == {True, False}


def test_rows_are_sorted_and_the_unverified_are_last(calm):
    found = ss.contact_sensitivity(calm, LAW, most=5)
    assert found.verified.sum() == 5
    assert found.verified[:5].all() and not found.turns[5:].any()
    assert list(found.turns[:5]) == sorted(found.turns[:5], reverse=True)
    assert (found.verdict_after[5:] == "").all()
    assert "first-order shifts only" in found.scope
    whole = ss.contact_sensitivity(calm, LAW)
    key = {(c, w): a for c, w, a in zip(whole.contact, whole.what, whole.after, strict=True)}
    for c, w, a in zip(found.contact[:5], found.what[:5], found.after[:5], strict=True):
        assert key[c, w] == a


def test_a_grain_that_is_let_go_is_left_out(calm):
    """Opening one of two contacts makes a rattler, not a buckling grain."""
    found = ss.contact_sensitivity(calm, LAW)
    rows = ss.touching(calm)
    number = np.bincount(np.concatenate([calm.contacts.i[rows], calm.contacts.j[rows]]), minlength=calm.n_bodies)
    two = np.flatnonzero(number == 2)
    if not len(two):
        pytest.skip("no grain of this packing has two contacts")
    opened = (found.what == "opens") & (np.isin(found.i, two) | np.isin(found.j, two))
    assert opened.any() and not np.char.count(found.verdict_after[opened], "buckles").all()


def test_a_cell_that_follows_the_stress_is_changed_with_its_contact(calm):
    """Without a contact the cell's rows of J are those of the packing in which its force has vanished."""
    control = ss.stress_controlled(calm.control, {"xx": 0.1, "yy": 0.1})
    state = calm._replace(control=control)
    found = ss.contact_sensitivity(state, LAW)
    for k in alone(state, found)[-40:]:
        if found.what[k] == "opens":
            twin = ss.stability(*between_two(state, found.i[k], found.j[k], kn=1e-14, kt=0.0))
            rates = np.concatenate([twin.growth_rate, np.sqrt(np.maximum(-twin.negative, 0))])
            assert rates.max(initial=0.0) == pytest.approx(found.after[k], rel=1e-7, abs=1e-9)


def test_bad_input_is_told(calm, swinging):
    with pytest.raises(ValueError, match="at least 0"):
        ss.contact_sensitivity(calm, LAW, most=-1)
    with pytest.raises(ValueError, match="this packing has 1, counted from 0"):
        ss.contact_sensitivity(swinging, LAW, pair=1, most=0)
    law = ss.linear()
    with pytest.raises(ValueError, match="nothing but rattlers"):
        ss.contact_sensitivity(ss.sample([[0, 0, 0], [3, 0, 0]], [0.5, 0.5], law), law)


def test_a_frictionless_packing_can_only_open():
    law = ss.hertz_mindlin(1.0, 0.0, 0.0)
    state = sheared(16, 2, 0.9, 0.0, seed=1, law=law, steps=1)
    found = ss.contact_sensitivity(state, law, most=3)
    assert set(found.what) == {"opens"}
    assert np.isnan(found.mobilised).all()
