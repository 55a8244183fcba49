"""Scenarios: bad input is one sentence, good input survives a round trip; archives keep every bit."""

from pathlib import Path

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.laws.builtin import DAMPING_N, DAMPING_T, KT
from stickslip.data import archive
from stickslip.experiments.realizations import make_law as law_of
from stickslip.experiments.registry import ScenarioError, read_scenario, scenario
from stickslip.loading.protocols import Change, perturbed
from stickslip.wings.studies.flow.scenario import FlowLaw
from tests.conftest import make_law, make_packing, stirred

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"aray": {}}, "a scenario has no key 'aray': did you mean 'array'"),
        ({"array": {"raduis": 0.5}}, r"the table \[array\] has no key 'raduis': did you mean 'radius'"),
        ({"law": {"wall": {"mo": 0.5}}}, r"the table \[law.wall\] has no key 'mo': did you mean 'mu'"),
        ({"array": {"radius": [0.5, 0.5]}}, "radius has 2 entries, but there are 10 disks"),
        ({"array": {"disks": 2.5}}, "array.disks must be a valid integer, got 2.5"),
        ({"array": {"gap": -0.6}}, "overlap by more than a radius"),
        ({"law": {"mu": float("nan")}}, "law.mu must be a finite number, got nan"),
        ({"law": {"mu": "rough"}}, "law.mu must be a valid number, got 'rough'"),
        ({"law": {"kind": "hertz"}}, "law.kind must be 'hertz_mindlin' or 'linear', got 'hertz'"),
        ({"load": {"press": 0.0}}, "press = 0 leaves the disks without contact"),
        ({"load": {"push": [0.01, 0.02]}}, "first of them 0.0"),
        ({"load": {"step": 1e-9}}, "use a larger load.step"),
        ({"load": {"disk": 11}}, "load.disk must be at most 10, the number of disks, got 11"),
        ({"load": {"push": [0.0, 0.05]}}, "dynamics.loads contains 0.062, which load.push"),
        ({"dynamics": {"watch": 0.01}}, "not among dynamics.loads"),
        ({"load": {"press": 2000.0}}, "makes disks overlap the substrate"),
        ({"dynamics": {"duration": 1e13}}, "must be less than or equal to 10000000"),
        ({"array": {"float_radius": 3}}, r"the table \[array\] has no key 'float_radius'"),
        ({"seed": True}, "seed must be a valid integer, got True"),
        ({"experiment": "cyclic-shear", "cycles": {"amplitudes": []}}, r"cycles.amplitudes must have at least 1 entry"),
        ({"load": {"push": 0.01}}, "load.push must be a list"),
        ({"experiment": "disks"}, "experiment must be one of 'disk-array', .*, got 'disks'"),
        ({"experiment": "flows"}, "did you mean 'flow'?"),
        ({"experiment": "Sphere_Shear"}, "did you mean 'sphere-shear'?"),
    ],
)
def test_a_bad_scenario_gives_a_one_sentence_error(tables, message):
    with pytest.raises(ScenarioError, match=message) as caught:
        scenario(**tables)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [("[array\n", "not valid TOML"), ("[array]\ndisks = 'ten'\n", "array.disks must be a valid integer, got 'ten'")],
)
def test_a_bad_file_gives_a_one_sentence_error(tmp_path, text, message):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=message):
        read_scenario(path)
    (tmp_path / "bad.json").write_text("{not json")
    with pytest.raises(ScenarioError, match="not valid JSON"):
        read_scenario(tmp_path / "bad.json")
    with pytest.raises(ScenarioError, match="cannot be read"):
        read_scenario(tmp_path / "absent.toml")


def test_the_example_is_the_paper_and_survives_a_round_trip(tmp_path):
    from stickslip.wings.papers.disk_array.claims import paper_scenario

    example, paper = read_scenario(EXAMPLES / "disk_array.toml"), paper_scenario()
    assert example.array == paper.array
    assert example.law == paper.law
    assert example.load.press == paper.load.press
    (tmp_path / "scenario.json").write_text(example.text)
    again = read_scenario(tmp_path / "scenario.json")
    assert again == example
    assert again.digest == example.digest != paper_scenario(seed=1).digest


def test_path_passes_through_turning_points_and_wanted_loads():
    path = ss.protocols.load_path([0.0, 0.03, 0.01], 0.01, through=[0.015, 0.012])
    np.testing.assert_allclose(path, [0, 0.01, 0.012, 0.015, 0.02, 0.03, 0.02, 0.01], atol=1e-15)


def test_a_change_lies_in_the_middle_of_its_bracket_and_disks_stay_in_their_plane():
    assert Change(1.0, 2.0).load == 1.5
    disks = ss.assembly(ss.disks([[0, 0], [3, 0]], 0.5), cell=ss.box(dim=2))
    kicked = perturbed(disks, 1, 0.1).grains
    assert kicked.velocity[:, :2].all() and kicked.spin[:, 2].all()
    assert not kicked.velocity[:, 2].any() and not kicked.spin[:, :2].any()


def test_archive_keeps_states_with_contact_memory_bit_for_bit(tmp_path):
    law = make_law("hertz_mindlin", "sharp")
    state = stirred(make_packing(3, 1), law, np.random.default_rng(1))
    archive.write(tmp_path / "a.h5", {"frame": state, "words": "grain", "numbers": {"x": np.arange(3), "y": 1.5}})
    back = archive.read(tmp_path / "a.h5")
    assert back["words"] == "grain"
    assert back["numbers"]["y"] == 1.5
    assert np.array_equal(back["numbers"]["x"], np.arange(3))
    end, _, _ = ss.run(state, law, 300, 0.05)
    again, _, _ = ss.run(back["frame"], law, 300, 0.05)
    assert np.array_equal(end.grains.position, again.grains.position)
    assert np.array_equal(end.grains.spin, again.grains.spin)


def test_archive_that_fails_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.h5"
    archive.write(path, {"x": 1.0})
    with pytest.raises(TypeError):
        archive.write(path, {"x": 2.0, "bad": object()})
    assert archive.read(path) == {"x": 1.0}
    assert [p.name for p in tmp_path.iterdir()] == ["a.h5"]
    path.write_text("not HDF5")
    with pytest.raises(ValueError, match="not a stickslip archive"):
        archive.read(path)


@pytest.mark.parametrize(("given", "ratio"), [({}, 0.5), ({"damping_ratio": 0.2}, 0.2)])
def test_what_a_law_has_where_nothing_is_given(given, ratio):
    chosen = FlowLaw(kind="linear", kn=7.0, restitution=0.6, speed=0.1, **given)
    table = law_of(chosen, radius=0.5, mass=1.0).table[0, 0]
    assert table[KT] == pytest.approx(2.0)  # 2/7 of kn
    assert table[DAMPING_T] == pytest.approx(ratio * table[DAMPING_N]) and table[DAMPING_N] > 0


def test_a_misspelt_table_is_named_before_what_is_missing():
    with pytest.raises(ScenarioError, match=r"a scenario has no key 'grain': did you mean 'grains'\?"):
        scenario(experiment="gouge", grain={"number": 10})
