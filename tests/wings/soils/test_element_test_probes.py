"""Probes along an element test: the states that are probed, what is said about them, and what is refused."""

import csv
import re
import sys

import numpy as np
import pytest
from matplotlib import pyplot as plt

import stickslip as ss
from stickslip.cli import main
from stickslip.experiments.realizations import make_law
from stickslip.experiments.registry import named_measures
from stickslip.figures.style import render as png
from stickslip.runs.page import folder_content
from stickslip.wings.soils.element_test import simulate as element
from stickslip.wings.soils.element_test.measures import MEASURES
from stickslip.wings.soils.element_test.report import figures, sentences
from stickslip.wings.soils.element_test.sample import describe_direction, first_seen, plane_of, probe

DISKS = {"dim": 2, "grains": 60, "pressure": 100.0, "friction": 0.0}
LAW = {"young": 1e9, "poisson": 0.2, "mu": 0.3}
PATH = {"strain": 8e-3, "step": 4e-4}


@pytest.fixture(autouse=True)
def _without_figures():
    yield
    plt.close("all")


def scenario(**more):
    return ss.scenario(**({"experiment": "element-test", "sample": DISKS, "law": LAW, "path": PATH} | more))


@pytest.fixture(scope="module")
def result():
    sample, probes = DISKS | {"grains": 40}, {"strains": [5e-4, 8e-3], "directions": 32}
    return ss.simulate(scenario(sample=sample, realizations=2, probes=probes), workers=1)


def test_states_nearest_to_the_stated_strains_are_probed_in_the_first_sample_only(result):
    first, second = result.runs
    loads = first.series.load
    assert [state.load for state in first.probes] == [loads[np.abs(loads - at).argmin()] for at in (5e-4, 8e-3)]
    assert second.probes == ()


@pytest.fixture(scope="module")
def calm():
    """A path without rearrangements, probed at its end, where contacts slide."""
    path = {"strain": 3e-4, "step": 1e-4}
    result = ss.simulate(scenario(path=path, probes={"states": 1, "directions": 32}), workers=1)
    assert not result.runs[0].series.rearranged.any() and result.runs[0].series.sliding_fraction[-1] > 0
    return result


def test_a_probed_state_has_the_response_of_the_state_of_the_path(calm):
    run, result = calm.runs[0], calm
    held = run.end._replace(control=ss.control.loads(60))
    plane = [np.diag([0.0, 1.0]), np.diag([1.0, 0.0])]
    envelope = ss.protocols.response_envelope(held, result.law, directions=32, plane=plane)
    last = run.probes[-1]
    scale = np.abs(envelope.stress).max()
    assert last.envelope.stress == pytest.approx(envelope.stress, abs=1e-4 * scale)
    assert last.band.determinant == pytest.approx(ss.protocols.localisation(held, result.law).determinant, abs=1e-4)
    assert last.stress == pytest.approx(run.series.stress[-1], rel=1e-6, abs=1e-4)


def test_growth_rates_are_those_of_all_eigenvalues(calm):
    result = calm
    state, law = result.runs[0].end._replace(control=ss.control.loads(60)), result.law
    last = result.runs[0].probes[-1]
    loose = state._replace(control=ss.control.stress_controlled(state.control, ss.measure.stress(state, law)[:2, :2]))
    for k, each in enumerate((state, loose)):
        spectrum = ss.stability(each, law, dashpots=False, method="dense")
        assert last.pair[k] == pytest.approx(spectrum.growth_rate.max(initial=0), rel=1e-3)
        assert last.real[k] == pytest.approx(np.sqrt(-spectrum.negative).max(initial=0), rel=1e-3)


def with_work(state, work):
    """Probed state whose stress gives a second-order work for each direction."""
    envelope = state.envelope
    return state._replace(envelope=envelope._replace(stress=np.asarray(work)[:, None, None] * envelope.strain))


def test_signs_are_those_of_the_first_state_that_shows_them(result):
    one, two = result.runs[0].probes
    work = np.ones(32)
    work[4] = -0.5
    assert not one.signs["negative work"]
    seen = first_seen((one, with_work(two, work)))
    assert seen["negative work"].load == two.load and seen["negative work"].weakest == pytest.approx(np.pi / 4)
    gone = with_work(two, np.where(np.arange(32) == 7, np.nan, 1.0))
    assert gone.signs["no equilibrium"] and not gone.signs["negative work"]
    assert gone.failing == pytest.approx(7 * np.pi / 16)
    softened = two._replace(band=two.band._replace(determinant=-0.1), pair=np.array([0, 2.0]), real=np.array([3.0, 0]))
    seen = softened.signs
    assert seen["complex pair, fixed stress"] and seen["divergence, fixed strain"] and seen["band"]
    assert not (seen["complex pair, fixed strain"] or seen["divergence, fixed stress"] or one.signs["band"])


def test_the_sentence_says_where_it_wanted_to_fail_and_where_the_peak_is(result):
    work = np.ones(32)
    work[28] = -0.5
    first = result.runs[0]._replace(probes=(with_work(result.runs[0].probes[1], work),))
    text = sentences(result._replace(runs=(first, result.runs[1])))[0]
    assert re.match(
        r"Sample 0 first tended to fail at a strain of 0\.008, in the direction 315° \(axial strain 0\.71, lateral "
        r"strain -0\.71, constant volume\), where second-order work is negative; the peak angle is at 0\.00\d+\.$",
        text,
    )
    numbers = MEASURES.of(result._replace(runs=(first, result.runs[1])))
    assert numbers["strain_at_cone"].mean == 8e-3 and numbers["cone_direction"].mean == 315
    calm = result.runs[0]._replace(probes=(with_work(result.runs[0].probes[1], np.ones(32)),))
    quiet = result._replace(runs=(calm, result.runs[1]))
    assert sentences(quiet)[0] == "No direction was found in which sample 0 could fail, up to a strain of 0.008."
    assert np.isnan(named_measures(ss.experiments.EXPERIMENTS["element-test"], quiet)["strain_at_cone"][0])


@pytest.mark.parametrize(
    ("path", "dim", "angle", "words"),
    [
        ({"kind": "triaxial"}, 3, 0, "0° (axial strain 1.00, lateral strain 0.00, compression)"),
        ({"kind": "triaxial"}, 3, 90, "90° (axial strain 0.00, lateral strain 0.71, compression)"),
        ({"kind": "undrained"}, 3, 360 - np.degrees(np.arctan(np.sqrt(0.5))),
         "324.7° (axial strain 0.82, lateral strain -0.41, constant volume)"),
        ({"kind": "simple-shear"}, 2, 0, "0° (shear strain 0.71, normal strain 0.00, constant volume)"),
        ({"kind": "plane-strain"}, 3, 315, "315° (axial strain 0.71, lateral strain -0.71, constant volume)"),
    ],
)  # fmt: skip
def test_directions_are_named_by_their_strains(path, dim, angle, words):
    chosen = ss.scenario(experiment="element-test", path=path)
    assert describe_direction(np.radians(angle), chosen.path, dim) == words


def test_the_path_itself_is_the_direction_in_which_an_undrained_test_strains():
    chosen = ss.scenario(experiment="element-test", path={"kind": "undrained"})
    plane, _ = plane_of(chosen.path, 3)
    unit = plane / np.linalg.norm(plane, axis=(1, 2), keepdims=True)
    gradient = element.drive_of(chosen.path, 3).gradient
    assert np.einsum("kab,ab->k", unit, -gradient) @ unit.reshape(2, 9) == pytest.approx(-gradient.ravel())


def test_a_run_that_is_stopped_does_not_probe_again(tmp_path, monkeypatch):
    chosen = scenario(probes={"strains": [1e-4, 1e-3], "directions": 8}, path={"strain": 1e-3, "step": 4e-4})
    probed = []
    monkeypatch.setattr(element, "SAVE_EVERY", 0.0)
    monkeypatch.setattr(element, "probe", lambda *given: (probed.append(given[2]), probe(*given))[1])

    def stop(stage, share, words):
        if "load 0.0002" in words:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ss.simulate(chosen, folder=tmp_path, workers=1, report=stop)
    assert len(probed) == 1
    again = ss.simulate(chosen, folder=tmp_path, workers=1)
    assert len(probed) == 2 and [state.load for state in again.runs[0].probes] == probed
    assert probed[0] == pytest.approx(1e-4, rel=0.3) and probed[1] == 1e-3


@pytest.mark.parametrize("turns", [[1e-3, 2e-4, 1e-3], [-1e-3, 1e-3], 1e-3])
def test_states_are_probed_before_the_path_turns(turns):
    chosen = scenario(path={"strain": turns, "step": 1e-4}, probes={"states": 3})
    loads, first = element.loads_of(chosen), np.atleast_1d(turns)[0]
    rows = sorted(element._rows_to_probe(chosen))
    assert rows[-1] == np.abs(loads - first).argmin() and len(rows) == 3
    assert loads[rows] == pytest.approx(first * np.array([1, 4, 9]) / 9, rel=0.3)


def test_a_strain_of_the_way_back_is_probed_on_the_way_there():
    loads = element.loads_of(scenario(path={"strain": [1e-3, 2e-4], "step": 1e-4}))
    turn, back = int(loads.argmax()), float(loads[-3])
    assert np.abs(loads[: turn + 1] - back).min() > 0
    chosen = scenario(path={"strain": [1e-3, 2e-4], "step": 1e-4}, probes={"strains": [back]})
    (row,) = element._rows_to_probe(chosen)
    assert row == np.abs(loads[: turn + 1] - back).argmin()


@pytest.mark.slow
def test_contacts_slide_again_in_a_state_that_dynamics_brought_to_rest(monkeypatch):
    """Grains swing as they come to rest, and leave the Coulomb limit; the path would make them slide again."""
    path = {"strain": 2e-3, "integrator": "dynamic", "inertial_number": 1e-3}
    chosen, slides = scenario(path=path, probes={"states": 1, "directions": 8}), []
    for further in (element._load_further, lambda rig, state, scales: state):
        monkeypatch.setattr(element, "_load_further", further)
        slides.append(ss.simulate(chosen, workers=1).runs[0].probes[0].envelope.slides.max())
    assert slides[0] > 1.4 * slides[1]


def test_a_moving_sample_comes_to_rest_before_it_is_probed_and_the_path_goes_on_as_without_probes():
    path = {"strain": 1e-3, "integrator": "dynamic", "inertial_number": 1e-3}
    run = ss.simulate(scenario(path=path, probes={"strains": [4e-4], "directions": 8}), workers=1).runs[0]
    (state,) = run.probes
    row = int(np.flatnonzero(run.series.load == state.load)[0])
    assert state.reason == "" and not state.envelope.collapsed.any()
    assert state.stress == pytest.approx(
        run.series.stress[row], abs=15.0
    )  # a stiff sample carries a tenth more as it is loaded further
    plain = ss.simulate(scenario(path=path), workers=1).runs[0]
    np.testing.assert_array_equal(plain.series.stress, run.series.stress)


def test_a_sample_of_spheres_and_a_law_without_a_sharp_limit_can_be_probed():
    law = LAW | {"coulomb": "smooth"}
    sample = {"grains": 40, "friction": 0.0, "grading": {"kind": "uniform", "smallest": 0.9e-3, "largest": 1.1e-3}}
    path = {"kind": "simple-shear", "strain": 1e-5}
    run = ss.simulate(scenario(law=law, sample=sample, path=path, probes={"states": 1, "directions": 8}), workers=1)
    (state,) = run.runs[0].probes
    assert state.unique == "UNDECIDED" and state.envelope.plane[0, 0, 1] == pytest.approx(-np.sqrt(0.5))


def test_a_state_that_cannot_be_probed_gives_a_reason(result):
    gas = ss.packings.from_arrays(np.array([[1e-3, 1e-3], [3e-3, 3e-3]]), np.full(2, 4e-4), result.law, cell=[5e-3] * 2,
                                  dim=2)  # fmt: skip
    state = probe(gas, make_law(scenario().law), 1e-3, np.array([np.diag([0.0, 1]), np.diag([1.0, 0])]), 8)
    assert "only rattlers" in state.reason and not any(state.signs.values())
    lame = result._replace(runs=(result.runs[0]._replace(probes=(state,)),))
    assert any("No equilibrium could be probed at a strain of 0.001: the packing" in text for text in sentences(lame))
    assert len(list(figures(lame))) == 5


def test_figures_and_tables_of_probes_are_written(result, tmp_path, monkeypatch, capsys, request):
    *_, first, second = figures(result)
    words = [text.get_text() for text in second[1].legends[0].get_texts()]
    assert {"response", "elastic part: no contact slides"} <= set(words)
    assert [first[0], second[0]] == ["fig6_directions.png", "fig7_envelopes.png"]
    assert min(len(png(figure)) for _, figure in (first, second)) > 5000
    request.getfixturevalue("plain_figures")
    (tmp_path / "test.toml").write_text(
        'experiment = "element-test"\nsample = {dim = 2, grains = 40, pressure = 100.0}\npath = {strain = 1e-5}\n'
        "probes = {states = 1, directions = 8}\n"
    )
    out = tmp_path / "out"
    monkeypatch.setattr(sys, "argv", ["stickslip", "run", str(tmp_path / "test.toml"), "--out", str(out)])
    with pytest.raises(SystemExit) as ended:
        main()
    shown = capsys.readouterr().out
    assert ended.value.code == 0 and "Signs of failure of sample 0" in shown and "fig6_directions.png" in shown
    tables = {}
    for name in ("probes.csv", "envelopes.csv"):
        with (out / name).open(encoding="utf-8") as file:
            tables[name] = list(csv.DictReader(file))
    assert len(tables["probes.csv"]) == 1 and len(tables["envelopes.csv"]) == 8
    (remarks,) = (text for heading, text in folder_content(out, search=False).sections if heading == "Remarks")
    assert "No direction was found in which sample 0 could fail" in remarks
    assert float(tables["probes.csv"][0]["strain"]) == pytest.approx(1e-5)
    assert float(tables["envelopes.csv"][2]["strain_lateral"]) == pytest.approx(1)


@pytest.mark.parametrize("signs", ["compression", "tension"])
def test_the_map_of_directions_stands_at_the_strains_of_the_series(result, signs):
    turned = result._replace(scenario=result.scenario.model_copy(update={"signs": signs}))
    (figure,) = (figure for name, figure in figures(turned) if name == "fig6_directions.png")
    above, below = figure.axes[:2]
    gap = below.lines[0].get_xdata()[:, None] - above.lines[0].get_xdata()
    assert gap.shape[0] == 2 and np.abs(gap).min(axis=1).max() < 1e-12
    low, high = np.sort(below.get_xlim())
    signs = above.lines[1:]
    assert signs and all(low < line.get_xdata()[0] < high for line in signs)  # none is on the edge
    words = [text.get_text() for text in above.get_legend().get_texts()]
    assert len(words) == len(signs) and not any(";" in word for word in words)
    assert below.get_ylim() == (0, 360) and 360 in below.get_yticks()
    assert figure.axes[2].get_ylim()[0] > -1 and figure.axes[2].get_ylim()[1] == 1


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"probes": {"strains": [0.5]}}, r"probes\.strains must be from 0 to 0\.008, where the path turns, got 0\.5"),
        (
            {"probes": {"strains": [-1e-3]}},
            r"probes\.strains must be from 0 to 0\.008, where the path turns, got -0\.001",
        ),
        ({"probes": {"strains": [1e-3], "states": 3}}, "exclude each other"),
        ({"probes": {"direction": 8}}, r"\[probes\] has no key 'direction': did you mean 'directions'"),
        ({"probes": {}, "path": {"kind": "isotropic", "pressures": [200.0]}}, "choose a path with a strain"),
    ],
)
def test_bad_probes_are_refused_in_one_sentence(tables, words):
    with pytest.raises(ss.experiments.ScenarioError, match=words) as caught:
        scenario(**tables)
    assert "\n" not in str(caught.value)
