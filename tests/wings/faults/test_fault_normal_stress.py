"""Normal stress on faults that changes in time: pressure, a slider, energy, restart, tables, refusals, BP6."""

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.integrate import quad, solve_ivp
from scipy.linalg import solve_banded
from scipy.optimize import brentq
from scipy.special import erfc

import stickslip as ss
from stickslip import friction
from stickslip.experiments.registry import EXPERIMENTS, ScenarioError, papers, read_scenario, scenario
from stickslip.runs.folder import write_result
from stickslip.wings.faults.fault import simulate as room
from stickslip.wings.faults.fault.claims import CYCLAPS, bp6_claims, bp6_scenario
from stickslip.wings.faults.friction.fault_record import YEAR
from stickslip.wings.faults.friction.fault_state import perturbed_state, with_rates
from stickslip.wings.faults.friction.stress_transfer import INSTANTS
from tests.conftest import save_noise
from tests.conftest import stickslip_here as stickslip

SOURCE = friction.Injection(flux=1.25e-6, storage=1e-9, diffusivity=0.1, stop=8.64e6)
TABLE = friction.StressTable([0.0, 1e7, 1.2e7], [0.0, 1000.0], [[0.0, 0.0], [-2e6, 1e6], [3e6, 0.0]])
EXAMPLE = Path(__file__).parents[3] / "examples" / "injection.toml"
QUIET = friction.Recording(quiet_sampling=YEAR)
STATIONS = friction.Recording(stations=(0.0, 525.0), quiet_sampling=1e5)


def uniform(cells=8, **more):
    """Periodic fault that is the same everywhere, so that it slides as one block on the springs of two plates."""
    more = {"a": 0.015, "b": 0.010, "dc": 1e-3, "normal": 20e6, "boundary": "periodic", "thickness": 2e3} | more
    return friction.line_fault(cells * 100.0, 100.0, **more)


def injected(cells=100, **more):
    """Half of a fault of 10 km with velocity-strengthening friction and an injection at its centre."""
    more = {"a": 0.007, "b": 0.005, "dc": 4e-3, "normal": 50e6, "plate_rate": 0.0, "changes": (SOURCE,)} | more
    fault = friction.line_fault(5e3, 5e3 / cells, **more)
    return fault, friction.initial_state(fault, velocity=1e-12, stress=29.2e6)


# ---- changes of the normal stress


@pytest.mark.parametrize("time", [3e6, 1.3e7])
def test_the_pressure_is_that_of_numerical_diffusion(time):
    """Implicit finite volumes on one side of the source, into which half of the flux goes until it stops."""
    step, h, number = 2e4, 20.0, 600
    x, pressure = (np.arange(number) + 0.5) * h, np.zeros(number)
    k = SOURCE.diffusivity * step / h**2
    bands = np.array([np.full(number, -k), np.full(number, 1 + 2 * k), np.full(number, -k)])
    bands[1, 0] = 1 + k
    for n in range(round(time / step)):
        supply = pressure.copy()
        supply[0] += 0.5 * SOURCE.flux / SOURCE.storage * step / h * ((n + 0.5) * step < SOURCE.stop)
        pressure = solve_banded((1, 1), bands, supply)
    assert np.abs(SOURCE.pressure(x, time) - pressure).max() < 0.005 * pressure.max()


def test_the_fluid_is_conserved():
    x = np.linspace(-40e3, 40e3, 80_001)
    moved = SOURCE._replace(start=1e6, at=300.0)
    for time in (0.5e6, 4e6, 3e7):
        volume = moved.storage * np.trapezoid(moved.pressure(x, time), x)
        given = moved.flux * np.clip(time - moved.start, 0.0, moved.stop - moved.start)
        assert volume == pytest.approx(given, rel=1e-6, abs=1e-12)


def test_tables_are_linear_between_times_and_depths():
    change = TABLE.change(np.array([-50.0, 500.0, 2000.0]), 1.1e7)
    assert np.allclose(change, [0.5e6, 0.5e6, 0.5e6])
    assert np.allclose(TABLE.change(np.array([250.0]), 5e6), 0.75 * -1e6 + 0.25 * 0.5e6)
    assert np.allclose(TABLE.change(np.array([0.0]), 9e9), 3e6)


def test_a_table_of_pressures_replaces_the_closed_form():
    fault, state = injected(50)
    times, depths = SOURCE.stop * np.linspace(0.0, 1.0, 150) ** 2, np.linspace(0.0, 5e3, 251)
    table = friction.StressTable(times, depths, [SOURCE.change(depths, time) for time in times])
    until = SOURCE.stop / YEAR
    by_table = friction.simulate_fault(fault._replace(changes=(table,)), until, start=state, recording=STATIONS)
    exact = friction.simulate_fault(fault, until, start=state, recording=STATIONS)
    assert by_table.state.time == exact.state.time == SOURCE.stop
    assert np.allclose(by_table.state.slip(fault), exact.state.slip(fault), rtol=0, atol=1e-4)


# ---- faults


@pytest.mark.parametrize("law", ["aging", "slip"])
@pytest.mark.parametrize("more", [{}, {"alpha": 0.2}, {"alpha": 0.2, "b2": 0.004, "dc2": 5e-3}])
def test_a_uniform_fault_is_a_slider(law, more):
    """Quasi-static balance τ = σ(t) f and Linker–Dieterich evolution, integrated as written in w, s and s2."""
    wave = friction.Oscillation(amplitude=4e6, period=2e6)
    fault = uniform(law=law, form="logarithmic", wave_speed=np.inf, changes=(wave,), **more)
    state = perturbed_state(fault, friction.initial_state(fault), 1.0)
    stiffness = -fault.transfer(np.ones(8))[0]
    a, b, b2, dc, dc2, v0 = fault.a[0], fault.b[0], fault.b2[0], fault.dc[0], fault.dc2[0], fault.v0

    def rates(time, x):
        w, *states = x
        sigma = fault.normal[0] + 4e6 * np.sin(np.pi * 1e-6 * time)
        slope = np.pi * 1e-6 * 4e6 * np.cos(np.pi * 1e-6 * time)
        v, changes = v0 * np.exp(w), []
        for s, length in zip(states, (dc, dc2), strict=True):
            steady = v / v0 * np.exp(s)
            evolve = (1 - steady) / np.exp(s) if law == "aging" else -steady * np.log(steady) / np.exp(s)
            changes.append(v0 / length * evolve - fault.alpha / (b + b2) * slope / sigma)
        mu = fault.mu0 + a * w + b * states[0] + b2 * states[1]
        driven = stiffness * (fault.plate_rate - v)
        return [(driven - slope * mu) / (sigma * a) - (b * changes[0] + b2 * changes[1]) / a, *changes]

    second = state.log_state if state.log_state2 is None else state.log_state2
    start = [state.log_velocity[0], state.log_state[0], second[0]]
    end = friction.simulate_fault(fault, 0.2, start=state, tolerance=1e-9).state
    true = solve_ivp(rates, (0.0, end.time), start, method="LSODA", rtol=1e-10, atol=1e-10).y[:, -1]
    assert np.allclose(end.log_velocity, true[0], atol=2e-6)
    assert np.allclose(np.log(end.theta(fault) * v0 / dc), true[1], atol=2e-6)
    assert abs(end.log_velocity[0] - np.log(fault.plate_rate / v0)) > 0.01


@pytest.mark.parametrize("alpha", [0.0, 0.3])
def test_friction_balances_stress_under_the_present_normal_stress(alpha):
    fault, state = injected(alpha=alpha)
    history = friction.simulate_fault(fault, 0.25, start=state, recording=STATIONS)
    end, now = history.state, fault._replace(normal=fault.normal_at(history.state.time), changes=())
    friction_now = end.stress(fault) / now.normal
    v, theta = end.velocity(fault), end.theta(fault)
    x = v / (2 * fault.v0) * np.exp((fault.mu0 + fault.b * np.log(fault.v0 * theta / fault.dc)) / fault.a)
    assert np.allclose(friction_now, fault.a * np.arcsinh(x), rtol=1e-9)
    assert now.normal[0] == pytest.approx(50e6 - SOURCE.pressure(fault.depth[:1], end.time)[0])
    last = friction.simulate_fault(fault, history.time[-1] / YEAR - 1e-9, start=state, recording=STATIONS).state
    assert last.time == history.time[-1]
    assert fault.depth[10] == 525.0
    assert history.steps > 0.25 * YEAR / STATIONS.quiet_sampling > 77
    assert np.diff(history.time).max() < 2 * STATIONS.quiet_sampling
    assert history.stress[-1, 1] == pytest.approx(last.stress(fault)[10], rel=1e-9)
    assert history.theta[-1, 1] == pytest.approx(last.theta(fault)[10], rel=1e-9)
    again = with_rates(fault, end)
    assert np.allclose(again.rates, end.rates, rtol=1e-9, atol=1e-20)


@pytest.mark.parametrize("more", [{}, {"alpha": 0.3}, {"alpha": 0.3, "b": 0.003, "b2": 0.002, "dc2": 8e-3}])
def test_a_perturbation_leaves_the_stress(more):
    fault, state = injected(**more)
    end = friction.simulate_fault(fault, 0.2, start=state, recording=STATIONS).state
    other = perturbed_state(fault, end, 0.5)
    assert np.allclose(other.log_velocity, end.log_velocity + 0.5, atol=1e-9)
    assert np.allclose(perturbed_state(fault, end, 0.0).log_state, end.log_state, atol=1e-9)


def test_a_change_at_the_start_is_part_of_the_initial_state():
    change = friction.StressTable([0.0, 1e7], [0.0], [[5e6], [0.0]])
    fault, state = injected(changes=(change,), alpha=0.3)
    assert np.allclose(state.velocity(fault), 1e-12, rtol=1e-9)
    higher, same = injected(changes=(), normal=55e6)
    assert np.allclose(state.theta(fault), same.theta(higher), rtol=1e-9)


def test_energy_is_conserved_without_plates():
    fault, state = injected()
    energy = friction.simulate_fault(fault, 0.5, start=state, recording=STATIONS, tolerance=1e-8).energy
    assert energy.loading == 0.0
    assert energy.frictional > 0
    assert abs(energy.residual) < 1e-10


def test_a_continued_run_is_the_run_without_a_stop():
    fault, state = injected(alpha=0.2, changes=(SOURCE, TABLE, friction.Oscillation(1e5, 5e6)))
    whole = friction.simulate_fault(fault, 0.4, start=state, recording=STATIONS)
    half = friction.simulate_fault(
        fault, whole.time[len(whole.time) // 2] / YEAR - 1e-9, start=state, recording=STATIONS
    )
    rest = friction.simulate_fault(fault, 0.4, start=half.state, recording=STATIONS)
    assert 0 < half.state.time < whole.state.time
    for name in ("excess_slip", "log_state", "log_velocity", "energy"):
        assert np.array_equal(getattr(rest.state, name), getattr(whole.state, name)), name


def test_steps_end_where_the_normal_stress_is_not_smooth():
    """Even if they are longer than the injection."""
    short = SOURCE._replace(start=1e5, stop=1.3e5)
    fault, state = injected(40, changes=(short,))
    recording = friction.Recording(stations=(0.0,), quiet_sampling=0.2 * YEAR)
    for time in (short.start, short.stop):
        assert friction.simulate_fault(fault, time / YEAR, start=state, recording=recording).state.time == time


def test_a_small_normal_stress_near_the_surface_starts_from_steady_stress():
    shape = {"a": 0.010, "b": 0.015, "dc": 8e-3, "normal": [(0.0, 1e5), (5e3, 50e6)]}
    fault = friction.line_fault(10e3, 100.0, **shape)
    with pytest.raises(ValueError, match=r"the default initial stress, .* of steady sliding at the deepest cell"):
        friction.initial_state(fault)
    state = friction.initial_state(fault, stress="steady")
    assert np.allclose(state.theta(fault) * fault.plate_rate, fault.dc, rtol=1e-9)
    end = friction.simulate_fault(fault, 1.0, start=state).state
    assert np.allclose(end.velocity(fault), fault.plate_rate, rtol=1e-6)
    with pytest.raises(ValueError, match="stress must be values in Pa, or 'steady', got 'low'"):
        friction.initial_state(fault, stress="low")


# ---- constant friction


def crack(ratio, x, *, modulus, pressure, diffusion):
    """Slip of a crack with constant friction under p = Δp erfc(x/l), and its half-length; Viesca, arXiv:2102.03123.

    Without a singular stress at its tips, the half-length λ l follows from T = (2/π) ∫ erfc(λ sin u) du from 0 to π/2,
    and slip from the stress drop by the kernel of a crack of mode III.
    """
    drop = pressure * 0.6

    def missing(scale):
        return 2 / np.pi * quad(lambda u: erfc(scale * np.sin(u)), 0, np.pi / 2)[0] - ratio

    half = brentq(missing, 1e-6, 50.0) * diffusion

    def slip(at):
        def rate(xi):
            kernel = sum(np.arccosh(abs((half**2 - at * y) / (half * (at - y)))) for y in (xi, -xi))
            return drop * (erfc(xi / diffusion) - ratio) * kernel

        return 2 / (np.pi * modulus) * (quad(rate, 0, at, limit=200)[0] + quad(rate, at, half, limit=200)[0])

    return np.array([slip(at) if at < half else 0.0 for at in x]), half


@pytest.mark.parametrize("ratio", [pytest.param(0.3, marks=pytest.mark.slow), 0.6])
def test_slip_with_constant_friction_is_that_of_viesca(ratio):
    """A direct effect a → 0 without evolution: the error falls with a, and that of an extrapolation with a²."""
    end, pressure, length = 1e6, 5e6, np.sqrt(4 * 0.1 * 1e6)
    times, depths = end * np.linspace(0.0, 1.0, 80) ** 2, np.linspace(0.0, 1500.0, 301)
    values = [-pressure * erfc(depths / (length * np.sqrt(max(t, 1e-9) / end))) for t in times]
    slips = []
    for a in (8e-4, 4e-4, 2e-4):
        fault = friction.line_fault(
            1500.0, 25.0, a=a, b=0.0, dc=1e-2, normal=50e6, v0=1e-7, plate_rate=0.0,
            changes=(friction.StressTable(times, depths, values),),
        )  # fmt: skip
        start = friction.initial_state(fault, velocity=1e-7, stress=0.6 * (50e6 - ratio * pressure))
        history = friction.simulate_fault(fault, end * (1 - 1e-9) / YEAR, start=start, recording=QUIET)
        assert history.state.time == end
        slips.append(history.state.excess_slip)
    true, half = crack(ratio, fault.depth, modulus=fault.modulus, pressure=pressure, diffusion=length)
    errors = [np.abs(slip - true).max() / true[0] for slip in slips]
    assert 1.6 < errors[0] / errors[1] < 2.4
    assert errors[2] < 0.05
    assert np.abs(2 * slips[2] - slips[1] - true).max() < 0.01 * true[0]
    assert fault.depth[slips[2] > 1e-3 * true[0]].max() == pytest.approx(half, abs=0.1 * half)


# ---- scenarios


def test_the_archive_and_the_dataset_have_the_normal_stress(tmp_path, monkeypatch):
    monkeypatch.setattr(Figure, "savefig", save_noise)
    smaller = {"line": {"width": 5e3, "cell": 100.0}, "run": {"years": 0.3, "stations": (0.0, 500.0)}}
    chosen = scenario(**(read_scenario(EXAMPLE).model_dump() | smaller))
    result = ss.simulate(chosen)
    write_result(tmp_path / "out", EXPERIMENTS["fault"], result)
    data, own = ss.io.open_dataset(tmp_path / "out")["series"], friction.fault_dataset(result.history)
    time = result.history.time
    true = [50e6 - SOURCE.pressure(result.history.station, t) for t in time]
    for normal in (data.normal, own.normal):
        assert normal.attrs["units"] == "Pa"
        assert np.allclose(normal, true)
    assert result.crept_length == 100.0 * (result.history.state.excess_slip >= 4e-3).sum() > 0


def test_a_table_from_a_file(tmp_path):
    (tmp_path / "s.csv").write_text("time \\ depth,0,1000\n0,0,0\n1e7,-2e6,1e6\n12000000,3e6,0\n")
    for ours, table in zip(friction.read_stress_table(tmp_path / "s.csv"), TABLE, strict=True):
        assert np.array_equal(ours, table)
    tables = 'experiment = "fault"\nline.cell = 25.0\nnormal_stress.file = "s.csv"\n'  # beside the scenario
    (tmp_path / "fault.toml").write_text(tables)
    chosen = read_scenario(tmp_path / "fault.toml")
    (tmp_path / "s.csv").unlink()
    assert chosen.normal_stress.changes == ((0.0, 0.0), (-2e6, 1e6), (3e6, 0.0))
    assert np.allclose(chosen.fault.normal_at(1.2e7)[0], 50e6 + 3e6, rtol=1e-2)


def test_initial_stress_varies_with_depth():
    chosen = scenario(
        experiment="fault", line={"cell": 100.0}, run={"years": 0.01}, loading={"stress": ((0.0, 26e6), (40e3, 28e6))}
    )
    state = room.simulate_cycles(chosen).history.state
    assert np.allclose(state.prestress, np.interp(chosen.fault.depth, [0.0, 40e3], [26e6, 28e6]))


def test_bad_files_are_refused_with_one_sentence(tmp_path):
    wrong = "s.csv is not a table of numbers: give depths in m in the first row"
    shape = r"s.csv: values must have shape \(K, D\), got \(1, 1\), as depth has D = 2"
    for text, message in (("", wrong), ("t,0\n", wrong), ("t,0\n1,x\n", wrong), ("t,0,1\n1,2\n", shape)):
        (tmp_path / "s.csv").write_text(text)
        with pytest.raises(ValueError, match=message):
            friction.read_stress_table(tmp_path / "s.csv")


def test_every_instant_of_an_oscillation_is_checked():
    assert 2.0 * YEAR / INSTANTS > 44714.0  # the period is shorter than the time between two instants
    with pytest.raises(ScenarioError, match="use smaller changes"):
        scenario(experiment="fault", normal_stress={"amplitude": 50.000001e6}, run={"years": 2.0})


def test_no_plates_need_a_velocity_at_the_start():
    fault = injected()[0]
    with pytest.raises(ValueError, match="plate_rate = 0 requires an initial velocity"):
        friction.initial_state(fault)


# ---- BP6


def test_the_benchmark_starts_as_published():
    state = friction.initial_state(bp6_scenario(quick=True).fault, velocity=1e-12, stress=29.2e6)
    assert np.log10(state.theta(bp6_scenario(quick=True).fault)[0]) == pytest.approx(10.612318, abs=1e-6)
    assert papers()["seas-bp6"].paper.title.startswith("SEAS benchmark problem BP6-QD")
    assert papers()["seas-bp1"].paper.title.startswith("SEAS benchmark problem BP1-QD")


def made(factor=1.0):
    """A result with the published series, its slip multiplied by a factor."""
    chosen = bp6_scenario(quick=True)
    fault = chosen.fault
    rows = [row for table in CYCLAPS.values() for row in table]
    time = np.array([0.0, *sorted(row[0] for row in rows)])
    table = np.zeros((3, len(time), 6)) + np.array([0.0, -12.0, 29.2])[:, None, None]
    for place, values in enumerate(CYCLAPS.values()):
        for t, *measured, _ in values:
            table[:, time == t, place] = np.array(measured)[:, None]
    state = friction.initial_state(fault, velocity=1e-12, stress=29.2e6)
    events = room.FaultEvents(*np.zeros((len(room.FaultEvents._fields), 0)))
    history = room.FaultHistory(
        **dict.fromkeys(room.FaultHistory._fields)
        | {"fault": fault, "events": events, "state": state, "theta": state.theta(fault)[None], "time": time}
        | {"slip": factor * table[0], "velocity": 10 ** table[1], "stress": 1e6 * table[2]}
        | {"station": np.array(chosen.run.stations)}
    )
    return room.FaultResult(chosen, history, None)


def test_verdicts_follow_the_numbers():
    assert {c.verdict for c in bp6_claims(made(), made(), made())} == {"reproduced"}
    other = {c.id: c.verdict for c in bp6_claims(made(1.02), made(), made(1.02))}
    assert [key for key, verdict in other.items() if verdict == "not reproduced"] == [f"slip-{k}" for k in range(1, 6)]


@pytest.mark.slow
def test_the_quick_benchmark(tmp_path):
    run = stickslip("reproduce", "seas-bp6", "--quick", "--out", tmp_path / "out")
    assert run.returncode == 0, run.stderr
    claims = {c["id"]: c for c in json.loads((tmp_path / "out" / "claims.json").read_text())}
    assert {c["verdict"] for c in claims.values()} == {"reproduced"}
    assert (tmp_path / "out" / "fltst_dp000.0977.txt").exists()
    assert (tmp_path / "out" / "fig4_normal_stress.png").exists()
