"""Derivatives of the deciding eigenvalue against differences of equilibria, and the probability of a verdict."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

import stickslip as ss
from stickslip.cli.app import app
from stickslip.solve import gradient
from tests.modes.conftest import sheared

LAW = ss.laws.hertz_mindlin(1.0, 2 / 7, 0.5)


@pytest.fixture(scope="module")
def packing():
    state, outcome = ss.newton(sheared(12, 2, 0.88, 6e-4, seed=3, law=LAW), LAW)
    assert outcome.ok
    grains, contacts = state.grains, state.contacts
    return state._replace(
        grains=grains._replace(angle=0 * grains.angle), contacts=contacts._replace(roll=0 * contacts.roll)
    )


@pytest.fixture(scope="module")
def slope(packing):
    return ss.modes.eigenvalue_gradient(packing, LAW)


def nearest(state, value, law=LAW):
    values = np.linalg.eigvals(ss.modes.dynamical_matrix(state, law, ss.modes.backbone(state, law)).toarray())
    return values[np.argmin(np.abs(values - value))]


def difference(eigenvalue, step):
    """Derivative by central differences of fourth order."""
    return sum(weight * eigenvalue(k * step) for k, weight in gradient.STENCIL) / step


def at_rest(state, law=LAW):
    state, outcome = ss.newton(state, law)
    assert outcome.ok
    return state


def test_it_is_the_softest_mode(packing, slope):
    values = ss.spectrum(packing, LAW).eigenvalues
    assert slope.value == pytest.approx(values[np.abs(values) > 1e-9].real.min(), rel=1e-10)


def test_forces(packing, slope):
    """Opposite pushes on two grains, so that the total vanishes."""
    control = packing.control

    def eigenvalue(h):
        force = control.force.copy()
        force[4, 0], force[7, 0] = h, -h
        return nearest(at_rest(packing._replace(control=control._replace(force=force))), slope.value)

    assert difference(eigenvalue, 1e-5) == pytest.approx(slope.by_force[4, 0] - slope.by_force[7, 0], rel=1e-6)


def test_torques(packing, slope):
    control = packing.control

    def eigenvalue(h):
        torque = control.torque.copy()
        torque[4, 2] = h * packing.grains.radius[4]
        return nearest(at_rest(packing._replace(control=control._replace(torque=torque))), slope.value)

    assert difference(eigenvalue, 1e-5) == pytest.approx(slope.by_force[4, 5], rel=1e-6)


def test_radii(packing, slope):
    """The inertia of a disk of constant mass grows with the square of its radius."""
    grains = packing.grains

    def eigenvalue(h):
        radius = grains.radius.copy()
        radius[4] += h
        inertia = grains.inertia * (radius / grains.radius) ** 2
        return nearest(at_rest(packing._replace(grains=grains._replace(radius=radius, inertia=inertia))), slope.value)

    assert difference(eigenvalue, 1e-5) == pytest.approx(slope.by_radius[4], rel=1e-6)


@pytest.mark.parametrize("name", ["kn", "kt", "mu"])
def test_parameters(packing, slope, name):
    values = {"kn": 1.0, "kt": 2 / 7, "mu": 0.5}

    def eigenvalue(h):
        law = ss.laws.hertz_mindlin(**(values | {name: values[name] + h}))
        return nearest(at_rest(packing, law), slope.value, law)

    assert difference(eigenvalue, 1e-4) == pytest.approx(slope.by_parameter[name], rel=1e-6, abs=1e-9)


def test_measured_positions_and_the_contacts_that_carry_them(packing, slope):
    grains = packing.grains

    def eigenvalue(h):
        position = grains.position.copy()
        position[4, 1] += h
        moved = packing._replace(grains=grains._replace(position=position))
        return nearest(gradient.with_given_slips(moved), slope.value)

    assert difference(eigenvalue, 1e-6) == pytest.approx(slope.by_position[4, 1], rel=1e-6)
    rows = slope.by_contact
    ends = (packing.contacts.i[: len(rows)], packing.contacts.j[: len(rows)])
    total = sum(sign * rows[end == 4].sum(axis=0) for end, sign in zip(ends, (1, -1), strict=True))
    np.testing.assert_allclose(total, slope.by_position[4], atol=1e-6 * np.abs(slope.by_position).max())


STRAIN = np.array([[0.3, 1.0], [0.2, -0.1]])


def modulus(state, law=LAW):
    return np.einsum("ab,abcd,cd", STRAIN, ss.modes.elastic_moduli(state, law).tensor, STRAIN)


def test_moduli(packing):
    """To forces, radii, stiffness and positions, against differences of equilibria."""
    slope = ss.modes.modulus_gradient(packing, LAW, STRAIN)
    assert slope.value == pytest.approx(modulus(packing), rel=1e-12)
    grains, control = packing.grains, packing.control

    def pushed(h):
        force = control.force.copy()
        force[4, 0], force[7, 0] = h, -h
        return modulus(at_rest(packing._replace(control=control._replace(force=force))))

    def resized(h):
        radius = grains.radius.copy()
        radius[4] += h
        return modulus(at_rest(packing._replace(grains=grains._replace(radius=radius))))

    def stiffer(h):
        law = ss.laws.hertz_mindlin(1.0, 2 / 7 + h, 0.5)
        return modulus(at_rest(packing, law), law)

    def moved(h):
        position = grains.position.copy()
        position[4, 1] += h
        return modulus(gradient.with_given_slips(packing._replace(grains=grains._replace(position=position))))

    assert difference(pushed, 1e-5) == pytest.approx(slope.by_force[4, 0] - slope.by_force[7, 0], rel=1e-6)
    assert difference(resized, 1e-5) == pytest.approx(slope.by_radius[4], rel=1e-6)
    assert difference(stiffer, 1e-4) == pytest.approx(slope.by_parameter["kt"], rel=1e-6)
    assert difference(moved, 1e-6) == pytest.approx(slope.by_position[4, 1], rel=1e-6)


def test_growth_rate_of_a_pair_follows_its_eigenvalue(swinging):
    law = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth")
    slope = ss.modes.eigenvalue_gradient(swinging, law)
    assert slope.growth_rate == pytest.approx(ss.stability(swinging, law).growth_rate[0], rel=1e-6)
    small = 1e-7 * (1 + 2j)
    after = abs(np.sqrt(slope.value + small).imag)
    assert slope.growth_derivative(small) == pytest.approx(after - slope.growth_rate, rel=1e-2)


def test_the_spread_of_samples_is_the_linear_one(packing, slope):
    error, rng = 1e-4, np.random.default_rng(0)
    size = error * packing.grains.radius.mean()

    def sample():
        position = packing.grains.position.copy()
        position[:, :2] += size * rng.normal(size=(12, 2))
        return nearest(
            gradient.with_given_slips(packing._replace(grains=packing.grains._replace(position=position))), slope.value
        ).real

    sure = ss.modes.verdict_probability(packing, LAW, position_error=error, samples=3)
    spread = np.std([sample() for _ in range(100)])
    assert spread == pytest.approx(sure.deviation, rel=0.2)  # 1/√200 = 0.07 of 100 samples, and curvature
    assert sure.probability == 1.0 == sure.high
    assert sure.low == pytest.approx(0.025 ** (1 / 3))  # Clopper and Pearson
    assert 0 < sure.share < 1


def test_an_unstable_packing_becomes_uncertain_with_the_error(swinging):
    law = ss.laws.hertz_mindlin(1.0, 2 / 7, 10.0, coulomb="smooth")
    stable = [
        ss.modes.verdict_probability(swinging, law, position_error=error, samples=12).stable for error in (1e-7, 3e-2)
    ]
    assert stable[0] == 0 < stable[1]


def test_the_command_says_how_sure_it_is(tmp_path, monkeypatch, few_spheres):
    monkeypatch.chdir(tmp_path)
    file = str(few_spheres)
    done = CliRunner().invoke(app, ["stability", file, "--position-error", "1e-7", "--json"])
    sure = json.loads(done.stdout)["position_error"]
    assert (sure["stable"], sure["samples"], len(sure["contact"])) == (0, 100, 2)
    assert sure["im_lambda"] == json.loads(done.stdout)["pairs"][0]["im_lambda"]
    refused = CliRunner().invoke(app, ["stability", file, "--position-error=nan"])
    assert refused.exit_code != 0 and not list(tmp_path.iterdir())


def test_what_has_no_derivatives_is_said(packing):
    with pytest.raises(ValueError, match="the law has dashpots, but the probability of a verdict"):
        damped = ss.laws.hertz_mindlin(mu=0.5, damping="viscoelastic", damping_n=0.3)
        ss.modes.verdict_probability(packing, damped, position_error=1e-3)
    with pytest.raises(ValueError, match="moments or lever arms"):
        ss.modes.eigenvalue_gradient(packing, ss.laws.with_lever(LAW, "overlap"))
    with pytest.raises(ValueError, match="cells that follow a stress and rigid groups are not supported"):
        control = ss.control.stress_controlled(packing.control, {"xx": 1e-3})
        ss.modes.eigenvalue_gradient(packing._replace(control=control), LAW)
    with pytest.raises(ValueError, match="not in equilibrium"):
        ss.modes.eigenvalue_gradient(packing, ss.laws.hertz_mindlin(2.0, 0.1, 0.5))
    with pytest.raises(ValueError, match="position_error must"):
        ss.modes.verdict_probability(packing, LAW, position_error=0.0)
    with pytest.raises(ValueError, match="at most 1"):
        ss.modes.verdict_probability(packing, LAW, position_error=2.0)


def test_the_norm_of_unbalanced_forces(packing):
    """Off equilibrium by a push of one grain, against differences of forces."""
    grains, control = packing.grains, packing.control
    position = grains.position.copy()
    position[4, :2] += 2e-4, -1e-4
    off = gradient.with_given_slips(packing._replace(grains=grains._replace(position=position)))
    free, slope = ss.modes.backbone(off, LAW), ss.modes.residual_gradient(off, LAW)

    def norm(state, law=LAW):
        return np.linalg.norm(ss.modes.residual_vector(state, ss.forces(state, law)[0], free))

    def moved(h):
        place = position.copy()
        place[7, 0] += h
        return norm(gradient.with_given_slips(off._replace(grains=grains._replace(position=place))))

    def pushed(h):
        force = control.force.copy()
        force[4, 1] += h
        return norm(off._replace(control=control._replace(force=force)))

    def resized(h):
        radius = grains.radius.copy()
        radius[4] += h
        return norm(off._replace(grains=off.grains._replace(radius=radius)))

    assert slope.value == pytest.approx(norm(off), rel=1e-12)
    assert difference(moved, 1e-6) == pytest.approx(slope.by_position[7, 0], rel=1e-6)
    assert difference(pushed, 1e-6) == pytest.approx(slope.by_force[4, 1], rel=1e-6)
    assert difference(resized, 1e-6) == pytest.approx(slope.by_radius[4], rel=1e-6)
    given = {"kn": 1.0, "kt": 2 / 7, "mu": 0.5}

    def stiffer(h, name):
        return norm(off, ss.laws.hertz_mindlin(**given | {name: given[name] + h}))

    for name, value in slope.by_parameter.items():
        slow = difference(lambda h, name=name: stiffer(h, name), 1e-4)
        assert slow == pytest.approx(value, rel=1e-6, abs=1e-9)
    with pytest.raises(ValueError, match="all forces balance"):
        ss.modes.residual_gradient(packing, LAW)


def test_growth_of_damped_motions(packing):
    """The exponent s of M s² v = (J + s C) v, against those of equilibria that were solved again."""
    given = {"kn": 1.0, "kt": 2 / 7, "mu": 0.5, "damping_n": 0.2, "damping_t": 0.1}
    law = ss.laws.hertz_mindlin(**given)
    slope, free = ss.modes.eigenvalue_gradient(packing, law), ss.modes.backbone(packing, law)

    def exponent(state, law):
        n, (_, damp) = len(free), ss.modes.contact_blocks(state, law)
        pull, drag = (
            m.toarray() / free.mass[:, None]
            for m in (ss.jacobian(state, law, free), ss.modes.assembled(state, damp, free))
        )
        values = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [pull, drag]]))
        return values[np.argmin(np.abs(values - slope.value))]

    def pushed(h):
        force = packing.control.force.copy()
        force[4, 0], force[7, 0] = h, -h
        return exponent(at_rest(packing._replace(control=packing.control._replace(force=force)), law), law)

    def with_parameter(h, name):
        other = ss.laws.hertz_mindlin(**given | {name: given[name] + h})
        return exponent(at_rest(packing, other), other)

    result = ss.stability(packing, law)
    assert slope.growth_rate == pytest.approx(result.slowest.real, rel=1e-9)
    assert difference(pushed, 1e-5) == pytest.approx(slope.by_force[4, 0] - slope.by_force[7, 0], rel=1e-6)
    assert set(slope.by_parameter) == set(given)
    for name, value in slope.by_parameter.items():
        found = difference(lambda h, name=name: with_parameter(h, name), 1e-4)
        assert found == pytest.approx(value, rel=1e-6, abs=1e-9)
