"""Events of faults: closed forms of cracks, a slow twin from every step, ledgers, and the first event after a start."""

import numpy as np
import pytest

from stickslip import friction
from stickslip.wings.faults.friction import fault_cycles
from stickslip.wings.faults.friction.fault_record import Moment, Recorder, crack_stress_drop, measure_source
from stickslip.wings.faults.friction.fault_state import perturbed_state
from stickslip.wings.faults.friction.stress_transfer import stress_matrix

SHORT = {"a": [(2000, 0.010), (3000, 0.025)], "b": 0.015, "dc": 1.5e-3, "normal": 10e6}
DROP, STRESS = 3e6, 30e6


def at(time, slip, energy=(0.0, 0.0, 0.0)):
    """A fault at one time, of which only slip and energies matter."""
    return Moment(time, slip, None, None, None, 0.0, np.array(energy))


def crack(cells, half, **more):
    """Fault without plate motion, and an elliptic slip over a half-length that lowers the stress by DROP inside."""
    width = 4e3 if more.get("boundary") == "surface" else 8e3
    given = {"a": 0.01, "b": 0.0, "dc": 1.0, "normal": 50e6, "plate_rate": 0.0}
    fault = friction.line_fault(width, width / cells, **given, **more)
    x = fault.depth - (0.0 if fault.boundary == "surface" else width / 2)
    return fault, 2 * DROP / fault.modulus * np.sqrt(np.maximum(half**2 - x**2, 0.0)), np.abs(x) < half


@pytest.mark.parametrize(
    "more", [{"boundary": "infinite"}, {"boundary": "infinite", "shear": "in-plane"}, {"boundary": "surface"}]
)
def test_cracks_have_their_uniform_stress_drop_by_all_definitions(more):
    """Antiplane, in-plane, and half of an antiplane one below a free surface; moment (G/G*) π Δτ L²/4, or its half."""
    half, errors = 2000.0, []
    for cells in (512, 2048):
        fault, slip, inside = crack(cells, half, **more)
        arrival = np.where(inside, np.abs(fault.depth - fault.depth[inside][0]) / 2500.0, np.inf)
        found = measure_source(fault, np.full(cells, STRESS), at(0.0, 0 * slip), at(9.0, slip), arrival)
        share = 0.5 if fault.boundary == "surface" else 1.0
        moment = share * np.pi * DROP * half**2 * fault.shear_modulus / fault.modulus
        assert found["moment"] == pytest.approx(moment, rel=1e-3)
        assert found["rupture_length"] == pytest.approx(2 * share * half)
        assert found["seismological_stress_drop"] == pytest.approx(DROP, rel=1e-3)
        assert found["rupture_speed"] == pytest.approx(2500.0)
        potency = moment / fault.shear_modulus
        errors.append((found["stress_drop"] / DROP - 1, found["slip_weighted_stress_drop"] / DROP - 1))
        assert found["released"] == pytest.approx((STRESS - DROP / 2) * potency, rel=2e-3)
    assert np.abs(errors[-1]).max() < 0.03  # the square roots at the tips
    assert (np.abs(errors[1]) < 0.6 * np.abs(errors[0])).all()


def test_a_buried_crack_in_a_half_space_is_a_whole_one():
    """Its constant is 4/π: its upper end does not move freely, as that of one at the surface does."""
    fault = friction.line_fault(4e3, 50.0, a=0.01, b=0.0, dc=1.0, normal=50e6, plate_rate=0.0)
    inside = (fault.depth > 2000.0) & (fault.depth < 3000.0)
    slip = np.where(inside, 0.1, 0.0)
    found = measure_source(fault, slip, at(0.0, 0 * slip), at(9.0, slip), np.where(inside, fault.depth, np.inf))
    assert found["seismological_stress_drop"] == pytest.approx(4 / np.pi * fault.shear_modulus * 0.1 / 1000.0)


def test_uniform_slip_between_plates():
    """D lowers the stress by G D/(2W) everywhere; without ends there is no crack of the same moment."""
    given = {"a": 0.01, "b": 0.0, "dc": 1.0, "normal": 50e6, "plate_rate": 1e-9}
    fault = friction.line_fault(2e3, 50.0, **given, boundary="periodic", thickness=700.0)
    arrival = np.abs(np.r_[0:20, -20:0]) * 50.0 / 800.0  # from the first cell to both sides
    excess, work = np.full(40, 0.5 - 2e-9), (1.0, 5.0, 2.0)
    found = measure_source(fault, np.full(40, STRESS), at(1.0, 0 * excess), at(3.0, excess, work), arrival)
    drop = fault.shear_modulus * (0.5 - 2e-9) / 1400.0
    assert found["stress_drop"] == pytest.approx(drop, rel=1e-12)
    assert found["slip_weighted_stress_drop"] == pytest.approx(drop, rel=1e-12)
    assert np.isnan(found["seismological_stress_drop"])
    assert found["rupture_speed"] == pytest.approx(800.0)
    assert found["released"] == pytest.approx(2e3 * (0.5 - 2e-9) * (STRESS - drop / 2), rel=1e-12)
    assert found["fracture"] == pytest.approx(5.0 - 2e3 * 0.5 * (STRESS - drop), rel=1e-9)
    assert [found[name] for name in ("loading", "frictional", "radiated")] == list(work)


@pytest.mark.parametrize(("dip", "known"), [(90.0, 1.26), (60.0, 1.17), (30.0, 1.17)])
def test_the_constant_for_dipping_cracks_that_reach_the_surface(dip, known):
    """Slip of a uniform stress drop on a dipping fault from its dense matrix: how far the constant is off."""
    given = {"a": 0.01, "b": 0.0, "dc": 1.0, "normal": 50e6, "shear": "in-plane", "dip": dip}
    fault = friction.line_fault(4e3, 20.0, **given)
    dense = np.array([fault.transfer(row) for row in np.eye(200)]).T
    slip = np.linalg.solve(dense, np.full(200, -DROP))
    moment = fault.shear_modulus * fault.cell * slip.sum()
    assert crack_stress_drop(fault, moment, 4e3, surface=True) / DROP == pytest.approx(known, abs=0.02)


@pytest.fixture(scope="module")
def steps_and_history():
    """A run with three events, and (time, excess slip, ln V) of each of its steps."""
    steps, true = [], Recorder.step

    def step(self, before, now):
        if not steps:
            steps.append((before.time, before.excess_slip.copy(), before.log_velocity.copy()))
        steps.append((now.time, now.excess_slip.copy(), now.log_velocity.copy()))
        true(self, before, now)

    with pytest.MonkeyPatch.context() as now:
        now.setattr(fault_cycles.Recorder, "step", step)
        history = friction.simulate_fault(friction.line_fault(5e3, 100.0, **SHORT), 20.0)
    return steps, history


def work(stress, slips):
    """∫ τ dδ along a fault with cells of 100 m, by the trapezoidal rule."""
    return 100.0 * float((0.5 * (stress[1:] + stress[:-1]) * slips).sum())


def test_events_are_those_of_a_slow_twin(steps_and_history):
    """Every quantity again from all steps, with a dense matrix, loops over cells, and work by the trapezoidal rule."""
    steps, history = steps_and_history
    fault, threshold, events = history.fault, 1e-3, history.events
    h, g, dense = fault.cell, fault.shear_modulus, stress_matrix(50, fault.cell, fault.modulus, "surface")
    prestress, fast = history.state.prestress, [fault.v0 * np.exp(w.max()) >= threshold for *_, w in steps]
    first = [k for k in range(1, len(fast)) if fast[k] and not fast[k - 1]]
    assert len(first) == len(events.start) >= 3
    for number, k in enumerate(first):
        last = k + fast[k:].index(False)
        t, u, w = (np.array(column) for column in zip(*steps[k - 1 : last + 1], strict=True))
        v = fault.v0 * np.exp(w)
        slip = u[-1] - u[0] + fault.plate_rate * (t[-1] - t[0])
        drop = dense @ (u[0] - u[-1])
        arrival = {}
        for cell in range(50):
            reached = [m for m in range(len(t)) if v[m, cell] >= threshold]
            if reached:
                m = reached[0]
                share = (np.log(threshold) - np.log(v[m - 1, cell])) / np.log(v[m, cell] / v[m - 1, cell])
                arrival[cell] = t[m - 1] + share * (t[m] - t[m - 1])
        origin = min(arrival, key=arrival.get)
        far = max(arrival, key=lambda cell: abs(cell - origin))
        stress = prestress + u @ dense
        steps_of_slip = np.diff(u + fault.plate_rate * t[:, None], axis=0)

        def elastic(slipped):
            return -h * (slipped @ prestress + 0.5 * slipped @ dense @ slipped)

        twin = {
            "moment": sum(g * h * d for d in slip),
            "rupture_length": h * len(arrival),
            "rupture_speed": abs(far - origin) * h / (arrival[far] - arrival[origin]),
            "stress_drop": np.mean([drop[cell] for cell in arrival]),
            "slip_weighted_stress_drop": sum(drop * slip) / sum(slip),
            "seismological_stress_drop": 2 / np.pi * sum(g * h * d for d in slip) / (h * len(arrival)) ** 2,
            "released": elastic(u[0]) - elastic(u[-1]),
        }
        for name, value in twin.items():
            assert getattr(events, name)[number] == pytest.approx(value, rel=1e-9), name
        assert events.frictional[number] == pytest.approx(work(stress - fault.damping * v, steps_of_slip), rel=3e-4)
        assert events.radiated[number] == pytest.approx(work(fault.damping * v, steps_of_slip), rel=5e-3)
        loading = fault.plate_rate * h * np.trapezoid(stress.sum(axis=1), t)
        assert events.loading[number] == pytest.approx(loading, rel=1e-3)


def test_energies_of_each_event_are_balanced(steps_and_history):
    """To 1e-7 of the energy that is released, which has the tolerance 1e-4 of a step in slip over D_c."""
    events = steps_and_history[1].events
    assert np.abs(events.energy_residual).max() < 1e-7
    # Noda et al. 2013: half the slip-weighted stress drop times potency is radiated or work above the final stress
    potency = events.moment / steps_and_history[1].fault.shear_modulus
    available = 0.5 * events.slip_weighted_stress_drop * potency
    assert np.allclose(events.radiated + events.fracture, available, rtol=1e-6)
    assert (events.fracture > 0).all()
    assert (events.slip_weighted_stress_drop > events.seismological_stress_drop).all()


def test_the_first_event_after_an_artificial_start_is_marked(steps_and_history):
    history = steps_and_history[1]
    assert history.events.first.tolist() == [True] + [False] * (len(history.events.start) - 1)
    assert history.state.events == len(history.events.start)
    later = friction.simulate_fault(history.fault, 30.0, start=history.state)
    assert len(later.events.start) and not later.events.first.any()
    pushed = perturbed_state(history.fault, history.state, 0.1)
    assert friction.simulate_fault(history.fault, 30.0, start=pushed).events.first[0]


def test_magnitudes():
    """10^(9.1 + 1.5 M) N m is the moment of a magnitude M."""
    assert np.allclose(friction.moment_magnitude([10**19.6, 10**9.1]), [7.0, 0.0])
    with pytest.raises(ValueError, match="moment must be positive and finite, got 0"):
        friction.moment_magnitude([1.0, 0.0])
