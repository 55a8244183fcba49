"""Results as an xarray dataset: units, ragged contacts, a table of one frame, runs that are not finished."""

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.contacts.neighbors import with_neighbor_list
from stickslip.core.units import SI, Fields, in_si
from stickslip.data import archive
from stickslip.data.checkpoint import Checkpoint
from stickslip.wings.studies.flow.simulate import FlowSeries, StageEnd
from tests.conftest import make_law, make_packing, stirred

LAW = make_law("hertz_mindlin", "sharp")


def results(path, si=False):
    """A file of two frames that have different numbers of contacts, and a table."""
    rng = np.random.default_rng(0)
    one, two = (stirred(make_packing(3, seed=seed), LAW, rng) for seed in (0, 3))
    series = {"time": np.arange(4.0), "kinetic_energy": np.ones(4), "center": np.zeros((4, 3)), "kind": "a"}
    series = Fields(series, FlowSeries)
    tree = {"law": LAW, "frames": {"first": one, "last": two}, "series": series, "units": "those of the scenario"}
    archive.write(path / "results.h5", tree, scenario="text", version="0", units=SI if si else None)
    return one, two


def test_frames_have_units_and_contacts_are_ragged(tmp_path):
    one, two = results(tmp_path)
    tree = ss.io.open_dataset(tmp_path)
    data, series = tree["frames"], tree["series"]
    assert dict(data.sizes)["frame"] == 2
    assert data.position.dims == ("frame", "grain", "axis")
    assert data.position.units == "length"
    assert data.velocity.units == "length/time"
    assert series.kinetic_energy.dims == ("time",)
    assert series.kinetic_energy.units == "energy"
    assert series.center.dims == ("time", "axis")
    assert list(series.center.axis.values) == ["x", "y", "z"]
    assert float(series.kinetic_energy.sel(time=2.2, method="nearest").time) == 2.0
    np.testing.assert_array_equal(data.position.sel(frame="last"), two.grains.position)
    counts = [len(ss.measure.touching(state)) for state in (one, two)]
    assert counts[0] != counts[1]
    np.testing.assert_array_equal(data.contact_count, counts)
    assert data.sizes["contact"] == sum(counts)
    assert tree.attrs["scenario"] == "text"
    assert tree.attrs["stickslip"] == "0"


def test_the_table_of_a_frame_holds_its_contacts(tmp_path):
    one, two = results(tmp_path)
    data = ss.io.open_dataset(tmp_path / "results.h5")
    for state, frames in ((one, ("first", 0, -2)), (two, ("last", 1, -1))):
        rows = ss.measure.touching(state)
        for frame in frames:
            table = ss.io.contact_table(data, frame)
            np.testing.assert_array_equal(table.i, state.contacts.i[rows])
            np.testing.assert_array_equal(table[["slip_x", "slip_y", "slip_z"]], state.contacts.slip[rows])
            force = ss.measure.contact_forces(state, LAW)[rows]
            np.testing.assert_array_equal(table[["force_x", "force_y", "force_z"]], force)
            assert set(table["mode"]) <= {"stick", "slide"}
    for wrong in ("middle", 2, -3):
        with pytest.raises(ValueError, match="use first, last"):
            ss.io.contact_table(data, wrong)


def test_walls_that_are_left_keep_their_number_in_the_whole_run(tmp_path):
    """Contacts name bodies: grains from 0, then walls in the order of the run, also where some were removed before."""
    law, radius = ss.laws.linear(), 0.5
    corner = [[radius - 0.01, radius - 0.01, 0], [3.0, radius - 0.02, 0]]
    points, normals = np.array([[0, 0, 0], [9, 0, 0], [0, 0, 0]], float), [[1, 0, 0], [-1, 0, 0], [0, 1, 0]]
    frames = {}
    for name, kept in (("all", [0, 1, 2]), ("left", [0, 2]), ("floor", [2])):
        walls = ss.flat_walls(points[kept], np.array(normals, float)[kept])
        state = with_neighbor_list(ss.assembly(ss.disks(corner, radius), walls, ss.box(dim=2)), law)
        frames[name] = ss.accept(state, ss.forces(state, law)[1])
    words = {"walls": "west\neast\nfloor", "frame_walls": {"left": "west\nfloor", "floor": "floor"}}
    archive.write(tmp_path / "results.h5", {"law": law, "frames": frames} | words, scenario="", version="0")
    data = ss.io.open_dataset(tmp_path)
    expected = {"all": [(0, 2), (0, 4), (1, 4)], "left": [(0, 2), (0, 4), (1, 4)], "floor": [(0, 4), (1, 4)]}
    for name, pairs in expected.items():
        table = ss.io.contact_table(data, name)
        assert sorted(zip(table.i, table.j, strict=True)) == pairs
        ends = table.set_index(["i", "j"])
        # a disk sinks by 0.01 or 0.02, at k_n = 1, and is pushed along the normal of the wall that the index names
        np.testing.assert_allclose(ends.loc[(1, 4), ["force_x", "force_y"]], [0, 0.02], atol=1e-15)
        if (0, 2) in pairs:
            np.testing.assert_allclose(ends.loc[(0, 2), ["force_x", "force_y"]], [0.01, 0], atol=1e-15)
    np.testing.assert_array_equal(
        np.isnan(data["frames"].wall_point.sel(frame="left").values).any(axis=1), [False, True, False]
    )


def test_units_are_si_where_the_scenario_is(tmp_path):
    results(tmp_path, si=True)
    data = ss.io.open_dataset(tmp_path)
    assert data["frames"].position.units == "m"
    assert data["series"].kinetic_energy.units == "J"


def test_what_an_unfinished_run_has_kept_can_be_looked_at(tmp_path):
    kept = Checkpoint(tmp_path, "text")
    state = stirred(make_packing(2), LAW, np.random.default_rng(0))
    kept.save("000000", {"state": state, "rows": {"time": np.arange(3.0)}})
    kept.save("000001", {"state": state._replace(time=2.0), "rows": {"time": np.arange(2.0)}})
    data = ss.io.open_dataset(tmp_path)
    np.testing.assert_array_equal(data["frames"].time, [state.time, 2.0])
    assert data.attrs["finished"] == "no"


@pytest.mark.parametrize("made", [None, "folder", "file"])
def test_a_foreign_place_is_told(tmp_path, made):
    place = tmp_path / "place"
    if made == "folder":
        place.mkdir()
    if made == "file":
        place.write_bytes(b"PK\x03\x04")
    with pytest.raises(
        ValueError, match=r"(place (does not exist|contains no results): give a run folder|give the results\.h5)"
    ):
        ss.io.open_dataset(place)


def saved(path, tree, si=False):
    archive.write(path / "results.h5", tree, scenario="", version="0", units=SI if si else None)
    return ss.io.open_dataset(path)


def frames(*times):
    state = stirred(make_packing(2), LAW, np.random.default_rng(0))
    return [state._replace(time=float(t)) for t in times]


def test_frames_are_chosen_by_time(tmp_path):
    tree = saved(tmp_path, {"law": LAW, "frames": dict(zip("abc", frames(0, 10, 30), strict=True))})
    data = tree["frames"]
    assert data.position.dims == ("time", "grain", "axis")
    near = data.position.sel(time=22, method="nearest")
    assert (float(near.time), str(near.frame.values)) == (30.0, "c")
    assert len(ss.io.contact_table(tree, "c")) == len(ss.io.contact_table(tree, 2)) > 0


def test_frames_of_a_load_path_are_chosen_by_load(tmp_path):
    loads = {"0.000000": 0, "0.030000": 0, "0.090000": 0}
    data = saved(tmp_path, {"frames": dict(zip(loads, frames(*loads.values()), strict=True))})["frames"]
    assert float(data.position.sel(load=0.08, method="nearest")["load"]) == 0.09
    assert list(data.frame.values) == list(loads)


def test_stages_are_a_named_dimension(tmp_path):
    rows = [{"name": n, "start": float(k), "end": k + 1.0} for k, n in enumerate(("pour", "rest"))]
    stages = {f"{k:02d}": Fields(row, StageEnd) for k, row in enumerate(rows)}
    found = saved(tmp_path, {"stages": stages})["stages"]
    assert float(found.end.sel(stage="rest")) == 2.0
    assert found.start.units == "time"


def test_no_name_has_a_dot_and_nested_tables_do_not_clash(tmp_path):
    inner = {"time": np.arange(3.0), "friction": np.ones(3)}
    outer = {"time": np.arange(5.0), "friction": np.ones(5), "late": inner}
    tree = saved(tmp_path, {"runs": {"0001": outer, "0002": outer}})
    assert set(tree["runs"].children) == {"0001", "0002"}
    assert tree["runs/0001"].friction.sizes == {"time": 5}
    assert tree["runs/0001/late"].friction.sizes == {"late_time": 3}
    assert not [name for node in tree.subtree for name in (*node.variables, *node.dims) if "." in str(name)]


def test_what_does_not_grow_is_no_coordinate(tmp_path):
    tree = saved(tmp_path, {"series": {"time": np.array([0.0, 1.0, 1.0]), "friction": np.zeros(3)}})
    assert tree["series"].friction.dims == ("series",)
    assert "time" in tree["series"]


DIMENSIONS = {
    "length": "[length]", "time": "[time]", "length/time": "[length]/[time]", "rad": "", "rad/time": "1/[time]",
    "mass": "[mass]", "mass length^2": "[mass]*[length]**2", "force": "[mass]*[length]/[time]**2",
    "force length": "[mass]*[length]**2/[time]**2", "force/length": "[mass]/[time]**2",
    "energy": "[mass]*[length]**2/[time]**2", "force/length^(dim-1)": "[mass]/[length]/[time]**2",
    "length/time^2": "[length]/[time]**2", "length^2": "[length]**2", "length^2/time^2": "[length]**2/[time]**2",
    "1/time": "1/[time]", "1/time^2": "1/[time]**2", "1": "", "energy/length": "[mass]*[length]/[time]**2",
    "force/time": "[mass]*[length]/[time]**3",
}  # fmt: skip


def test_pint_reads_every_unit_in_si():
    pint = pytest.importorskip("pint")
    from pint.util import ParserHelper

    registry = pint.UnitRegistry()
    for name, wanted in DIMENSIONS.items():
        found = registry.Unit(in_si(name)).dimensionality
        assert found == registry.get_dimensionality(ParserHelper.from_string(wanted) if wanted else {}), name
