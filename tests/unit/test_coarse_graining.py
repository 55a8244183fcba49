"""Coarse-grained fields against sums over the packing, the balance of forces, and a slow obvious sum."""

import numpy as np
import pytest
from scipy.integrate import quad

import stickslip as ss
from tests.conftest import make_law, make_packing, stirred

LAW = make_law("hertz_mindlin", "sharp")


def moving(dim, wall=True, seed=0):
    """A small packing with memory, moving."""
    rng = np.random.default_rng(seed)
    state = stirred(make_packing(dim, seed, wall=wall), LAW, rng)
    velocity = rng.normal(0, 0.1, (len(state.grains.radius), 3))
    velocity[:, dim:] = 0
    return state._replace(grains=state.grains._replace(velocity=velocity))


@pytest.mark.parametrize(("dim", "lean"), [(2, 0.0), (3, 0.0), (3, 0.4), (2, 0.4)])
def test_means_over_a_periodic_cell_are_those_of_the_packing(dim, lean):
    state, _ = ss.packings.jammed(12, packing_fraction=0.88 if dim == 2 else 0.7, dim=dim, seed=3)
    state = ss.packings.sheared(state, lean)
    state = stirred(state, LAW, np.random.default_rng(0))
    grains = state.grains._replace(velocity=np.full_like(state.grains.position, 0.5) * (np.arange(3) < dim))
    state = state._replace(grains=grains)
    fields = ss.measure.coarse_grained(state, LAW, width=0.6, spacing=0.4)
    assert set(fields.density.dims) == set(("abc" if lean else "xyz")[:dim])
    mean = fields.mean(fields.density.dims)
    assert mean.stress.values == pytest.approx(ss.measure.stress(state, LAW)[:dim, :dim], abs=1e-7)
    assert float(mean.packing_fraction) == pytest.approx(ss.measure.packing_fraction(state), rel=1e-6)
    area = ss.measure.packing_fraction(state) / mean.packing_fraction
    assert float(mean.density * area) == pytest.approx(grains.mass.sum() / abs(np.linalg.det(_cell(state))), rel=1e-6)
    assert np.abs(fields.velocity - 0.5).max() < 1e-12 and np.abs(fields.kinetic_stress).max() < 1e-12


def _cell(state):
    return state.cell.vectors[: state.cell.dim, : state.cell.dim]


@pytest.mark.parametrize("dim", [2, 3])
def test_stress_and_density_at_a_point_are_sums_over_images(dim):
    state, width = moving(dim), 0.3
    fields = ss.measure.coarse_grained(state, LAW, width=width, spacing=0.5)
    place = dict.fromkeys(fields.density.dims, 1)
    here = fields.isel(place)
    point = np.append([float(here[axis]) for axis in fields.density.dims], np.zeros(3 - dim))
    norm, periodic = (2 * np.pi * width**2) ** (-dim / 2), state.cell.periodic
    shifts = [(k * periodic) @ state.cell.vectors for k in np.array(list(np.ndindex(9, 9, 9))) - 4]
    shifts = np.unique(shifts, axis=0)

    def gauss(x):
        return norm * np.exp(-0.5 * ((point - x - shifts) ** 2).sum(axis=1) / width**2).sum()

    grains = state.grains
    density = sum(m * gauss(x) for m, x in zip(grains.mass, grains.position, strict=True))
    assert float(here.density) == pytest.approx(density, rel=1e-6)
    flux = sum(m * gauss(x) * v for m, x, v in zip(grains.mass, grains.position, grains.velocity, strict=True))
    assert here.velocity.values == pytest.approx((flux / density)[:dim], rel=1e-6)
    thermal = sum(
        m * gauss(x) * np.outer(v - flux / density, v - flux / density)
        for m, x, v in zip(grains.mass, grains.position, grains.velocity, strict=True)
    )
    assert here.kinetic_stress.values == pytest.approx(thermal[:dim, :dim], rel=1e-5, abs=1e-8)
    stress = np.zeros((3, 3))
    force, branch = ss.measure.contact_forces(state, LAW), ss.measure.branch_vectors(state)
    for row in ss.measure.touching(state):
        x = grains.position[state.contacts.i[row]]
        stress += np.outer(force[row], branch[row]) * quad(lambda s, x=x, r=branch[row]: gauss(x - s * r), 0, 1)[0]
    assert here.stress.values == pytest.approx(stress[:dim, :dim], rel=1e-6, abs=1e-8)


def test_in_equilibrium_the_divergence_of_the_stress_is_the_weight():
    """Away from the floor, ∂_b σ_ab = ρ g_a at every point, whatever the width."""
    rng = np.random.default_rng(2)
    place = np.stack([np.tile(np.arange(4) * 1.02, 5), np.repeat(0.5 + 0.9 * np.arange(5), 4)], axis=1)
    place[:, 0] += 0.5 * np.repeat(np.arange(5) % 2, 4) + rng.uniform(-0.01, 0.01, 20)
    grains = ss.disks(np.column_stack([place, np.zeros(20)]), np.full(20, 0.5))
    cell = ss.box([4.08, 10.0, 1.0], [True, False, False], 2)
    control = ss.control.loads(20, 1, gravity=(0, -1e-3, 0))
    state, outcome = ss.relax(ss.assembly(grains, ss.flat_walls([0, 0, 0], [0, 1, 0]), cell, control), LAW)
    assert outcome.ok
    h, width = 0.04, 0.25
    fields = ss.measure.coarse_grained(state, LAW, width=width, spacing=h)
    inside = fields.sel(y=slice(6 * width, None))
    scale = float(np.abs(1e-3 * fields.density).max())
    step = [float(fields[axis][1] - fields[axis][0]) for axis in "xy"]
    for component, gravity in (("x", 0.0), ("y", -1e-3)):
        across, up = (inside.stress.sel(component=component, along=along).values for along in "xy")
        divergence = (np.roll(across, -1, 0) - np.roll(across, 1, 0))[:, 1:-1] / (2 * step[0])
        divergence += (up[:, 2:] - up[:, :-2]) / (2 * step[1])
        weight = gravity * inside.density.values[:, 1:-1]
        assert np.abs(divergence - weight).max() < 0.02 * scale
    assert np.abs(1e-3 * inside.density).max() > 0.3 * scale


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width": 0.0}, r"width must be positive.*, got 0.0"),
        ({"width": 0.1, "spacing": -1.0}, r"spacing must be positive, got -1.0"),
        ({"width": 0.1, "spacing": 1e-4}, r"spacing = 0.0001 gives a grid of .* points, more than 1e\+07"),
        ({"width": 1e9}, r"width = 1e\+09 exceeds the cell"),
    ],
)
def test_wrong_widths_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        ss.measure.coarse_grained(moving(2), LAW, **options)
