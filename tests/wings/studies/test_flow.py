"""Flows: weight, gates, plates, courses of time, sentences for what cannot be, and the command line end to end."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.data import archive
from stickslip.experiments.registry import ScenarioError, read_scenario, scenario
from stickslip.wings.studies.flow.pouring import knots
from tests.conftest import stickslip_here as stickslip
from tests.unit.test_scenario import EXAMPLES

FLOOR = {"name": "floor", "point": [0.0, 0.0], "normal": [0.0, 1.0]}
LEFT = {"name": "left", "point": [0.0, 0.0], "normal": [1.0, 0.0], "mu": 0.0}
GATE = {"name": "gate", "point": [6.0, 0.0], "normal": [-1.0, 0.0], "mu": 0.0}
LAW = {"kn": 1e4, "mu": 0.5, "restitution": 0.3}
PLATES = [{"name": "bottom", "height": 0.0}, {"name": "top", "height": 12.0, "pressure": 2.0, "mass": 8.0}]


def pour(**more):
    """Forty grains in a box six wide."""
    return {"number": 40, "mass": 1.0, "polydispersity": 0.1, "low": [0.0, 0.0], "high": [6.0, 16.0], **more}


def flow(**changes):
    """Grains that settle in a box, unless told otherwise."""
    tables = {
        "experiment": "flow", "grains": pour(), "law": LAW, "walls": [FLOOR, LEFT, GATE], "gravity": [0.0, -1.0],
        "stages": [{"name": "settle", "duration": 4.0}], "samples": 20, "frames": 4,
    }  # fmt: skip
    return {key: value for key, value in (tables | changes).items() if value is not None}


def sheared(stages, plates=PLATES, **more):
    grains = pour(low=[0.0, 1.0], high=[8.0, 11.0])
    cell = {"size": [8.0, 12.0], "periodic": ["x"]}
    return scenario(**flow(grains=grains, cell=cell, plates=plates, walls=None, gravity=None, stages=stages, **more))


def test_grains_come_to_rest_and_the_floor_carries_their_weight():
    stages = [
        {"name": "fall", "duration": 6.0},
        {"name": "settle", "duration": 60.0, "until": "rest", "kinetic": 1e-5, "drag": 0.5},
    ]
    found = ss.experiments.flow.simulate_flow(scenario(**flow(stages=stages, samples=100)))
    series, weight = found.series, found.poured.state.grains.mass.sum()
    assert found.stages[1].rested
    assert found.stages[1].end < 66
    assert series.kinetic_energy[-1] < 1e-6 * series.kinetic_energy.max()
    np.testing.assert_allclose(series.wall_force[-1, 0, 1], -weight, rtol=0.01)  # the criterion's own accuracy
    np.testing.assert_allclose(series.wall_force[-1, 1:].sum(axis=0)[0] + series.wall_force[-1, 0, 0], 0, atol=0.4)
    assert 2 < series.coordination[-1] < 5
    assert 0.05 < found.poured.dt / ss.measure.stable_time_step(found.frames[-1], found.law) < 0.3
    assert ss.measure.heights(found.frames[-1].grains.position, found.frames[-1].walls).min() > 0
    assert series.low[:, 1].min() > 0.3


def test_grains_pass_where_a_gate_was_and_other_contacts_keep_their_memory():
    stages = [{"name": "settle", "duration": 8.0}, {"name": "open", "duration": 4.0, "remove": ["gate"]}]
    walls = [FLOOR, LEFT, {**GATE, "mu": 0.5}]
    found = ss.experiments.flow.simulate_flow(scenario(**flow(stages=stages, walls=walls)))
    before, after = (found.series.stage == k for k in (0, 1))
    assert found.series.high[before, 0].max() < 6
    assert found.series.high[after, 0][-1] > 7
    assert np.isfinite(found.series.wall_force[before]).all()
    assert np.isnan(found.series.wall_force[after, 2]).all()
    assert found.frame_walls[-1] == ("floor", "left")
    settled = next(f for f in found.frames if f.time == found.stages[0].end)
    opened, n = ss.packings.without_walls(settled, [1]), 40
    assert opened.contacts.count[0] < settled.contacts.count[0]
    ss.packings.check(opened)
    rows = slice(0, opened.contacts.count[0])
    assert (np.diff(opened.contacts.key[rows]) > 0).all()
    old = {(i, j): s for i, j, s in zip(settled.contacts.i, settled.contacts.j, settled.contacts.slip, strict=True)}
    for i, j, slip in zip(*(getattr(opened.contacts, f)[rows] for f in ("i", "j", "slip")), strict=True):
        assert (old[i, j + 1 if j == n + 1 else j] == slip).all()  # the gate was wall 2 and is wall 1
    fresh = opened._replace(contacts=opened.contacts._replace(stale=True))
    law = found.law  # a list made anew by the engine has the same keys and carries the same memory
    np.testing.assert_allclose(ss.forces(fresh, law)[0].force, ss.forces(opened, law)[0].force, atol=1e-12)


def test_a_plate_feels_what_presses_it_and_shears_the_grains():
    stages = [
        {"name": "compress", "duration": 90.0, "until": "rest", "kinetic": 1e-5, "drag": 0.5},
        {"name": "press", "duration": 90.0, "until": "rest", "kinetic": 1e-5, "force": {"top": 32.0}},
        {"name": "shear", "duration": 30.0, "velocity": {"top": {"x": 1.0}}, "drag": 0.0},
    ]
    found = ss.experiments.flow.simulate_flow(sheared(stages, samples=400))
    series = found.series
    for stage, force in ((0, 16.0), (1, 32.0)):  # pressure 2 on a length of 8, then a force
        last = np.flatnonzero(series.stage == stage)[-1]
        assert found.stages[stage].rested
        np.testing.assert_allclose(series.plate_force[last, :, 1], [-force, force], rtol=0.01)
    top = found.poured.plates["top"]
    moved = found.frames[-1].grains.position[top] - found.poured.state.grains.position[top]
    np.testing.assert_allclose(moved[:, 0], found.stages[2].end - found.stages[2].start, rtol=1e-3)
    assert np.ptp(moved[:, 1]) < 1e-9
    shear = ss.experiments.flow.plane_shear(found)
    assert 0.1 < shear.friction < 0.7
    assert shear.pressure == pytest.approx(4.0, rel=0.2)  # few grains, instantaneous forces
    assert shear.inertial_number == pytest.approx(shear.shear_rate * np.sqrt(4 / np.pi / shear.pressure), rel=0.1)
    profile = ss.experiments.flow.velocity_profile(found)[:, 0]
    known = np.flatnonzero(np.isfinite(profile))
    assert profile[known[-1]] > 0.5 > profile[known[0]]


@pytest.mark.slow
def test_a_velocity_follows_its_course():
    table = [[0.0, 0.0], [1.0, 2.0], [3.0, 2.0]]
    stages = [
        {"name": "ramp", "duration": 3.0, "velocity": {"bottom": {"x": table}}},
        {"name": "shake", "duration": 2.25, "velocity": {"bottom": {"x": {"amplitude": 1.0, "frequency": 0.8}}}},
    ]
    found = ss.experiments.flow.simulate_flow(sheared(stages, samples=50))
    time, x = found.series.time, found.series.plate_position[:, 0, 0] - 4.0
    ramp, early = np.where(time < 1, time**2, 2 * time - 1), found.series.stage == 0
    np.testing.assert_allclose(x[early], ramp[early], atol=5e-3)
    since = time[~early] - 3.0
    expected = 5.0 + (1 - np.cos(1.6 * np.pi * since)) / (1.6 * np.pi)
    np.testing.assert_allclose(x[~early], expected, atol=5e-3)  # 32 knots a period, and half a time step


def test_courses_become_knots():
    times, values = knots(0.3, 5.0)
    assert (times, values) == (0.0, 0.3)
    motion = {"floor": {"y": {"amplitude": 2.0, "frequency": 4.0}}}
    shaking = scenario(**flow(stages=[{"name": "a", "duration": 1.0, "velocity": motion}]))
    times, values = knots(shaking.stages[0].velocity["floor"].y, 1.0)
    fine = np.linspace(0, 1, 1000)
    np.testing.assert_allclose(np.interp(fine, times, values), 2 * np.sin(8 * np.pi * fine), atol=0.01)


def test_a_wall_with_a_force_presses_the_grains():
    lid = {"name": "lid", "point": [0.0, 16.0], "normal": [0.0, -1.0], "force": 30.0, "mass": 5.0, "mu": 0.0}
    stages = [{"name": "press", "duration": 60.0, "until": "rest", "kinetic": 1e-5, "drag": 0.5}]
    found = ss.experiments.flow.simulate_flow(
        scenario(**flow(walls=[FLOOR, LEFT, GATE, lid], gravity=None, stages=stages))
    )
    assert found.stages[0].rested
    np.testing.assert_allclose(found.series.wall_force[-1, [0, 3], 1], [-30.0, 30.0], rtol=0.01)
    assert found.series.wall_point[-1, 3, 1] < 16


@pytest.mark.parametrize("dim", [2, 3])
# 3 s: forty disks are poured three times
def test_pouring_leaves_room_and_is_the_same_for_the_same_seed(dim):
    groove = [
        {"name": "a", "point": [0.0, 0.0, 0.0][:dim], "normal": [1.0, 1.0, 0.0][:dim]},
        {"name": "b", "point": [0.0, 0.0, 0.0][:dim], "normal": [-1.0, 1.0, 0.0][:dim]},
    ]
    grains = pour(dim=dim, low=[-8.0, 0.0, 0.0][:dim], high=[8.0, 12.0, 6.0][:dim], radius=[0.3, 0.5])
    tables = flow(grains=grains, walls=groove, gravity=[0.0, -1.0, 0.0][:dim])
    one, two, other = (ss.packings.poured(scenario(**tables, seed=seed)) for seed in (3, 3, 4))
    assert np.array_equal(one.state.grains.position, two.state.grains.position)
    assert not np.array_equal(one.state.grains.position, other.state.grains.position)
    position, radius = one.state.grains.position, one.state.grains.radius
    apart = np.linalg.norm(position[:, None] - position, axis=2) - radius[:, None] - radius
    assert (apart + 9 * np.eye(40) > 0).all()
    height = (position[:, None] - one.state.walls.point) @ one.state.walls.normal.T
    assert (height > radius[:, None, None]).all()
    if dim == 2:
        chosen = scenario(**tables | {"stages": [{"name": "settle", "duration": 2.0}]}, seed=3)
        one, two = (ss.experiments.flow.simulate_flow(chosen, threads=t).frames[-1] for t in (1, 2))
        assert len(ss.measure.touching(one)) > 5 and one.grains.spin.any()
        assert np.array_equal(one.grains.position, two.grains.position)
        assert np.array_equal(one.grains.spin, two.grains.spin)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"grains": pour(density=1.0)}, "give exactly one of grains.density and grains.mass"),
        ({"grains": pour(low=[0.0, 17.0])}, "grains.low = 17 is not below grains.high = 16 along y"),
        ({"grains": pour(low=[0.0, 0.0, 0.0])}, "grains.low has 3 components, but grains.dim = 2"),
        ({"grains": {"number": 4}}, "grains.low is missing: give it"),
        ({"law": {"mu": 0.5}}, "law.kn is missing"),
        ({"law": {"kn": 1.0, "young": 1.0, "poisson": 0.3}}, "law.young and law.kn exclude each other"),
        ({"law": {"young": 1.0, "poisson": 0.3}}, "use kind = \"hertz_mindlin_reff\""),
        ({"law": {"kn": 1.0, "restitution": 0.5, "damping_n": 1.0}}, "law.restitution and damping coefficients"),
        ({"law": {"kn": 1.0, "kind": "hertz_mindlin", "restitution": 0.5}}, "law.restitution requires law.speed"),
        ({"walls": [FLOOR, FLOOR]}, "two walls or plates are called 'floor'"),
        ({"walls": [{**FLOOR, "nromal": 1}]}, r"\[walls\] \(entry 1\) has no key 'nromal': did you mean 'normal'"),
        ({"walls": [FLOOR, {**LEFT, "mu": -1.0}]}, r"\(entry 2\) must be greater than or equal to 0, got -1.0"),
        ({"walls": [{**FLOOR, "force": 1.0}]}, "wall 'floor' has a force but no mass"),
        ({"walls": [{**FLOOR, "normal": [1.0, 1.0], "force": 1.0}]}, "but an inclined normal"),
        (
            {"walls": [{**FLOOR, "force": 1.0, "mass": 1.0, "velocity": {"y": 1.0}}]},
            "'floor' has a force and a velocity along y: give only one",
        ),
        ({"walls": [{**FLOOR, "velocity": {"z": 1.0}}]}, "has a z component, but grains.dim = 2"),
        ({"walls": [{**FLOOR, "velocity": {"x": "fast"}}]}, "a velocity of 'fast' is not allowed: use a number"),
        ({"walls": [{**FLOOR, "velocity": {"x": [[1.0, 0.0], [0.0, 0.0]]}}]}, "use increasing, non-negative times"),
        ({"walls": [{**FLOOR, "normal": [0.0, 0.0]}]}, "a normal of length zero"),
        ({"cell": {"size": [6.0, 9.0], "periodic": ["x"]}}, "wall 'left' crosses the cell, which is periodic along x"),
        ({"cell": {"periodic": ["x"]}}, "cell.size is missing"),
        ({"plates": PLATES}, "cell.size is missing"),
        ({"stages": [{"name": "a", "duration": 1.0, "remove": ["gaet"]}]}, "removes 'gaet', which is unknown"),
        ({"stages": [{"name": "a", "duration": 1.0, "velocity": {"lid": {"x": 1.0}}}]}, "'lid', which is unknown"),
        ({"stages": [{"name": "a", "duration": 1.0, "force": {"floor": 1.0}}]}, "in stage 'a' but no mass"),
        (
            {"stages": [{"name": "a", "duration": 1.0, "remove": ["gate"]}] * 2},
            "names 'gate', which an earlier stage removed",
        ),
        ({"stages": [{"name": "a", "duration": 1.0, "until": "calm"}]}, "must be 'rest'"),
        ({"dt": 1e-12}, r"time steps: at most 1e\+09 are allowed"),
        ({"walls": [{**FLOOR, "name": "a\n"}]}, r"walls.name \(entry 1\) = 'a\\n' is not allowed"),
    ],
)  # fmt: skip
def test_a_bad_flow_is_one_sentence(changes, words):
    with pytest.raises(ScenarioError, match=words) as caught:
        scenario(**flow(**changes))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"grains": pour(number=400)}, "grains.number = 400 is too large, as the region .* has room for 52 grains"),
        ({"walls": [{**FLOOR, "point": [0.0, 30.0]}]}, "has room for 0 grains .* clear of walls"),
        ({"dt": 0.01}, "dt = 0.01 exceeds the largest stable value for six contacts on the lightest grain"),
        ({"grains": pour(low=[-1.0, 0.0])}, None),
    ],
)
def test_grains_that_cannot_be_poured_are_one_sentence(changes, words):
    if words is None:  # a region that a wall cuts is filled in front of the wall
        state = ss.packings.poured(scenario(**flow(**changes))).state
        assert ss.measure.heights(state.grains.position, state.walls).min() > 0
        return
    with pytest.raises(ScenarioError, match=words) as caught:
        ss.packings.poured(scenario(**flow(**changes)))
    assert "\n" not in str(caught.value)


def test_grains_behind_a_wall_are_named_with_it():
    grains, cell = pour(low=[0.0, 2.0], high=[6.0, 18.0]), {"size": [9.0, 18.0]}
    with pytest.raises(ScenarioError, match=r"grain 46 at \(7.071, 0.5\) is behind wall 'gate': move the wall"):
        ss.packings.poured(scenario(**flow(grains=grains, cell=cell, plates=[{"name": "bed", "height": 0.5}])))
    row = ss.disks([[0.5, 0.5], [7.0, 0.5]], 0.5)
    with pytest.raises(ValueError, match=r"grain 1 at \(7, 0.5\) lies behind wall 1"):
        ss.assembly(row, ss.flat_walls([[0, 0], [6, 0]], [[0, 1], [-1, 0]]))


@pytest.mark.parametrize(
    ("plate", "words"),
    [
        ({"spacing": 0.9}, "spacing = 0.9, below the diameter"),
        ({"spacing": 20.0}, "longer than the cell"),
        ({"spacing": 4.0}, "has holes of 3 between its grains"),
        ({"pressure": 1.0, "force": 1.0}, "has both a force and a pressure: give only one"),
    ],
)
def test_plates_that_cannot_be_built_are_one_sentence(plate, words):
    stage = [{"name": "a", "duration": 1.0}]
    with pytest.raises(ScenarioError, match=words):
        ss.packings.poured(sheared(stage, plates=[{"name": "top", "height": 11.7, "radius": 0.5, **plate}]))


def test_the_time_step_follows_the_stiffness_that_contacts_will_have():
    hertz = {"kind": "hertz_mindlin_reff", "young": 1e6, "poisson": 0.3, "mu": 0.5}
    soft = ss.packings.poured(scenario(**flow(law=hertz)))
    hard = ss.packings.poured(scenario(**flow(law=hertz | {"young": 1e8})))
    assert hard.dt == pytest.approx(soft.dt * 100**-0.4, rel=0.01)  # t ~ E^(-2/5) at a given speed, by Hertz
    again = scenario(**flow(law=hertz, dt=soft.dt / 2))
    assert ss.packings.poured(again).dt == soft.dt / 2


def test_a_run_that_blows_up_ends_with_one_sentence():
    fast = {**FLOOR, "velocity": {"y": 1e4}}
    with pytest.raises((RuntimeError, ValueError)) as caught:
        ss.experiments.flow.simulate_flow(
            scenario(**flow(walls=[fast, LEFT, GATE], dt=1e-3, law={"kn": 1.0, "mu": 0.5}))
        )
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["column_collapse", "plane_shear"])
def test_examples_are_scenarios_that_survive_a_round_trip(name, tmp_path):
    example = read_scenario(EXAMPLES / f"{name}.toml")
    (tmp_path / "scenario.json").write_text(example.text)
    assert read_scenario(tmp_path / "scenario.json") == example
    assert ss.packings.poured(example).dt > 0


TOML = """
experiment = "flow"
gravity = [0.0, -1.0]
samples = 12
frames = 3
[grains]
number = {number}
mass = 1.0
low = [0.0, 0.0]
high = [6.0, 9.0]
[law]
kn = 1e3
restitution = 0.5
[[walls]]
name = "floor"
point = [0.0, 0.0]
normal = [0.0, 1.0]
[[walls]]
name = "gate"
point = [6.0, 0.0]
normal = [-1.0, 0.0]
[[stages]]
name = "fall"
duration = 2.0
[[stages]]
name = "open"
duration = 1.0
remove = ["{gate}"]
"""


@pytest.mark.usefixtures("plain_figures")
def test_the_command_line_from_end_to_end(tmp_path):
    (tmp_path / "s.toml").write_text(TOML.format(number=30, gate="gate"))
    done = stickslip("run", tmp_path / "s.toml", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "fall" in done.stdout
    names = {path.name for path in (tmp_path / "out").iterdir()}
    figures = {"fig1_snapshots.png", "fig2_time_series.png"}
    assert names == {*figures, "manifest.json", "results.h5", "scenario.json", "series.csv"}
    numbers = archive.read(tmp_path / "out" / "results.h5")
    table = np.genfromtxt(tmp_path / "out" / "series.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["kinetic_energy"], numbers["series"]["kinetic_energy"], rtol=1e-8)
    assert {"floor_force_y", "gate_force_x", "center_x"} <= set(table.dtype.names)
    again = ss.experiments.flow.simulate_flow(read_scenario(tmp_path / "s.toml"))
    last = numbers["frames"][sorted(numbers["frames"])[-1]]
    assert np.array_equal(last.grains.position, again.frames[-1].grains.position)  # same scenario, same bits
    for wrong, words in (({"number": 400, "gate": "gate"}, "room for"), ({"number": 30, "gate": "gaet"}, "gaet")):
        (tmp_path / "s.toml").write_text(TOML.format(**wrong))
        run = stickslip("run", tmp_path / "s.toml", "--out", tmp_path / "new")
        assert run.returncode == 2
        assert words in run.stderr
        assert run.stderr.count("\n") == 1
        assert not (tmp_path / "new").exists()
