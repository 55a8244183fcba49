"""Inflated grains: Lamé's solution, steps against the linear response, fits of screening to fields made of it."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import jv, spherical_jn, spherical_yn, stdtrit, yv

import stickslip as ss
from stickslip.solve import inclusion as module
from stickslip.solve.inclusion import Inflation
from tests.modes.conftest import sheared, triangular

SMOOTH = ss.laws.hertz_mindlin(mu=0.0)
ROUGH = ss.laws.hertz_mindlin(mu=0.3)


@pytest.fixture(scope="module")
def deep():
    """Frictionless disks deep in the jammed phase."""
    return ss.packings.jammed(1000, packing_fraction=0.95, dim=2, seed=1)[0]


@pytest.fixture(scope="module")
def rough():
    return sheared(60, 2, 0.88, 2e-4, seed=2, law=ROUGH)


@pytest.mark.parametrize("kt", [0.0, 0.5])
def test_a_lattice_answers_as_lame_says_from_its_moduli(kt):
    """K + G = (√3/4)(3k_n + k_t); nothing is fitted. A lattice of sixfold symmetry has no tangential displacement."""
    law = ss.laws.linear(1.0, kt, 0.5)
    state = triangular(law, 40)
    field = ss.modes.inflate(state, law, growth=1e-9)
    fits = field.fit()
    expected = field.elastic(fits.rings.radius)
    # beyond two diameters discreteness leaves 0.3 %
    np.testing.assert_allclose(fits.rings.mean[0], expected, atol=3e-3 * expected.max())
    assert np.abs(fits.rings.mean[1]).max() < 1e-8 * expected.max()
    assert fits.preferred == "elastic"


def test_disks_deep_in_the_jammed_phase_answer_as_an_elastic_body(deep):
    field = ss.modes.inflate(deep, SMOOTH, range(0, 1000, 20))
    fits, share = field.fit(), np.pi / field.volume
    elastic = fits.models[0]
    assert abs(elastic.near.real - fits.lame) < elastic.errors[0] < 0.2 * fits.lame
    assert abs(elastic.far.real + share * elastic.near.real) < elastic.errors[1] + share * elastic.errors[0]
    assert fits.preferred == "elastic" and "elastic body" in fits.verdict
    dipole, odd = fits.models[1:]
    assert abs(dipole.screening.real) < dipole.errors[-1]
    assert abs(odd.screening.imag) < odd.errors[-1]


@pytest.mark.slow
def test_spheres_answer_as_an_elastic_body():
    state, _ = ss.packings.jammed(1000, packing_fraction=0.72, seed=1, tolerance=1e-12)
    field = ss.modes.inflate(state, SMOOTH, range(0, 1000, 20), growth=1e-9)
    fits = field.fit()
    assert [fit.model for fit in fits.models] == ["elastic", "dipole"] and fits.preferred == "elastic"
    assert abs(fits.models[0].near.real - fits.lame) < fits.models[0].errors[0] < 0.35 * fits.lame


def test_the_dipole_is_the_force_of_the_grain_and_the_answer_of_its_neighbors(deep):
    """ΔP by an independent route: the stress of an equilibrium with a larger grain, in one quasi-static step."""
    field, growth = ss.modes.inflate(deep, SMOOTH, [5]), 1e-6
    path = ss.protocols.inflate(deep, SMOOTH, [5], growth=growth, steps=1)
    moduli = ss.modes.elastic_moduli(deep, SMOOTH)
    rise = ss.measure.pressure(path.states[0], SMOOTH) - ss.measure.pressure(deep, SMOOTH)
    expected = rise * field.volume / (2 * np.pi * (moduli.bulk + moduli.shear))
    assert field.lame[0] == pytest.approx(expected, rel=1e-4)  # both are differences at that growth


LAWS = {
    "smooth": SMOOTH, "rough": ROUGH, "reff": ss.laws.hertz_mindlin_reff(mu=0.3),
    "lever": ss.laws.with_lever(ROUGH, "overlap"), "rolling": ss.laws.with_rolling(ROUGH, k_roll=0.1, mu_roll=10.0),
}  # fmt: skip


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_small_steps_are_the_linear_response(law):
    state = sheared(60, 2, 0.88, 2e-4, seed=2, law=law)
    centers = [3, 17]
    field = ss.modes.inflate(state, law, centers, growth=1e-6, within=1.0)
    off = []
    for growth in (1e-5, 1e-6):
        path = ss.protocols.inflate(state, law, centers, growth=growth, steps=2, within=1.0)
        assert not path.changes.any()
        off.append(np.abs(path.displacement / growth - field.displacement / 1e-6).max())
    size = np.abs(field.displacement).max() / 1e-6
    assert off[1] < 1e-3 * size and off[1] < 0.2 * off[0]  # the difference is of the order of the growth


def test_each_inflated_grain_is_an_experiment_of_its_own(rough):
    both, one = (ss.modes.inflate(rough, ROUGH, centers) for centers in ([3, 17], [17]))
    np.testing.assert_allclose(both.displacement[1], one.displacement[0], atol=1e-9 * np.abs(one.displacement).max())
    assert both.lame[1] == pytest.approx(one.lame[0], rel=1e-9)


def test_angles_of_grains_do_not_matter(rough):
    """A grain that has turned before does not turn further when it grows."""
    grains, contacts = rough.grains, rough.contacts
    angle, count = np.array([0, 0, 2.0]) * np.ones((60, 1)), contacts.count[0]
    roll = contacts.roll.copy()
    i, j = contacts.i[:count], contacts.j[:count]
    roll[:count] += (grains.radius[i] + grains.radius[j])[:, None] * angle[0]
    turned = rough._replace(grains=grains._replace(angle=grains.angle + angle), contacts=contacts._replace(roll=roll))
    ends = [ss.protocols.inflate(state, ROUGH, [3], steps=1).states[0] for state in (rough, turned)]
    a, b = (end.grains.angle - start.grains.angle for end, start in zip(ends, (rough, turned), strict=True))
    np.testing.assert_allclose(a, b, atol=1e-6 * np.abs(a).max())


def test_a_rim_of_frozen_grains_is_a_boundary(deep):
    middle = deep.cell.vectors.sum(axis=0)[:2] / 2
    far = np.linalg.norm(ss.measure.wrapped(deep)[:, :2] - middle, axis=1) > 14
    held = deep._replace(control=ss.control.fixed(deep.control, np.flatnonzero(far)))
    field = ss.modes.inflate(held, SMOOTH)
    assert 12 < field.outer < 16 and np.isnan(field.lame).all()
    assert not field.displacement[0, far].any() and not field.counted[0, far].any()
    elastic = field.fit().models[0]
    at_rim = elastic.displacement(np.array([field.outer])).real
    assert abs(at_rim[0]) < 0.2 * abs(elastic.near) / field.outer


def made(rng, screening, noise, dim=2, centers=1, grains=800, edge=18.0):
    """Field of given κ² with independent noise."""
    away = rng.normal(size=(centers, grains, dim))
    distance = edge * rng.uniform(0, 1, (centers, grains)) ** (1 / dim) + 0.5
    normal = away / np.linalg.norm(away, axis=2, keepdims=True)
    k, r = np.sqrt(complex(screening)), distance
    if dim == 3:
        w = -(k**2) * spherical_yn(1, k * r) + 0.02 * k * spherical_jn(1, k * r) if k else 1 / r**2 - r / edge**3 + 0j
    else:
        w = -np.pi / 2 * k * yv(1, k * r) + 0.3 * k * jv(1, k * r) if k else 1 / r - r / edge**2 + 0j
    across = np.stack([-normal[..., 1], normal[..., 0]], axis=2) if dim == 2 else 0.0
    u = w.real[..., None] * normal + w.imag[..., None] * across + noise * rng.normal(size=normal.shape)
    counted = np.ones(r.shape, bool)
    rest = (1.0, edge, np.nan, np.full(centers, np.nan), [], np.zeros((centers, 0, 4), int))
    return Inflation(1.0, np.arange(centers), normal * distance[..., None], u, counted, *rest)


@pytest.mark.parametrize(("screening", "dim"), [(0.03 + 0.02j, 2), (0.04 - 0.01j, 2), (0.05, 3)])
def test_screening_is_recovered(screening, dim):
    fits = made(np.random.default_rng(0), screening, 1e-5, dim, grains=40_000).fit()
    best = fits.models[-1]
    assert best.screening == pytest.approx(screening, abs=1e-4)
    r = np.linspace(3, 15, 5)
    k = np.sqrt(complex(screening))
    if dim == 2:
        truth = -np.pi / 2 * k * yv(1, k * r) + 0.3 * k * jv(1, k * r)
        np.testing.assert_allclose(best.displacement(r), truth, atol=1e-3)
    assert fits.preferred == ("odd" if dim == 2 else "dipole")


def test_aicc_of_all_models_is_corrected_for_the_number_of_rings():
    """Burnham and Anderson: χ² over its excess, which is that of the richest model for all, + 2k + 2k(k+1)/(n−k−1)."""
    excess = []
    for fit in made(np.random.default_rng(0), 0.03 + 0.02j, 1e-2).fit().models:
        k, n = len(fit.errors), fit.rings.mean.size
        excess.append(fit.misfit / (fit.aicc - 2 * k - 2 * k * (k + 1) / (n - k - 1)))
    assert len(excess) == 3 and excess == pytest.approx([excess[0]] * 3, rel=1e-9) and excess[0] >= 1


def test_errors_follow_from_the_scatter_of_parts_with_students_quantile():
    rng, rings, parts, n = np.random.default_rng(2), 3, 5, 300
    ring, part, value = rng.integers(rings, size=n), rng.integers(parts, size=n), rng.normal(size=n)
    found = module._ring_means(ring, [np.ones(n), value], part, parts)
    mean = np.array([value[ring == k].mean() for k in range(rings)])
    sums = [[(value - mean[ring])[(ring == k) & (part == p)].sum() for p in range(parts)] for k in range(rings)]
    np.testing.assert_allclose(found.mean[0], mean)
    np.testing.assert_allclose(found.covariance, parts * np.cov(sums) / np.outer(found.count, found.count))
    field = made(rng, 0.0, 0.01).fit().models[0].rings
    few, many = (module.screening_fits(field._replace(parts=p), 1.0).models[0].errors for p in (8, 800))
    assert few / many == pytest.approx(np.full(len(few), stdtrit(7, 0.975) / stdtrit(799, 0.975)))


def test_rings_lie_between_the_given_distances():
    field = made(np.random.default_rng(0), 0.0, 0.01, grains=4000)
    whole, part = (field.fit(**ends).models[0].rings.radius for ends in ({}, {"inner": 5.0, "outer": 12.0}))
    assert whole[0] < 5 < part[0] < part[-1] < 12 < whole[-1]


def test_a_field_without_tangential_displacement_is_fitted():
    field = made(np.random.default_rng(0), 0.0, 0.0)
    normal = field.offset / np.linalg.norm(field.offset, axis=2, keepdims=True)
    fits = field._replace(displacement=normal / np.linalg.norm(field.offset, axis=2, keepdims=True)).fit()
    assert fits.preferred == "elastic" and fits.models[0].near == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("centers", [1, pytest.param(12, marks=pytest.mark.slow)])
def test_intervals_contain_the_truth_as_often_as_they_say(centers):
    rng, truth, draws = np.random.default_rng(1), 0.03 + 0.02j, 40
    inside = np.zeros((draws, 2), bool)
    for draw in range(draws):
        odd = made(rng, truth, 0.01 * np.sqrt(centers), centers=centers, grains=500).fit().models[2]
        off = odd.screening - truth
        inside[draw] = np.abs([off.real, off.imag]) < odd.errors[-2:]
    assert (inside.sum(axis=0) >= 33).all()  # of 40: 38 expected, with a standard deviation of 1.4
    assert not inside.all()


def test_an_odd_field_is_told_from_an_elastic_one():
    rng = np.random.default_rng(2)
    kinds = {0.0: [], 0.03: [], 0.03 + 0.02j: []}
    for _ in range(5):
        for screening, names in kinds.items():
            names.append(made(rng, screening, 0.01).fit().preferred)
    assert kinds[0.0].count("elastic") >= 4
    assert kinds[0.03].count("dipole") >= 4
    assert kinds[0.03 + 0.02j].count("odd") == 5


def test_the_growth_at_which_a_contact_changes_bounds_the_linear_response(rough):
    with pytest.raises(ValueError, match=r"before growth = 0.1, the contact \(\d+, \d+\) ") as problem:
        ss.modes.inflate(rough, ROUGH, [3], growth=0.1)
    allowed = float(str(problem.value).split(": use ")[1].split(" for")[0])
    assert 0 < allowed < 0.1
    ss.modes.inflate(rough, ROUGH, [3], growth=0.99 * allowed)
    path = ss.protocols.inflate(rough, ROUGH, [3], growth=0.1, steps=5)
    assert path.changes.sum() > 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"growth": -1.0}, "above −1"), ({"growth": 0.0}, "at least 1e-09 in size"), ({"growth": 5.0}, "at most 1"),
        ({"growth": 1.0}, "for a linear response"), ({"grain": 60}, "bodies have numbers"),
        ({"grain": []}, "each grain once"), ({"grain": [3, 3]}, "each grain once"), ({"within": -1.0}, "within"),
    ],
)  # fmt: skip
def test_what_cannot_be_inflated_is_said(rough, change, message):
    with pytest.raises(ValueError, match=message):
        ss.modes.inflate(rough, ROUGH, **{"grain": 3, **change})


def test_grains_that_bear_nothing_or_are_held_are_not_inflated(rough):
    held = rough._replace(control=ss.control.fixed(rough.control, [3]))
    loose, _ = ss.packings.jammed(100, packing_fraction=0.86, dim=2, seed=1)
    force = np.zeros((60, 3))
    force[7, 0] = 1e-3
    pulled = rough._replace(control=rough.control._replace(force=force))
    rattler = np.flatnonzero(ss.measure.rattlers(loose, 3))[0]
    for function in (ss.modes.inflate, ss.protocols.inflate):
        with pytest.raises(ValueError, match="grain 3 is held in place"):
            function(held, ROUGH, 3)
        with pytest.raises(ValueError, match=f"grain {rattler} is a rattler"):
            function(loose, SMOOTH, rattler)
        with pytest.raises(ValueError, match="not in equilibrium"):
            function(pulled, ROUGH, 3)
    with pytest.raises(ValueError, match=r"1 rings of width .* a fit needs 5"):
        ss.modes.inflate(rough, ROUGH).fit()


def rotated(tensor, angle):
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    return np.einsum("ai,bj,ck,dl,ijkl->abcd", turn, turn, turn, turn, tensor)


def test_odd_moduli_are_those_of_the_mean_over_all_directions():
    rng = np.random.default_rng(3)
    angles = 2 * np.pi * np.arange(8) / 8  # exact for a tensor of rank four
    tensor = rng.normal(size=(2, 2, 2, 2))
    mean = np.mean([rotated(tensor, angle) for angle in angles], axis=0)
    moduli, average = (ss.results.ElasticModuli(t, 0 * t, np.zeros((0, 2, 2)), None) for t in (tensor, mean))
    for name in ("bulk", "shear", "odd_shear", "odd_torque"):
        assert getattr(average, name) == pytest.approx(getattr(moduli, name), abs=1e-12)
    # a closed cycle of shear strain yields 2 K^o × its area, and dilation a torque
    phase = np.linspace(0, 2 * np.pi, 4001)
    s2, s3 = 0.3 * np.cos(phase), 0.2 * np.sin(phase)
    strain = np.array([[s2, s3], [s3, -s2]]) / 2
    tension = np.einsum("abcd,cdt->abt", mean, strain)
    middle = (tension[..., 1:] + tension[..., :-1]) / 2
    yields = -(middle * np.diff(strain)).sum()
    assert yields == pytest.approx(2 * moduli.odd_shear * np.pi * 0.3 * 0.2, rel=1e-5)
    dilated = np.einsum("abcc->ab", mean)
    assert dilated[1, 0] - dilated[0, 1] == pytest.approx(4 * moduli.odd_torque)


def test_a_packing_with_friction_has_an_odd_modulus_and_one_without_has_none(rough):
    smooth = sheared(60, 2, 0.88, 2e-4, seed=2, law=SMOOTH)
    free, bound = ss.modes.elastic_moduli(smooth, SMOOTH), ss.modes.elastic_moduli(rough, ROUGH)
    assert abs(free.odd_shear) < 1e-3 * abs(bound.odd_shear) + 1e-12
    assert 0 < abs(bound.odd_shear) < 0.1 * bound.shear


def test_the_figure_shows_rings_fits_and_the_line_from_the_moduli(deep):
    field = ss.modes.inflate(deep, SMOOTH, range(0, 1000, 50))
    fits = field.fit()
    figure = ss.figures.inclusion(field, fits)
    for k, axes in enumerate(figure.axes):
        points = axes.containers[0][0].get_xydata()
        rings = np.stack([fits.rings.radius, fits.rings.mean[k] / field.growth], axis=1)
        np.testing.assert_allclose(points, rings / field.diameter)
        assert axes.get_xlabel() == "distance [mean diameters]"
        lines = {line.get_label(): line.get_xydata() for line in axes.lines}
        for fit in fits.models:
            r, u = field.diameter * lines[fit.model].T
            w = fit.displacement(r) / field.growth
            np.testing.assert_allclose(u, (w.real, w.imag)[k])
        assert ("elastic, from the moduli" in lines) == (k == 0)
    drawn = {line.get_label(): line for line in figure.axes[0].lines}
    r, u = field.diameter * drawn["elastic, from the moduli"].get_xydata().T
    widths = [drawn[name].get_linewidth() for name in ("elastic", "dipole", "odd", "elastic, from the moduli")]
    assert widths == sorted(widths, reverse=True)  # all are visible where they coincide
    np.testing.assert_allclose(u, fits.lame * (1 / r - np.pi / field.volume * r) / field.growth)


@pytest.mark.parametrize("dim", [2, 3])
def test_elastic_displacements_vanish_where_a_ball_has_the_volume_of_the_packing(dim):
    """What an inflated grain displaces is taken up by the area or volume of the whole packing."""
    radius = 3.0
    volume = {2: np.pi * radius**2, 3: 4 / 3 * np.pi * radius**3}[dim]
    made = SimpleNamespace(dim=dim, volume=volume, lame=np.array([0.5, 1.5]))
    found = Inflation.elastic(made, np.array([1.0, radius]))
    assert found == pytest.approx([1 - radius**-dim, 0.0], abs=1e-14)
