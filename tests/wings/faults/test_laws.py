"""Forms of the law: closed forms, limits, derivatives, stability by finite differences, fits of synthetic records."""

import numpy as np
import pytest
from scipy.linalg import expm

from stickslip.wings.faults.friction import laws
from stickslip.wings.faults.friction.fitting import fit
from stickslip.wings.faults.friction.laws import (
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
from stickslip.wings.faults.friction.model import Data
from tests.wings.faults.closed_forms import stiff_step

USUAL = RateState(0.010, 0.015, 1e-5, 0.6, 1e-6)
FORMS = {
    "usual": USUAL,
    "regularized": USUAL._replace(form="regularized", mu0=0.05),  # so that V is not far above its regular range
    "cut-off": USUAL._replace(v1=3e-6, v2=2e-6),
    "two states": USUAL._replace(b2=0.004, dc2=6e-5),
    "two regularized": USUAL._replace(b2=0.004, dc2=6e-5, form="regularized", mu0=0.05),
    "two cut-off": USUAL._replace(b2=0.004, dc2=6e-5, v1=3e-6, v2=2e-6),
}
STIFF = 1e10  # stiffness in units of 1/D_c


@pytest.fixture(params=FORMS)
def rs(request):
    return FORMS[request.param]


def scalars(rs, w, s, s2, which=laws.friction):
    slider = slider_of(rs, Spring(1.0))
    return which(slider.form, (w, s, s2), slider[:6])[0]


def test_scalars_are_the_formulas_and_their_derivatives(rs):
    rng, d = np.random.default_rng(0), 1e-4
    for w, s, s2 in rng.uniform(-3, 3, (20, 3)):
        states = [rs.dc / rs.v0 * np.exp(s), rs.dc2 / rs.v0 * np.exp(s2)]
        mu = scalars(rs, w, s, s2)
        assert mu == pytest.approx(float(laws.friction_of(rs, rs.v0 * np.exp(w), *states)), rel=1e-13)
        slopes = scalars(rs, w, s, s2, laws.slopes)
        point, axes = np.array([w, s, s2]), d * np.eye(3)
        values = [scalars(rs, *(point + e)) - scalars(rs, *(point - e)) for e in axes]
        assert np.allclose(slopes, np.array(values) / (2 * d), rtol=0, atol=1e-10)  # third derivatives times d²/6
        ways = [scalars(rs, *(point + e), laws.slopes) - scalars(rs, *(point - e), laws.slopes) for e in axes]
        hessian = np.array(ways) / (2 * d)
        assert np.allclose(scalars(rs, w, s, s2, laws.curvatures), hessian[np.triu_indices(3)], rtol=0, atol=1e-10)


@pytest.mark.parametrize("law", laws.EVOLUTIONS)
@pytest.mark.parametrize("damping", [0.0, 3e3])
def test_the_jacobian_of_the_slider_is_that_of_its_rates(rs, law, damping):
    slider, d = slider_of(rs._replace(law=law), Spring(300.0, damping)), 1e-5
    for point in np.random.default_rng(1).uniform(-2, 2, (10, 3)):
        exact = rates(slider, point, 2e-6, 1.3)[1]
        columns = [rates(slider, point + e, 2e-6, 1.3)[0] - rates(slider, point - e, 2e-6, 1.3)[0]
                   for e in d * np.eye(3)]  # fmt: skip
        by_differences = np.array(columns).T / (2 * d)
        if rs.b2 == 0:
            by_differences[0, 2] = 0.0  # the second state is not part of the system
        assert np.allclose(exact, by_differences, rtol=1e-6, atol=1e-8 * np.abs(exact).max())


@pytest.mark.parametrize("law", laws.EVOLUTIONS)
def test_sliding_becomes_steady(rs, law):
    """Every form reaches its closed form of steady friction, with θ = D_c/V for each state."""
    rs = rs._replace(law=law)
    h = spring_slider(rs, Spring(1e5), velocity_steps([1e-6, 1e-5, 3e-7], distance=2e-3))
    for velocity, end in ((1e-6, 2e3), (1e-5, 2.2e3)):
        row = np.argmin(np.abs(h.time - end))
        assert h.friction[row] == pytest.approx(float(laws.steady_friction(rs, velocity)), rel=1e-8)
        assert h.theta[row] == pytest.approx(rs.dc / velocity, rel=1e-6)
        if rs.b2:
            assert h.theta2[row] == pytest.approx(rs.dc2 / velocity, rel=1e-6)


@pytest.mark.parametrize("law", laws.EVOLUTIONS)
def test_a_step_of_an_infinitely_stiff_slider(rs, law):
    rs, slip = rs._replace(law=law), 1e-5 * np.r_[0.01, 0.3, 1.0, 3.0, 6.0]
    legs = (LoadStep(1.0, 1e-6), LoadStep(7.0, 1e-5))
    h = spring_slider(rs, Spring(STIFF / rs.dc), legs, times=1.0 + slip / 1e-5)
    expected = stiff_step(rs, 1e-6, 1e-5, slip)
    assert np.allclose(h.friction, expected, rtol=1e-8, atol=0)
    known = prescribed(rs, np.r_[0.0, slip / 1e-5], np.full(5, 1e-5), theta=rs.dc / 1e-6)
    assert np.allclose(known.friction, expected, rtol=1e-12, atol=0)


def test_limits_are_the_usual_law():
    """arcsinh → ln for V ≫ V0 e^{−Φ/a}; cut-offs → ln for V ≪ V1, V2; b2 = 0, or b in two halves → one state."""
    legs = slide_hold_slide([30.0, 300.0], velocity=1e-6, distance=5e-5, reslide=1e-5)
    rs, spring = USUAL._replace(alpha=0.2), Spring(3e3)
    legs = (*legs, LoadStep(5.0, 1e-5, 1.3))
    usual = spring_slider(rs, spring, legs)
    same = {
        "regularized": rs._replace(form="regularized", mu0=0.6),
        "cut-off": rs._replace(v1=1e6, v2=1e6),
        "no second state": rs._replace(dc2=3e-5),
        "halves": rs._replace(b=0.0075, b2=0.0075, dc2=rs.dc),
    }
    for limit, other in same.items():
        h = spring_slider(other, spring, legs)
        assert np.allclose(h.friction, usual.friction, rtol=1e-8, atol=0), limit
        assert np.allclose(np.log(h.velocity), np.log(usual.velocity), rtol=0, atol=1e-6), limit
    far = spring_slider(rs._replace(v1=1e-5, v2=1e-5), spring, legs)
    assert np.abs(far.friction - usual.friction).max() > 1e-3


def test_rest_is_regular_with_the_regularized_form_only():
    edges = [0.0, 10.0, 20.0]
    assert np.isnan(prescribed(USUAL, edges, [1e-6, 0.0]).friction[1])
    assert prescribed(USUAL._replace(form="regularized"), edges, [1e-6, 0.0]).friction[1] == 0.0
    slow = USUAL._replace(form="regularized")
    theta = slow.dc / 1e-6
    rate = np.exp(slow.mu0 / slow.a) / (2 * slow.v0)  # f = a V rate near rest, at θ = D_c/V0
    assert laws.friction_of(slow, 1e-40, theta) == pytest.approx(slow.a * rate * 1e-40, rel=1e-12)


def test_cut_offs_turn_weakening_into_strengthening_or_end_the_direct_effect():
    """Above V2 the evolution effect ends, and steady friction rises as a ln V; above V1 it falls as −b ln V."""
    fast = np.array([1e-3, 1e-2])
    rise = np.diff(laws.steady_friction(USUAL._replace(v2=1e-6), fast))[0]
    assert rise == pytest.approx(USUAL.a * np.log(10), rel=2e-3)
    fall = np.diff(laws.steady_friction(USUAL._replace(v1=1e-6), fast))[0]
    assert fall == pytest.approx(-USUAL.b * np.log(10), rel=2e-3)


@pytest.mark.parametrize("law", laws.EVOLUTIONS)
@pytest.mark.parametrize("damping", [0.0, 800.0])
def test_critical_stiffness_is_where_an_eigenvalue_crosses_zero(rs, law, damping):
    """Eigenvalues of the rates by finite differences, on both sides of k_c."""
    rs, v, d = rs._replace(law=law), 1.5e-6, 1e-6
    critical = critical_stiffness(rs, v, damping)
    assert critical > 0
    many = 3 if rs.b2 else 2

    def growth(k):
        slider, point = slider_of(rs, Spring(k, damping)), np.log(v / rs.v0) * np.array([1.0, -1.0, -1.0])
        columns = [(rates(slider, point + e, v, 1.0)[0] - rates(slider, point - e, v, 1.0)[0]) / (2 * d)
                   for e in d * np.eye(3)[:many]]  # fmt: skip
        values = np.linalg.eigvals(np.array(columns).T[:many])
        sliding = steady_sliding(rs, Spring(k, damping), v)
        assert sliding.stable == (k > critical)
        gaps = np.abs(sliding.eigenvalues[:, None] - values).min(axis=1)
        assert (gaps < 1e-7 * np.abs(values).max()).all()
        return values.real.max()

    assert growth(critical * (1 - 1e-3)) > 0 > growth(critical * (1 + 1e-3))
    assert abs(growth(critical * (1 + 1e-12))) < 1e-8
    assert growth(critical * 0.1) > 0 > growth(critical * 10)


@pytest.mark.parametrize("second", [{}, {"b2": 0.002, "dc2": 3e-5}])
def test_the_sentence_on_stable_sliding_gives_the_effects_at_its_velocity(second):
    """b = 0.015 exceeds a = 0.010, but not at V = 9 V2, where it is a tenth."""
    surface = RateState(0.010, 0.015, 1e-5, v2=1e-7, **second)
    sliding = steady_sliding(surface, Spring(100.0), 9e-7)
    name = "b + b2" if second else "b"
    assert sliding.stable
    assert f"{name} at this velocity = {0.1 * (0.015 + surface.b2):.4g} does not exceed" in sliding.sentence


def test_two_states_have_the_critical_stiffness_of_each_alone():
    slope = critical_stiffness(USUAL)
    assert critical_stiffness(USUAL._replace(b2=1e-12, dc2=3e-4)) == pytest.approx(slope, rel=1e-6)
    assert critical_stiffness(USUAL._replace(b=1e-12, b2=0.015, dc2=3e-5)) == pytest.approx(slope / 3, rel=1e-6)
    assert critical_stiffness(USUAL._replace(b=0.009, b2=0.006, dc2=USUAL.dc)) == pytest.approx(slope, rel=1e-12)
    assert critical_stiffness(USUAL._replace(b=0.002, b2=0.001, dc2=3e-5)) <= 0
    assert "b + b2 = 0.003" in steady_sliding(USUAL._replace(b=0.002, b2=0.001), Spring(10.0), 1e-6).sentence


def test_small_disturbances_grow_as_the_eigenvalues_say(rs):
    v, t = 1e-6, np.linspace(0, 40.0, 9)
    spring = Spring(1.3 * critical_stiffness(rs, v), 0.0)
    h = spring_slider(rs, spring, (LoadStep(40.0, v),), theta=rs.dc / v * (1 + 1e-7), times=t, tolerance=1e-14)
    many = 3 if rs.b2 else 2
    matrix = rates(slider_of(rs, spring), np.zeros(3), v, 1.0)[1][:many, :many]
    start = np.r_[0.0, np.full(many - 1, 1e-7)]
    linear = np.array([expm(matrix * s) @ start for s in t])
    off = np.log(h.velocity / v)
    assert np.allclose(off, linear[:, 0], rtol=0, atol=1e-4 * np.abs(linear).max())


def test_normal_stress_acts_on_both_states(rs):
    """Linker and Dieterich: Σ b Δln θ = −α Δln σ; the force does not jump."""
    rs = rs._replace(alpha=0.3)
    for damping in (0.0, 2e3):
        legs = (LoadStep(10.0, 1e-6), LoadStep(10.0, 1e-6, 1.1))
        h = spring_slider(rs, Spring(2e3, damping), legs, times=[10.0, 10.0 + 1e-9])
        states = [(rs.b, h.theta)] + ([(rs.b2, h.theta2)] if rs.b2 else [])
        change = sum(b * np.log(theta[1] / theta[0]) for b, theta in states)
        assert change == pytest.approx(-0.3 * np.log(1.1), rel=1e-6)
        force = h.normal * h.friction + damping * h.velocity
        assert force[1] == pytest.approx(force[0], rel=1e-9)


# fits

LEGS = (*velocity_steps([1e-6, 1e-5, 1e-6, 3e-5, 1e-6], distance=3e-4), LoadStep(100.0, 0.0), LoadStep(100.0, 1e-6))


def record(rs, stiffness=5e3, noise=0.0, legs=LEGS):
    times = np.linspace(0, sum(leg.duration for leg in legs), 900)
    h = spring_slider(rs, Spring(stiffness), legs, times=times)
    return Data(times, h.friction + np.random.default_rng(0).normal(0, 1, 900) * noise, legs)


@pytest.mark.parametrize(
    ("rs", "options"),
    [
        (USUAL._replace(b2=0.004, dc2=1e-4, law="slip"), {"free": ("b2", "dc2")}),
        (USUAL._replace(form="regularized", mu0=0.05), {"form": "regularized"}),
        (USUAL._replace(v1=1e-4, v2=5e-5, law="slip"), {"free": ("v1", "v2")}),
        (USUAL._replace(v2=5e-5), {"free": ("v2",)}),
    ],
)
def test_exact_records_give_exact_parameters(rs, options):
    best = fit(record(rs), law=rs.law, fixed={"stiffness": 5e3, "v0": 1e-6}, **options)
    for name in best.names:
        assert best.values[name] == pytest.approx(getattr(rs, name), rel=1e-3), name
    assert best.rate_state()._replace(**{n: getattr(rs, n) for n in best.names}) == rs._replace(alpha=0.0)


def test_a_second_state_that_is_not_there_is_not_determined():
    best = fit(record(USUAL, noise=3e-4), fixed={"stiffness": 5e3, "dc2": 1e-4}, free=("b2",))
    assert not best.identifiable
    assert "these data do not determine b2" in best.sentence


def test_alpha_is_fitted_with_two_states():
    legs = (*LEGS[:3], LoadStep(60.0, 1e-6, 1.05), LoadStep(60.0, 1e-6, 1.0), *LEGS[3:])
    rs = USUAL._replace(b2=0.004, dc2=1e-4, alpha=0.2)
    best = fit(record(rs, legs=legs), fixed={"stiffness": 5e3, "v0": 1e-6, "dc2": 1e-4, "b2": 0.004}, free=("alpha",))
    assert best.values["alpha"] == pytest.approx(0.2, rel=1e-3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: fit(record(USUAL), fixed={"stiffness": 1e4}, form="log"), "form must be 'logarithmic'"),
        (lambda: fit(record(USUAL), fixed={"stiffness": 1e4}, free=("b2",)), "a second state has two parameters"),
        (lambda: fit(record(USUAL), fixed={"stiffness": 1e4}, form="regularized", free=("v1",)), "cut-off velocities"),
        (
            lambda: spring_slider(USUAL._replace(form="x"), Spring(1.0), LEGS),
            "form must be 'logarithmic' or 'regularized', got 'x'",
        ),
        (lambda: spring_slider(USUAL._replace(b2=-0.1), Spring(1.0), LEGS), "b2 must be zero or positive, got -0.1"),
        (lambda: spring_slider(USUAL._replace(v1=0.0), Spring(1.0), LEGS), "v1 must be positive, or inf, got 0"),
        (lambda: spring_slider(USUAL._replace(v1=float("nan")), Spring(1.0), LEGS), "v1 is NaN"),
        (lambda: spring_slider(USUAL._replace(v1=1.0, form="regularized"), Spring(1.0), LEGS), "cut-off velocities"),
    ],
)
def test_bad_input_gives_a_one_sentence_error(call, message):
    with pytest.raises(ValueError, match=r"^.+$") as caught:
        call()
    assert message in str(caught.value)
