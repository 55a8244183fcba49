"""Damping of gouge by name: γ_n, or a restitution with the reading that turns it into γ_n."""

import json
import pickle

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.laws.builtin import DAMPING_N, DAMPING_T
from stickslip.data.law_schema import KEYS
from stickslip.experiments.registry import read_scenario
from stickslip.solve.collision import eq8_damping
from stickslip.wings.papers.gouge.sample import damping, gouge_law

SLIDE = [{"kind": "slide", "velocity": 0.3, "slip": 1.0}]
MEETING = {"size": 3e-3, "speed": 25.0}
MASS = 2500 * np.pi / 6 * 3e-3**3


def of(**law):
    return ss.scenario(experiment="gouge", law=law, protocol=SLIDE)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ({}, "law has no damping: give damping_n"),
        ({"damping_n": 1e4, "restitution": 0.98, "reading": "eq8", **MEETING}, "exclude each other: give only one"),
        ({"restitution": 0.98, **MEETING}, "requires law.reading: give reading"),
        ({"restitution": 0.98, "reading": "eq8", "size": 3e-3}, "requires law.speed"),
        ({"damping_n": 1e4, "speed": 25.0}, "law.speed requires law.restitution"),
        ({"restitution": 0.98, "reading": "literal", **MEETING}, "'eq8' or 'collision'"),
        ({"restitution": 0.98, "reading": "eq8", "poisson": 0.0, **MEETING}, "no solution for poisson = 0"),
        ({"restitution": 0.98, "reading": "eq8", "poisson": 0.5, **MEETING}, "no solution for poisson = 0.5"),
        ({"restitution": 0.98, "reading": "eq8", "damping_ratio": 1 / 3, **MEETING}, "restitution = 0.98 with damping"),
    ],
)  # fmt: skip
def test_damping_that_is_not_said_one_way_is_refused(law, words):
    with pytest.raises(ss.experiments.ScenarioError, match=words):
        of(**law)


def test_a_scenario_without_a_law_is_refused():
    with pytest.raises(ss.experiments.ScenarioError, match="law is missing"):
        ss.scenario(experiment="gouge", protocol=SLIDE)


def test_old_keys_are_read_from_finished_runs_only(tmp_path):
    old = {"experiment": "gouge", "protocol": SLIDE, "law": {"gamma_n": 1e4, "restitution": None, "rescaled": True}}
    (tmp_path / "scenario.json").write_text(json.dumps(old))
    assert read_scenario(tmp_path / "scenario.json") == of(damping_n=1e4, kind="hertz_mindlin_reff_rescaled")
    with pytest.raises(ss.experiments.ScenarioError, match=r"\[law\] has no key 'gamma_n'"):
        ss.scenario(**old)


def test_a_law_table_has_the_keys_that_its_experiment_takes():
    law = of(damping_n=1e4).law
    assert set(type(law).model_fields) < set(KEYS)
    assert (law.kn, law.wall, law.coulomb, law.damping_ratio) == (None, None, "sharp", 0.5)
    assert pickle.loads(pickle.dumps(law)) == law
    for key in ("kn", "wall", "coulomb", "file"):
        with pytest.raises(ss.experiments.ScenarioError, match=rf"the table \[law\] has no key '{key}'"):
            of(damping_n=1e4, **{key: 1.0})


def test_gamma_is_taken_as_it_is():
    law = gouge_law(of(damping_n=123.0, damping_ratio=0.25), 0.5)
    assert law.table[0, 0, [DAMPING_N, DAMPING_T]] == pytest.approx([123.0, 30.75])


@pytest.mark.parametrize("restitution", [0.98, 0.3])
def test_collision_reads_the_restitution_that_a_collision_has(restitution):
    law = gouge_law(of(restitution=restitution, reading="collision", **MEETING), 0.0)
    assert ss.laws.collision(law, radius=1.5e-3, mass=MASS, speed=25.0).restitution == pytest.approx(
        restitution, abs=1e-6
    )


def restitution_of_eq8(gamma, young, poisson, size, density, speed, ratio) -> float:
    """Eq 8 of the supplement as it is printed, integrated step by step with this γ_n."""
    mass, d = density * np.pi / 6 * size**3 / 2, size / 2
    tangential = ratio * gamma
    a = (3 * tangential - gamma) ** 2 / (3 * (3 * tangential + 2 * gamma))
    a *= (1 - poisson**2) * (1 - 2 * poisson) / (young * poisson**2)
    stiffness = young * np.sqrt(2 * d) / (3 * mass * (1 - poisson**2))

    def rate(y):
        depth = max(y[0], 0.0)
        return np.array([y[1], -stiffness * (depth**1.5 + 1.5 * a * np.sqrt(depth) * y[1])])

    y, dt = np.array([0.0, speed]), 2e-8
    while y[0] > 0 or y[1] > 0:  # Runge–Kutta; 650 steps a collision
        k1 = rate(y)
        k2 = rate(y + dt / 2 * k1)
        k3 = rate(y + dt / 2 * k2)
        y = y + dt / 6 * (k1 + 2 * k2 + 2 * k3 + rate(y + dt * k3))
    return -y[1] / speed


@pytest.mark.parametrize("restitution", [0.98, 0.3])
@pytest.mark.parametrize("more", [{}, {"poisson": 0.2, "ratio": 0.7, "size": 2e-3, "speed": 10.0}])
def test_eq8_is_the_printed_formula(restitution, more):
    """Its γ_n, put back into the printed equation, gives the restitution; 1e-3 is the error of the last step."""
    case = {"young": 50e9, "poisson": 0.3, "size": 3e-3, "speed": 25.0, "ratio": 0.5} | more
    chosen = of(
        restitution=restitution, reading="eq8", damping_ratio=case["ratio"],
        **{name: case[name] for name in ("young", "poisson", "size", "speed")},
    )  # fmt: skip
    found = restitution_of_eq8(
        damping(chosen), case["young"], case["poisson"], case["size"], 2500.0, case["speed"], case["ratio"]
    )
    assert found == pytest.approx(restitution, abs=1e-3)


def test_the_readings_differ_by_thousands():
    """1.0e4 and 6.0e7 for 0.98, 6.2e5 and 3.7e9 for 0.3: what was found before the package had either by name."""
    values = {
        (e, reading): damping(of(restitution=e, reading=reading, **MEETING))
        for e in (0.98, 0.3)
        for reading in ("eq8", "collision")
    }
    expected = {(0.98, "eq8"): 1.0e4, (0.98, "collision"): 6.0e7, (0.3, "eq8"): 6.2e5, (0.3, "collision"): 3.7e9}
    assert values == pytest.approx(expected, rel=0.02)


def test_no_restitution_is_lost_without_damping():
    for reading in ("eq8", "collision"):
        assert damping(of(restitution=1.0, reading=reading, **MEETING)) == 0.0


@pytest.mark.parametrize("wrong", [{"poisson": 0.0}, {"poisson": 0.6}, {"ratio": 1 / 3}, {"young": -1.0}])
def test_eq8_without_a_solution_is_one_sentence(wrong):
    given = {"young": 50e9, "poisson": 0.3, "ratio": 0.5} | wrong
    with pytest.raises(ValueError, match=r"Eq 8 has a solution only for"):
        eq8_damping(0.98, radius=1.5e-3, mass=MASS, speed=25.0, **given)
