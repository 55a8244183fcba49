"""Responses to probes: the ellipse of moduli, contact status, inverse probes, and the sign against dynamics."""

from functools import cache

import numpy as np
import pytest

import stickslip as ss
from stickslip.loading.envelope import negative_ranges

LAW = ss.laws.hertz_mindlin(mu=0.3)


@cache
def packing(dim=2, number=30):
    state, _ = ss.packings.jammed(number, pressure=1e-3, dim=dim, seed=1)
    return ss.equilibrate(state, LAW, check="nothing")[0]


@cache
def strained(number, steps, size=2e-4):
    """Disks compressed along y at constant σ_xx, so that contacts slide."""
    state = packing(2, number)
    side = {"xx": ss.measure.stress(state, LAW)[0, 0]}
    state = state._replace(control=ss.control.stress_controlled(state.control, side))
    for _ in range(steps):
        state, outcome = ss.equilibrate(ss.packings.strained(state, np.diag([0, -size])), LAW, check="nothing")
        assert outcome.ok
    return state


@pytest.mark.parametrize("dim", [2, 3])
def test_while_contacts_stick_the_response_is_that_of_the_moduli(dim):
    state = packing(dim)
    moduli = ss.modes.elastic_moduli(state, LAW).tensor
    envelope = ss.protocols.response_envelope(state, LAW, directions=8)
    assert not envelope.slides.any()
    assert envelope.stress == pytest.approx(np.einsum("abcd,mcd->mab", moduli, envelope.strain), rel=1e-3, abs=1e-5)
    assert envelope.elastic == pytest.approx(np.einsum("abcd,mcd->mab", moduli, envelope.strain))
    assert np.einsum("kab,lab->kl", envelope.plane, envelope.plane) == pytest.approx(np.eye(2))


def test_the_response_where_contacts_slide_is_not_elastic_and_differs_for_opposite_probes():
    envelope = ss.protocols.response_envelope(strained(30, 60), LAW, directions=16)
    gap = np.linalg.norm(envelope.stress - envelope.elastic, axis=(1, 2)) / np.linalg.norm(envelope.elastic)
    assert gap.max() > 0.02 and gap.min() < 1e-3
    assert np.abs(envelope.stress[:8] + envelope.stress[8:]).max() > 0.05 * np.abs(envelope.stress).max()


def test_probes_of_stress_agree_with_the_contact_status_of_the_linear_problem():
    """The status comes from complementarity, without any finite step."""
    state = strained(30, 60)
    envelope = ss.protocols.response_envelope(state, LAW, directions=12, control="stress")
    probed = ss.quasirigid.probe_statuses(state, LAW, envelope.stress)
    assert all(answer.status.ok for answer in probed) and len({tuple(a.status.sliding) for a in probed}) > 3
    strain = np.array([answer.strain for answer in probed])
    assert np.abs(strain - envelope.strain).max() < 1e-3 * np.abs(strain).max()
    assert [answer.status.sliding.sum() for answer in probed] == envelope.slides.tolist()


@pytest.mark.parametrize("dim", [2, 3])
def test_probes_of_stress_undo_probes_of_strain(dim):
    state = strained(30, 60) if dim == 2 else packing(3)
    there = ss.protocols.response_envelope(state, LAW, directions=6)
    for strain, stress in zip(there.strain, there.stress, strict=True):
        other = np.zeros_like(stress)
        other[0, 0] = 1.0
        back = ss.protocols.response_envelope(state, LAW, directions=4, control="stress", plane=[stress, other])
        assert back.strain[0] * np.linalg.norm(stress) == pytest.approx(strain, rel=2e-3, abs=2e-3)


def push(state, direction, work, *, size=1e-7, dt=0.15, mass=10.0, chunk=20):
    """Strain along a direction, over what the work predicts, under a little more than the load that balances it.

    The cell has one degree of freedom, with a mass; the load is the stress along the direction. Above 10 it collapses.
    """
    control = state.control._replace(cell_free=np.zeros((3, 3), bool), cell_rate=np.zeros((3, 3)))
    state, dim = state._replace(control=control), len(direction)
    load = (ss.measure.stress(state, LAW)[:dim, :dim] * direction).sum() + 1e-2 * abs(work) * size
    strain, rate, drag = 0.0, 0.0, 2 * np.sqrt(abs(work) / mass)
    for _ in range(int(min(30 * max(np.sqrt(mass / abs(work)), 60), 8000) / (chunk * dt))):
        excess = load - (ss.measure.stress(state, LAW)[:dim, :dim] * direction).sum()
        rate += chunk * dt * (excess / mass - drag * rate)
        state = state._replace(control=ss.control.strained_at(state.control, -rate * direction))
        state, _, _ = ss.run(state, LAW, chunk, dt, drag=0.05, threads=1)
        strain += rate * chunk * dt
        if abs(strain) > 0.1 * size:
            break
    return strain / (1e-2 * size)


@pytest.mark.slow
def test_the_sample_collapses_exactly_in_the_directions_of_the_cone():
    state = strained(100, 101)
    envelope = ss.protocols.response_envelope(state, LAW, directions=180)
    ((begin, end),) = envelope.cones
    inside = np.flatnonzero((envelope.angle > begin + 0.02) & (envelope.angle < end - 0.02))
    assert len(inside) >= 2 and (envelope.work[inside] < 0).all()
    for k in (*inside, 45, 90, inside[0] - 4, inside[-1] + 3):
        answer = push(state, np.tensordot([np.cos(envelope.angle[k]), np.sin(envelope.angle[k])], envelope.plane, 1),
                      envelope.work[k])  # fmt: skip
        assert (answer > 10) == (k in inside), (k, envelope.work[k], answer)
        if k not in inside:
            assert answer == pytest.approx(1, abs=0.1)


def test_ranges_of_negative_work_wrap_around_and_lie_between_probes():
    angle = np.radians(np.arange(0, 360, 90))
    assert np.degrees(negative_ranges(angle, np.array([-1.0, 1, 1, 1]))) == pytest.approx(np.array([[-45, 45]]))
    assert np.degrees(negative_ranges(angle, np.array([1, -3.0, 1, np.nan]))) == pytest.approx(
        np.array([[22.5, 157.5], [180, 360]])
    )
    assert negative_ranges(angle, np.ones(4)) == [] and negative_ranges(angle, -np.ones(4)) == [(0.0, 2 * np.pi)]


def test_a_lattice_that_is_isotropic_has_a_determinant_of_one():
    law = ss.laws.linear(1.0, 0.5, 0.5)
    site = np.array([[0, 0], [1, 0], [0.5, 0.75**0.5], [1.5, 0.75**0.5]])
    place = np.concatenate([site + shift for shift in ([0, 0], [0, 3**0.5], [2, 0], [2, 3**0.5])])
    state = ss.packings.from_arrays(place, np.full(16, 0.5 + 1e-9), law, cell=[4, 2 * 3**0.5], dim=2)
    assert ss.protocols.localisation(state, law).determinant == pytest.approx(1, abs=1e-6)


def test_a_packing_out_of_balance_and_wrong_stresses_are_refused():
    state = ss.packings.strained(packing(), np.diag([0, -1e-4]))
    state = ss.accept(state, ss.forces(state, LAW)[1])
    with pytest.raises(ValueError, match="not in equilibrium was given"):
        ss.protocols.response_envelope(state, LAW, directions=4)
    with pytest.raises(ValueError, match=r"stresses of shape \(3,\) were given"):
        ss.quasirigid.probe_statuses(packing(), LAW, np.ones(3))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"control": "both"}, "'strain' and 'stress' are allowed"),
        ({"directions": 0}, "directions"),
        ({"plane": np.eye(2)}, "two symmetric tensors of shape"),
        ({"plane": [np.eye(2), 2 * np.eye(2)]}, "must span a plane"),
        ({"size": -1.0}, "size"),
    ],
)
def test_wrong_arguments_get_one_sentence(options, message):
    with pytest.raises(ValueError, match=message) as problem:
        ss.protocols.response_envelope(packing(), LAW, **options)
    assert "\n" not in str(problem.value)
