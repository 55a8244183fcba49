"""What `fit` advises can be pasted into its command line, and what a user states is compared with the record."""

import re
import shlex

import numpy as np
import pytest

from stickslip.wings.faults.friction.laboratory import LabRecord, record_data, write_csv
from stickslip.wings.faults.friction.laws import RateState, Spring, spring_slider
from stickslip.wings.faults.friction.loads import velocity_steps
from tests.conftest import stickslip_here

K, CLOCK = 1500.0, 5000.0  # stiffness, and start of the clock of the record
SURFACE = RateState(0.010, 0.014, 20e-6, 0.6, 1e-6, "slip")
LEGS = velocity_steps([1e-6, 1e-5, 1e-6], distance=3e-4)
TIMES = np.unique(np.r_[np.arange(0.0, 630.0, 2.0), np.arange(300.0, 330.0, 0.5)])
PLACE = np.interp(TIMES, np.cumsum([0, *(leg.duration for leg in LEGS)]), [0, 3e-4, 6e-4, 9e-4])
OPTION = re.compile(r"""(--[a-z]+(?:-[a-z]+)*)((?: (?:'[^']*'|"[^"]*"|[-+.\de]+|theta))?)""")


def lab(theta=None, **more):
    h = spring_slider(SURFACE, Spring(K), LEGS, times=TIMES, theta=theta)
    noise = 2e-4 * np.random.default_rng(0).normal(size=len(TIMES))
    record = LabRecord(CLOCK + TIMES, h.friction + noise, h.load_point)
    return record._replace(**{name: change(getattr(record, name)) for name, change in more.items()})


def advice(said: str, *names: str) -> list[str]:
    """Options that a sentence names, as they are typed."""
    found = [option + value for option, value in OPTION.findall(said) if option in names]
    assert found, said
    return [word for text in found for word in shlex.split(text)]


def told(done) -> str:
    return " ".join((done.stdout + done.stderr).split())


@pytest.mark.parametrize(
    ("made", "given", "option"),
    [
        ({}, ["--stiffness", "1.5"], "--stiffness"),
        ({}, ["--stiffness", "4500"], "--free-stiffness"),
        ({}, [], "--free-stiffness"),
        ({"friction": lambda mu: mu + 8 * PLACE}, ["--stiffness", "1500"], "--detrend"),
        ({"theta": 4.0}, ["--stiffness", "1500"], "--free"),
    ],
)
def test_advice_can_be_pasted(tmp_path, made, given, option):
    write_csv(tmp_path / "a.csv", lab(**made))
    command = ["fit", "a.csv", "--law", "slip"]
    first = stickslip_here(*command, *given, cwd=tmp_path)
    pasted = advice(told(first), option)
    kept = [] if "stiffness" in option else given
    again = stickslip_here(*command, *kept, *pasted[: 2 if option in ("--stiffness", "--free") else 1], cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert option not in told(again)


def test_legs_that_are_printed_are_those_of_the_record(tmp_path):
    noisy = lab(load_point=lambda x: x + 3e-7 * np.random.default_rng(1).normal(size=len(x)))
    write_csv(tmp_path / "a.csv", noisy)
    command = ["fit", "a.csv", "--law", "slip", "--stiffness", "1500"]
    first = stickslip_here(*command, cwd=tmp_path)
    assert "slip" in first.stdout and "aging" not in first.stdout
    (text,) = re.findall(r'its velocity is assumed to be "([^"]*)"', told(first))
    assert re.search(r"until 5300\.0", text) or re.search(r"until 5299\.9", text), text
    again = stickslip_here(*command, "--velocity", text, cwd=tmp_path)
    assert again.returncode == 0 and "--velocity" not in told(again)
    with pytest.warns(UserWarning, match="noise"):
        found = record_data(noisy).legs
    pasted = record_data(noisy, velocity=text).legs
    np.testing.assert_allclose(pasted, found, rtol=1e-4)


def test_columns_without_headings_are_advised_as_they_are_typed(tmp_path):
    record = lab()
    rows = np.stack([record.time, 1e6 * record.load_point, record.friction], axis=1)
    np.savetxt(tmp_path / "a.txt", rows)
    first = stickslip_here("fit", "a.txt", "--law", "slip", "--stiffness", "1500", cwd=tmp_path)
    assert first.returncode == 2
    pasted = advice(told(first), "--columns")
    again = stickslip_here("fit", "a.txt", "--law", "slip", "--stiffness", "1500", *pasted, cwd=tmp_path)
    assert again.returncode == 0, again.stderr


def test_a_stated_velocity_that_the_record_contradicts_is_told_and_prefers_nothing(tmp_path):
    write_csv(tmp_path / "a.csv", lab())
    given = ["fit", "a.csv", "--stiffness", "1500", "--velocity"]
    wrong = told(stickslip_here(*given, "1e-6 until 5500 s, then 1e-5", cwd=tmp_path))
    said = (
        "--velocity states 1e-05 m/s from 5500 to 5628 s, but the load point moved by 0.000128 m until 5628 s "
        "instead of"
    )
    assert said in wrong
    assert "neither describes the record" in wrong and "the data prefer" not in wrong
    right = told(stickslip_here(*given, "1e-6 until 5300 s, then 1e-5 until 5330, then 1e-6", cwd=tmp_path))
    assert "--velocity" not in right and "the data prefer the slip law" in right


@pytest.mark.parametrize("stiffness", [4500.0, 300.0])
def test_both_laws_are_fitted_to_the_same_samples_and_a_wrong_stiffness_is_told(tmp_path, stiffness):
    friction = lab().friction.copy()
    friction[[40, 260, 330]] += 0.05
    write_csv(tmp_path / "a.csv", lab()._replace(friction=friction))
    done = stickslip_here("fit", "a.csv", "--stiffness", stiffness, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    said = told(done)
    assert said.count("samples are spikes") == 1 and "the data prefer" not in said
    assert f"a stiffness of {stiffness:g} 1/m contradicts the record, which shows 1" in said
