"""Element tests of cemented samples: bonds as wanted, elastic constants, strengths, and the catalogue of breaks."""

import csv
import re

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.bonding import with_weakest_broken
from stickslip.core.progress import NotInEquilibriumError
from stickslip.experiments.realizations import make_law
from stickslip.experiments.registry import SweepMember
from stickslip.figures.style import render as png
from stickslip.solve.moduli import elastic_moduli
from stickslip.wings.soils.element_test import simulate as element
from stickslip.wings.soils.element_test.measures import SAMPLE, LoadedSample
from stickslip.wings.soils.element_test.report import columns, compare, figures, files, sentences
from stickslip.wings.soils.element_test.sample import BALANCED, describe_break, make_sample, with_cement
from stickslip.wings.soils.element_test.scenario import Cement

DISKS = {"dim": 2, "grains": 40, "pressure": 100.0, "friction": 0.1}
CEMENT = {"tensile_strength": 5e3, "shear_strength": 8e3}


def scenario(sample=DISKS, *, cement=None, **path):
    return ss.scenario(experiment="element-test", sample=sample, path=path, cement=CEMENT | (cement or {}))


@pytest.fixture(scope="module")
def pulled():
    """A direct tension test of disks that fails."""
    return ss.simulate(scenario(strain=-0.02, step=5e-4, cement={"until": 0.3}), workers=1)


def test_bonds_have_the_stiffness_and_the_scatter_of_potyondy_and_cundall():
    """k = E A/(R_i + R_j) along and k/2.5 across the bond; 5σ of the mean and of the standard deviation."""
    site = np.stack(np.meshgrid(*[np.arange(8.0)] * 3), -1).reshape(-1, 3)
    radius = 0.48 + 0.02 * (site.sum(axis=1) % 2)  # gaps of 0.02
    cement = Cement(tensile_strength=3.0, shear_strength=5.0, scatter=0.2, modulus=2.0, radius=0.9, gap=0.021)
    bonds = with_cement(ss.assembly(ss.spheres(site, radius)), cement, 7.0, seed=1).bonds
    assert len(bonds.i) == 3 * 7 * 64
    area = np.pi * (0.9 * 0.48) ** 2
    np.testing.assert_allclose(bonds.stiffness[:, 0], 14 * area / 0.98)
    np.testing.assert_allclose(bonds.stiffness[:, 1], bonds.stiffness[:, 0] / 2.5)
    for column, mean in ((0, 3.0), (1, 5.0)):
        share = bonds.strength[:, column] / (mean * area)
        assert np.mean(share) == pytest.approx(1, abs=5 * 0.2 / len(share) ** 0.5)
        assert np.std(share) == pytest.approx(0.2, abs=5 * 0.2 / (2 * len(share)) ** 0.5)
    tension, shear = (bonds.strength[:, k] / bonds.strength[:, k].mean() for k in (0, 1))
    moments = bonds.strength[:, 2:] / bonds.strength[:, 2:].mean(axis=0)
    np.testing.assert_allclose(moments, np.stack([tension, shear], 1))
    assert abs(np.corrcoef(tension, shear)[0, 1]) < 5 / len(shear) ** 0.5


@pytest.mark.parametrize(
    ("way", "turn", "tension"), [((1e-3, 0, 0), 0, True), ((-1e-3, 0, 0), 1e-3, False), ((0, 0, 0), 3e-3, True)]
)
def test_a_break_has_the_mode_and_the_energy_of_its_loads(way, turn, tension):
    """Stretch x, and rotations ±θ about z or both θ: energies k x²/2, k_s (θ r)²/2 and k_b (2θ)²/2."""
    pair = ss.assembly(ss.spheres([[0, 0, 0], [1.0, 0, 0]], 0.5), cell=ss.box([4, 4, 4], (True,) * 3))
    made = with_cement(pair, Cement(tensile_strength=1e-4, shear_strength=1e-4), 1.0, seed=0)
    signs = [1, 1] if any(way) else [1, -1]
    angle = np.array([[0, 0, turn * sign] for sign in signs], float)
    grains = made.grains._replace(position=made.grains.position + np.array([[0, 0, 0], way]), angle=angle)
    moved = made._replace(grains=grains)
    k = made.bonds.stiffness[0]
    expected = np.array([k[0] * way[0], k[1] * turn * (1 + way[0]), 0, 0] if any(way) else [0, 0, k[2] * 2 * turn, 0])
    found = describe_break(moved, with_weakest_broken(moved))
    assert (found.i, found.j, found.tension) == (0, 1, tension)
    assert found.energy == pytest.approx(0.5 * (expected[k > 0] ** 2 / k[k > 0]).sum(), rel=1e-4)
    np.testing.assert_allclose(found.position, [[0.5 + way[0] / 2, 0, 0]], atol=1e-12)


@pytest.mark.parametrize("sample", [DISKS, {"grains": 60, "friction": 0.1}], ids=["disks", "spheres"])
def test_the_first_step_has_the_elastic_constants_of_the_bonded_packing(sample):
    """E and ν from the compliance of the moduli, without pressure."""
    assert len(element.loads_of(scenario(sample, strain=1e-6, step=2e-6))) == 2
    strong = {"tensile_strength": 5e6, "shear_strength": 8e6} if sample is not DISKS else {}
    chosen = scenario(sample, strain=1e-6, step=2e-6, cement=strong | {"gap": 0.02})
    run = ss.simulate(chosen, workers=1).runs[0]
    law, dim = make_law(chosen.law), chosen.sample.dim
    made, _ = make_sample(chosen.sample, law, 0, lambda *_: None)
    tolerance = BALANCED * chosen.stress_scale * chosen.sample.area
    state = element._cement(chosen, made, law, 0, tolerance).state
    normal = np.einsum("aacc->ac", elastic_moduli(state, law).tensor)
    compliance = np.linalg.inv(normal)[:, -1]
    found = SAMPLE.of(LoadedSample(run, chosen))
    assert found["E"] == pytest.approx(1 / compliance[-1], rel=1e-4)
    assert found["nu"] == pytest.approx(-compliance[: dim - 1].mean() / compliance[-1], rel=1e-3)


def test_every_lost_bond_is_in_the_catalogue(pulled, tmp_path):
    run = pulled.runs[0]
    bonds, breaks, series = run.end.bonds, run.breaks, run.series
    lost = {(i, j) for i, j in zip(bonds.i[~bonds.intact], bonds.j[~bonds.intact], strict=True)}
    assert lost == set(zip(breaks.i, breaks.j, strict=True)) and len(lost) == len(breaks.row) > 3
    assert (np.diff(breaks.row) >= 0).all() and (breaks.energy > 0).all()
    stress = -series.stress[:, 1, 1]
    peak = int(stress.argmax())
    assert 0 < peak < len(stress) - 1 < len(element.loads_of(pulled.scenario)) - 1  # it ends as it has failed
    assert stress[-1] <= 0.3 * stress[peak] < stress[-2]
    assert np.abs(series.stress[:, 0, 0]).max() < 1e-6 * stress[peak]
    found, table = SAMPLE.of(LoadedSample(run, pulled.scenario)), columns(run, pulled.scenario)
    assert found["tensile_strength"] == found["strength"] == pytest.approx(stress[peak])
    assert found["sigma1_peak"] == 0 and np.isnan(found["psi"])
    assert np.isnan(found["UCS"]) and np.isnan(found["phi_peak"]) and "phi" not in table
    assert found["broken_tension"] + found["broken_shear"] == len(lost)
    assert table["broken_tension"][-1] + table["broken_shear"][-1] == len(lost)
    assert found["broken_tension_peak"] == table["broken_tension"][peak]
    writers = dict(files(pulled))
    writers["breaks.csv"](tmp_path / "breaks.csv")
    with (tmp_path / "breaks.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    assert [(int(row["i"]), int(row["j"])) for row in rows] == list(zip(breaks.i, breaks.j, strict=True))
    assert {row["mode"] for row in rows} <= {"tension", "shear"}
    assert f"broke in tension and {int((~breaks.tension).sum())} in shear." in " ".join(sentences(pulled))


def test_a_failed_sample_without_lateral_stress_is_in_equilibrium(pulled):
    """Its lateral stress is round-off of zero, and is compared with the axial one."""
    law, end = make_law(pulled.scenario.law), pulled.runs[0].end
    assert ss.measure.imbalance(end, law) < 1e-5
    assert ss.stability(end, law).balanced


def test_a_cemented_test_that_is_stopped_continues_with_the_same_bits(pulled, tmp_path, monkeypatch):
    monkeypatch.setattr(element, "SAVE_EVERY", 0.0)
    middle = f"load {pulled.runs[0].series.load[int(pulled.runs[0].breaks.row[2])]:.4g}"

    def stop(stage, share, words):
        if middle in words:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ss.simulate(pulled.scenario, folder=tmp_path, workers=1, report=stop)
    again = ss.simulate(pulled.scenario, folder=tmp_path, workers=1)
    columns = ([*each.runs[0].series, *each.runs[0].breaks] for each in (again, pulled))
    for got, known in zip(*columns, strict=True):
        np.testing.assert_array_equal(got, known)


def test_bonds_that_broke_on_the_way_to_no_equilibrium_are_not_in_the_catalogue(pulled, tmp_path, monkeypatch):
    """They are intact in the last equilibrium, and their row is beyond the series."""
    row, calls = int(pulled.runs[0].breaks.row[-1]), []

    def settle(*about, **options):
        calls.append(found := settled(*about, **options))
        if len(calls) == row + 1:
            raise NotInEquilibriumError("no equilibrium", found[1])
        return found

    settled = element.settle
    monkeypatch.setattr(element, "settle", settle)
    run = element.load_sample(pulled.scenario, 0, False, None, lambda *_: None)
    assert len(run.series.load) == row and run.ended
    assert len(run.breaks.row) == (~run.end.bonds.intact).sum() < len(pulled.runs[0].breaks.row)
    dict(files(pulled._replace(runs=(run,))))["breaks.csv"](tmp_path / "breaks.csv")


def test_every_figure_can_be_drawn(pulled):
    drawn = {name: png(figure) for name, figure in figures(pulled)}
    assert "fig9_broken_bonds.png" in drawn and min(map(len, drawn.values())) > 5000


def test_a_sample_that_lost_all_bonds_before_the_test_has_no_strength(pulled):
    """Elastic constants of grains that do not touch would be those of round-off; counts remain."""
    run, bonds = pulled.runs[0], len(pulled.runs[0].end.bonds.i)
    lost = run.breaks._replace(row=np.zeros(bonds, int), tension=np.ones(bonds, bool))
    runs = run, run._replace(breaks=lost)
    found, void = (SAMPLE.of(LoadedSample(one, pulled.scenario)) for one in runs)
    for name in ("E", "nu", "E_half", "nu_half", "tensile_strength", "strength"):
        assert np.isfinite(found[name]) and np.isnan(void[name]), name
    assert void["broken_before"] == bonds


def test_a_sample_that_did_not_fail_has_a_lower_bound(pulled):
    kept = pulled.runs[0].breaks.row[0]
    series = element.ElementSeries(*(column[:kept] for column in pulled.runs[0].series))
    early = pulled._replace(runs=(pulled.runs[0]._replace(series=series),))
    assert "The strength is a lower bound in sample 0" in " ".join(sentences(early))
    assert "lower bound" not in " ".join(sentences(pulled))


def member(confining, strain, sigma1, sigma3, **more):
    values = {"sigma1_peak": sigma1, "sigma3_peak": sigma3} | more
    return SweepMember(
        {"cement.confining": confining, "path.strain": strain},
        {name: (value, "Pa") for name, value in values.items()}, None,
    )  # fmt: skip


def test_a_sweep_has_the_strengths_their_ratio_and_an_envelope_of_the_tests_in_compression():
    """σ₁ = 9 MPa + 3 σ₃: φ = 30°, c = 9/(2 √3) MPa; the circle in tension is beside the envelope."""
    members = [
        member(0.0, 0.02, 9e6, 0.0, UCS=9e6), member(0.0, -0.01, 0.0, -1.5e6, tensile_strength=1.5e6),
        member(1e6, 0.02, 12e6, 1e6), member(2e6, 0.02, 15e6, 2e6),
    ]  # fmt: skip
    found = compare(members)
    assert re.search(r"at the peak: φ = \(30.0000.*°, c = \(?2598.*kPa, from 3 of 4 members", found.remarks[0])
    assert found.remarks[1] == (
        "Uniaxial compressive strength 9e+03 kPa, direct tensile strength 1.5e+03 kPa: a ratio of 6."
    )
    assert set(found.files) == {"mohr.png", "mohr.csv"} and len(png(found.files["mohr.png"])) > 5000
    assert "cement.confining [Pa]" in found.files["mohr.csv"]
    assert compare(members[:2]).remarks == found.remarks[1:]


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"cement": CEMENT | {"tensile_strength": -5e3}}, r"cement\.tensile_strength"),
        ({"cement": CEMENT | {"shear_strength": 0.0}}, r"cement\.shear_strength"),
        ({"cement": {"tensile_strength": 5e3}}, r"cement\.shear_strength"),
        ({"cement": CEMENT | {"scatter": 0.5}}, r"cement\.scatter"),
        ({"cement": CEMENT | {"confining": -1.0}}, r"cement\.confining"),
        ({"cement": CEMENT | {"modulus": 1e6}}, r"cement\.modulus must be at most .* round-off .* got 1e\+06"),
        ({"cement": CEMENT | {"stiffness_ratio": 0.001, "modulus": 1e3}}, r"modulus must be at most .* got 1000"),
        ({"cement": CEMENT | {"modulus": 1e-6}}, r"cement\.modulus must be at least .* double their length, got 1e-06"),
        ({"cement": CEMENT | {"radius": 1.5}}, r"cement\.radius must be less than or equal to 1, got 1\.5"),
        (
            {"cement": CEMENT | {"radius": 1e-3, "tensile_strength": 0.01}},
            r"cement\.radius must be at least .* equilibria, got",
        ),
        (
            {"cement": CEMENT | {"stiffness_ratio": 1e-9}},
            r"cement\.stiffness_ratio must be greater than or equal to 0\.001",
        ),
        ({"cement": CEMENT | {"shear_strength": 1e-9}}, r"cement\.shear_strength must be at least .* got 1e-09"),
        ({"cement": CEMENT, "path": {"kind": "undrained"}}, r'path\.kind = "triaxial", .* got "undrained"'),
        ({"cement": CEMENT, "path": {"integrator": "dynamic"}}, r'path\.integrator = "quasi-static", .* got "dynamic"'),
        (
            {"cement": CEMENT, "path": {"strain": [0.01, 0.0, 0.02]}},
            r"single path\.strain, beyond failure, got \[0\.01, ",
        ),
        ({"cement": CEMENT, "probes": {}}, "probes exclude"),
        ({"cement": CEMENT, "law": {"kind": "hertz_mindlin", "kn": 1e9, "kt": 1e9}}, "which this law lacks"),
    ],
)
def test_cement_that_cannot_be_is_refused_in_one_sentence(tables, words):
    with pytest.raises(ss.experiments.ScenarioError) as caught:
        ss.scenario(experiment="element-test", sample=DISKS, **tables)
    assert re.search(words, str(caught.value)) and "\n" not in str(caught.value)


def test_cement_stronger_than_grains_bear_is_refused_before_anything_is_saved(tmp_path):
    strong = scenario(cement={"tensile_strength": 1e5, "shear_strength": 1e5}, strain=1e-3)
    with pytest.raises(ss.experiments.ScenarioError, match=r"cement\.tensile_strength must be at most .* got 100000"):
        ss.simulate(strong, folder=tmp_path)
    assert not list(tmp_path.iterdir())
