"""Elastic moduli: lattices in closed form, differences of equilibria, and what can't have any."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.solve.moduli import ElasticModuli, isotropic, isotropic_tensor, symmetrised, voigt
from tests.modes.conftest import LAW, OVERLAP, sheared, triangular


def cubic(law, across=3):
    """Face-centred cubic, cells of edge √2, spheres of diameter 1."""
    site = np.array([[0, 0, 0], [0, 1, 1], [1, 0, 1], [1, 1, 0]]) / 2**0.5
    steps = 2**0.5 * np.stack(np.meshgrid(*[np.arange(across)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    place = (steps[:, None] + site).reshape(-1, 3)
    return ss.packings.from_arrays(place, np.full(len(place), 0.5 + OVERLAP / 2), law, cell=[across * 2**0.5] * 3)


@pytest.mark.parametrize("kt", [0.0, 0.4])
def test_triangular_lattice(kt):
    """Three bonds a site: λ = (√3/4)(k_n − k_t), G = (√3/4)(k_n + k_t), no non-affine motion."""
    law = ss.laws.linear(1.3, kt, 0.5)
    moduli = ss.modes.elastic_moduli(triangular(law), law)
    bulk, shear = 3**0.5 / 2 * 1.3, 3**0.5 / 4 * (1.3 + kt)
    # an overlap of 1e-8 carries a pressure that changes C by as much
    np.testing.assert_allclose([moduli.bulk, moduli.shear], [bulk, shear], rtol=1e-7)
    assert moduli.poisson == pytest.approx((bulk - shear) / (bulk + shear), rel=1e-6)
    assert moduli.anisotropy < 1e-7 and moduli.asymmetry < 1e-7
    assert np.abs(symmetrised(moduli.non_affine)).max() < 1e-7  # disks follow a rotation by turning, no strain
    assert np.abs(moduli.motion[moduli.free.axis < 3]).max() < 1e-7
    np.testing.assert_allclose(moduli.young, 2 * shear * (1 + moduli.poisson))
    bounds = ss.modes.moduli_bounds(triangular(law), law)
    np.testing.assert_allclose(bounds.bulk, bulk, rtol=1e-7)
    np.testing.assert_allclose(bounds.shear[1:], shear, rtol=1e-7)
    assert bounds.shear[0] == pytest.approx(shear, rel=1e-7) if kt == 0 else 0 < bounds.shear[0] < shear


def test_face_centred_cubic():
    """Central springs k of length 1: C_11 = 2k/a, C_12 = C_44 = k/a, a = √2."""
    law = ss.laws.linear(1.0, 0.0, 0.5)
    moduli = ss.modes.elastic_moduli(cubic(law), law)
    unit = 1 / 2**0.5
    truth = unit * np.diag([2.0, 2, 2, 1, 1, 1])
    truth[:3, :3] += unit * (1 - np.eye(3))
    np.testing.assert_allclose(moduli.voigt, truth, atol=1e-7)
    assert moduli.bulk == pytest.approx(4 / 3 * unit, rel=1e-7)


@pytest.mark.parametrize(("dim", "n", "fraction"), [(2, 16, 0.88), (3, 20, 0.68)])
def test_differences_of_equilibria(dim, n, fraction):
    state = sheared(n, dim, fraction, 2e-3, seed=3)
    moduli = ss.modes.elastic_moduli(state, LAW)
    h, size, part = 1e-7, np.abs(moduli.tensor).max(), slice(0, dim)
    for c, d in [(0, 0), (0, 1), (1, 0), (dim - 1, 1)]:
        gradient, stresses, carried = np.zeros((dim, dim)), [], []
        gradient[c, d] = h
        for sign in (1, -1):
            moved = with_neighbor_list(ss.packings.strained(state, sign * gradient))
            carried.append(ss.measure.stress(moved, LAW)[part, part])
            end, outcome = ss.newton(moved, LAW, tolerance=1e-15)
            assert outcome.ok
            stresses.append(ss.measure.stress(end, LAW)[part, part])
        # residuals of 1e-15 over steps of 1e-7
        np.testing.assert_allclose(-(stresses[0] - stresses[1]) / 2 / h, moduli.tensor[:, :, c, d], atol=1e-7 * size)
        np.testing.assert_allclose(-(carried[0] - carried[1]) / 2 / h, moduli.affine[:, :, c, d], atol=1e-7 * size)
    for strain, error in ((1e-4, 4e-4), (1e-3, 4e-3)):  # three times the strain
        end, outcome = ss.equilibrate(ss.packings.strained(state, strain * np.outer(*np.eye(dim)[:2])), LAW)
        change = (ss.measure.stress(end, LAW) - ss.measure.stress(state, LAW))[0, 1]
        assert outcome.ok and change == pytest.approx(-strain * moduli.tensor[0, 1, 0, 1], rel=error)
    assert np.abs(moduli.non_affine).max() > 0.1 * size
    assert 1e-4 < moduli.asymmetry < 0.1  # friction has no potential
    assert np.linalg.eigvalsh(moduli.voigt + moduli.voigt.T).min() > 0


def test_a_rattler_changes_nothing():
    law = ss.laws.linear(1.0, 0.4, 0.5)
    lattice = triangular(law)
    keep = np.arange(16) != 5
    place, radius = lattice.grains.position, lattice.grains.radius
    cell = np.diag(lattice.cell.vectors)[:2]
    without = ss.packings.from_arrays(place[keep, :2], radius[keep], law, cell=cell, dim=2)
    small = np.where(keep, radius, 0.3)
    loose = ss.packings.from_arrays(place[:, :2], small, law, cell=cell, dim=2)
    a, b = ss.modes.elastic_moduli(without, law), ss.modes.elastic_moduli(loose, law)
    np.testing.assert_allclose(a.voigt, b.voigt, rtol=1e-12)
    assert len(a.free) == len(b.free) == 45
    assert np.abs(a.non_affine).max() > 0.01


def test_isotropic_parts_of_an_isotropic_tensor():
    for dim in (2, 3):
        tensor = isotropic_tensor(dim, 1.7, 0.6)
        np.testing.assert_allclose(isotropic(tensor), (1.7, 0.6))
        assert voigt(tensor)[-1, -1] == pytest.approx(0.6)
        odd = np.zeros_like(tensor)
        odd[0, 0, 1, 1], odd[1, 1, 0, 0] = 2.0, -2.0
        assert ElasticModuli(odd, odd, None, None).asymmetry == pytest.approx(1)  # largest share of an odd part


def test_what_has_no_moduli_is_reported():
    with pytest.raises(ValueError, match="periodic in all its dimensions"):
        ss.modes.elastic_moduli(ss.packings.disk_array(4, press=5e-5), LAW)
    law = ss.laws.linear()
    far = ss.packings.from_arrays([[0, 0], [3, 0]], [0.5, 0.5], law, cell=[6.0, 6.0], dim=2)
    with pytest.raises(ValueError, match="only rattlers"):
        ss.modes.elastic_moduli(far, law)
