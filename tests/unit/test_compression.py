"""Frictional packings compressed to a pressure, and the quench of frictionless ones."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.measure import elastic_energy
from stickslip.loading import compression, packing
from stickslip.loading.packing import frictionless, jammed, random_grains
from stickslip.solve.equilibrate import quench

compressed = ss.packings.compressed
LAWS = {
    "hertz_mindlin": ss.laws.hertz_mindlin(),
    "reff": ss.laws.hertz_mindlin_reff(),
    "linear": ss.laws.linear(kn=0.3),
}


def energy(state, law):
    """Elastic energy and forces, from other kernels than that of the quench."""
    state = with_neighbor_list(state, law)
    loads, trial = ss.forces(state, law)
    return elastic_energy(ss.accept(state, trial), law), loads.force


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", LAWS)
def test_a_quench_ends_at_a_minimum_of_the_energy(name, dim):
    law = frictionless(LAWS[name])
    start = random_grains(60, {2: 0.9, 3: 0.7}[dim], dim, radius=(0.5, 0.7), mass=1.0, i0=None, seed=4)
    end = quench(start, law, 1e-14)
    lowest, force = energy(end, law)
    assert lowest > 1e-6
    assert np.abs(force).max() <= 1.1e-14  # round-off of positions
    assert lowest < 0.2 * energy(start, law)[0]
    rng = np.random.default_rng(0)
    for _ in range(5):
        move = np.zeros_like(end.grains.position)
        move[:, :dim] = rng.normal(scale=1e-3, size=(60, dim))
        moved = end._replace(grains=end.grains._replace(position=end.grains.position + move))
        assert energy(moved, law)[0] > lowest


def test_a_quench_of_loose_grains_ends_without_contacts_and_does_not_jam(monkeypatch):
    monkeypatch.setattr(packing, "MANY", 0)
    law = frictionless(ss.laws.hertz_mindlin())
    start = random_grains(60, 0.5, 3, radius=0.5, mass=1.0, i0=None, seed=0)
    assert energy(quench(start, law, 1e-14), law)[0] < 1e-30
    for fraction in (0.5, 0.6):
        with pytest.raises(ValueError, match=rf"fraction {fraction}: no force between them exceeds"):
            jammed(60, packing_fraction=fraction, radius=0.5)


def test_a_quench_under_a_large_tolerance_ends_with_contacts_that_carry_more_or_with_none():
    start, law = (
        ss.assembly(ss.disks([[0.0, 0.0], [0.9, 0.0]], 0.5), cell=ss.box(dim=2)),
        ss.laws.linear(kn=1.0, mu=0.0),
    )
    assert np.ptp(quench(start, law, 1.0).grains.position[:, 0]) > 1


def test_a_quench_that_runs_out_of_steps_returns_the_last_positions():
    law = frictionless(ss.laws.hertz_mindlin())
    start = random_grains(60, 0.7, 3, radius=0.5, mass=1.0, i0=None, seed=0)
    end = quench(start, law, 1e-14, steps=20)
    assert 1e-9 < energy(end, law)[0] < energy(start, law)[0]


@pytest.mark.parametrize("dim", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_a_frictional_packing_is_at_rest_under_the_pressure(dim):
    law = ss.laws.hertz_mindlin(mu=0.4)
    state, info = compressed(40, mu=0.4, pressure=1e-3, dim=dim, seed=2)
    stress = ss.measure.stress(state, law)
    np.testing.assert_allclose(np.diag(stress)[:dim], 1e-3, rtol=1e-8)  # Newton's tolerance over the force
    assert ss.measure.residual(state, law)[0] <= 1e-13  # round-off of forces over their mean
    assert info.residual <= 5e-14
    assert info.pressure == pytest.approx(1e-3, rel=1e-8)
    assert not state.control.cell_free.any()
    assert not state.grains.velocity.any()
    force, normal = ss.measure.contact_forces(state, law), ss.measure.branch_vectors(state)
    rows = ss.measure.touching(state)
    normal = normal[rows] / np.linalg.norm(normal[rows], axis=1)[:, None]
    along = np.einsum("ck,ck->c", force[rows], normal)
    across = np.linalg.norm(force[rows] - along[:, None] * normal, axis=1)
    assert (across <= 0.4 * along * (1 + 1e-9)).all()
    at_limit = int((across > 0.4 * along * (1 - 1e-9)).sum())
    assert 0 < at_limit == info.sliding < info.contacts
    assert dim + 1 <= info.coordination < 2 * dim + 0.3
    # it is an ordinary packing: shear finds the next equilibrium
    assert ss.equilibrate(ss.packings.sheared(state, 1e-6), law)[1].ok


def test_a_frictional_packing_is_the_same_for_the_same_seed():
    a, b, c = (compressed(20, mu=0.3, pressure=1e-3, dim=2, seed=s)[0] for s in (1, 1, 2))
    assert np.array_equal(a.grains.position, b.grains.position)
    assert np.array_equal(a.contacts.slip, b.contacts.slip)
    assert not np.array_equal(a.grains.position, c.grains.position)


def test_grains_that_never_come_to_rest_end_at_an_equilibrium_all_the_same(monkeypatch):
    """Loosely held grains may move slowly for a long time; Newton's method finds where they rest."""
    run, newton, levels, last = compression.run, compression.newton, [], 1e-13

    def never_at_rest(*given, tolerance, **options):
        levels.append(tolerance)
        state, record, outcome = run(*given, tolerance=tolerance, **options)
        return state, record, outcome._replace(status=ss.Status.STEPS_SPENT) if tolerance < last else outcome

    def fails_before(state, law, tolerance):
        end, outcome = newton(state, law, tolerance=tolerance)
        return end, outcome if levels[-1] < last else outcome._replace(status=ss.Status.STEPS_SPENT)

    monkeypatch.setattr(compression, "run", never_at_rest)
    monkeypatch.setattr(compression, "newton", fails_before)
    _, report = compressed(20, mu=0.5, pressure=1e-3, dim=2)
    assert report.residual < last
    assert sum(level < last for level in levels) == compression.PATIENCE


def test_without_friction_the_packing_is_like_a_jammed_one():
    _, info = compressed(45, mu=0.0, pressure=1e-3, dim=2, seed=0)
    held = 45 - info.rattlers
    assert info.contacts >= 2 * (held - 1) + 1
    assert info.sliding == 0
    _, other = jammed(45, pressure=1e-3, dim=2)
    assert info.packing_fraction == pytest.approx(other.packing_fraction, abs=0.02)  # samples of 45 disks


def test_friction_lowers_contact_number_and_packing_fraction():
    values = [compressed(45, mu=mu, pressure=1e-4, dim=2, seed=1)[1] for mu in (0.0, 0.3, 10.0)]
    assert values[0].coordination > values[1].coordination > values[2].coordination
    assert values[0].packing_fraction > values[1].packing_fraction > values[2].packing_fraction


def test_a_law_and_progress():
    told = []
    law = ss.laws.linear(kn=2.0, kt=1.0, mu=0.5)
    state, info = compressed(
        30, law=law, pressure=2e-3, dim=2, report=lambda stage, share, text: told.append((share, text))
    )
    assert ss.measure.residual(state, law)[0] <= 1e-13  # round-off of forces over their mean
    assert info.pressure == pytest.approx(2e-3, rel=1e-8)
    assert told[0][0] < told[-1][0] == pytest.approx(1.0, abs=0.01)
    assert all(f"{word} " in told[-1][1] for word in ("pressure", "unbalanced force", "contact number"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pressure": 1e-3}, "give either mu or a law"),
        ({"pressure": 1e-3, "mu": 0.5, "law": ss.laws.linear()}, "give either mu or a law"),
        ({"pressure": 1e-3, "mu": -0.1}, "mu must be zero or positive, got -0.1"),
        ({"pressure": -1e-3, "mu": 0.1}, "pressure must be positive, got -0.001"),
        ({"pressure": 0.5, "mu": 0.1}, r"pressure must be at most 0\.03.* overlap by more than 0.25 of their radius"),
        ({"pressure": 1e-12, "mu": 0.1}, "too small for a tolerance of 5e-14"),
        ({"pressure": 1e-9, "mu": 0.1}, "would take about .* steps: use a higher pressure"),
        ({"pressure": 1e-3, "mu": 0.1, "dim": 4}, r"dim must be 2 \(disks\) or 3 \(spheres\), got 4"),
        ({"pressure": 1e-3, "mu": 0.1, "radius": (0.5, -0.7)}, "positive numbers"),
        ({"pressure": 1e-3, "mu": 0.1, "radius": [5.0] + [0.5] * 19}, "use more grains"),
        ({"pressure": 1e-3, "mu": 0.1, "mass": -1.0}, "mass"),
    ],
)
def test_an_impossible_compression_gives_a_one_sentence_error(options, message):
    with pytest.raises(ValueError, match=message) as problem:
        compressed(20, **options)
    assert "\n" not in str(problem.value)


def test_a_pressure_that_is_not_reached_is_reported_with_what_was_reached(monkeypatch):
    monkeypatch.setattr(compression, "STEPS", 2000)
    with pytest.raises(ValueError, match="about 1e\\+04 steps"):
        compressed(20, mu=0.5, pressure=1e-4, dim=2)
    scales = compression.Scales(1.2e-4, 100.0, 700.0, 0.5)
    monkeypatch.setattr(compression, "compression_scales", lambda *given: scales)
    with pytest.raises(ss.NotInEquilibriumError) as problem:
        compressed(20, mu=0.5, pressure=1e-4, dim=2)
    message = str(problem.value)
    assert message.startswith("no packing at rest under a pressure of 0.0001 was found, the compression ended at ")
    assert "with a packing fraction of 0.7" in message
    assert "\n" not in message
