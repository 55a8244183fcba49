"""The slider and prescribed slip against closed forms, finite differences and SciPy's own solver."""

from decimal import Decimal, localcontext

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.linalg import expm

from stickslip.wings.faults.friction import laws as closed
from stickslip.wings.faults.friction.laws import (
    End,
    RateState,
    Spring,
    critical_stiffness,
    prescribed,
    rates,
    slider_of,
    spring_slider,
    steady_sliding,
)
from stickslip.wings.faults.friction.loads import LoadStep, slide_hold_slide, velocity_steps
from tests.wings.faults.closed_forms import stiff_step

PAPER = RateState(0.0247, 0.0178, 5.3e-3, 0.4, 0.02, "slip")  # Ferdowsi & Rubin 2021
WEAK = RateState(0.010, 0.015, 1e-5, 0.6, 1e-6)
LAWS = ("aging", "slip")
CLOSE = 1e-6  # relative, to every closed form
STIFF = 1e10  # stiffness in units of 1/D_c: its slip is then wrong by 1e-11 D_c


def frozen_hold(a, stiffness, velocity, time):
    """Slip velocity during a hold of the load point while the state is constant: a V'/V = −k V."""
    return velocity / (1 + stiffness * velocity * np.asarray(time) / a)


def slip_law_hold(rs, stiffness, velocity, slip):
    """Slip velocity after slip x during a hold of the load point that follows steady sliding at V_i, for the slip law.

    With y = ln(θ V_i/D_c) and z = ln(V/V_i), the force balance is a z + b y = −k x and the law is dy/dx = −(z + y)/D_c,
    hence dy/dx + λ y = k x/(a D_c) with λ = (a − b)/(a D_c). The solution is y = (k/(a D_c)) [x/λ − (1 − e^{−λx})/λ²],
    or y = k x²/(2 a D_c) for a = b, and V = V_i e^{−(kx + by)/a}.
    """
    x = np.asarray(slip, float)
    u = (rs.a - rs.b) / (rs.a * rs.dc) * x
    near = np.abs(u) < 1e-4  # avoids cancellation; the series of (u − 1 + e^{−u})/u² is accurate to 1e-18
    far = np.where(near, 1.0, u)
    shape = np.where(near, 0.5 - u / 6 + u**2 / 24 - u**3 / 120, (far + np.expm1(-far)) / far**2)
    y = stiffness / (rs.a * rs.dc) * x**2 * shape
    return velocity * np.exp(-(stiffness * x + rs.b * y) / rs.a)


@pytest.mark.parametrize("law", LAWS)
def test_steady_friction(law):
    rs = PAPER._replace(law=law)
    h = spring_slider(rs, Spring(200.0), velocity_steps([0.02, 0.2, 0.002], distance=0.2))
    for velocity, end in ((0.02, 10.0), (0.2, 11.0), (0.002, 111.0)):
        row = np.argmin(np.abs(h.time - end))
        assert h.friction[row] == pytest.approx(float(closed.steady_friction(rs, velocity)), rel=CLOSE)
        assert h.theta[row] == pytest.approx(rs.dc / velocity, rel=CLOSE)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("new", [0.1, 0.002])
def test_a_step_of_an_infinitely_stiff_slider(law, new):
    rs = PAPER._replace(law=law)
    slip = rs.dc * np.r_[0.01, 0.3, 1.0, 3.0, 6.0]
    legs = (LoadStep(1.0, 0.02), LoadStep(7 * rs.dc / new, new))
    h = spring_slider(rs, Spring(STIFF / rs.dc), legs, times=1.0 + slip / new)
    expected = stiff_step(rs, 0.02, new, slip)
    jump = rs.a * np.log(new / 0.02)
    assert stiff_step(rs, 0.02, new, 0.0) == pytest.approx(float(closed.steady_friction(rs, 0.02) + jump), rel=1e-14)
    assert np.allclose(h.friction, expected, rtol=CLOSE * 1e-2, atol=0)
    known = prescribed(rs, np.r_[0.0, slip / new], np.full(5, new), theta=rs.dc / 0.02)
    assert np.allclose(known.friction, expected, rtol=1e-13, atol=0)
    if law == "aging":
        theta = rs.dc / new + (rs.dc / 0.02 - rs.dc / new) * np.exp(-slip / rs.dc)
        assert np.allclose(known.theta, theta, rtol=1e-13, atol=0)


@pytest.mark.parametrize("law", LAWS)
def test_stationary_hold_and_reslide(law):
    rs, v = PAPER._replace(law=law), 0.02
    for hold in (0.1, 10.0, 1e5):
        h = prescribed(rs, [0.0, 1.0, 1.0 + hold, 1.0 + hold + 1e-9], [v, 0.0, v])
        assert np.isnan(h.friction[1])
        expected = rs.b * np.log1p(v * hold / rs.dc) if law == "aging" else 0.0  # the slip law evolves only with slip
        assert h.friction[2] - h.friction[0] == pytest.approx(expected, rel=CLOSE, abs=1e-10)


@pytest.mark.parametrize("law", LAWS)
def test_a_hold_in_which_the_state_does_nothing(law):
    rs, k, v = PAPER._replace(law=law, b=0.0), 200.0, 0.02
    times = np.geomspace(1e-6, 1e6, 30)
    h = spring_slider(rs, Spring(k), (LoadStep(1e6, 0.0),), before=v, times=times)
    assert np.allclose(h.velocity, frozen_hold(rs.a, k, v, times), rtol=CLOSE, atol=0)
    early = spring_slider(
        PAPER._replace(law=law, dc=1e6), Spring(k), (LoadStep(1.0, 0.0),), before=v, times=np.geomspace(1e-4, 1, 9)
    )
    assert np.allclose(early.velocity, frozen_hold(rs.a, k, v, early.time), rtol=CLOSE, atol=0)


@pytest.mark.parametrize("b", [0.0178, 0.0247, 0.03, 0.0247 * (1 + 1e-7)])
def test_a_hold_by_the_slip_law(b):
    rs, k, v = PAPER._replace(b=b), 800.0, 0.02
    h = spring_slider(rs, Spring(k), (LoadStep(1e4, 0.0),), before=v, times=np.geomspace(1e-4, 1e4, 40))
    assert np.allclose(h.velocity, slip_law_hold(rs, k, v, h.slip), rtol=CLOSE, atol=0)
    time, _ = quad(lambda x: 1 / slip_law_hold(rs, k, v, x), 0, h.slip[25], epsrel=1e-11, limit=500)
    assert time == pytest.approx(h.time[25], rel=CLOSE)
    assert h.friction[0] - h.friction == pytest.approx(k * (h.slip - h.slip[0]), rel=CLOSE, abs=1e-12)


def test_a_hold_by_the_slip_law_where_a_is_nearly_b():
    rs = PAPER._replace(b=0.0247 * (1 - 1e-4))
    k, v, x = 1e3, 0.02, 0.9 * rs.dc
    with localcontext() as context:
        context.prec = 40
        a, b, dc, slip, stiffness = map(Decimal, (rs.a, rs.b, rs.dc, x, k))
        rate = (a - b) / (a * dc)
        y = stiffness / (a * dc) * (slip / rate - (1 - (-rate * slip).exp()) / rate**2)
        expected = float(-(stiffness * slip + b * y) / a)
    computed = float(np.log(slip_law_hold(rs, k, v, x) / v))
    assert computed == pytest.approx(expected, rel=1e-11)  # the series that stands in there is good to 1e-18


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("damping", [0.0, 3.0])
def test_slopes_by_finite_differences(law, damping):
    slider = slider_of(PAPER._replace(law=law), Spring(300.0, damping))
    d = 1e-5  # error of central differences: d²/6 of the rates' third derivative, and 1e-16/d of the rates
    for w, s in np.random.default_rng(0).uniform(-4, 4, (20, 2)):
        place = np.array([w, s, 0.0])
        now, exact = rates(slider, place, 0.03, 1.3)
        columns = [(rates(slider, place + e, 0.03, 1.3)[0] - rates(slider, place - e, 0.03, 1.3)[0]) / (2 * d)
                   for e in d * np.eye(3)[:2]]  # fmt: skip
        size = np.abs(exact).max() + np.abs(now).max()
        assert np.allclose(exact[:2, :2], np.array(columns).T[:2], rtol=1e-7, atol=1e-9 * size)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("damping", [0.0, 5e-3])
def test_against_radau_of_scipy(law, damping):
    rs, k = PAPER._replace(law=law), 170.0
    legs = slide_hold_slide([0.5, 20.0], velocity=0.02, distance=0.03, reslide=0.1)
    slider, y, began = slider_of(rs, Spring(k, damping)), np.zeros(2), 0.0
    for leg in legs:
        made = solve_ivp(
            lambda t, y, leg=leg: rates(slider, (*y, 0.0), leg.velocity, leg.normal)[0][:2], (0, leg.duration), y,
            method="Radau", rtol=1e-9, atol=1e-9,
        )  # fmt: skip
        y, began = made.y[:, -1], began + leg.duration
        h = spring_slider(rs, Spring(k, damping), legs, times=[began])
        assert h.friction[0] == pytest.approx(rs.mu0 + rs.a * y[0] + rs.b * y[1], abs=1e-8)
        assert np.log(h.velocity[0] / rs.v0) == pytest.approx(y[0], abs=1e-6)


@pytest.mark.parametrize("law", LAWS)
def test_the_force_balances_and_tolerance_tells_the_error(law):
    rs, spring = PAPER._replace(law=law, alpha=0.3), Spring(170.0, 0.01)
    legs = (LoadStep(2.0, 0.02), LoadStep(1.0, 0.1, 1.4), LoadStep(3.0, 0.0, 1.4), LoadStep(2.0, 0.02, 0.8))
    times = np.linspace(0, 8, 301)
    best = spring_slider(rs, spring, legs, times=times, tolerance=1e-13)
    force = best.normal * best.friction + spring.damping * best.velocity
    assert np.allclose(force - force[0], spring.stiffness * (best.load_point - best.slip), rtol=0, atol=1e-12)
    rate = np.gradient(best.slip, best.time)  # slip comes from the spring, velocity from the law
    inside = (np.abs(times - 2) > 0.2) & (np.abs(times - 3) > 0.5) & (np.abs(times - 6) > 0.5)
    assert np.allclose(rate[inside], best.velocity[inside], rtol=0.03, atol=1e-6)
    for tolerance in (1e-6, 1e-8, 1e-10):
        h = spring_slider(rs, spring, legs, times=times, tolerance=tolerance)
        assert np.abs(h.friction - best.friction).max() < 2 * tolerance  # steps' errors add up, times a or b


@pytest.mark.parametrize("ratio", [1.5, 0.8])
def test_a_jump_of_normal_stress(ratio):
    rs, k = PAPER._replace(alpha=0.3, law="aging"), 200.0
    for damping in (0.0, 2.0):
        h = spring_slider(
            rs, Spring(k, damping), (LoadStep(1.0, 0.02), LoadStep(1.0, 0.02, ratio)), times=[1.0, 1.0 + 1e-12]
        )
        assert h.theta[1] / h.theta[0] == pytest.approx(ratio ** (-0.3 / 0.0178), rel=1e-8)
        force = h.normal * h.friction + damping * h.velocity
        assert force[1] == pytest.approx(force[0], rel=1e-9)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    ("ratio", "damping"), [(0.7, 0.0), (1.0, 0.0), (1.6, 0.0), (0.8, 1500.0), (1.0, 1500.0), (4.0, 0.0)]
)
def test_small_disturbances_grow_as_the_eigenvalues_say(law, ratio, damping):
    rs, v = WEAK._replace(law=law), 1e-6
    spring = Spring(ratio * critical_stiffness(rs, v, damping), damping)
    sliding = steady_sliding(rs, spring, v)
    assert sliding.stable == (ratio > 1)
    assert ("unstable" in sliding.sentence) == (ratio <= 1)
    size, t = 1e-7, np.linspace(0, 60.0, 13)
    h = spring_slider(rs, spring, (LoadStep(60.0, v),), theta=rs.dc / v * (1 + size), times=t, tolerance=1e-14)
    matrix = rates(slider_of(rs, spring), np.zeros(3), v, 1.0)[1][:2, :2]
    linear = np.array([expm(matrix * s) @ [0, size] for s in t])
    off = np.stack([np.log(h.velocity / v), np.log(h.theta * v / rs.dc)], axis=1)
    assert np.allclose(off, linear, rtol=0, atol=1e-4 * np.abs(linear).max())  # size² and round-off
    if ratio == 1.0:
        direct = rs.a + damping * v
        assert sliding.growth_rate == pytest.approx(0, abs=1e-12)
        assert sliding.frequency == pytest.approx(v / rs.dc * np.sqrt((rs.b - direct) / direct), rel=1e-9)
    assert sliding.growth_rate == pytest.approx(sliding.eigenvalues.real.max())


def test_below_the_critical_stiffness_slip_runs_away_and_damping_holds_it():
    assert critical_stiffness(WEAK) == pytest.approx(500.0)
    legs = (LoadStep(1e3, 1e-6), LoadStep(3e3, 1.5e-6))
    lost = spring_slider(WEAK, Spring(200.0), legs)
    assert lost.end is End.RUNAWAY
    assert not lost.ok
    assert 1e3 < lost.reached < 4e3
    assert len(lost.time) == len(lost.friction)
    assert np.isfinite(lost.friction).all()
    assert spring_slider(WEAK, Spring(600.0), legs).ok
    assert spring_slider(WEAK, Spring(200.0, 1.0), legs).ok


def test_published_parameters_strengthen_with_velocity():
    assert critical_stiffness(PAPER) < 0
    assert "any spring" in steady_sliding(PAPER, Spring(1e-3), 0.1).sentence
    rise = closed.steady_friction(PAPER, 0.1) - closed.steady_friction(PAPER, 0.02)
    assert rise == pytest.approx((0.0247 - 0.0178) * np.log(5), rel=1e-12)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: spring_slider(PAPER._replace(a=0.0), Spring(1.0), (LoadStep(1, 1),)), "a must be positive, got 0.0"),
        (
            lambda: spring_slider(PAPER._replace(law="slow"), Spring(1.0), (LoadStep(1, 1),)),
            "must be 'aging' or 'slip'",
        ),
        (lambda: spring_slider(PAPER, Spring(-1.0), (LoadStep(1, 1),)), "stiffness must be positive"),
        (
            lambda: spring_slider(PAPER, Spring(1.0, -1.0), (LoadStep(1, 1),)),
            "damping must be zero or positive, got -1.0",
        ),
        (lambda: spring_slider(PAPER, Spring(1.0), ()), "a load history needs at least one"),
        (
            lambda: spring_slider(PAPER, Spring(1.0), (LoadStep(1, 1), LoadStep(0, 1))),
            r"legs\[1\].duration must be positive, got 0",
        ),
        (lambda: spring_slider(PAPER, Spring(1.0), (LoadStep(1, np.nan),)), r"legs\[0\].velocity is NaN"),
        (lambda: spring_slider(PAPER, Spring(1.0), (LoadStep(1, 0.0),)), "give `before`"),
        (lambda: spring_slider(PAPER, Spring(1.0), (LoadStep(1, "x"),)), "velocity must be a number"),
        (lambda: spring_slider(PAPER, Spring(1.0), (LoadStep(1, 1),), times=[]), "times is empty"),
        (lambda: spring_slider(PAPER, Spring(1.0), (LoadStep(1, 1),), times=[0, 2]), "within the legs, 0 to 1"),
        (lambda: spring_slider(PAPER, Spring(1.0), (LoadStep(1, 1),), times=[0.5, 0.2]), "sort the samples"),
        (lambda: spring_slider(PAPER, Spring(1.0), (LoadStep(1, 1),), theta=-1.0), "theta must be positive"),
        (lambda: prescribed(PAPER, [0, 1, 2], [1.0, -1.0]), "not negative"),
        (lambda: prescribed(PAPER, [0, 1, 2], [0.0, 1.0]), "give theta"),
        (lambda: velocity_steps([1.0, 0.0], distance=1.0), "velocities must be positive and finite, got 0"),
        (lambda: slide_hold_slide([0.0], velocity=1.0, distance=1.0), "holds must be positive and finite, got 0"),
        (lambda: steady_sliding(PAPER, Spring(1.0), 0.0), "velocity must be positive"),
    ],
)
def test_bad_input_gives_a_one_sentence_error(call, sentence):
    with pytest.raises((TypeError, ValueError), match=sentence.replace("(", r"\(")) as caught:
        call()
    assert "\n" not in str(caught.value)
