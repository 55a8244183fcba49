"""Dipping faults: kernels against a numerical half-space, normal stress, surface displacement, files, BP3."""

import json

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.integrate import quad_vec, solve_ivp

import stickslip as ss
from stickslip import friction
from stickslip.experiments.registry import EXPERIMENTS, ScenarioError, papers, scenario
from stickslip.runs.folder import write_result
from stickslip.wings.faults.fault import figures as figures
from stickslip.wings.faults.fault import simulate as room
from stickslip.wings.faults.fault.claims import FDRA, SURFACE, YEARS, bp3_claims, bp3_scenario
from stickslip.wings.faults.friction.fault_cycles import Energy, join_histories
from stickslip.wings.faults.friction.fault_record import YEAR, Moment, Surface, hermite, hermite_rate
from stickslip.wings.faults.friction.fault_state import steady_stress
from stickslip.wings.faults.friction.stress_transfer import (
    half_space_stress,
    image_nodes,
    stress_matrix,
    stress_transfer,
    surface_displacement,
)
from tests.conftest import save_noise
from tests.conftest import stickslip_here as stickslip

G = 32.04e9
SHORT = {"a": [(2000, 0.010), (3000, 0.025)], "b": 0.015, "dc": 1.5e-3, "normal": 10e6, "shear": "in-plane"}
BESIDE = (-3e3, -0.01, 0.01, 2e3)


def small(cell=100.0, **more):
    """Dipping fault of 5 km with events every few years."""
    return friction.line_fault(5e3, cell, **(SHORT | {"dip": 30.0} | more))


def tensor(mean, deviator):
    """Stress (…, 2, 2) from (σ_xx + σ_zz)/2 and (σ_zz − σ_xx)/2 + i σ_xz."""
    xx, zz, xz = mean - deviator.real, mean + deviator.real, deviator.imag
    return np.moveaxis(np.array([[xx, xz], [xz, zz]]), (0, 1), (-2, -1))


def infinite_body(x, z, ends, dip):
    """Stress (2, 2) of two edge dislocations of unit slip along t, over G/(1 − ν), as in textbooks, for scalars."""
    t = np.array([np.cos(np.radians(dip)), np.sin(np.radians(dip))])
    frame, out = np.array([t, [-t[1], t[0]]]), 0.0
    for sign, end in zip((1, -1), ends, strict=True):
        a, b = frame @ (np.array([x, z]) - end * t)
        r = (a * a + b * b) ** 2
        shear = a * (a * a - b * b)
        out = out - sign / (2 * np.pi * r) * np.array([[-b * (3 * a * a + b * b), shear], [shear, b * (a * a - b * b)]])
    return frame.T @ out @ frame


def numerical_half_space(x, z, ends, dip):
    """Stress in an infinite body, and that of the line loads (Flamant) that remove its tractions at z = 0."""

    def load(at):
        arm = np.array([x - at, z])
        distance = np.hypot(*arm)
        force = infinite_body(at, 0.0, ends, dip)[:, 1]
        return -2 / np.pi * (force @ arm) / distance**4 * np.outer(arm, arm)

    turned = quad_vec(lambda angle: load(x + z * np.tan(angle)) * z / np.cos(angle) ** 2, -np.pi / 2, np.pi / 2)[0]
    return infinite_body(x, z, ends, dip) + turned


# ---- half-space


@pytest.mark.parametrize("dip", [20.0, 60.0, 90.0])
def test_the_stress_is_that_of_a_numerical_half_space(dip):
    ends = [0.5, 1.5]
    for x, z in ((0.3, 0.4), (-1.0, 0.7), (2.0, 2.5), (0.2, 3.0)):
        stress = tensor(*half_space_stress([x + 1j * z], ends, dip))[0, 0]
        assert np.allclose(stress, numerical_half_space(x, z, ends, dip), rtol=0, atol=1e-9)


@pytest.mark.parametrize("dip", [5.0, 30.0, 90.0])
def test_the_surface_is_free(dip):
    x = np.array([-3.0, -0.2, 0.1, 1.0, 20.0])
    mean, deviator = half_space_stress(x, [0.0, 0.7, 1.5, 4.0], dip)
    assert np.abs(mean + deviator).max() < 1e-13
    assert np.abs(mean - deviator.real).max() > 0.1


def test_forces_are_balanced_and_strains_compatible():
    h, ends = 1e-3, [0.5, 1.2]

    def stress(x, z):
        return tensor(*half_space_stress([x + 1j * z], ends, 40.0))[0, 0]

    for x, z in ((0.1, 0.8), (1.5, 0.6)):
        right, left, down, up = stress(x + h, z), stress(x - h, z), stress(x, z + h), stress(x, z - h)
        assert np.abs((right - left)[0] + (down - up)[1]).max() / (2 * h) < 1e-5
        total = np.trace(right + left + down + up) - 4 * np.trace(stress(x, z))
        assert abs(total) / h**2 < 1e-3


def test_deep_slip_is_that_in_an_infinite_body():
    """What the surface adds falls with the square of the depth."""
    lag, added = np.arange(-3.0, 4.0), []
    for depth in (50.0, 100.0, 200.0):
        t = np.exp(1j * np.radians(40.0))
        mean, deviator = half_space_stress((depth + lag) * t, [depth - 0.5, depth + 0.5], 40.0)
        traction = (mean + t**2 * deviator)[:, 0]
        added.append(np.abs(traction - 0.5j / np.pi / (lag**2 - 0.25)).max())
    assert np.allclose(np.array(added[:-1]) / added[1:], 4.0, rtol=0.1)
    assert added[-1] < 1e-5


def dense_matrix(number, cell, modulus, dip):
    """Minus the normal stress, and i times the shear stress: edge dislocations, but for slip that is band-limited."""
    i, t = np.arange(number), np.exp(1j * np.radians(dip))
    mean, deviator = half_space_stress((i + 0.5) * cell * t, np.arange(number + 1) * cell, dip)
    lags = np.abs(i[:, None] - i), i[:, None] + i + 1
    uniform = sum(modulus / (2 * np.pi * cell) / (lag**2 - 0.25) for lag in lags)
    return modulus * (mean + t**2 * deviator) + 1j * (stress_matrix(number, cell, modulus, "surface") - uniform)


def test_stress_of_smooth_slip_on_a_dipping_fault_converges():
    """The limit is that of cells of a 27th; near the trace errors decrease in proportion to the cells."""

    def slip(number):
        return (1 - ((np.arange(number) + 0.5) / number) ** 2) ** 3

    errors = []
    for number in (20, 40, 80):
        t, fine = np.exp(1j * np.radians(40.0)), 27 * number
        mean, deviator = half_space_stress((np.arange(number) + 0.5) / number * t, np.arange(fine + 1) / fine, 40.0)
        traction = (mean + t**2 * deviator) @ slip(fine)
        shear, normal = stress_transfer(number, 1 / number, 1.0, "surface", dip=40.0).tractions(slip(number))
        away = np.abs(shear - traction.imag)
        errors.append((away[0], away[number // 5 :].max(), np.abs(normal + traction.real)[number // 5 :].max()))
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (slopes[:, 0] > 0.9).all() and (slopes[:, 1:] > 1.7).all()
    assert max(errors[-1][1:]) < 1e-4


@pytest.mark.parametrize("number", [7, 100, 300])
@pytest.mark.parametrize("dip", [4.0, 30.0, 60.0, 90.0])
def test_interpolated_kernels_are_the_dense_ones(dip, number):
    cell, slip = 25.0, np.random.default_rng(number).normal(size=number)
    dense = dense_matrix(number, cell, G, dip)
    for sense in (1, -1):
        shear, normal = stress_transfer(number, cell, G, "surface", dip=dip, sense=sense).tractions(slip)
        assert np.abs(shear - dense.imag @ slip).max() < 1e-12 * np.abs(dense).max()
        assert np.abs(normal + sense * dense.real @ slip).max() < 1e-12 * np.abs(dense).max()


@pytest.mark.parametrize("dip", [0.5, 4.0, 45.0])
def test_the_memory_of_a_dipping_fault_is_bounded(dip):
    for number in (10, 150, 1000):
        assert len(stress_transfer(number, 25.0, G, "surface", dip=dip).image[1]) <= 2 * image_nodes(number, dip)
    with pytest.raises(ValueError, match=rf"200,000 cells of a fault with a dip of {dip:g}°"):
        friction.line_fault(40e3, 0.2, **SHORT, dip=dip)


def test_slip_of_a_vertical_fault_does_not_change_its_normal_stress():
    transfer, slip = stress_transfer(50, 100.0, G, "surface", dip=90.0), np.linspace(1, 0, 50)
    shear, normal = transfer.tractions(slip)
    assert np.abs(normal).max() < 1e-12 * np.abs(shear).max()
    assert stress_transfer(50, 100.0, G, "surface").tractions(slip)[1] == 0.0


@pytest.mark.parametrize("dip", [15.0, 60.0, 90.0])
def test_displacement_of_the_surface(dip):
    """It jumps by the slip at the trace, vanishes far away, and its slope is the strain of a free surface."""
    ends, t = np.linspace(0.0, 2.0, 5), np.exp(1j * np.radians(dip))
    slip = np.array([1.0, 1.0, 0.7, 0.2])
    foot, hanging = surface_displacement([-1e-9, 1e-9], ends, dip) @ slip
    assert foot - hanging == pytest.approx(t, abs=1e-8)
    assert np.abs(surface_displacement([-1e9, 1e9], ends, dip)).max() < 1e-8
    for x in (-2.0, 0.4, 3.0):
        before, after = surface_displacement([x - 1e-4, x + 1e-4], ends, dip) @ slip
        mean, deviator = half_space_stress([x], ends, dip)
        along = (mean - deviator.real)[0] @ slip  # σ_xx = 2 G/(1 − ν) du/dx
        assert (after - before).real / 2e-4 == pytest.approx(along / 2, rel=1e-5)


# ---- faults


@pytest.mark.parametrize(("slip", "alpha"), [pytest.param("normal", 0.0, marks=pytest.mark.slow), ("thrust", 0.2)])
def test_another_integration_through_an_earthquake(slip, alpha):
    """Dense kernels, and θ' = 1 − Vθ/D_c − (α/b) θ σ'/σ as written, by SciPy."""
    fault = small(slip=slip, alpha=alpha)
    start, n = friction.initial_state(fault), len(fault.depth)
    history = friction.simulate_fault(fault, 9.0 if slip == "normal" else 10.0, start=start, tolerance=1e-8)
    assert len(history.events.start) > 0
    dense = dense_matrix(n, fault.cell, G / 0.75, 30.0)
    clamping, w = (-1 if slip == "thrust" else 1) * dense.real, [start.log_velocity]

    def rates(_, y):
        u, s = y.reshape(2, n)
        normal, stress = 10e6 + clamping @ u, start.prestress + dense.imag @ u
        for _ in range(60):
            y = 0.5 * np.exp(w[0] + (fault.mu0 + fault.b * s) / fault.a)
            push = fault.damping * fault.v0 * np.exp(w[0])
            slope = normal * fault.a * y / np.sqrt(1 + y * y) + push
            step = (normal * fault.a * np.arcsinh(y) + push - stress) / slope
            w[0] = w[0] - np.clip(step, -2, 2)
            if np.abs(step).max() < 1e-12:
                break
        v = fault.v0 * np.exp(w[0])
        aging = fault.v0 / fault.dc * np.exp(-s) - v / fault.dc
        return np.concatenate([v - 1e-9, aging - alpha / fault.b * (clamping @ (v - 1e-9)) / normal])

    log_state = start.log_state - fault.state_shift(start.normal(fault))
    begin = np.concatenate([start.excess_slip, log_state])
    end = solve_ivp(rates, (0, history.state.time), begin, "DOP853", rtol=1e-9, atol=1e-10).y[:, -1].reshape(2, n)
    state = history.state
    assert np.abs(end[0] - state.excess_slip).max() < 1e-7
    assert np.abs(end[1] - np.log(fault.v0 * state.theta(fault) / fault.dc)).max() < 1e-5
    assert np.abs(state.normal(fault) / 10e6 - 1).max() > 0.01


def test_records_are_those_of_the_state():
    fault = small(alpha=0.1)
    recording = friction.Recording(stations=(550.0, 1450.0), surface=BESIDE, quiet_profiles=YEAR, spacing=50.0)
    history = friction.simulate_fault(fault, 9.0, recording=recording)
    state = friction.simulate_fault(fault, history.time[-1] / YEAR - 1e-9).state
    assert state.time == history.time[-1]
    cells, velocity = [5, 14], state.velocity(fault)
    for name, values in (
        ("stress", state.stress(fault)),
        ("theta", state.theta(fault)),
        ("normal", state.normal(fault)),
    ):
        assert np.allclose(getattr(history, name)[-1], values[cells], rtol=1e-6), name
    moved = surface_displacement(BESIDE, np.arange(51) * 100.0, 30.0)
    t, side = np.exp(1j * np.radians(30.0)), np.array([1, 1, -1, -1])
    rigid = 0.5e-9 * side * t
    assert np.allclose(history.horizontal[-1] + 1j * history.down[-1], moved @ state.excess_slip + rigid * state.time)
    rate = history.horizontal_velocity[-1] + 1j * history.down_velocity[-1]
    assert np.allclose(rate, moved @ (velocity - 1e-9) + rigid, rtol=1e-6)
    place = np.searchsorted(history.profile_depth, fault.depth)
    state = friction.simulate_fault(fault, 4.0, tolerance=1e-6).state  # ends a short step later
    assert history.profile_time[4] / YEAR == pytest.approx(4.0)
    assert np.allclose(history.profile_normal[4, place], state.normal(fault), rtol=1e-3)
    assert np.allclose(history.profile_stress[4, place], state.stress(fault), rtol=1e-2)


def test_a_fault_that_creeps_as_the_plates_moves_both_sides_as_rigid_bodies():
    fault = small(a=0.02, slip="normal")
    start = friction.initial_state(fault, stress=steady_stress(fault, 1e-9))
    history = friction.simulate_fault(fault, 5.0, start=start, recording=friction.Recording(surface=BESIDE))
    motion = 0.5e-9 * history.time[-1] * np.exp(1j * np.radians(30.0))
    expected = motion * np.array([-1, -1, 1, 1])
    assert np.allclose(history.horizontal[-1] + 1j * history.down[-1], expected, rtol=1e-6)


def test_the_rate_of_a_profile_is_the_derivative_of_slip():
    rng = np.random.default_rng(3)
    before, after = (Moment(t, *rng.normal(size=(2, 4)), None, None, 0.0, np.zeros(3)) for t in (1.0, 3.5))
    for x in (0.0, 0.3, 1.0):
        slope = (hermite(before, after, x + 1e-6) - hermite(before, after, x - 1e-6)) / 2e-6 / 2.5
        assert np.allclose(hermite_rate(before, after, x), slope, atol=1e-7)


def test_a_continued_dipping_fault_is_the_same():
    fault, recording = small(alpha=0.1), friction.Recording(stations=(550.0,), surface=BESIDE)
    whole = friction.simulate_fault(fault, 9.0, recording=recording)
    first = friction.simulate_fault(fault, 4.0, recording=recording)
    parts = join_histories([first, friction.simulate_fault(fault, 9.0, start=first.state, recording=recording)])
    for name in ("time", "slip", "normal", "horizontal", "down_velocity", "profile_stress", "surface"):
        assert np.array_equal(getattr(parts, name), getattr(whole, name)), name


def test_energy_is_balanced():
    """But for a small asymmetry: stress is that at the centres of cells, not an average over them."""
    history = friction.simulate_fault(small(), 20.0)
    assert abs(history.energy.residual) < 1e-4
    assert np.abs(history.events.energy_residual).max() < 1e-4


def test_a_normal_stress_that_vanishes_is_told():
    fault, excess = small(), np.zeros(50)
    excess[10] = 1.0
    excess *= -2 * 10e6 / np.min(fault.transfer.tractions(-excess)[1])
    start = friction.initial_state(fault)._replace(excess_slip=-excess)
    place = fault.depth[np.argmin(start.normal(fault))]
    with pytest.raises(RuntimeError, match=rf"slip opens the fault at {place:g} m after 0 years: use a larger normal"):
        friction.simulate_fault(fault, 1.0, start=start)


def test_a_dipping_fault_prints_its_dip():
    assert repr(small(slip="normal")) == "Fault: normal with a dip of 30°, 50 cells of 100 m, aging law"


def test_surface_stations_are_checked():
    with pytest.raises(ValueError, match="require in-plane shear and boundary = 'surface'"):
        friction.simulate_fault(small(shear="antiplane", dip=90.0), 1.0, recording=friction.Recording(surface=(1.0,)))
    with pytest.raises(ValueError, match=r"finite, nonzero distances from the trace \(use 0\.01 and −0\.01 m"):
        friction.simulate_fault(small(), 1.0, recording=friction.Recording(surface=(0.0,)))


# ---- scenarios


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"line": {"dip": 30.0}}, "dip = 30 and slip = 'thrust' require in-plane shear"),
        (
            {"line": {"shear": "in-plane", "cell": 160.0, "dip": 30.0}},
            "cell = 160 m does not resolve the cohesive length",
        ),
        ({"run": {"surface": (1e3,)}}, 'run.surface requires line.shear = "in-plane"'),
        ({"run": {"surface": (0.0,)}, "line": {"shear": "in-plane"}}, "run.surface contains 0: use 0.01 and −0.01"),
    ],
)
def test_bad_scenarios_are_refused_with_one_sentence(change, message):
    with pytest.raises(ScenarioError) as caught:
        scenario(experiment="fault", **change)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_have_the_signs_and_columns_of_the_benchmark(tmp_path, monkeypatch):
    monkeypatch.setattr(Figure, "savefig", save_noise)
    line = {"width": 5e3, "cell": 100.0, "shear": "in-plane", "dip": 60.0, "slip": "normal"}
    surface = {"years": 9.0, "stations": (0.0, 1500.0), "surface": (-8e3, *BESIDE)}
    short = {name: value for name, value in SHORT.items() if name != "shear"}
    result = ss.simulate(scenario(experiment="fault", line=line, friction=short, run=surface))
    write_result(tmp_path, EXPERIMENTS["fault"], result)
    h, names = result.history, {path.name for path in tmp_path.iterdir()}
    assert {"slip.dat", "shear_stress.dat", "normal_stress.dat", "srfst_fn-00.txt", "srfst_fn+00.txt"} < names
    assert {"srfst_fn-08.txt", "srfst_fn+02.txt", "fltst_dp015.txt", "fig5_surface.png"} < names

    def table(name, mark):
        lines = (tmp_path / name).read_text().splitlines()
        assert "# dip_angle=60 degrees" in lines and "# motion=normal" in lines
        start = next(k for k, line in enumerate(lines) if line.startswith(mark))
        return lines[start - 1].split(), np.loadtxt(tmp_path / name, skiprows=start + 1)

    head, on_fault = table("fltst_dp015.txt", "# Here is")
    assert head == ["t", "slip", "slip_rate", "shear_stress", "normal_stress", "state"]
    columns = h.time, -h.slip[:, 1], np.log10(h.velocity[:, 1]), -h.stress[:, 1] / 1e6, h.normal[:, 1] / 1e6
    assert np.allclose(on_fault[:, :5], np.stack(columns, axis=1), rtol=1e-6)
    head, beside = table("srfst_fn-08.txt", "# Here is")
    assert head == ["t", "disp_1", "disp_2", "vel_1", "vel_2"]
    columns = h.time, h.horizontal[:, 0], h.down[:, 0], h.horizontal_velocity[:, 0], h.down_velocity[:, 0]
    assert np.allclose(beside, np.stack(columns, axis=1), rtol=1e-6)
    head, profiles = table("normal_stress.dat", "# Here are")
    assert head == ["t", "max_slip_rate", "normal_stress"]
    assert np.allclose(profiles[1:, 2:], h.profile_normal / 1e6, rtol=1e-6)
    assert np.allclose(table("shear_stress.dat", "# Here are")[1][1:, 2:], -h.profile_stress / 1e6, rtol=1e-6)
    data, own = ss.io.open_dataset(tmp_path), friction.fault_dataset(h)
    assert np.array_equal(data["surface"].down, h.down) and data["surface"].down.attrs["units"] == "m"
    assert data["surface"].down.dims == ("time", "station")
    assert np.array_equal(own.horizontal.sel(surface=-8e3), h.horizontal[:, 0])
    assert np.array_equal(data["series"].normal, own.normal)
    assert data["profiles"].normal.attrs["units"] == "Pa"


# ---- BP3


def test_the_benchmark_starts_as_published():
    """FDRA prints ±26.54612 MPa and log10 θ = 3.903090; initial rates of the surface are half those of the plates."""
    fault = bp3_scenario(quick=True, dip=30.0, slip="normal").fault
    state = friction.initial_state(fault)
    assert state.prestress[0] / 1e6 == pytest.approx(26.54612, abs=1e-5)
    assert np.log10(state.theta(fault)[0]) == pytest.approx(3.903090, abs=1e-6)
    rate = Surface(fault, [-16e3, 0.01])(state.rates[0], 1.0)
    assert np.allclose(rate, [-4.329686e-10 - 2.499745e-10j, 4.330127e-10 + 2.5e-10j], rtol=2e-4)
    assert papers()["seas-bp3"].paper.title.startswith("SEAS benchmark problem BP3-QD")
    assert "Erickson2023" in EXPERIMENTS["fault"].references(bp3_scenario())["dipping faults"]


def made(case, cell, factor=1.0):
    """A result with the published series, its slip multiplied by a factor."""
    chosen, published = bp3_scenario(dip=case[0], slip=case[1], cell=cell), FDRA[case]
    fault = chosen.fault
    start = np.r_[published["events"], 1100 + published["cycle"][1] / published["cycle"][0] * np.arange(6)] * YEAR
    columns = np.ones((len(room.FaultEvents._fields), len(start)))
    events = room.FaultEvents(*columns)._replace(start=start)
    station = np.array(chosen.run.stations)
    slip, stress, normal = (np.tile(np.array(v)[:, None], len(station)) for v in zip(*published["fault"], strict=True))
    moved = np.zeros((2, len(SURFACE), 2))
    for place, *values in published["surface"]:
        moved[:, SURFACE.index(place)] = values
    state = friction.initial_state(fault)
    history = room.FaultHistory(
        **dict.fromkeys(room.FaultHistory._fields)
        | {"fault": fault, "events": events, "state": state, "theta": state.theta(fault)[None]}
        | {"time": np.array(YEARS) * YEAR, "station": station, "surface": np.array(SURFACE)}
        | {"slip": factor * slip, "stress": 1e6 * stress, "normal": 1e6 * normal}
        | {"horizontal": moved[..., 0], "down": moved[..., 1]}
    )
    return room.FaultResult(chosen, history, None)


def test_series_are_drawn_in_years_and_megapascals_and_uplift_is_up():
    history = made((60.0, "thrust"), 25.0).history
    flat = ("max_velocity", "moment_rate", "profile_time", "profile_seismic", "profile_max_velocity", "profile_depth")
    history = history._replace(
        velocity=np.full_like(history.slip, 1e-9), theta=history.slip, profile_slip=np.zeros((2, 2)),
        horizontal_velocity=history.down, down_velocity=history.down, **dict.fromkeys(flat, np.zeros(2)),
        energy=Energy(0.0, 0.0, 0.0, 0.0), steps=1, rejected=0,
    )  # fmt: skip
    top, normal, stress = figures.station_series(history).axes
    horizontal, uplift = figures.surface_series(history).axes
    for axes, values in (
        (top, history.velocity), (normal, history.normal / 1e6), (stress, history.stress / 1e6),
        (horizontal, history.horizontal), (uplift, -history.down),
    ):  # fmt: skip
        np.testing.assert_allclose(axes.lines[1].get_xydata(), np.stack([YEARS, values[:, 1]], axis=1), rtol=1e-12)


def test_verdicts_follow_the_numbers():
    fine, coarse = ([made(case, cell) for case in FDRA] for cell in (25.0, 50.0))
    claims = bp3_claims(fine, coarse)
    assert {c.verdict for c in claims} == {"reproduced"}
    assert len({c.id for c in claims}) == len(claims)
    fine[1] = made((30.0, "normal"), 25.0, 1.02)
    coarse[1] = made((30.0, "normal"), 50.0, 1.02)
    other = {c.id for c in bp3_claims(fine, coarse) if c.verdict == "not reproduced"}
    assert other == {"slip-250-30-normal", "slip-490-30-normal"}
    coarse[0] = made((60.0, "thrust"), 40e3 / 1500, 1.002)  # an error that the ratio of the cells makes larger
    unsure = {c.id for c in bp3_claims(fine, coarse) if c.verdict == "undecided"}
    assert unsure == {"slip-250-60-thrust", "slip-490-60-thrust"}
    coarse[0] = made((60.0, "thrust"), 50.0, 1.002)  # cells twice as long: the change is the error, not a third of it
    claims = {c.id: c for c in bp3_claims(fine, coarse)}
    slip = claims["slip-250-60-thrust"]
    assert slip.error == pytest.approx(0.002 * abs(slip.measured))


@pytest.mark.slow
def test_the_quick_benchmark(tmp_path):
    run = stickslip("reproduce", "seas-bp3", "--quick", "--out", tmp_path / "out")
    assert run.returncode == 0, run.stderr
    claims = {c["id"]: c for c in json.loads((tmp_path / "out" / "claims.json").read_text())}
    assert {c["verdict"] for c in claims.values()} == {"reproduced"}
    assert (tmp_path / "out" / "srfst_fn-00.txt").exists()
