"""Statements on sheared spheres: planes and funnels, oscillating stress, births, blocks of J, and the stored study."""

from types import SimpleNamespace

import numpy as np
import pytest

import stickslip as ss
from benchmarks import pairs_by_law
from benchmarks.births import births_by_law
from stickslip.core.state import volume
from stickslip.reports.claims import place
from stickslip.solve.freedom import jacobian
from stickslip.wings.papers.sphere_shear import claims
from stickslip.wings.papers.sphere_shear.claims import late_births, motion_claims, number_claims

RATE, FREQUENCY = 0.01, 0.4


def turn(out):
    """(1, 20, 5, 3) displacements of five grains in one turn of a spiral, and `out` times as much out of its plane."""
    rng, time = np.random.default_rng(1), np.arange(20) * 2 * np.pi / FREQUENCY / 20
    a, b, c = rng.normal(size=(3, 5, 3))
    wave = np.exp(RATE * time)[:, None, None]
    plane = a * np.cos(FREQUENCY * time)[:, None, None] + b * np.sin(FREQUENCY * time)[:, None, None]
    return (wave * (plane + out * c * np.cos(2 * FREQUENCY * time)[:, None, None]))[None]


def test_a_spiral_lies_in_a_plane_and_a_funnel_does_not():
    wide, flat = claims.axis_ratios(turn(0.0))
    assert flat.shape == (1, 5)
    assert flat.max() < 1e-14
    assert wide.min() > 0.05
    assert claims.axis_ratios(turn(1.0))[1].min() > 0.05


@pytest.mark.parametrize("rise", [0.0, 0.5])
def test_axes_of_an_ellipse_that_drifts_along_its_normal(rise):
    """Σcos² = Σsin² = T/2 over a turn: the singular values are √(T/2), b √(T/2) and √T times the drift."""
    angle = 2 * np.pi * np.arange(12) / 12
    path = np.stack([np.cos(angle), 0.8 * np.sin(angle), np.full(12, rise)], axis=1)[None, :, None]
    wide, flat = claims.axis_ratios(path)
    assert wide[0, 0] == pytest.approx(0.8)
    assert flat[0, 0] == pytest.approx(np.sqrt(2) * rise, abs=1e-15)
    line = claims.axis_ratios(path * [1.0, 0.0, 0.0])
    assert max(part.max() for part in line) < 1e-15


@pytest.mark.parametrize("level", [0.0, 0.7])
def test_mean_and_power_of_an_oscillation(level):
    """δσ = e^{ω_i t} (level + cos ω_r t), M = e^{2 ω_i t}: mean over root mean square is level/√(level² + ½)."""
    time = np.linspace(0.0, 200 * 2 * np.pi / FREQUENCY, 40_001)
    grown = np.exp(RATE * time)
    run = SimpleNamespace(
        time=time, msd=grown**2, growth_rate=RATE, growth=SimpleNamespace(start=time[400], stop=time[-1]),
        shear_stress=np.where(time > 0, 0.3 + 1e-9 * grown * (level + np.cos(FREQUENCY * time)), 0.3),
    )  # fmt: skip
    wave = claims.stress_oscillation(run)
    assert wave.offset == pytest.approx(level / np.sqrt(level**2 + 0.5), abs=0.01)
    assert wave.exponent == pytest.approx(0.5, abs=0.01)
    assert claims.stress_oscillation(SimpleNamespace(growth=None)) is None


def test_births_are_counted_where_pairs_appear():
    path = SimpleNamespace(strain=np.array([0.0, 0.2, 0.4, 0.6, 1.0]), pairs=np.array([0, 2, 1, 4, 3]))
    assert late_births(path) == 1.5  # two before the middle, three after it
    without = SimpleNamespace(strain=path.strain, pairs=np.zeros(5, int))
    assert np.isnan(late_births(without))


def test_blocks_exchange_as_the_paper_says(monkeypatch):
    """Also by finite differences of forces and torques; and an entry that is off is noticed."""
    law = ss.laws.hertz_mindlin(mu=10.0, coulomb="smooth")
    state, _ = ss.packings.jammed(20, packing_fraction=0.7, seed=3, law=law)
    state = ss.protocols.ramp(state, [0.0, 1e-3], ss.protocols.aqs(law))[-1].state
    differences = claims.block_asymmetry(state, law)
    assert differences.pop("axes") > 1e-5
    assert max(differences.values()) < 1e-14
    slipless = state._replace(contacts=state.contacts._replace(slip=0 * state.contacts.slip))
    assert claims.block_asymmetry(slipless, law)["axes"] < 1e-14
    c, row, step = state.contacts, ss.measure.touching(state)[0], 1e-7
    i, j = int(c.i[row]), int(c.j[row])

    def change(grain, name, axis):
        """Derivative of force and torque over radius on both grains."""
        loads = []
        for sign in (1, -1):
            moved = getattr(state.grains, name).copy()
            moved[grain, axis] += sign * step / (state.grains.radius[grain] if name == "angle" else 1.0)
            force, _ = ss.forces(state._replace(grains=state.grains._replace(**{name: moved})), law)
            loads.append(np.stack([force.force, force.torque / state.grains.radius[:, None]]))
        return (loads[0] - loads[1]) / (2 * step)

    for name, signs in (("position", (1, -1)), ("angle", (-1, 1))):
        for axis in range(3):
            there, back = change(j, name, axis)[:, i], change(i, name, axis)[:, j]
            for part in (0, 1):
                np.testing.assert_allclose(there[part], signs[part] * back[part], atol=1e-6)

    def damaged(*given):
        matrix = jacobian(*given).tolil()
        matrix[6 * i, 6 * j] *= 1 + 1e-6
        return matrix.tocsr()

    monkeypatch.setattr(claims, "jacobian", damaged)
    assert claims.block_asymmetry(state, law)["A"] > 1e-8


def test_more_than_half_with_its_interval():
    assert [claims._mostly(n, 60) for n in (60, 45, 30, 15, 0)] == [True, True, None, False, False]


def test_the_stored_summary_is_that_of_the_packings(tmp_path, monkeypatch):
    monkeypatch.setattr(pairs_by_law, "BIRTHS", tmp_path / "births.csv")
    pairs_by_law.write_summary(births_by_law(pairs_by_law.read_births()))
    assert (tmp_path / "births.csv").read_text() == claims.BIRTHS.read_text()
    assert len(claims.read_births()) == 14


def test_every_row_belongs_to_a_place_that_is_shown():
    path = SimpleNamespace(strain=np.array([0.0, 1.0]), pairs=np.array([0, 1]))
    rows = claims.law_claims() + number_claims(SimpleNamespace(paths=[path], single=[None]))
    assert {place(row) for row in [*rows, *motion_claims(SimpleNamespace(single=[None]))]} <= set(claims.SHOWS)


def test_time_of_sound_and_modes_that_drag_overdamps():
    """c = √(G/ρ) = √(0.08/0.5) = 0.4: a diameter takes 2.5; of five modes, two are zero and one has ω ≤ η_0/2."""
    state, _ = ss.packings.jammed(20, packing_fraction=0.7, seed=3)
    mass = np.full(20, 0.5 * volume(state) / 20)
    state = state._replace(grains=state.grains._replace(mass=mass))
    path = SimpleNamespace(strain=np.array([0.0, 1e-4, 1.0]), shear_stress=np.array([1.0, 1.0 + 8e-6, 9.0]), last=state)
    assert claims.sound_time(path) == pytest.approx(2.5)
    half = claims.DRAG / 2
    modes = np.array([0.0, 1e-13, (0.9 * half) ** 2, (1.1 * half) ** 2, 1.0])
    assert claims.damping_shares(modes) == pytest.approx((1 / 3, 0.9 * half))


@pytest.mark.parametrize(("dim", "freedoms"), [(2, 2), (3, 5)])
@pytest.mark.parametrize("squeeze", [1.0, 0.8])
def test_the_statistic_of_isotropic_normals_is_a_chi_square(dim, freedoms, squeeze, monkeypatch):
    rng, state = np.random.default_rng(0), SimpleNamespace(cell=SimpleNamespace(dim=dim))
    values = []
    for normal in rng.normal(size=(400, 150, 3)) * [1.0, squeeze, dim == 3]:
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        monkeypatch.setattr(claims, "touching", lambda _, n=normal: n)
        monkeypatch.setattr(claims, "fabric", lambda _, n=normal: n.T @ n / len(n))
        values.append(claims.isotropy_statistic(state))
    spread = np.sqrt(2 * freedoms / 400)  # of the mean of 400 values
    assert (abs(np.mean(values) - freedoms) < 4 * spread) == (squeeze == 1.0)
