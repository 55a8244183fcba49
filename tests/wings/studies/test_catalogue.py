"""The catalogue of events: scenario, packings until enough events are found, tables, measures, resume and figures."""

import pickle
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import stickslip as ss
from stickslip.cli import main
from stickslip.runs.folder import write_result
from stickslip.wings.studies.catalogue import figures as figures
from stickslip.wings.studies.catalogue import read_table, simulate
from stickslip.wings.studies.catalogue.simulate import (
    MEASURES,
    event_table,
    rows_of,
    stack_tables,
    step_table,
    write_table,
)
from tests.conftest import save_noise
from tests.events.made import events_of, samples

SMALL = {"packing": {"grains": 12, "packing_fraction": 0.9}, "shear": {"drag": 0.1}}
CALLS, PACKED, MADE = [], {}, {}


def seed_of(state) -> int:
    """Seed of the packing from which a state was made."""
    return next(k for k in range(20) if np.array_equal(PACKED.get(k), state.grains.position))


def scenario(**tables):
    return ss.scenario(experiment="catalogue", **SMALL | tables)


@pytest.fixture
def made(monkeypatch):
    """Search replaced by a formula: two events for each packing, one more for every third; packing 4 fails."""

    def find_events(state, law, *, to, drag, step, most, report, **more):
        seed = seed_of(state)
        CALLS.append(seed)
        if seed == 4:
            raise ss.NotInEquilibriumError("no equilibrium was found")
        report("search for events", 0.5, "half")
        return events_of(seed, 2 + (seed % 3 == 0), state, step)

    def make_packing(chosen, law, seed):
        key = chosen.model_dump_json(), pickle.dumps(law), seed
        if key not in MADE:  # once for all tests
            MADE[key] = pickle.dumps(packing(chosen, law, seed))
        state, packed = pickle.loads(MADE[key])
        PACKED[seed] = state.grains.position
        return state, packed

    packing = simulate.make_packing
    monkeypatch.setattr(simulate, "make_packing", make_packing)
    monkeypatch.setattr(simulate, "find_events", find_events)
    CALLS.clear()


BAD = [
    ({}, "shear.drag is missing: give it"),
    ({"shear": {}}, "shear.drag is missing"),
    ({"shear": {"drag": 0.0}}, "shear.drag must be greater than 0, got 0.0"),
    ({"shear": {"drag": -1}}, "shear.drag"),
    ({"shear": {"drag": float("nan")}}, "shear.drag must be a finite number, got nan"),
    ({"shear": {"drag": "0.1"}}, "shear.drag must be a valid number, got '0.1'"),
    (
        {"shear": {"drag": 0.1, "resolution": 1e-3}},
        "shear.resolution must be smaller than shear.step = 0.0004, got 0.001",
    ),
    ({"shear": {"drag": 0.1, "step": 0.5}}, "shear.step must be at most the largest strain"),
    ({"shear": {"drag": 0.1, "step": 1e-6, "resolution": 1e-9}}, "400000 load steps"),
    ({"shear": {"drag": 0.1, "window": 1e-4}}, "shear.window must be at least"),
    ({"shear": {"drag": 0.1, "strain": float("inf")}}, "shear.strain must be a finite number, got inf"),
    ({"shear": {"drag": 0.1, "drags": 1}}, "drags"),
    ({"shear": {"drag": 0.1}, "events": 0}, "events must"),
    ({"shear": {"drag": 0.1}, "events": 2.5}, "events must be a valid integer, got 2.5"),
    ({"shear": {"drag": 0.1}, "packings": 10**9}, "packings must be less than or equal to 100000, got 1000000000"),
    ({"shear": {"drag": 0.1}, "packing": {"dim": 4}}, "packing.dim must"),
    ({"shear": {"drag": 0.1}, "packing": {"pressure": 1e-3, "packing_fraction": 0.9}}, "exclude each other"),
    ({"shear": {"drag": 0.1}, "law": {"kind": "hookean"}}, "law.kind must"),
]


@pytest.mark.parametrize(("tables", "message"), BAD)
def test_what_cannot_be_run_is_refused_in_one_sentence(tables, message):
    with pytest.raises(ss.experiments.ScenarioError) as caught:
        ss.scenario(experiment="catalogue", **tables)
    assert message in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(("wanted", "packings", "seeds"), [
    (1, 50, [0]), (3, 50, [0]), (4, 50, [0, 1]), (9, 50, [0, 1, 2, 3]), (11, 50, [0, 1, 2, 3, 5]), (99, 3, [0, 1, 2]),
])  # fmt: skip
def test_packings_are_sheared_until_there_are_enough_events(made, wanted, packings, seeds):
    result = ss.simulate(scenario(events=wanted, packings=packings), workers=1)
    assert [sample.seed for sample in result.samples] == seeds
    assert result.number == sum(2 + (seed % 3 == 0) for seed in seeds)
    assert len(result.failures) == (max(seeds) > 4)
    assert repr(result).startswith("CatalogueResult: ")


@pytest.mark.parametrize("events", [10, 14])  # 10: exactly those of the first four packings
def test_the_result_does_not_depend_on_how_many_run_at_a_time(made, monkeypatch, events):
    chosen = scenario(events=events)
    result = ss.simulate(chosen, workers=1)
    monkeypatch.setattr(simulate, "reach", lambda workers: ss.ensemble.Spread(5, "five"))
    CALLS.clear()
    five = ss.simulate(chosen, workers=1)
    assert CALLS[:5] == [0, 1, 2, 3, 4]  # a batch
    assert [s.seed for s in five.samples] == [s.seed for s in result.samples]
    assert five.failures == result.failures
    for name, column in event_table(result.samples).items():
        np.testing.assert_array_equal(column, event_table(five.samples)[name])


def test_nothing_but_failures_is_an_error(made):
    with pytest.raises(RuntimeError, match="every packing failed; first message: packing 4: "):
        ss.simulate(scenario(seed=4, packings=1), workers=1)


def call(monkeypatch, *arguments) -> int:
    monkeypatch.setattr(sys, "argv", ["stickslip", *map(str, arguments)])
    with pytest.raises(SystemExit) as caught:
        main()
    return caught.value.code


def save_black(figure, path, format=None, **options):
    Image.new("L", (300, 300)).save(path, format)


def test_a_run_that_was_stopped_goes_on_and_equals_one_that_was_not(made, monkeypatch, tmp_path):
    monkeypatch.setattr(Figure, "savefig", save_black)  # which takes no second to draw
    text = (
        'experiment = "catalogue"\nevents = 6\npackings = 4\n[packing]\ngrains = 12\npacking_fraction = 0.9\n'
        "[shear]\ndrag = 0.1\n"
    )
    (tmp_path / "c.toml").write_text(text)
    assert call(monkeypatch, "run", tmp_path / "c.toml", "--out", tmp_path / "whole", "--workers", "1") == 0
    through = simulate.find_events

    def stopped(state, law, **options):
        if seed_of(state) == 2:
            raise KeyboardInterrupt
        return through(state, law, **options)

    monkeypatch.setattr(simulate, "find_events", stopped)
    assert call(monkeypatch, "run", tmp_path / "c.toml", "--out", tmp_path / "parts", "--workers", "1") == 130
    monkeypatch.setattr(simulate, "find_events", through)
    CALLS.clear()
    assert call(monkeypatch, "resume", tmp_path / "parts", "--workers", "1") == 0
    assert CALLS == [2]  # the two packings before it were saved
    names = sorted(path.name for path in (tmp_path / "whole").iterdir() if path.suffix in (".csv", ".h5", ".png"))
    assert {"events.csv", "steps.csv", "results.h5", "fig4_roc.png"} <= set(names)
    for name in names:
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "parts" / name).read_bytes(), name


def test_the_dataset_has_the_tables_with_units(made, monkeypatch, tmp_path):
    monkeypatch.setattr(Figure, "savefig", save_noise)
    result = ss.simulate(scenario(events=5), workers=1)
    write_result(tmp_path, ss.experiments.EXPERIMENTS["catalogue"], result)
    data = ss.io.open_dataset(tmp_path)
    events = event_table(result.samples)
    np.testing.assert_array_equal(data["events"].strain, events["strain"])
    np.testing.assert_array_equal(data["events"].softest, events["softest"])
    assert data["events"].softest.attrs["units"] == "1/time^2"
    np.testing.assert_array_equal(data["steps"].switch, step_table(result.samples)["switch"])
    assert [str(kind) for kind in data["events"].kind.values] == events["kind"].tolist()
    assert data["frames"].sizes["frame"] == len(result.samples)


def test_members_of_a_sweep_are_measured(made, tmp_path):
    tables = SMALL | {"events": 5, "sweep": {"law.mu": [0.5, 10.0]}}
    swept = ss.run_sweep(ss.sweep(experiment="catalogue", **tables), tmp_path, workers=1)
    assert swept.failures == ["", ""]
    data = ss.io.open_sweep(tmp_path)
    assert data.events.values.tolist() == [5.0, 5.0] and data.share_pair.values[0] == pytest.approx(0.4)


def test_a_table_comes_back_from_its_file(tmp_path):
    for table in (event_table(samples()), step_table(samples())):
        write_table(tmp_path / "t.csv", table, digits=17)
        back = read_table(tmp_path / "t.csv")
        assert list(back) == list(table)
        for name, column in table.items():
            assert back[name].shape == column.shape and back[name].dtype.kind == column.dtype.kind, name
            np.testing.assert_array_equal(back[name], column)
    table = event_table(samples())
    events = [event for sample in samples() for event in sample.found.events]
    assert list(zip(table["trigger_i"], table["trigger_j"], strict=True)) == [event.trigger for event in events]
    write_table(tmp_path / "t.csv", table)
    head = (tmp_path / "t.csv").read_text().splitlines()[0].split(",")
    assert "softest_0 [1/time2]" in head and "kind" in head and "strain [-]" in head


def test_a_table_without_events_comes_back(tmp_path):
    table = event_table([])
    write_table(tmp_path / "t.csv", table)
    assert len(read_table(tmp_path / "t.csv")["strain"]) == 0


def test_tables_with_different_numbers_of_distances_are_joined():
    first, second = event_table(samples(1, 3)), event_table(samples(2, 2))
    second["softest"] = second["softest"][:, :4]
    both = stack_tables([("a", first), ("b", second)], "law")
    assert both["law"].tolist() == ["a"] * 3 + ["b"] * 4
    assert both["softest"].shape == (7, 6) and np.isnan(both["softest"][3:, 4:]).all()
    np.testing.assert_array_equal(rows_of(both, both["law"] == "b")["strain"], second["strain"])


def test_tables_without_events_do_not_take_columns_from_others(tmp_path):
    write_table(tmp_path / "t.csv", event_table([]))
    full, empty = event_table(samples(1, 3)), read_table(tmp_path / "t.csv")
    both = stack_tables([("none", empty), ("some", full)], "part")
    assert both["part"].tolist() == ["some"] * 3
    np.testing.assert_array_equal(both["softest"], full["softest"])


def test_measures_are_those_of_the_table(made):
    result = ss.simulate(scenario(events=5), workers=1)
    numbers = {name: value for name, (value, _) in MEASURES(result).items()}
    assert numbers["events"] == 5 and numbers["packings"] == 2
    assert numbers["events_per_strain"] == pytest.approx(
        5 / sum(s.found.steps.strain[-1] + 4e-4 for s in result.samples)
    )
    assert sum(value for name, value in numbers.items() if name.startswith("share_")) == pytest.approx(1)
    assert numbers["saddle_node_exponent"] == 0.5
    assert numbers["auc_switch"] > 0.9


def test_figures_show_the_events():
    table = event_table(samples(6, 6))
    top, bottom = figures.eigenvalue_before_events(table).axes
    median = next(line for line in top.lines if line.get_label() == "median")
    x, y = median.get_data()
    assert np.polyfit(np.log(x), np.log(y), 1)[0] == pytest.approx(1.0, abs=1e-6)  # λ² ∝ distance
    flat = next(line for line in bottom.lines if line.get_label() == "median")
    assert np.allclose(flat.get_ydata(), 1)
    counts = {"law": {"saddle_node": 3, "sliding": 1}}
    axes = figures.classes(counts).axes[0]
    assert [text.get_text() for text in axes.texts] == ["3", "1"]
    upper, _ = figures.drops({"law": table}).axes
    shares = upper.lines[0].get_ydata()
    assert shares[0] == 1 and (np.diff(shares) < 0).all()
    rising = table | {"stress_drop": np.where(np.arange(len(table["stress_drop"])) < 3, -1.0, table["stress_drop"])}
    shares = figures.drops({"law": rising}).axes[0].lines[0].get_ydata()
    assert (shares[0], shares[-1]) == (
        pytest.approx(1 - 3 / len(rising["stress_drop"])),
        1 / len(rising["stress_drop"]),
    )


def test_a_run_without_events_is_still_reported(monkeypatch, capsys):
    monkeypatch.setattr(simulate, "find_events", lambda state, law, **o: events_of(0, 0, state, o["step"]))
    result = ss.simulate(scenario(packings=1), workers=1)
    assert result.number == 0 and list(simulate.figures(result)) == []
    simulate.show(result)
    assert "0 events in 1 packing," in capsys.readouterr().out
    numbers = {name: value for name, (value, _) in MEASURES(result).items()}
    assert numbers["events_per_strain"] == 0 and np.isnan(numbers["saddle_node_exponent"])
