"""Cyclic shear: loops of a lattice in closed form, moduli, energies, return of grains, curves of sands, runs."""

import csv
import re
import sys

import numpy as np
import pytest

import stickslip as ss
from stickslip.cli import main
from stickslip.core.arguments import checked
from stickslip.core.dynamics.ledger import Ledger
from stickslip.core.progress import NotInEquilibriumError
from stickslip.experiments.realizations import make_law
from stickslip.experiments.registry import named_measures
from stickslip.figures.style import render as png
from stickslip.wings.soils.cyclic_shear import report
from stickslip.wings.soils.cyclic_shear import simulate as cyclic
from stickslip.wings.soils.element_test.sample import make_sample

DISKS = {"dim": 2, "grains": 40, "pressure": 100.0, "friction": 0.1}
SPHERES = {"grains": 60, "friction": 0.1}
SOFT = {"young": 1e9, "poisson": 0.2}


def scenario(sample=DISKS, law=SOFT, **more):
    return ss.scenario(experiment="cyclic-shear", sample=sample, law=law, **more)


@checked  # states are checked once, not in each step
def responses(rig, amplitude, number=2):
    """Cycles of a sample at one amplitude."""
    ends, cycles = [rig.sample], []
    for _ in range(number):
        cycles.append(cyclic.shear_once(rig, ends[-1], amplitude))
        ends.append(cycles[-1].end)
    return cyclic._response(amplitude, cycles, ends, rig.law)


# the lattice


KN, KT, MU, OVERLAP = 1.0, 0.5, 0.05, 1e-4


@pytest.fixture(scope="module")
def lattice():
    """Disks on a triangular lattice, all contacts compressed by `OVERLAP`."""
    law = ss.laws.linear(kn=KN, kt=KT, mu=MU)
    site = np.array([[0, 0], [1, 0], [0.5, 0.75**0.5], [1.5, 0.75**0.5]])
    place = np.concatenate([site + shift for shift in ([0, 0], [0, 3**0.5], [2, 0], [2, 3**0.5])])
    radius = np.full(16, 0.5 * (1 + OVERLAP))
    state = ss.packings.from_arrays(place, radius, law, cell=[4, 2 * 3**0.5], dim=2)
    chosen = scenario(DISKS | {"pressure": float(ss.measure.pressure(state, law))})
    return cyclic.Rig(chosen, law, state, 240)


SLOW = [pytest.param(amplitude, marks=pytest.mark.slow) for amplitude in (1e-5, 8e-5)]


@pytest.mark.parametrize("amplitude", [3e-5, *SLOW])
def test_the_loops_of_a_triangular_lattice_have_a_closed_form(lattice, amplitude):
    """All disks move with the cell, and rotate by −γ/2 until the contacts along x slide.

    The slip of contacts at 0 and ±60° is (½, −¼, −¼) γ, so that those along x reach μN first, at γ_c = 2μN/(k_t a). As
    torques are in balance, the others then keep −½ μN and never slide. The lattice is an elastic spring beside one that
    yields at γ_c: ΔW = 4 G_t γ_c (γ₀ − γ_c), G_n = (√3/4) k_n, G_t = (√3/4) k_t. Derived here, up to terms of the order
    of the strain (1e-4), the overlap (1e-4), and trapezia across the corners of the loop.
    """
    response = responses(lattice, amplitude)
    gn, gt, yields = 3**0.5 / 4 * KN, 3**0.5 / 4 * KT, 2 * MU * KN * OVERLAP / KT
    slides = min(yields / amplitude, 1.0)
    g, area = gn + gt * slides, 4 * gt * yields * amplitude * (1 - slides)
    angle = np.arccos(1 - 2 * slides)
    loop = cyclic.Loop(response, 1)
    assert loop.turns[0] == pytest.approx(g, rel=1e-3)
    assert loop.area == pytest.approx(area, rel=2e-3, abs=1e-6 * g * amplitude**2)
    assert loop.damping == pytest.approx(area / (2 * np.pi * g * amplitude**2), rel=2e-3, abs=1e-6)
    storage, loss = loop.harmonics
    assert storage == pytest.approx(gn + gt * (angle - 0.5 * np.sin(2 * angle)) / np.pi, rel=1e-3)
    assert loss == pytest.approx(area / np.pi / amplitude**2, rel=2e-3, abs=1e-6)
    assert cyclic.kind_of(response) == ("elastic" if amplitude < yields else "reversible")
    if amplitude > yields:
        shares = loop.shares
        assert shares["sliding"] == pytest.approx(1, abs=2e-3)
        assert abs(shares["residual"]) < 2e-3
        # 5 of 48 contacts, of which 16 slide. Rows that rotate against each other change only the slip of contacts that
        # slide, so those of two rows may slide more and those between them less: round-off decides
        assert 5 / 16 * 0.99 < response.busiest[1] < 5 / 8 * 1.01


# samples


@pytest.fixture(scope="module")
def spheres():
    """A prepared sample of spheres, its scenario and its law."""
    chosen = scenario(SPHERES)
    law = make_law(chosen.law)
    state, _ = make_sample(chosen.sample, law, 0, lambda *_: None)
    return chosen, law, state


def rig(spheres, steps=12, **cycles):
    _, law, state = spheres
    return cyclic.Rig(scenario(SPHERES, cycles=cycles), law, state, steps)


@pytest.mark.parametrize("normal", ["constant-volume", "constant-stress"])
def test_small_cycles_have_the_stiffness_of_the_elastic_moduli(spheres, normal):
    here = rig(spheres, normal=normal)
    response = responses(here, 1e-7, 1)
    assert cyclic.Loop(response, 0).turns[0] == pytest.approx(cyclic.tangent_modulus(here), rel=1e-3)
    assert abs(cyclic.Loop(response, 0).damping) < 3e-5  # equilibria to 1e-10 of a force, strains of 1e-7


def test_only_the_imposed_stress_stays_constant(spheres):
    held, closed = (responses(rig(spheres, normal=f"constant-{name}"), 1e-4, 1) for name in ("stress", "volume"))
    assert held.normal[0] == pytest.approx(1e5, rel=1e-6)
    assert np.abs(held.height).max() > 1e-8
    assert np.abs(closed.height).max() < 1e-14 and np.ptp(closed.normal) > 10
    assert held.gamma[0] == pytest.approx(1e-4 * np.sin(2 * np.pi * np.arange(13) / 12), abs=1e-8)


# 3 s: the error of trapezia falls only if the second loop has several times as many steps as the first
def test_the_ledger_closes_the_area_of_a_loop_in_which_grains_rearrange(spheres):
    """In two parts: the balance of the ledger itself, and the trapezia of the loop, whose error falls with the step."""
    left = []
    for steps in (12, 48):
        response = responses(rig(spheres, steps), 5e-3, 1)
        assert response.rearranged.sum() > 3
        loop = cyclic.Loop(response, 0)
        shares = loop.shares
        left.append((abs(shares["residual"]), abs(shares["drawn"])))
        assert shares["sliding"] > 0.5 and shares["dashpots"] < 0.1
        assert 0 < loop.in_rearrangements <= 1 and 0.1 < response.busiest[0] <= 1
    assert max(left[0][0], left[1][0]) < 5e-3 and left[1][1] < min(0.01, left[0][1])


def test_rolling_friction_has_its_share():
    law = SOFT | {"rolling": "spring", "k_roll": 1e5, "mu_roll": 0.02}
    chosen = scenario(law=law, cycles={"amplitudes": [3e-4], "number": 2, "steps": 20})
    shares = cyclic.Loop(ss.simulate(chosen, workers=1).runs[0].responses[0], -1).shares
    assert shares["rolling"] > 0.5 and abs(shares["residual"]) < 1e-3


@pytest.mark.slow
def test_a_cycle_of_many_steps_dissipates_what_slow_dynamics_does(spheres):
    """The same loop by dynamics at a rate so slow that its dashpots take 1 % of the work of friction."""
    _, law, state = spheres
    amplitude, response = 5e-3, responses(rig(spheres, 80), 5e-3, 1)
    scales, rate, size = cyclic.compression_scales(state, law, 1e5, 1e-10), 0.3, np.linalg.det(state.cell.vectors)
    control = state.control
    energies = np.zeros(len(Ledger._fields))
    for way, length in ((1, amplitude), (-1, 2 * amplitude), (1, amplitude)):
        moving = state._replace(control=ss.control.strained_at(control, way * rate * cyclic.SHEAR))
        steps = 10 * round(length / rate / scales.dt / 10)
        state, record, _ = ss.run(moving, law, steps, scales.dt, drag=2 / scales.time, every=steps, ledger=10)
        energies += [column[-1] - column[0] for column in record.ledger]
    slow = Ledger(*energies / size)
    assert slow.viscous + slow.drag < 0.03 * slow.coulomb
    mine = Ledger(*response.energies[0].T)
    assert mine.coulomb[-1] == pytest.approx(slow.coulomb, rel=0.05)


# numbers


def made(distance, tau=None, amplitude=1e-4):
    """A response with given returns and loops."""
    cycles, steps = len(distance) - 1, 400
    gamma = np.tile(amplitude * np.sin(2 * np.pi * np.arange(steps + 1) / steps), (cycles, 1))
    tau = 1e8 * gamma if tau is None else tau
    nothing, none = np.zeros_like(gamma), np.zeros(cycles)
    energies = np.zeros((*gamma.shape, len(Ledger._fields)))
    work = 0.5 * (tau[:, 1:] + tau[:, :-1]) * np.diff(gamma)
    energies[:, 1:, Ledger._fields.index("external")] = np.cumsum(work, axis=1)
    return cyclic.Response(
        amplitude, gamma, tau, nothing, nothing, nothing, nothing.astype(bool),
        energies, none, none, np.array(distance),
    )  # fmt: skip


def test_the_first_harmonics_and_the_damping_ratio_of_an_ellipse():
    theta = np.linspace(0, 2 * np.pi, 401)
    tau = np.tile(1e4 * np.sin(theta) + 2e3 * np.cos(theta) + 500 * np.sin(3 * theta), (1, 1))
    response = made(np.zeros((2, 2)), tau)
    assert cyclic.Loop(response, 0).harmonics == pytest.approx((1e8, 2e7), rel=1e-9)
    assert cyclic.Loop(response, 0).area == pytest.approx(np.pi * 1e-8 * 2e7, rel=1e-3)
    g = (1e4 - 500) / 1e-4  # at the turns
    assert cyclic.Loop(response, 0).damping == pytest.approx(np.pi * 1e-8 * 2e7 / (2 * np.pi * g * 1e-8), rel=1e-3)


def test_kinds_of_cycles():
    same, away = np.zeros((5, 5)), 0.1 * (1 - np.eye(5))
    twice = np.array([[0.1 * ((a - b) % 2) for a in range(5)] for b in range(5)])
    gamma = made(same).gamma
    plastic = 1e8 * gamma + 1e3 * np.cos(2 * np.pi * np.arange(401) / 400)
    assert cyclic.kind_of(made(same)) == "elastic"
    assert cyclic.kind_of(made(same, plastic)) == "reversible"
    assert cyclic.kind_of(made(twice, plastic)) == "periodic" and cyclic.period(made(twice)) == 2
    assert cyclic.kind_of(made(away, plastic)) == "irreversible"
    assert cyclic.kind_of(made(np.zeros((2, 2)))) == "undecided"


# sands


def test_the_damping_of_a_hyperbola_is_that_of_masing_s_rule():
    """Branches of the loop are the hyperbola τ = γ/(1 + γ/γ_r), twice as large. c₂ and c₃ vanish at a = 1, c₁ is 1."""
    gamma = np.geomspace(1e-5, 1e-2, 7)
    scale = 0.6329 - 0.00566 * np.log(10)
    for amplitude, d in zip(gamma, report.Curve(1e-3, 1.0).damping(gamma), strict=True):
        x = np.linspace(0, amplitude, 20_001)
        backbone = x / (1 + x / 1e-3)
        peak = backbone[-1]
        area = 8 * (np.trapezoid(backbone, x) - 0.5 * peak * amplitude)
        masing = area / (2 * np.pi * peak * amplitude)
        assert d == pytest.approx(scale * masing / (1 + amplitude / 1e-3) ** 0.1, rel=2e-3, abs=1e-6)


def test_curves_of_sands_by_hand():
    assert report.darendeli(101.325e3).reference == pytest.approx(0.0352e-2)
    assert report.menq(101.325e3, 1.0) == pytest.approx((0.12e-2, 0.86))
    assert report.menq(4 * 101.325e3, 1.0).reference == pytest.approx(0.24e-2)
    low, high = report.band(101.325e3, np.array([1e-3]))["G_ratio"]
    well, uniform = (1 / (1 + (1e-3 / r) ** 0.86) for r in (0.12e-2 * 10**-0.6, 0.12e-2))
    assert low == pytest.approx(min(well, 1 / (1 + (1 / 0.352) ** 0.919))) and high == pytest.approx(uniform)


# runs


SHORT = {"amplitudes": [1e-6, 1e-4], "number": 2, "steps": 12}


@pytest.fixture(scope="module")
def result():
    return ss.simulate(scenario(cycles=SHORT, realizations=2, check=True), workers=1)


def test_numbers_and_sentences_of_a_run(result):
    text = " ".join(report.sentences(result))
    for words in ("1e-06 elastic", "0.0001 ", "Curves of sands are for spheres", "Doubling the number of steps"):
        assert words in text
    named = named_measures(ss.experiments.EXPERIMENTS["cyclic-shear"], result)
    assert named["G_smallest"][0] == pytest.approx(named["G0"][0], rel=1e-3) and named["G0"][1] == "N/m"
    assert named["gamma_elastic"][0] == 1e-4 and np.isnan(named["in_band"][0])
    row = result.to_dataframe().loc["G0"]
    assert (row.value, row.unit) == named["G0"] and "tangent modulus" in row.meaning


def test_a_modulus_that_the_smallest_amplitude_does_not_have_is_said(result):
    softer = [run._replace(modulus=1.1 * run.modulus) for run in result.runs]
    assert "G at the smallest amplitude differs by 9.1% " in " ".join(report.sentences(result._replace(runs=softer)))
    assert "smallest amplitude differs" not in " ".join(report.sentences(result))


def test_spheres_are_compared_with_the_band_of_sands(result):
    """At 1e-4 and 100 kPa, G/Gmax is 0.72 to 0.89 in the band, and D is 1 to 4 %."""
    chosen = scenario(SPHERES, cycles=SHORT)
    table = {"amplitude": np.array([1e-6, 1e-4]), "G_ratio": np.array([1.0, 0.8]), "damping": np.array([0.0, 0.02])}
    assert report.in_band(chosen, table).tolist() == [[0, 1], [0, 1]]
    assert "G/Gmax lies in the band of sands at" in " ".join(report.sentences(result._replace(scenario=chosen)))


def test_every_figure_can_be_drawn(result):
    assert min(len(png(figure)) for _, figure in report.figures(result)) > 5000


def test_each_amplitude_begins_where_it_is_said(result):
    onward = ss.simulate(scenario(cycles=SHORT | {"start": "previous"}), workers=1).runs[0]
    fresh = result.runs[0]
    assert fresh.responses[1].tau[0, 0] == fresh.responses[0].tau[0, 0]
    assert onward.responses[1].tau[0, 0] == onward.responses[0].tau[-1, -1]


def test_a_run_that_is_stopped_continues_after_its_last_cycle(tmp_path):
    chosen = scenario(cycles=SHORT)
    whole = ss.simulate(chosen, workers=1).runs[0]
    count = 0

    def stop(stage, share, words):
        nonlocal count
        count += "γ" in words
        if count == 30:  # in the third cycle
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ss.simulate(chosen, folder=tmp_path, workers=1, report=stop)
    seen = []
    again = ss.simulate(chosen, folder=tmp_path, workers=1, report=lambda *words: seen.append(words[2])).runs[0]
    assert sum("γ" in words for words in seen) == 24
    for one, other in zip(whole.responses, again.responses, strict=True):
        np.testing.assert_array_equal(one.tau, other.tau)
        np.testing.assert_array_equal(one.energies, other.energies)


def test_cycles_that_end_early_are_left_out(monkeypatch):
    shear_once = cyclic.shear_once

    def fail(rig, state, amplitude, *rest):
        if amplitude > 1e-5:
            raise NotInEquilibriumError("the sample does not come to rest", None)
        return shear_once(rig, state, amplitude, *rest)

    monkeypatch.setattr(cyclic, "shear_once", fail)
    run = cyclic.shear_sample(scenario(cycles=SHORT), 0, 1, None, lambda *_: None)
    assert len(run.responses) == 1 and "cycle 1 at an amplitude of 0.0001 was not finished" in run.ended


@pytest.mark.usefixtures("plain_figures")
def test_the_command_line_writes_a_table_of_cycles(tmp_path, monkeypatch, capsys):
    (tmp_path / "test.toml").write_text(
        'experiment = "cyclic-shear"\nsample = {dim = 2, grains = 40, pressure = 100.0, friction = 0.1}\n'
        "law = {young = 1e9, poisson = 0.2}\ncycles = {amplitudes = [1e-7], number = 1, steps = 12}\n"
    )
    monkeypatch.setattr(sys, "argv", ["stickslip", "run", str(tmp_path / "test.toml"), "--out", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0 and "tangent modulus of the sample" in capsys.readouterr().out
    with (tmp_path / "out" / "cycles.csv").open(encoding="utf-8") as file:
        (row,) = csv.DictReader(line for line in file if not line.startswith("#"))
    assert float(row["G_ratio"]) == pytest.approx(1, rel=1e-3) and {"damping", "G [N/m]", "kind"} <= set(row)


# bad input


@pytest.mark.parametrize(
    ("cycles", "words"),
    [
        ({"amplitudes": [3.0]}, r"cycles\.amplitudes = 3, .* use at most \d\.\d"),
        ({"amplitudes": [1e-12]}, r"cycles\.amplitudes must be at least 1e-08, .* below round-off, got 1e-12"),
        ({"amplitudes": [1e-3, 1e-4]}, "must increase"),
    ],
)
def test_bad_scenarios_are_refused_in_one_sentence(cycles, words):
    with pytest.raises(ss.experiments.ScenarioError) as caught:
        scenario(cycles=cycles)
    assert re.search(words, str(caught.value)) and "\n" not in str(caught.value)
