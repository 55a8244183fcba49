"""Small cases by hand, each with a formula of its own: a factor in the core that is wrong shows here."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core import measure
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.dynamics.cell_motion import remaining_skin
from stickslip.core.scales import natural_scales
from stickslip.solve.moduli import voigt


@pytest.mark.parametrize(("dim", "up"), [(2, 1), (3, 2)])
def test_the_radius_of_a_contact_is_that_of_the_grain_at_a_wall_and_the_harmonic_one_of_a_pair(dim, up):
    """F_n = k_n δ √(δ R): R = R_i at a flat wall, R_i R_j/(R_i + R_j) between grains."""
    law, normal, small, large, overlap = ss.laws.hertz_mindlin_reff(2.0, 0.5, 0.4), np.eye(3)[up], 0.3, 0.6, 0.01
    place = np.outer([small - overlap, 2 * small + large - 2 * overlap], normal)
    make = ss.disks if dim == 2 else ss.spheres
    state = ss.assembly(make(place, [small, large]), ss.flat_walls([0, 0, 0], normal), ss.box(dim=dim))
    force = ss.forces(state, law)[0].force @ normal
    at_wall, between = (2.0 * overlap * np.sqrt(overlap * r) for r in (small, small * large / (small + large)))
    # round-off of positions over the overlap: 1e-16/1e-2
    np.testing.assert_allclose(force, [at_wall - between, between, -at_wall], rtol=1e-12)


@pytest.mark.parametrize("mu", [0.05, 5.0])
def test_spring_and_dashpot_are_truncated_together_as_lammps_does(mu):
    """gran/hooke/history: F_t = −k s − c v; beyond the limit scaled, and s with it."""
    stiffness, damping, overlap, dt = 2.0, 0.5, 0.1, 1e-9
    slip, v = np.array([0.0, 0.03, -0.01]), np.array([0.0, 0.2, -0.4])
    law = ss.laws.linear(kn=1.0, kt=stiffness, mu=mu, damping="velocity", damping_t=damping)
    grains = ss.spheres([[0, 0, 0], [overlap - 1, 0, 0]], 0.5, mass=1e12, velocity=[v, 0 * v])  # too heavy to slow down
    state = with_neighbor_list(ss.assembly(grains))
    state = ss.accept(state, ss.forces(state, law)[1])
    state = state._replace(contacts=state.contacts._replace(slip=slip[None], mode=np.array([1], np.int8)))
    end, _, _ = ss.run(state, law, 1, dt, slip_update="rate")
    pull, limit = -stiffness * slip - damping * v, mu * overlap
    share = min(limit / np.linalg.norm(pull), 1.0)
    kept = share * (slip + damping * v / stiffness) - damping * v / stiffness
    np.testing.assert_allclose(end.contacts.slip[0], kept, atol=1e-8)  # dt v
    np.testing.assert_allclose(end.instant.force[0, :3], [overlap, *(share * pull)[1:]], atol=1e-8)


def test_the_stable_time_step_of_a_pair_that_shears_and_turns():
    """ω² = k_t (1/m_i + 1/m_j + R_i²/I_i + R_j²/I_j) = 7 k_t/m of two spheres, above 2 k_n/m."""
    law = ss.laws.linear(kn=1.0, kt=20.0, mu=1e6)
    state = ss.assembly(ss.spheres([[0, 0, 0], [0.999, 0, 0]], 0.5))
    longest = ss.measure.stable_time_step(state, law)
    assert longest == pytest.approx(2 / np.sqrt(7 * 20.0), rel=1e-9)  # power iteration down to round-off
    ss.run(state, law, 1, 0.999 * longest)
    with pytest.raises(ValueError, match="is unstable: with contacts this stiff, use at most"):
        ss.run(state, law, 1, 1.01 * longest)


def test_a_contact_with_a_wall_counts_once_and_one_of_two_grains_twice():
    walls = ss.flat_walls([[0, 0, 0], [1.997, 0, 0]], [[1, 0, 0], [-1, 0, 0]])
    law, place = ss.laws.linear(kn=1.0, kt=0.5), np.array([[0.499, 0, 0], [1.498, 0, 0], [1, 5, 5]])
    state, record, _ = ss.run(ss.assembly(ss.spheres(place, 0.5), walls), law, 1, 1e-3, every=1)
    assert ss.measure.contact_numbers(state).tolist() == [2, 2, 0]
    assert ss.measure.coordination(state) == 2.0
    assert record.rattlers[0] == 1
    assert record.touching[0] == 3
    assert record.coordination[0] == pytest.approx(4 / 3)
    assert record.held_coordination[0] == 2.0


@pytest.mark.parametrize(("dim", "contacts"), [(2, 2), (2, 3), (3, 3), (3, 4)])
def test_without_friction_a_grain_needs_one_support_more_than_dimensions(dim, contacts):
    """A grain among fixed ones: two contacts hold it with friction, dim + 1 without."""
    corner = 3**-0.5 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])  # of a tetrahedron
    turn = 2 * np.pi * np.arange(4) / 3
    side = corner if dim == 3 else np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    place = np.vstack([np.zeros(3), 0.999 * side[:contacts]])
    state = ss.assembly((ss.disks if dim == 2 else ss.spheres)(place, 0.5), cell=ss.box(dim=dim))
    state = state._replace(control=ss.control.fixed(state.control, np.arange(1, contacts + 1)))
    for mu, least in ((0.5, 2), (0.0, dim + 1)):
        law = ss.laws.linear(mu=mu)
        held = ss.modes.backbone(ss.accept(state, ss.forces(state, law)[1]), law).body
        assert (0 in held) == (contacts >= least)


@pytest.mark.parametrize("power", [1, 2])
def test_the_force_scale_of_a_users_law_is_extrapolated_linearly_from_a_tenth_of_a_diameter(power):
    """k δ^p: a law that is linear has the scale k d of the built-in one, and k δ² one of k (d/10)² times 10."""
    law = ss.laws.custom(
        normal_force=lambda overlap, kn, p: kn * overlap**p, parameters={"kn": 3.0, "kt": 1.0, "mu": 0.3, "p": power}
    )
    state = ss.assembly(ss.spheres([[0, 0, 0], [5, 0, 0]], [0.5, 0.8]))
    assert natural_scales(state, law).force == pytest.approx(3.0 * 0.1**power / 0.1, rel=1e-12)


def test_a_free_wall_falls_and_a_grain_on_it_rests_on_both_weights():
    """A floor of mass M that is free to move falls by g t²/2; where it is held up, it carries its own weight too."""
    pull, mass, law = np.array([0.0, 0.0, -0.01]), 3.0, ss.laws.linear(kn=1.0, kt=0.5)
    walls = ss.flat_walls([0, 0, 0], [0, 0, 1], mass=mass)
    state = ss.assembly(ss.spheres([[0, 0, 5]], 0.5, mass=2.0), walls)
    free = state.control.free.copy()
    free[1, :3] = True
    control = state.control._replace(free=free, gravity=pull)
    state = state._replace(control=control)
    unbalanced = ss.measure.unbalanced_forces(state, ss.forces(state, law)[0])
    np.testing.assert_allclose(unbalanced[:, :3], np.outer([2.0, mass], pull), rtol=1e-15)
    end, _, _ = ss.run(state, law, 100, 0.1)
    # velocity Verlet is exact under a constant force, up to a hundred roundings
    np.testing.assert_allclose(end.walls.point[0], 0.5 * 10.0**2 * pull, rtol=1e-12)
    np.testing.assert_allclose(end.grains.position[0] - [0, 0, 5], 0.5 * 10.0**2 * pull, rtol=1e-12)


def test_voigt_notation_is_what_its_order_says():
    """σ = C ε in components equals the matrix on (ε_xx, ε_yy, ε_zz, 2ε_yz, 2ε_xz, 2ε_xy)."""
    rng = np.random.default_rng(0)
    tensor, strain = rng.normal(size=(3, 3, 3, 3)), rng.normal(size=(3, 3))
    tensor, strain = tensor + tensor.transpose(1, 0, 2, 3), strain + strain.T
    stress = np.einsum("abcd,cd->ab", tensor, strain)
    xx, yy, zz, yz, xz, xy = (0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)
    given = [strain[xx], strain[yy], strain[zz], 2 * strain[yz], 2 * strain[xz], 2 * strain[xy]]
    np.testing.assert_allclose(voigt(tensor) @ given, [stress[k] for k in (xx, yy, zz, yz, xz, xy)], atol=1e-13)
    flat, plane = tensor[:2, :2, :2, :2], strain[:2, :2]
    given = [plane[0, 0], plane[1, 1], 2 * plane[0, 1]]
    stress = np.einsum("abcd,cd->ab", flat, plane)
    np.testing.assert_allclose(voigt(flat) @ given, [stress[0, 0], stress[1, 1], stress[0, 1]], atol=1e-13)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_force_on_the_cell_is_the_virtual_work_of_contacts_and_stress(dim):
    """−∂(E + V σ_ab G_ab)/∂(ℓ G_ab), ℓ = V^(1/dim), by differences of the elastic energy of a strained pair."""
    law, cell = ss.laws.linear(kn=3.0, kt=0.5, mu=0.4), [1.9, 2.2, 2.5][:dim] + [1.0] * (3 - dim)
    wanted = np.zeros((3, 3))
    wanted[:dim, :dim] = np.array([[0.3, -0.1, 0.05], [0.2, 0.7, -0.15], [0.25, 0.35, 0.4]])[:dim, :dim]
    control = ss.control.loads(2)
    free = np.zeros((3, 3), bool)
    free[:dim, :dim] = True
    control = control._replace(cell_free=free, stress=wanted)
    place = np.array([[0.4, 0.5, 0.6], [0.95, 1.2, 0.9]])
    place[:, dim:] = 0.0
    make = ss.disks if dim == 2 else ss.spheres
    state = ss.assembly(make(place, 0.5), cell=ss.box(cell, np.arange(3) < dim, dim), control=control)
    freedom = ss.freedom(state)
    force = ss.modes.residual_vector(state, ss.forces(state, law)[0], freedom)
    space, step = np.prod(cell[:dim]), 1e-6
    for k in np.flatnonzero(freedom.axis == 6):
        a, b = divmod(int(freedom.component[k]) - 6 * state.n_bodies, 3)
        gradient = np.zeros((3, 3))
        gradient[a, b] = step / space ** (1 / dim)
        energies = [
            measure.elastic_energy(with_neighbor_list(ss.packings.strained(state, sign * gradient)), law)
            for sign in (1, -1)
        ]
        work = space * wanted[a, b] * gradient[a, b] / step
        # the third derivative times step², and round-off over step
        assert force[k] == pytest.approx(-(energies[0] - energies[1]) / (2 * step) - work, abs=1e-9)


def test_a_pressure_on_a_lid_works_along_its_displacement():
    """`pressed`: a lid of a length under p is free along p alone, and p times its length is the force on it."""
    control = ss.control.force_controlled(ss.control.loads(1, 2), [2], [0, -1e-3 * 1.7])
    walls = ss.flat_walls([[0, 0, 0], [0, 1, 0]], [[0, 1, 0], [0, -1, 0]])
    state = ss.assembly(ss.disks([[0, 0.5]], 0.4), walls, ss.box(dim=2), control)
    unbalanced = ss.measure.unbalanced_forces(state, ss.forces(state, ss.laws.linear(kn=1.0, kt=0.5))[0])
    assert unbalanced[2].tolist() == [0, -1e-3 * 1.7, 0, 0, 0, 0]
    assert ss.freedom(state).component[-1] == 6 * 2 + 1


def test_the_room_that_a_strain_leaves_is_what_the_closest_pair_not_listed_has_left():
    """A pair at the edge of the skin, along the direction of compression: (w + s)(1 − e) − w."""
    made, widest, skin = np.array([[4.0, 0, 0], [1.0, 5.0, 0], [-0.5, 0.3, 6.0]]), 1.2, 0.3
    for change in (0.03, 0.2, 0.5):
        stretch = np.diag([1.0, 1 - change, 1.0])
        left, deformation = remaining_skin(made @ stretch.T, made, skin, widest)
        np.testing.assert_allclose(deformation, stretch, atol=1e-14)
        assert left == pytest.approx((widest + skin) * (1 - change) - widest, abs=1e-14)
    rng = np.random.default_rng(0)
    for _ in range(200):
        stretch = np.eye(3) + rng.normal(0, 0.05, (3, 3))
        left, deformation = remaining_skin(made @ stretch.T, made, skin, widest)
        np.testing.assert_allclose(deformation, stretch, atol=1e-13)
        apart = rng.normal(size=3)
        apart *= (widest + skin) / np.linalg.norm(apart)
        assert np.linalg.norm(stretch @ apart) - widest >= left - 1e-12


def test_stress_of_a_pair_in_a_box():
    """Compression positive: σ_xx = F_n r/V, whatever the sign of the normal."""
    law, overlap = ss.laws.linear(kn=3.0, kt=0.5), 0.02
    cell = ss.box([4.0, 5.0, 6.0], [True, True, True])
    state = ss.assembly(ss.spheres([[1, 1, 1], [2 - overlap, 1, 1]], 0.5), cell=cell)
    state = ss.accept(state, ss.forces(state, law)[1])
    assert measure.stress(state, law)[0, 0] == pytest.approx(3.0 * overlap * (1 - overlap) / 120, rel=1e-12)
