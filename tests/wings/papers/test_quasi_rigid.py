"""The biaxial test end to end: what a sample's numbers mean, scenarios, and what the command line leaves behind."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import stickslip as ss
from stickslip.data import archive
from stickslip.loading.compression import BOTTOM, LEFT, RIGHT, TOP
from stickslip.runs.folder import write_result
from stickslip.wings.papers.quasi_rigid import EXPERIMENT
from stickslip.wings.papers.quasi_rigid import cases as sliding
from stickslip.wings.papers.quasi_rigid import claims as quasi_claims
from stickslip.wings.papers.quasi_rigid.simulate import (
    Curve,
    SlowDynamics,
    collapse_load,
    prepare,
    simulate_quasi,
    strain_difference,
    stress_strain_curve,
    table_one,
)
from tests.conftest import stickslip_here as stickslip

SMALL = {"experiment": "quasi-rigid", "seed": 1, "disks": {"number": 40}, "dynamics": {"times": (1e3, 3e3)}}


@pytest.fixture(scope="module")
def small():
    return simulate_quasi(ss.scenario(**SMALL, loading={"factor": 3.0, "increment": 0.02, "unload": True}), workers=1)


# 5 s: a loaded and unloaded sample with two runs of dynamics, which the tests of this file share
def test_curve_is_what_the_walls_say(small):
    first = small.tested[0]
    state, n = first.path.states[-1], small.scenario.disks.number
    width = state.walls.point[RIGHT, 0] - state.walls.point[LEFT, 0]
    assert first.curve.ratio[-1] > first.curve.ratio[0] > 0
    height = state.walls.point[TOP, 1] - state.walls.point[1, 1]
    force = state.control.force
    assert first.curve.ratio[-1] == pytest.approx((force[n + TOP, 1] / width) / (force[n + RIGHT, 0] / height))
    assert first.curve.strain[0] == first.curve.volumetric[0] == 0
    assert first.curve.strain[-1] > 0
    assert first.back.load[-1] == pytest.approx(0, abs=1e-12)
    there = np.interp(first.back.load[0], first.curve.load, first.curve.strain)
    assert first.back.strain[-1] < first.back.strain[0] == pytest.approx(there, rel=0.1)


def test_contact_forces_start_and_end_as_the_packing_has_them(small):
    first = small.tested[0]
    m = ss.quasirigid.linear_system(first.path.states[0], first.law)
    contacts = first.path.states[0].contacts
    ours = {(int(i), int(j)): f for i, j, f in zip(contacts.i[m.rows], contacts.j[m.rows], m.force, strict=True)}
    for pair, force in zip(first.pairs, first.forces[0], strict=True):
        assert force == pytest.approx(ours[tuple(pair.tolist())], abs=1e-15)
    assert (np.abs(first.forces[..., 1]) <= 0.5 * first.forces[..., 0] + 1e-3 * first.forces[..., 0].mean()).all()


def test_table_one_holds_in_the_engine(small):
    errors = table_one(small.tested[0].path.states[-2], small.tested[0].law)
    assert max(errors.values()) < 1e-5


def test_claims_have_all_ids_and_say_what_was_measured(small):
    claims = {c.id: c for c in quasi_claims.evaluate_claims(small, cases=8, quick=True)}
    assert list(claims) == [
        "table-I-relations", "status-map-bijective", "one-consistent-state", "non-unique-example",
        "path-vs-dynamics-error", "collapse-load-ratio", "stability-premise", "flutter-example", "apex-counterexample",
        "mechanism-classes", "growth-through-mechanism", "growth-through-instability", "null-mode-classes",
        "geometric-stiffness-slope", "hundreds-of-critical-contacts", "all-sliding-least-stable",
        "sliding-contributions-negative", "close-to-all-sliding", "vibrations-switch-statuses", "vibrations-collapse",
        "linear-law-is-no-restriction",
    ]  # fmt: skip
    assert all(c.note and c.source.partition(":")[0] in quasi_claims.SHOWS for c in claims.values())
    unprinted = {name for name, c in claims.items() if c.paper is None}
    assert unprinted == {"non-unique-example", "collapse-load-ratio", "apex-counterexample"}
    assert all((c.verdict == "no reference") == (name in unprinted) for name, c in claims.items())
    told = {name: claims[name].verdict for name in ("stability-premise", "flutter-example")}
    assert set(told.values()) <= {"refuted", "not refuted", "reproduced", "undecided"}, told
    assert claims["mechanism-classes"].measured == 3
    assert claims["apex-counterexample"].measured is True
    assert "0 of" in claims["apex-counterexample"].note


def test_a_sample_whose_path_ends_at_once_has_no_dynamics_and_is_left_out(small):
    first = small.tested[0]
    both = quasi_claims._slow_error(small._replace(tested=(first, first._replace(slow=()))))
    assert "1 sample without dynamics at every duration" in both.note and "of 1 samples;" in both.note
    none = quasi_claims._slow_error(small._replace(tested=(first._replace(slow=()),)))
    assert none.verdict == "undecided" and none.note.startswith("no sample has slow dynamics")


def test_the_most_critical_contacts_of_a_path_under_four_times_the_force_on_the_lid(monkeypatch):
    legs = []

    def path(state, law, end, *, increment):
        legs.append((state.control, end, increment))
        return SimpleNamespace(points=[SimpleNamespace(sliding=k, load=0.1 * k) for k in (1, 7, 3)])

    monkeypatch.setattr(sliding, "load_path", path)
    assert sliding.most_critical(12, 1, increment=0.02) == (7, pytest.approx(0.3))
    ((begin, end, increment),) = legs
    lid = 12 + TOP
    assert end.force[lid] == pytest.approx(4 * begin.force[lid]) and begin.force[lid].any() and increment == 0.02
    assert np.array_equal(np.delete(end.force, lid, axis=0), np.delete(begin.force, lid, axis=0))


def test_difference_and_collapse_of_made_up_curves():
    load = np.linspace(0, 1, 101)
    path = Curve(load, load, load, load)
    late = Curve(load, load - 0.03, load, load)
    assert strain_difference(path, late) == pytest.approx(0.03)
    fails = Curve(load, np.where(load > 0.96, load + 1, load - 0.03), load, load)  # not compared that near to the end
    assert strain_difference(path, fails) == pytest.approx(0.03)
    energy = np.full(100, 1e-12)
    slow = SlowDynamics(1e5, path, energy / 10, 0.0)
    assert collapse_load([SlowDynamics(3e4, path, energy, 0.0), slow], path) is None
    assert collapse_load([slow], path) is None
    burst = energy.copy()
    burst[70:73] = 1e-9
    fallen = Curve(load, np.where(load > 0.7, load + 0.2, load), load, load)
    for curve, expected in ((fallen, load[71]), (path, None)):  # a burst after which the run is on the path is none
        both = [
            SlowDynamics(3e4, curve, burst, 0.0),
            SlowDynamics(1e5, curve, np.maximum(burst, energy) - 0.9 * energy, 0.0),
        ]
        assert collapse_load(both, path) == (None if expected is None else pytest.approx(expected))


@pytest.mark.usefixtures("plain_figures")  # those of collapses are drawn in test_axes_of_figures.py
def test_run_leaves_curves_figures_numbers(small, tmp_path):
    paths = write_result(tmp_path / "out", EXPERIMENT, small)
    names = [p.name for p in paths]
    assert names == [
        "fig1_curves.png", "fig2_statuses.png", "fig3_cone.png", "fig4_stiffness.png", "fig5_dynamics.png",
        "results.h5", "scenario.json", "series.csv",
    ]  # fmt: skip
    rows = (tmp_path / "out" / "series.csv").read_text().splitlines()
    assert rows[0] == "sample,curve,load,strain,volumetric_strain,stress_ratio"
    assert {row.split(",")[1] for row in rows[1:]} == {"path", "unloading", "dynamics 1000", "dynamics 3000"}
    numbers = archive.read(tmp_path / "out" / "results.h5")["samples"]["001"]
    assert numbers["path"]["load"][-1] == small.tested[0].path.load[-1]
    assert isinstance(numbers["frames"]["end"], ss.State)


@pytest.mark.slow
def test_shear_from_the_command_line(tmp_path):
    scenario = tmp_path / "shear.toml"
    scenario.write_text(
        'experiment = "quasi-rigid"\nseed = 1\n[disks]\nnumber = 40\n[loading]\ntest = "shear"\nratio = 0.02\n'
        "increment = 0.25\n[dynamics]\ntimes = []\n"
    )
    done = stickslip("run", scenario, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "Ends of the paths" in done.stdout
    text = json.loads((tmp_path / "out" / "scenario.json").read_text())
    assert text["loading"]["test"] == "shear"
    assert not (tmp_path / "out" / "fig5_dynamics.png").exists()


def test_strains_of_a_sheared_cell_are_positive_in_compression():
    state = ss.packings.sheared_box(12, seed=1)[0]
    wide = state._replace(cell=state.cell._replace(vectors=state.cell.vectors * [[1.1, 1, 1], [1, 1.1, 1], [1, 1, 1]]))
    chosen = ss.scenario(experiment="quasi-rigid", loading={"test": "shear"})
    assert stress_strain_curve([state, wide], [0.0, 1.0], chosen).volumetric == pytest.approx([0.0, 1 - 1.1**2])


def test_stresses_of_a_box_are_forces_over_the_length_on_which_they_act():
    chosen = ss.scenario(experiment="quasi-rigid", disks={"number": 12})
    state, _, end = prepare(chosen, 1)
    point, force = state.walls.point.copy(), end.force[12:]
    high, wide = point[TOP, 1] - point[BOTTOM, 1], point[RIGHT, 0] - point[LEFT, 0]
    point[RIGHT, 0] += high
    stretched = state._replace(walls=state.walls._replace(point=point), control=end)
    curve = stress_strain_curve([state, stretched], [0.0, 1.0], chosen)
    assert curve.ratio[1] == pytest.approx(force[TOP, 1] / (wide + high) / (force[RIGHT, 0] / high))
    assert curve.volumetric[1] < 0 == curve.volumetric[0]


@pytest.mark.parametrize(("wall", "axis", "loaded"), [("top", 1, TOP), ("right", 0, RIGHT)])
def test_the_wall_of_the_scenario_is_loaded(wall, axis, loaded):
    chosen = ss.scenario(experiment="quasi-rigid", disks={"number": 12}, loading={"wall": wall})
    state, _, end = prepare(chosen, 1)
    factor = np.ones((16, 3))
    factor[12 + loaded, axis] = chosen.loading.factor
    assert np.array_equal(end.force, factor * state.control.force)


def test_seeds_of_vibrations_are_their_velocities(monkeypatch):
    state, law = ss.packings.biaxial_box(12, seed=1)
    seen = []
    monkeypatch.setattr(sliding, "_watch", lambda state, *rest: (seen.append(state.grains.velocity), (0.0, 0.0))[1])
    for seed in (1, 2):
        sliding.vibrate(state, law, seed)
    first, still, second, _ = seen
    assert not still.any() and not np.allclose(first, second)
    sizes = first[:, :2] / np.random.default_rng(1).normal(size=first[:, :2].shape)
    assert sizes == pytest.approx(np.full(sizes.shape, sizes[0, 0])) and not first[:, 2].any()


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"law": {"mu": 0.0}}, "no contact slides or sticks without friction"),
        ({"disks": {"pressure": 0.5}}, "quasi-rigid grains overlap only slightly"),
    ],
)
def test_wrong_scenarios_give_a_one_sentence_error(tables, message):
    with pytest.raises(ss.experiments.ScenarioError) as problem:
        ss.scenario(experiment="quasi-rigid", **tables)
    assert message in str(problem.value)
    assert "\n" not in str(problem.value)
