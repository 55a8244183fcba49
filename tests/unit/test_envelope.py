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


@cache
def strained_spheres():
    """Spheres compressed along y at constant lateral stress, so that contacts slide."""
    state = packing(3, 60)
    side = {name: ss.measure.stress(state, LAW)[k, k] for name, k in (("xx", 0), ("zz", 2))}
    state = state._replace(control=ss.control.stress_controlled(state.control, side))
    for _ in range(20):
        state, outcome = ss.equilibrate(ss.packings.strained(state, np.diag([0, -3e-4, 0])), LAW, check="nothing")
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
    assert np.abs(strain - envelope.strain).max() < 2e-4 * np.abs(strain).max()
    assert [answer.status.sliding.sum() for answer in probed] == envelope.slides.tolist()


def test_probes_of_strain_of_spheres_agree_with_the_linear_problem_and_have_certificates():
    state = strained_spheres()
    envelope = ss.protocols.response_envelope(state, LAW, directions=6)
    probed = ss.quasirigid.probe_statuses(state, LAW, envelope.stress)
    assert envelope.slides.max() > 10 > envelope.slides.min()
    strain = np.array([answer.strain for answer in probed])
    assert np.abs(strain - envelope.strain).max() < 5e-4 * np.abs(strain).max()
    assert [answer.status.sliding.sum() for answer in probed] == envelope.slides.tolist()
    assert all(answer.status.uniqueness.unique for answer in probed)


def test_slow_dynamics_tends_to_the_response_as_the_rate_tends_to_zero():
    """No Newton's method: grains follow a strain that grows at a rate, with drag."""
    state = strained(30, 60)
    envelope = ss.protocols.response_envelope(state, LAW, directions=5)
    held = state._replace(control=ss.control.loads(30))
    size, errors = 2e-7, []
    for steps in (2000, 20_000):
        ends = [
            ss.run(held._replace(control=ss.control.strained_at(held.control, -size / (0.2 * steps) * strain)), LAW,
                   steps, 0.2, drag=0.3, threads=1)[0]
            for strain in envelope.strain
        ]  # fmt: skip
        change = np.array([ss.measure.stress(end, LAW) - ss.measure.stress(held, LAW) for end in ends])[:, :2, :2]
        errors.append(np.abs(0.5 * (change + change.swapaxes(1, 2)) / size - envelope.stress).max())
    assert errors[1] < 0.2 * errors[0] and errors[1] < 2e-3 * np.abs(envelope.stress).max()


def test_stiff_grains_have_the_ellipse_of_their_moduli():
    """Overlaps are 5e-5 of the size at this pressure, where positions have a round-off that forces feel."""
    state, _ = ss.packings.jammed(60, pressure=1e-7, dim=2, seed=5)
    state, _ = ss.equilibrate(state, LAW, check="nothing")
    envelope = ss.protocols.response_envelope(state, LAW, directions=4)
    assert np.abs(envelope.stress - envelope.elastic).max() < 1e-3 * np.abs(envelope.elastic).max()


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


def test_no_plane_of_any_orientation_is_weaker_than_the_weakest():
    state = strained_spheres()
    weakest = ss.protocols.localisation(state, LAW)
    moduli = ss.modes.elastic_moduli(state, LAW).tensor

    def determinant(normal):
        return np.linalg.det(np.einsum("...b,abcd,...d->...ac", normal, moduli, normal))

    normals = np.random.default_rng(0).normal(size=(20_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert determinant(weakest.normal) <= determinant(normals).min()
    assert np.linalg.norm(weakest.normal) == pytest.approx(1)


def test_a_packing_out_of_balance_and_wrong_stresses_are_refused():
    state = ss.packings.strained(packing(), np.diag([0, -1e-4]))
    state = ss.accept(state, ss.forces(state, LAW)[1])
    with pytest.raises(ValueError, match="the packing is not in equilibrium"):
        ss.protocols.response_envelope(state, LAW, directions=4)
    with pytest.raises(ValueError, match=r"stresses must be symmetric, .*, got shape \(3,\)"):
        ss.quasirigid.probe_statuses(packing(), LAW, np.ones(3))
    with pytest.raises(ValueError, match=r"got an array of shape \(3,\)"):
        ss.control.stress_controlled(packing().control, np.ones(3))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"control": "both"}, "control must be 'strain' or 'stress'"),
        ({"directions": 0}, "directions"),
        ({"plane": np.eye(2)}, "two symmetric tensors of shape"),
        ({"plane": [np.eye(2), 2 * np.eye(2)]}, "must span a plane"),
        ({"size": -1.0}, "size"),
        ({"size": 2.0}, r"size must be from \de-\d+ to 1 for probes of this packing, got 2"),
        ({"size": 1e-13}, "for probes of this packing, got 1e-13"),
        ({"plane": [[[np.nan, 0], [0, 1]], np.eye(2)]}, "plane contains NaN or infinity"),
        ({"plane": "xy"}, "plane must be real numbers, got words"),
    ],
)
def test_wrong_arguments_get_one_sentence(options, message):
    with pytest.raises(ValueError, match=message) as problem:
        ss.protocols.response_envelope(packing(), LAW, **options)
    assert "\n" not in str(problem.value)
