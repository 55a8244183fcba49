"""`stickslip run` of a fault: files, restart, dataset, files of the SEAS platform, refusals; the quick benchmark."""

import json

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import stickslip as ss
from stickslip.cli import main
from stickslip.experiments.registry import EXPERIMENTS, ScenarioError, papers, read_scenario, scenario
from stickslip.friction import fault_dataset
from stickslip.kit import ArchiveError
from stickslip.reports.page import write_page
from stickslip.runs import folder as run_folder
from stickslip.runs.folder import write_result
from stickslip.runs.page import folder_content
from stickslip.wings.faults.fault import report
from stickslip.wings.faults.fault import simulate as room
from stickslip.wings.faults.fault.claims import bp1_claims, bp1_scenario
from stickslip.wings.faults.fault.figures import max_slip_velocity
from stickslip.wings.faults.friction.fault_record import YEAR
from tests.conftest import save_noise
from tests.conftest import stickslip_here as stickslip

SMALL = """
experiment = "fault"
[line]
width = 5e3
cell = 100.0
strike_length = 1e4
[friction]
a = [[2000, 0.010], [3000, 0.025]]
dc = 1.5e-3
normal = 10e6
[run]
years = 40.0
stations = [0.0, 1500.0]
"""


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """Folder of a run, and the result that the command wrote there."""
    place, results, write = tmp_path_factory.mktemp("fault"), [], write_result
    (place / "small.toml").write_text(SMALL)
    with pytest.MonkeyPatch.context() as now:
        now.setattr(Figure, "savefig", save_noise)  # the figures of faults are drawn in test_axes_of_figures.py
        now.setattr(run_folder, "write_result", lambda *given: (results.append(given[2]), write(*given))[1])
        run = stickslip("run", place / "small.toml", "--out", place / "out")
    assert run.returncode == 0, run.stderr
    assert "earthquakes can nucleate" in " ".join(run.stdout.split())
    return place / "out", results[0]


@pytest.fixture(scope="module")
def folder(ran):
    return ran[0]


@pytest.fixture(scope="module")
def result(ran):
    return ran[1]


def test_parts_and_states_of_the_earlier_kernel_are_refused(tmp_path, monkeypatch):
    short, true = scenario(experiment="fault", line={"cell": 100.0}, run={"years": 1.0}), room.simulate_fault

    def earlier(*given, **more):
        history = true(*given, **more)
        return history._replace(state=history.state._replace(kernel="uniform"))

    with monkeypatch.context() as now:
        now.setattr(room, "simulate_fault", earlier)
        history = room.simulate_cycles(short, folder=tmp_path).history
    with pytest.raises(ArchiveError, match="slip that is uniform in each cell, but faults now have band-limited slip"):
        room.simulate_cycles(short, folder=tmp_path)
    with pytest.raises(ValueError, match="uniform slip in each cell, but faults now have band-limited slip"):
        true(history.fault, 2.0, start=history.state)


def test_files(folder):
    names = {path.name for path in folder.iterdir()}
    assert names == {
        "devol.dat", "events.csv", "fig1_slip.png", "fig2_velocity.png", "fig3_stations.png", "fltst_dp000.txt",
        "fltst_dp015.txt", "manifest.json", "results.h5", "scenario.json",
    }  # fmt: skip


def test_the_table_of_events_has_moments_and_magnitudes(folder, result):
    """The file, the archive and the measures are those of the result; without a length along strike there are none."""
    notes = [line for line in (folder / "events.csv").read_text().splitlines() if line.startswith("#")]
    assert "# moments and magnitudes are for a length along strike of 10000 m" in notes
    assert any(note.startswith("# The first event, after 8.9") for note in notes)
    table, events = pd.read_csv(folder / "events.csv", comment="#"), result.history.events
    assert np.allclose(table["seismic_moment [N m]"], 1e4 * events.moment, rtol=1e-11)
    assert np.allclose(table["magnitude [-]"], 2 / 3 * (np.log10(1e4 * events.moment) - 9.1), rtol=1e-11)
    assert np.allclose(table["slip_weighted_stress_drop [Pa]"], events.slip_weighted_stress_drop, rtol=1e-11)
    assert np.allclose(table["released [J/m]"], events.released, rtol=1e-11)
    assert table["first [-]"].tolist() == [1] + [0] * (len(table) - 1)
    saved = ss.io.open_dataset(folder)["events"]
    assert np.array_equal(saved.magnitude, result.magnitude) and saved.seismic_moment.attrs["units"] == "N m"
    late = result.magnitude[room.SETTLING :]
    assert EXPERIMENTS["fault"].measures(result)["magnitude"][0] == pytest.approx(late.mean())
    plain = result._replace(scenario=scenario(experiment="fault"))
    assert np.isnan(plain.magnitude).all() and "magnitude" not in report.event_table(plain)


def test_files_of_the_platform_are_what_was_simulated(folder, result):
    lines = (folder / "fltst_dp015.txt").read_text().splitlines()
    assert next(line for line in lines if not line.startswith("#")) == "t slip slip_rate shear_stress state"
    assert "# location=on fault, 1.5 km depth" in lines
    assert sum(line.startswith("# values=interpolated linearly between cells at ") for line in lines) == 1
    top = (folder / "fltst_dp000.txt").read_text()
    assert "# values=extrapolated along the parabola, even about the free surface, from cells at " in top
    h = result.history
    columns = np.loadtxt(folder / "fltst_dp015.txt", skiprows=lines.index("# Here is the time-series data.") + 1).T
    expected = h.time, h.slip[:, 1], np.log10(h.velocity[:, 1]), h.stress[:, 1] / 1e6, np.log10(h.theta[:, 1])
    for column, true in zip(columns, expected, strict=True):
        assert np.allclose(column, true, rtol=1e-6, atol=1e-12)
    lines = (folder / "devol.dat").read_text().splitlines()
    start = lines.index("# Here are the data")
    assert lines[start - 2 : start] == ["z", "t max_slip_rate slip"]
    table = np.loadtxt(folder / "devol.dat", skiprows=start + 1)
    assert table.shape == (len(h.profile_time) + 1, len(h.profile_depth) + 2)
    assert np.array_equal(table[0], np.r_[0, 0, h.profile_depth])
    assert np.allclose(table[1:, 2:], h.profile_slip, rtol=1e-6, atol=1e-12)


def test_the_dataset(folder, result):
    data = ss.io.open_dataset(folder)
    assert data["series"].slip.dims == ("time", "station")
    assert data["series"].slip.attrs["units"] == "m"
    assert np.array_equal(data["series"].station, [0.0, 1500.0])
    assert data["profiles"].slip.dims == ("time", "depth")
    assert data["energy"].loading.attrs["units"] == "J/m"
    assert np.array_equal(data["events"].start, result.history.events.start)
    own = fault_dataset(result.history)
    assert own.stress.dims == ("time", "station")
    assert own.event_start.attrs["units"] == "s"
    assert own.sizes["event"] == len(result.history.events.start)


def test_a_stopped_run_continues_bit_for_bit(result, tmp_path, monkeypatch):
    chosen, true = result.scenario, room.simulate_fault
    monkeypatch.setattr(room, "PART", 15.0)  # the other run had one part

    def stopped(fault, years, **more):
        if years > room.PART:
            raise KeyboardInterrupt
        return true(fault, years, **more)

    monkeypatch.setattr(room, "simulate_fault", stopped)
    with pytest.raises(KeyboardInterrupt):
        ss.simulate(chosen, folder=tmp_path)
    calls = []
    monkeypatch.setattr(room, "simulate_fault", lambda *args, **more: calls.append(args[1]) or true(*args, **more))
    again = ss.simulate(chosen, folder=tmp_path)
    assert calls == [30.0, 40.0]  # the first years were loaded
    for name in ("time", "slip", "stress", "profile_slip", "max_velocity"):
        assert np.array_equal(getattr(again.history, name), getattr(result.history, name))
    assert np.array_equal(again.history.state.excess_slip, result.history.state.excess_slip)
    assert np.array_equal(again.history.events.start, result.history.events.start)


def test_steps_have_the_tolerance_of_the_scenario(result, monkeypatch):
    seen = []

    def stopped(*_, tolerance, **more):
        seen.append(tolerance)
        raise KeyboardInterrupt

    monkeypatch.setattr(room, "simulate_fault", stopped)
    finer = result.scenario.run.model_copy(update={"tolerance": 1e-6})
    with pytest.raises(KeyboardInterrupt):
        ss.simulate(result.scenario.model_copy(update={"run": finer}))
    assert seen == [1e-6]


def test_two_states_in_files_and_datasets(tmp_path, monkeypatch):
    two = 'law = "slip"\nb = 0.012\nb2 = 0.004\ndc2 = 5e-3'
    (tmp_path / "s.toml").write_text(SMALL.replace("[friction]", f"[friction]\n{two}").replace("40.0", "8.0"))
    monkeypatch.setattr(room, "PART", 3.0)
    out, chosen = tmp_path / "out", read_scenario(tmp_path / "s.toml")
    assert ss.simulate(chosen, folder=out).history.fault.states == 2
    history = ss.simulate(chosen).history
    write_result(out, EXPERIMENTS["fault"], ss.simulate(chosen, folder=out))
    data = ss.io.open_dataset(out)
    assert np.array_equal(data["series"].theta2, history.theta2)
    assert data["series"].theta2.attrs["units"] == "s"
    assert data["fault"].dc2.attrs["units"] == "m"
    assert np.array_equal(data["fault"].theta2, history.state.theta2(history.fault))
    assert np.array_equal(fault_dataset(history).theta2, history.theta2)
    assert "Gu1984" in EXPERIMENTS["fault"].references(chosen)["rate-and-state friction"]


def test_a_fault_without_events_says_so_everywhere(tmp_path, capsys):
    """On the terminal, in the figure and on the page, which has no packing and no time series of depths."""
    (tmp_path / "s.toml").write_text(SMALL.replace("years = 40.0", "years = 1.5"))
    result = ss.simulate(read_scenario(tmp_path / "s.toml"))
    said = "There was no event in 1.56 years: no slip velocity reached 0.001 m/s."
    EXPERIMENTS["fault"].show(result)
    assert said in " ".join(capsys.readouterr().out.split())
    report.write_events(result, tmp_path / "events.csv")
    notes = (tmp_path / "events.csv").read_text().splitlines()
    assert f"# {said}" in notes and notes[-1].startswith("start [s],")
    assert max_slip_velocity(result.history).axes[0].get_title() == "no event in 1.56 years"
    write_result(tmp_path / "out", EXPERIMENTS["fault"], result)
    shown = folder_content(tmp_path / "out")
    sections = dict(shown.sections)
    assert said in sections["Remarks"] and "max velocity" in sections["Time series"]
    assert "station" not in sections["Time series"]
    assert "Events" not in sections
    write_page(shown, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "no packing" not in page and page.index("<h2>Measures") == page.index("<h2>")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("[loading]\nstress = 1e9", "loading: no state balances the initial stress of 1e+09 Pa at 50 m"),
        ('[friction]\nform = "logarithmic"\nv2 = 1e-10', "values that vary with depth, or v2 far above this velocity"),
    ],
)
def test_a_start_without_balance_leaves_nothing(change, message, tmp_path, monkeypatch, capsys):
    table = change.partition("\n")[0]
    text = SMALL.replace(table, change) if table in SMALL else f"{SMALL}{change}\n"
    (tmp_path / "s.toml").write_text(text)
    monkeypatch.setattr("sys.argv", ["stickslip", "run", str(tmp_path / "s.toml"), "--out", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    told = capsys.readouterr().err
    assert message in " ".join(told.split()) and told.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_stations_that_were_not_chosen_are_those_on_the_fault(tmp_path):
    short = ss.scenario(experiment="fault", line={"width": 5e3, "cell": 100.0})
    assert short.run.stations == (0.0, 2500.0, 5000.0)
    (tmp_path / "short.json").write_text(short.text)
    assert read_scenario(tmp_path / "short.json") == short


def test_measures_are_averages_over_settled_events(result):
    events = result.history.events
    assert len(events.start) > room.SETTLING + 2
    assert result.recurrence == pytest.approx(np.diff(events.start)[room.SETTLING :].mean())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"friction": {"dc": 1e-3}}, "cell = 50 m does not resolve the cohesive length G D_c/(b σ) = 42.72 m"),
        ({"friction": {"a": ((3e3, 0.01), (1e3, 0.02))}}, "the depths of a are not in order at 1000"),
        ({"friction": {"b2": 0.001}}, "b2 requires dc2"),
        ({"run": {"stations": (50e3,)}}, "run.stations contains 50000 m"),
        ({"run": {"threshold": 1e-10}}, "run.threshold must exceed loading.plate_rate"),
        ({"line": {"boundary": "periodic"}}, "finite, got inf"),
        ({"line": {"width": 1.01e3, "cell": 300.0}}, "a whole number of cells, at least three"),
        ({"injection": {"flux": 1e-5, "stop": 8.64e6}}, "the effective normal stress falls to -"),
        (
            {"injection": {"flux": 1e-9, "start": 5.0, "stop": 3.0}},
            "an injection must end after its start, got 5 to 3 s",
        ),
        ({"normal_stress": {"amplitude": 51e6}}, "use smaller changes, or a larger normal stress"),
        ({"normal_stress": {"times": (0, 1), "changes": ((0,),)}}, "values must have shape (K, D), got (1, 1)"),
        ({"normal_stress": {"times": (1, 0), "changes": ((0,), (1,))}}, "the times of a table of normal stress do not"),
        ({"normal_stress": {"times": (0, 1), "changes": ((0,), (1, 2))}}, "differ in length"),
        ({"normal_stress": {"times": (0, 1e6), "changes": ((0,), (90e6,))}}, "cohesive length G D_c/(b σ) ="),
        ({"normal_stress": {"file": "nowhere.csv"}}, "nowhere.csv cannot be read: No such file"),
        ({"normal_stress": {"file": "a.csv", "times": (0, 1)}}, "exclude each other"),
        ({"friction": {"alpha": 0.2, "b": 0.0}}, "alpha = 0.2 requires b > 0"),
    ],
)
def test_bad_scenarios_are_refused_with_one_sentence(change, message):
    with pytest.raises(ScenarioError) as caught:
        scenario(experiment="fault", **change)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_fault_that_cannot_nucleate_says_so(tmp_path):
    (tmp_path / "s.toml").write_text(SMALL.replace("years = 40.0", "years = 5.0").replace("0.010", "0.020"))
    run = stickslip("run", tmp_path / "s.toml", "--out", tmp_path / "out")
    assert run.returncode == 0, run.stderr
    assert "no earthquake can nucleate: the fault is velocity-strengthening" in " ".join(run.stdout.split())


def test_the_defaults_are_the_benchmark():
    chosen = scenario(experiment="fault")
    fault = chosen.fault
    assert chosen.run.stations == (0, 2500, 5000, 7500, 1e4, 12500, 15000, 17500, 2e4, 25e3, 3e4, 35e3)
    assert np.allclose(fault.a[[0, 299]], 0.010)
    assert fault.a[np.argmin(np.abs(fault.depth - 16525))] == pytest.approx(0.010 + 0.015 * 1525 / 3000)
    assert np.allclose(fault.a[fault.depth > 18e3], 0.025)
    assert fault.damping == pytest.approx(2670 * 3464 / 2)
    assert papers()["seas-bp1"].paper.scenario(quick=True, seed=0).line.cell == 50.0


def made(recurrence=78.34, **more):
    """A result with eight events at a fixed recurrence."""
    start = (428.069 + recurrence * (np.arange(8) - 3)) * YEAR
    columns = {"depth": 12.5e3, "bottom": 18e3, "surface_slip": 3.0, "surface_velocity": 5.0} | more
    events = room.FaultEvents(
        **{name: np.full(8, columns.get(name, 1.0)) for name in room.FaultEvents._fields} | {"start": start}
    )
    chosen = bp1_scenario(quick=True)
    state = room.initial_state(chosen.fault)
    history = room.FaultHistory(
        **dict.fromkeys(room.FaultHistory._fields)
        | {"fault": chosen.fault, "events": events, "state": state, "theta": state.theta(chosen.fault)[None]}
    )
    return room.FaultResult(chosen, history, None)


def test_verdicts_follow_the_numbers():
    same = {c.id: c for c in bp1_claims(made(), (made(),))}
    assert same["recurrence"].verdict == "reproduced"
    assert all(c.verdict == "reproduced" for c in same.values() if c.id != "initial-state"), same
    other = {c.id: c.verdict for c in bp1_claims(made(79.5, depth=20e3), (made(79.5, depth=20e3),))}
    assert other["recurrence"] == "not reproduced"
    assert other["nucleation-depth"] == "not reproduced"
    unsure = {c.id: c.verdict for c in bp1_claims(made(), (made(80.0),))}
    assert unsure["recurrence"] == "undecided"


@pytest.mark.slow
def test_the_quick_benchmark(tmp_path):
    run = stickslip("reproduce", "seas-bp1", "--quick", "--out", tmp_path / "out")
    assert run.returncode == 0, run.stderr
    claims = {c["id"]: c for c in json.loads((tmp_path / "out" / "claims.json").read_text())}
    assert {c["verdict"] for c in claims.values()} == {"reproduced"}
    assert claims["recurrence"]["measured"] == pytest.approx(78.34, rel=5e-3)
