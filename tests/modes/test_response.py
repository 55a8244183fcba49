"""Response to forcing and noise: closed forms of two modes, equipartition, runs of the engine, and triggering."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import svdvals

import stickslip as ss
from stickslip.solve import response, transient, trigger
from stickslip.solve.balance import linearised
from stickslip.solve.freedom import displaced, freedom
from tests.modes.conftest import sheared, triangular

LAW = ss.laws.hertz_mindlin(mu=0.3)


@pytest.fixture(scope="module")
def packing():
    return sheared(16, 3, 0.68, 5e-4, seed=1, law=LAW)


def push(state, *bodies_and_axes):
    drive = np.zeros((len(bodies_and_axes), state.n_bodies, 6))
    for k, (body, axis) in enumerate(bodies_and_axes):
        drive[k, body, axis] = 1.0
    return drive


def two_modes(stiffness, skew, drag):
    return np.array([[stiffness, skew], [-skew, stiffness]]), drag * np.eye(2)


def test_two_coupled_modes_have_their_closed_form_gain():
    """A = [[a, k], [−k, b]]: the inverse of a 2 × 2 matrix, with damping that differs."""
    pull, drag = np.array([[1.0, 0.3], [-0.3, 1.4]]), np.diag([0.1, 0.25])
    motion = response.ForcedMotion(None, np.zeros(2), None, None, pull, drag, None, None)
    w, force = np.array([0.0, 0.7, 1.1]), np.array([1.0, 2.0])
    p, q = 1.0 - w**2 + 0.1j * w, 1.4 - w**2 + 0.25j * w
    truth = np.stack([q * 1 - 0.3 * 2, p * 2 + 0.3 * 1]) / (p * q + 0.3**2)
    projected = response._project(motion, w, force, lambda *_: None)
    np.testing.assert_allclose(projected, truth, rtol=1e-12)


def test_projection_is_the_direct_solution(packing, monkeypatch):
    drive, law = (
        push(packing, (3, 0), (5, 4)),
        ss.laws.hertz_mindlin(mu=0.3, damping="viscoelastic", damping_n=0.5, damping_t=0.5),
    )
    frequency = np.linspace(0.0, 1.5, 7)[1:]
    direct = ss.modes.frequency_response(packing, law, drive, frequency, drag=0.02)
    monkeypatch.setattr(response, "DIRECT_UP_TO", 0)
    projected = ss.modes.frequency_response(packing, law, drive, frequency, drag=0.02)
    np.testing.assert_allclose(projected.matrix, direct.matrix, atol=1e-7 * np.abs(direct.matrix).max())
    monkeypatch.setattr(response, "STEPS", 1)
    factored = ss.modes.frequency_response(packing, law, drive, frequency, drag=0.02)
    np.testing.assert_allclose(factored.matrix, direct.matrix, atol=1e-10 * np.abs(direct.matrix).max())


def pinned(state):
    return state._replace(control=ss.control.fixed(state.control, [0]))


def test_static_response_balances_the_force(packing):
    state = pinned(packing)
    answer = ss.modes.frequency_response(state, LAW, push(state, (3, 0)), 0.0)
    small = 1e-8
    moved = displaced(state, answer.free, small * answer.matrix[0, :, 0].real)
    left = ss.modes.residual_vector(moved, ss.forces(moved, LAW)[0], answer.free)
    left[answer.free.component == 6 * 3] += small
    assert np.abs(left).max() < 1e-4 * small  # forces are linear to that relative change of the overlaps


@pytest.mark.parametrize("damping", [{}, {"damping": "velocity", "damping_n": 0.3, "damping_t": 0.2}], ids=len)
def test_a_shaken_floor_moves_disks_as_in_a_run(damping):
    """Dashpots of contacts with the floor push, too."""
    law = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, **damping)
    law = ss.laws.for_pair(law, 0, 1)
    state, outcome = ss.relax(ss.packings.disk_array(4, press=5e-5), law, tolerance=1e-14)
    assert outcome.ok
    for axis in (0, 1):
        drive, rows = push(state, (4, axis)), push(state, *[(disk, axis) for disk in range(4)])
        answer = ss.modes.frequency_response(state, law, drive, 0.15, observe=rows, drag=0.1)
        motion = amplitudes_of_run(state, law, drive[0], 0.15, drag=0.1, small=1e-8)[:, axis]
        np.testing.assert_allclose(motion, answer.matrix[0, :, 0], rtol=2e-3)


def amplitudes_of_run(state, law, drive, omega, *, drag, small):
    """(N, 3) complex amplitudes of the grains in the last ten of sixty periods, per unit of the drive."""
    grid = np.arange(0.0, 60 * 2 * np.pi / omega, 2 * np.pi / omega / 128)
    factor = small * np.minimum(grid / grid[-1] * 3, 1) * np.cos(omega * grid)
    driven = trigger.with_drive(response.forced_motion(state, law, drag, None), drive, grid, factor)
    dt, probes = min(2 * np.pi / omega / 256, 0.1), range(len(state.grains.radius))
    record = ss.run(driven, law, int(grid[-1] / dt), dt, drag=drag, every=4, probes=probes)[1]
    last = record.time > record.time[-1] - 10 * 2 * np.pi / omega
    t, x = record.time[last] - state.time, record.position[last] - state.grains.position
    waves = np.stack([np.cos(omega * t), -np.sin(omega * t), np.ones(len(t))], axis=1)
    real, imaginary, _ = np.linalg.lstsq(waves, x.reshape(len(t), -1))[0].reshape(3, -1, 3) / small
    return real + 1j * imaginary


def test_a_driven_run_has_the_gain(packing):
    """The amplitude of grain 3 under a small force is that of the transfer function, with its phase."""
    omega, drag = 0.4, 0.1
    drive = push(packing, (3, 0))
    answer = ss.modes.frequency_response(packing, LAW, drive, omega, observe=drive, drag=drag)
    amplitude = amplitudes_of_run(packing, LAW, drive[0], omega, drag=drag, small=1e-9)[3, 0]
    assert abs(amplitude - answer.matrix[0, 0, 0]) < 2e-3 * answer.gain[0]  # dt and knots: (ωdt)²/24, 2e-4


def test_a_drive_pulls_free_coordinates_and_moves_prescribed_ones():
    """Far from each other: a free disk obeys m x'' = f(t); of one that is held, R times the angle follows the drive."""
    state, radius = ss.assembly(ss.disks([[0, 0], [9, 0]], [0.5, 0.8], mass=2.0)), 0.8
    state = state._replace(control=ss.control.fixed(state.control, [1]), time=3.0)
    drive, grid = push(state, (0, 1), (1, 5)).sum(axis=0), np.linspace(0.0, 4.0, 801)
    motion = SimpleNamespace(here=SimpleNamespace(state=state, mean_stiffness=1.0))
    end = ss.run(trigger.with_drive(motion, drive, grid, 1e-2 * np.sin(grid)), LAW, 300, 0.01)[0]
    t = 3.0
    assert end.grains.position[0, 1] == pytest.approx(1e-2 / 2.0 * (t - np.sin(t)), rel=1e-3)
    assert radius * end.grains.angle[1, 2] == pytest.approx(1e-2 * np.sin(t), rel=1e-3)
    assert not end.grains.angle[0].any() and not end.grains.position[1, 1]


def test_a_pinned_grain_that_is_shaken_slowly_carries_the_packing(packing):
    """At ω = 0 every grain moves with it, and none rotates; a free neighbour feels it as a force at any ω."""
    state = pinned(packing)
    rows = push(state, *[(grain, axis) for axis in (0, 1, 3) for grain in range(16)])
    still = ss.modes.frequency_response(state, LAW, push(state, (0, 0)), 0.0, observe=rows).matrix[0, :, 0]
    np.testing.assert_allclose(still[:16], 1.0, rtol=1e-9)
    np.testing.assert_allclose(still[16:], 0.0, atol=1e-9)


def test_observables_are_derivatives(packing):
    free = freedom(packing)
    q = 1e-7 * np.random.default_rng(0).normal(size=len(free))

    def stress(sign):
        moved = displaced(packing, free, sign * q)
        return ss.measure.stress(ss.accept(moved, ss.forces(moved, LAW)[1]), LAW)

    weights = ss.modes.stress_change(packing, LAW).reshape(9, -1)
    np.testing.assert_allclose(
        weights @ free.spread(q).ravel(),
        (stress(1) - stress(-1)).ravel() / 2,
        atol=1e-7 * np.abs(stress(1) - stress(-1)).max(),
    )
    row = int(ss.measure.touching(packing)[3])
    moved = displaced(packing, free, q)
    trial = ss.forces(moved, LAW)[1]
    change = trial.slip[trial.key == packing.contacts.key[row]][0] - packing.contacts.slip[row]
    weights = ss.modes.contact_slip(packing, row).reshape(2, -1)
    # the rotation of the slip itself, of the order of slip times displacement, is left out
    assert np.linalg.norm(weights @ free.spread(q).ravel()) == pytest.approx(np.linalg.norm(change), rel=1e-3)


def test_a_resonance_without_damping_is_named(packing):
    omega = float(ss.spectrum(packing, LAW).frequency.max())
    with pytest.raises(ValueError, match=rf"at frequency = {omega:.5g}\d*, the response is unbounded.*resonance"):
        ss.modes.frequency_response(packing, LAW, push(packing, (3, 0)), [0.1, omega])
    assert np.isfinite(ss.modes.frequency_response(packing, LAW, push(packing, (3, 0)), [0.1, 1.01 * omega]).gain).all()


def test_bad_input_is_one_sentence(packing):
    drive = push(packing, (3, 0))
    with pytest.raises(ValueError, match="frequency must be zero or positive, got -1"):
        ss.modes.frequency_response(packing, LAW, drive, [-1.0])
    with pytest.raises(ValueError, match="not in equilibrium"):
        ss.modes.frequency_response(packing, ss.laws.hertz_mindlin(2.0, 0.1, 0.3), drive, 1.0)
    with pytest.raises(ValueError, match=r"drive must have shape \(16, 6\), got \(6,\)"):
        ss.modes.frequency_response(packing, LAW, drive[0, 0], 1.0)
    with pytest.raises(ValueError, match="moves nothing"):
        ss.modes.frequency_response(packing, LAW, 0 * drive, 1.0)
    with pytest.raises(ValueError, match="an undamped mode is heated by noise without limit"):
        ss.modes.stationary_fluctuations(packing, LAW)
    with pytest.raises(ValueError, match="either a frequency"):
        ss.modes.trigger_amplitude(packing, LAW, drive)


@pytest.mark.parametrize("skew", [0.0, 0.05, 0.15])
def test_noise_of_two_coupled_modes_in_closed_form(skew):
    """z̈ + ν ż + (λ + ik) z = ξ has ⟨|z|²⟩ = (2T/λ)/(1 − k²/(ν²λ)), which diverges where the spectrum turns unstable."""
    stiffness, nu, temperature = 1.3, 0.2, 0.7
    pull, drag = two_modes(stiffness, skew, nu)
    dynamics, lift = transient.energy_dynamics(pull, drag)
    noise = np.zeros((4, 4))
    noise[2:, 2:] = 2 * temperature * drag
    covariance = transient.solve_continuous_lyapunov(dynamics, -noise)
    displacement = lift @ covariance[:2, :2] @ lift.T
    truth = 2 * temperature / stiffness / (1 - skew**2 / (nu**2 * stiffness))
    assert np.trace(displacement) == pytest.approx(truth, rel=1e-10)


@pytest.mark.parametrize("skew", [0.0, 0.05, 0.15])
def test_distance_to_instability_is_the_smallest_singular_value(skew):
    dynamics = transient.energy_dynamics(*two_modes(1.3, skew, 0.2))[0]
    scan = min(svdvals(dynamics - 1j * w * np.eye(4))[-1] for w in np.linspace(0.9, 1.4, 4001))
    assert transient.distance_to_instability(dynamics) == pytest.approx(scan, rel=2e-4)


def test_without_slip_every_mode_has_the_same_energy():
    """Linear springs without a load have a potential: equipartition."""
    law = ss.laws.linear(1.0, 0.5, 0.5)
    state = triangular(law)
    noisy = ss.modes.stationary_fluctuations(state, law, temperature=1.0, drag=0.1)
    assert noisy.kinetic == pytest.approx(0.5, rel=1e-6)
    assert noisy.elastic == pytest.approx(0.5, rel=1e-6)
    assert noisy.distance <= noisy.decay == pytest.approx(0.05, rel=1e-6)


def test_friction_moves_noise_away_from_equipartition_and_the_instability_nearer(packing):
    noisy = ss.modes.stationary_fluctuations(packing, LAW, temperature=1.0, drag=0.05)
    matrix, n = noisy.velocity * np.sqrt(np.outer(noisy.free.mass, noisy.free.mass)), len(noisy.free)
    assert np.trace(matrix) / (n - 3) / 2 == pytest.approx(noisy.kinetic, rel=1e-9)
    assert noisy.kinetic != pytest.approx(0.5, rel=1e-6)
    assert noisy.distance < noisy.decay and noisy.non_normality > 1


def test_a_noisy_run_has_the_variance(packing):
    """White noise on one grain: its values every 0.5, of variance 1/0.5, leave 1 % of the spectrum out."""
    drive, drag, small, h = push(packing, (3, 0)), 0.2, 1e-7, 0.5
    noisy = ss.modes.stationary_fluctuations(packing, LAW, noise=drive, drag=drag)
    grid = np.arange(0.0, 10_000.0, h)
    force = small * np.random.default_rng(0).normal(size=len(grid)) / np.sqrt(h)
    driven = trigger.with_drive(response.forced_motion(packing, LAW, drag, None), drive[0], grid, force)
    record = ss.run(driven, LAW, int(grid[-1] / 0.1), 0.1, drag=drag, every=10, probes=[3])[1]
    assert (
        packing.grains.mass == packing.grains.mass[0]
    ).all()  # the mean position is the centre of mass, which diffuses
    center = record.center[:, 0] - record.center[0, 0]
    x = (record.position[:, 0, 0] - record.position[0, 0, 0] - center)[200:] / small
    place = np.flatnonzero(noisy.free.component == 6 * 3)[0]
    assert np.mean(x**2) == pytest.approx(noisy.displacement[place, place], rel=0.1)  # 1000 decay times: 4.5 %


def near_its_limit(state, **dashpots):
    """Law with less friction, so that the contact nearest to the limit carries 0.8 of it."""
    return ss.laws.hertz_mindlin(mu=0.3 * np.nanmax(linearised(state, LAW).line.mobilisation) / 0.8, **dashpots)


@pytest.mark.parametrize(("how", "damping_n"), [("shaking", 0.0), ("shaking", 0.3), ("pulse", 0.0)])
def test_what_triggers_a_packing_is_predicted(packing, how, damping_n):
    """At rest, where dashpots do not move the Coulomb limit, the prediction would be wrong by tens of per cent."""
    law = near_its_limit(packing, damping_n=damping_n)
    times = np.linspace(0, 8, 17)
    drives = {
        "shaking": {"frequency": 0.8}, "pulse": {"times": times, "factors": np.sin(np.pi * times / 8) ** 2},
    }  # fmt: skip
    answer = ss.modes.trigger_amplitude(packing, law, push(packing, (3, 0)), drag=0.1, **drives[how])
    assert answer.contact == answer.first
    assert answer.measured == pytest.approx(answer.predicted, rel=0.03)  # forces are linear to the relative amplitude


def test_a_shaken_grain_triggers_what_is_predicted(packing):
    state, law = pinned(packing), near_its_limit(packing)
    answer = ss.modes.trigger_amplitude(state, law, push(state, (0, 1)), frequency=0.9, drag=0.1)
    assert answer.contact == answer.first
    assert answer.measured == pytest.approx(answer.predicted, rel=0.03)
    with pytest.raises(ValueError, match="torques"):
        ss.modes.trigger_amplitude(state, law, push(state, (3, 4)), frequency=0.9, drag=0.1)
    with pytest.raises(ValueError, match="never becomes steady"):
        ss.modes.trigger_amplitude(state, law, push(state, (0, 1)), frequency=0.9)


@pytest.fixture(scope="module")
def glued():
    """Disks, two of which are a rigid plate that is held."""
    state, law = sheared(16, 2, 0.9, 5e-4, seed=3, law=LAW), LAW
    control = ss.control.rigid(ss.control.fixed(state.control, [2, 5]), [2, 5])
    return ss.equilibrate(state._replace(control=control), law)[0]


def test_a_shaken_plate_is_its_disks_shaken_together(glued):
    """Fixed disks that are not glued, moved alike."""
    drive, alone = push(glued, (2, 0)) + push(glued, (5, 0)), glued.control.group * 0 - 1
    loose = glued._replace(control=glued.control._replace(group=alone))
    plate, parts = (ss.modes.frequency_response(s, LAW, drive, [0.0, 0.3], drag=0.1) for s in (glued, loose))
    np.testing.assert_allclose(plate.matrix, parts.matrix, atol=1e-9)


@pytest.mark.parametrize("where", [[(2, 0)], [(5, 0)], [(2, 5), (5, 5)]])
def test_a_plate_moves_as_a_whole(glued, where):
    drive = push(glued, *where).sum(axis=0)
    with pytest.raises(ValueError, match="rigid group of bodies 2, 5"):
        ss.modes.frequency_response(glued, LAW, drive, 0.3, drag=0.1)


@pytest.mark.parametrize(("body", "axis"), [(0, 2), (1, 3), (4, 5)])
def test_components_that_do_not_exist_are_refused(body, axis):
    """Disks do not leave the plane, and a wall does not turn."""
    state, law = ss.packings.disk_array(4, press=5e-5), ss.laws.for_pair(LAW, 0, 1)
    with pytest.raises(ValueError, match=f"component {axis} of body {body}, a component that does not exist"):
        ss.modes.frequency_response(state, law, push(state, (0, 0), (body, axis)), 0.1)


def test_no_pattern_and_no_noise_are_named(packing):
    none = np.zeros((0, 16, 6))
    with pytest.raises(ValueError, match="drive is empty"):
        ss.modes.frequency_response(packing, LAW, none, 0.1)
    with pytest.raises(ValueError, match="observe is empty"):
        ss.modes.frequency_response(packing, LAW, push(packing, (3, 0)), 0.1, observe=none)
    with pytest.raises(ValueError, match="noise is empty"):
        ss.modes.stationary_fluctuations(packing, LAW, noise=none, drag=0.1)
    with pytest.raises(ValueError, match="the noise moves nothing"):
        ss.modes.stationary_fluctuations(packing, LAW, noise=np.zeros((16, 6)), drag=0.1)


def test_the_slip_at_a_wall_does_not_turn_it():
    law = ss.laws.for_pair(ss.laws.hertz_mindlin(mu=10.0), 0, 1)
    state, _ = ss.relax(ss.packings.disk_array(4, press=5e-5), law)
    touching = ss.measure.touching(state)
    assert len(touching) > 3
    for contact in touching:
        assert not ss.modes.contact_slip(state, contact)[:, 4:, 3:].any()
    np.testing.assert_array_equal(ss.modes.contact_slip(state, True), ss.modes.contact_slip(state, 1))


def test_a_pulse_of_a_pinned_grain_also_drives_others_by_its_velocity(packing):
    """By the dashpots between them: the equations of motion, integrated by a method of another kind."""
    law = ss.laws.hertz_mindlin(mu=0.3, damping="viscoelastic", damping_n=0.5, damping_t=0.5)
    motion = response.forced_motion(pinned(packing), law, 0.0, None)
    drive, times, factors = push(packing, (0, 0)), [0.0, 3.0, 5.0], [0.0, 1.0, 0.0]
    ways, _ = trigger._pulse_ways(motion, drive, times, factors, 10.0, 2e-3)
    still, moving, prescribed = (part[:, 0] for part in motion.drives(drive))
    n, pull, drag, slope = len(motion.free), motion.pull, motion.drag, [1 / 3, -1 / 2, 0.0]

    def rate(t, state):
        force = np.interp(t, times, factors, right=0.0) * still + slope[np.searchsorted(times[1:], t)] * moving
        return np.concatenate([state[n:], force - pull @ state[:n] - drag @ state[n:]])

    end = solve_ivp(rate, (0.0, 10.0), np.zeros(2 * n), rtol=1e-6, atol=1e-10, max_step=0.1).y[:n, -1]
    true = motion.all_coordinates(end, 0.0 * prescribed)
    assert np.linalg.norm(drag @ end) > 0
    np.testing.assert_allclose(ways[-1], true, atol=2e-3 * np.abs(ways).max())


def test_no_drive_is_answered_more_than_the_worst_one(packing):
    drives = push(packing, (3, 0), (7, 1), (11, 5))
    answer = ss.modes.frequency_response(packing, LAW, drives, [0.1, 0.3, 0.7], drag=0.1)
    worst, gain = answer.worst_drive, answer.gain.max()
    assert answer.worst_frequency == answer.frequency[np.argmax(answer.gain)]
    assert np.linalg.norm(worst) == pytest.approx(1.0) and np.linalg.norm(answer.worst_answer) == pytest.approx(gain)
    for drive in np.random.default_rng(0).normal(size=(20, 3, 2)) @ [1, 1j]:
        assert np.linalg.norm(answer.matrix @ drive, axis=1).max() <= gain * np.linalg.norm(drive) * (1 + 1e-12)
