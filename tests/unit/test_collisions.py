"""One contact with a known answer: collisions, oblique impact, sliding that turns into rolling."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.laws.builtin import DAMPING_N, DAMPING_T

MEMORY = ["difference", "rate"]


def head_on(law, speed, radius=0.5, mass=2.0):
    """Two alike spheres a little apart, closing in at `speed` along an axis that is none of the frame's."""
    axis = np.array([2.0, -1.0, 2.0]) / 3
    grains = ss.spheres(
        [0 * axis, (2 * radius + 1e-6) * axis], radius, mass=mass, velocity=[speed / 2 * axis, -speed / 2 * axis]
    )
    return ss.assembly(grains, skin=0.1), axis


@pytest.mark.parametrize(
    ("kind", "memory"),
    [
        (ss.laws.hertz_mindlin, "difference"),
        (ss.laws.hertz_mindlin_reff, "difference"),
        (ss.laws.hertz_mindlin, "rate"),
    ],
)
def test_hertz_contact_time_and_peak_force(kind, memory):
    """t = 2.9432 δ/v, δ = (5 m_eff v²/4k)^{2/5}, F = k δ^{3/2}: Landau & Lifshitz, Theory of Elasticity, § 9."""
    speed, m_eff = 0.02, 1.0
    k = 1.0 if kind is ss.laws.hertz_mindlin else 0.5  # √R_eff of two spheres of radius 1/2
    deepest = (5 * m_eff * speed**2 / (4 * k)) ** 0.4
    duration, dt = 2.943275 * deepest / speed, 2.943275 * deepest / speed / 4000
    law = kind(1.0, 0.4, 0.3)
    state, axis = head_on(law, speed)
    end, record, _ = ss.run(state, law, 5000, dt, every=1, probes=(0, 1), slip_update=memory)
    touching = np.flatnonzero(record.touching)
    assert (touching[-1] - touching[0] + 1) * dt == pytest.approx(duration, abs=2 * dt)
    overlap = 1.0 - np.linalg.norm(record.position[:, 1] - record.position[:, 0], axis=1)
    # second order in a time step of a four-thousandth
    assert overlap.max() == pytest.approx(deepest, rel=1e-5)
    pull = np.linalg.norm(record.virial[np.argmax(overlap)] @ axis)
    assert pull / (1 - overlap.max()) == pytest.approx(k * deepest**1.5, rel=2e-5)
    np.testing.assert_allclose(end.grains.velocity, state.grains.velocity[::-1], atol=1e-6 * speed)
    quick = ss.laws.collision(law, radius=0.5, mass=2.0, speed=speed)
    assert quick.duration == pytest.approx(duration, rel=1e-6)
    assert quick.peak_force == pytest.approx(k * deepest**1.5, rel=1e-6)


@pytest.mark.parametrize(("c", "e"), [(0.01755, 0.98), (0.0923, 0.9), (0.6265, 0.5), (1.0874, 0.3)])
def test_restitution_of_the_viscoelastic_law(c, e):
    """x'' = −x^{3/2} − c √x x': the dimensionless collision of which the pairs (c, e) are known."""
    m_eff, r_eff, speed, kn = 1.0, 0.25, 0.02, 1.0
    unit = (m_eff**2 / (kn**2 * r_eff * speed)) ** 0.2
    law = ss.laws.hertz_mindlin_reff(kn, 0.0, 0.0, damping_n=c * kn * unit / m_eff)
    assert ss.laws.collision(law, radius=0.5, mass=2.0, speed=speed).restitution == pytest.approx(e, abs=6e-4)
    back = ss.laws.with_restitution(ss.laws.hertz_mindlin_reff(kn), e, radius=0.5, mass=2.0, speed=speed)
    assert back.table[0, 0, DAMPING_N] == pytest.approx(law.table[0, 0, DAMPING_N], rel=4e-3)
    state, axis = head_on(back, speed)
    dt = 3.2 * unit / 2000
    end, _, _ = ss.run(state, back, 8000, dt)
    after = (end.grains.velocity[1] - end.grains.velocity[0]) @ axis
    # explicit steps of a two-thousandth of the collision; second order where the dashpot sees the full step
    assert after == pytest.approx(e * speed, rel=2e-5)


@pytest.mark.parametrize("damping", ["velocity", "mass_velocity", "viscoelastic"])
@pytest.mark.parametrize("kind", [ss.laws.hertz_mindlin, ss.laws.hertz_mindlin_reff, ss.laws.linear])
def test_a_stated_restitution_is_what_a_collision_gives(kind, damping):
    law = ss.laws.with_restitution(kind(3.0, damping=damping), 0.7, radius=0.3, mass=0.2, speed=0.05, ratio=0.3)
    assert law.table[0, 0, DAMPING_T] == pytest.approx(0.3 * law.table[0, 0, DAMPING_N])
    assert ss.laws.collision(law, radius=0.3, mass=0.2, speed=0.05).restitution == pytest.approx(0.7, abs=1e-7)
    again = ss.laws.collision(law, radius=0.3, mass=0.2, speed=0.5).restitution
    constant = kind is ss.laws.linear and damping != "viscoelastic"
    assert (abs(again - 0.7) < 1e-7) == constant


@pytest.mark.parametrize("tension", [True, False])
@pytest.mark.parametrize("kind", [ss.laws.hertz_mindlin, ss.laws.hertz_mindlin_reff, ss.laws.linear])
def test_coeff_restitution_is_that_of_a_collision_with_and_without_tension(kind, tension):
    """Dynamics of two grains; without tension also beyond critical damping, e < exp(−2)."""
    for e in (1.0, 0.9, 0.3, 0.05):
        law = kind(1.0, 0.3, 0.2, damping="coeff_restitution", damping_n=e, damping_t=0.5, tension=tension)
        quick = ss.laws.collision(law, radius=0.5, mass=2.0, speed=0.02)
        assert quick.restitution == pytest.approx(e, abs=1e-7)
        state, axis = head_on(law, 0.02)
        end, _, _ = ss.run(state, law, int(1.2 * quick.duration / 0.004), 0.004)
        after = (end.grains.velocity[1] - end.grains.velocity[0]) @ axis
        assert after == pytest.approx(e * 0.02, abs=2e-3 * 0.02)  # first order in dt at touch, with these dashpots


@pytest.mark.parametrize("memory", MEMORY)
def test_oblique_impact_that_slides_throughout(memory):
    """Friction's impulse is μ times the normal one: Δv_t = −μ (1 + e) v_n, R Δω = 5/2 of it."""
    mu, v_n, v_t, radius = 0.1, 0.02, 0.3, 0.5
    law = ss.laws.hertz_mindlin(1.0, 0.8, mu)
    grains = ss.spheres([[0.0, 0.0, radius + 1e-6]], radius, velocity=[v_t, 0.0, -v_n])
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 0, 1]), skin=0.1)
    end, record, _ = ss.run(state, law, 4000, 0.005, every=1, slip_update=memory)
    assert record.touching[-1] == 0
    v, spin = end.grains.velocity[0], end.grains.spin[0]
    assert v[2] == pytest.approx(v_n, rel=1e-5)
    # the limit is reached within the first tenth of a per cent of the impulse
    assert v[0] == pytest.approx(v_t - mu * 2 * v_n, abs=2e-3 * mu * 2 * v_n)
    assert radius * spin[1] == pytest.approx(2.5 * (v_t - v[0]), rel=1e-9)


@pytest.mark.parametrize("memory", [MEMORY[0], pytest.param(MEMORY[1], marks=pytest.mark.slow)])
def test_a_sliding_ball_ends_up_rolling_with_five_sevenths_of_its_speed(memory):
    """It slides for 2 v₀/(7 μ g) and then rolls: the ball on a billiard table."""
    speed, mu, g, radius = 0.05, 0.2, 1e-3, 0.5
    law = ss.laws.hertz_mindlin_reff(1.0, 0.8, mu, damping_n=2.0, damping_t=0.2)
    depth = (g / np.sqrt(radius)) ** (2 / 3)
    grains = ss.spheres([[0.0, 0.0, radius - depth]], radius, velocity=[speed, 0.0, 0.0])
    control = ss.control.loads(1, 1, gravity=(0.0, 0.0, -g))
    state = ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 0, 1]), control=control, skin=0.1)
    slides = 2 * speed / (7 * mu * g)
    steps = int(1.5 * slides / 0.05)
    end, record, _ = ss.run(state, law, steps, 0.05, every=10, slip_update=memory)
    last = record.time[record.sliding > 0][-1]
    assert last == pytest.approx(slides, rel=0.02)  # the spring's stretch is given back while it turns to rolling
    v, spin = end.grains.velocity[0], end.grains.spin[0]
    # the tangential spring still swings a little
    assert v[0] == pytest.approx(5 / 7 * speed, rel=1e-2)
    assert v[0] + 0.4 * radius * spin[1] == pytest.approx(speed, rel=1e-9)  # angular momentum about the floor


def test_bad_restitution_is_refused_with_a_sentence():
    with pytest.raises(ValueError, match=r"from 0\.0001 to 1"):
        ss.laws.with_restitution(ss.laws.linear(), 1.3, radius=0.5, mass=1.0, speed=0.1)
    with pytest.raises(ValueError, match="speed must be positive"):
        ss.laws.collision(ss.laws.linear(), radius=0.5, mass=1.0, speed=0)


def test_elastic_constants_are_those_of_hertz_and_mindlin():
    """Two alike spheres: k_n = 4/3 E/(2 (1 − ν²)), k_t = 8 G/(2 (2 − ν)) with G = E/(2 (1 + ν))."""
    young, poisson = 3.0, 0.25
    shear = young / (2 * (1 + poisson))
    expected = 4 / 3 * young / (2 * (1 - poisson**2)), 8 * shear / (2 * (2 - poisson))
    assert ss.laws.elastic_constants(young, poisson) == pytest.approx(expected)
