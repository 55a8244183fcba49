"""Numbers of scenarios whose products overflow are refused, whichever key they stand at; what is left runs quietly."""

import copy
import json
import warnings

import pytest

from stickslip.experiments.registry import EXPERIMENTS, ScenarioError, read_scenario, scenario
from tests.conftest import stickslip_here
from tests.unit.test_scenario import EXAMPLES

SMALL = """experiment = "rate-state"
legs = [{{velocity = {velocity}, distance = 0.01}}, {{velocity = 0.1, distance = 0.01}}]
samples = {{number = 10, noise = {noise}}}
"""


def floats(tree, above=()):
    """Paths to all floats in nested dictionaries and lists."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        if isinstance(value, float):
            yield (*above, key)
        yield from floats(value, (*above, key))


def scenarios():
    """The tables of all examples that are one scenario, with their defaults."""
    texts = [path for path in sorted(EXAMPLES.glob("*.toml")) if "\n[sweep]" not in path.read_text(encoding="utf-8")]
    found = {path.stem: json.loads(read_scenario(path).text) for path in texts}
    assert {tables["experiment"] for tables in found.values()} == set(EXPERIMENTS)
    return found


@pytest.mark.parametrize("value", [1e308, -1e308, 1e101, -1e101])
def test_no_number_of_a_scenario_is_larger_than_what_may_be_squared(value):
    for name, tables in scenarios().items():
        for place in floats(tables):
            changed = holder = copy.deepcopy(tables)
            for key in place[:-1]:
                holder = holder[key]
            holder[place[-1]] = value
            with pytest.raises(ScenarioError):
                scenario(**changed)
                pytest.fail(f"{name}: {place} = {value:g} is taken")


@pytest.mark.parametrize(
    ("key", "value", "given"),
    [
        ("noise", 1e308, "1e+308"),
        ("noise", 1e-320, "1e-320"),
        ("noise", 10**300, "1000000000"),
        ("mu0", -1e150, "-1e+150"),
    ],
)
def test_sizes_are_told(tmp_path, key, value, given):
    table = {"noise": "samples", "mu0": "surface"}[key]
    (tmp_path / "a.json").write_text(json.dumps({"experiment": "rate-state", table: {key: value}}))
    run = stickslip_here("run", "a.json", "--out", "out", cwd=tmp_path)
    assert run.returncode == 2
    assert run.stderr.count("\n") == 1
    allowed = "beyond 64 bits" if isinstance(value, int) else "it must be 0, or between 1e-100 and 1e+100 in magnitude"
    assert allowed in run.stderr
    assert f"{table}.{key}" in run.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("noise", "velocity"), [(1e100, 0.02), (1e-100, 0.02), (0.0, 1e100), (0.0, 1e-100)])
def test_sizes_that_are_allowed_run_without_a_warning(tmp_path, noise, velocity):
    (tmp_path / "a.toml").write_text(SMALL.format(noise=noise, velocity=velocity))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run = stickslip_here("run", "a.toml", "--out", "out", cwd=tmp_path)
    assert run.returncode in (0, 1)
    assert not [str(w.message) for w in caught]
    assert run.stderr.count("\n") == run.returncode


FLOW = {
    "experiment": "flow", "grains": {"number": 8, "low": [0.0, 0.5], "high": [4.0, 3.0], "mass": 1.0, "radius": 0.4},
    "law": {"kn": 1e4}, "cell": {"size": [4.0, 4.0], "periodic": ["x"]},
    "plates": [{"name": "low", "height": 0.0}],
    "stages": [{"name": "a", "duration": 1.0}, {"name": "b", "duration": 1.0}],
}  # fmt: skip
SHAKEN = {"name": "low", "height": 0.0, "velocity": {"x": {"amplitude": 1.0, "frequency": 1e9}}}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"cell": {"size": [1e8, 4.0], "periodic": ["x"]}}, "plate 'low' would have 1.04e+08 grains: at most 1000000"),
        ({"cell": {"size": [1e100, 4.0], "periodic": ["x"]}}, "plate 'low' would have 1.04e+100 grains"),
        ({"plates": [SHAKEN]}, "low shakes 2e+09 times: at most 1000000 are allowed"),
        (
            {"stages": [{"name": "a", "duration": 1.0, "velocity": {"low": SHAKEN["velocity"]}}]},
            "low shakes 1e+09 times",
        ),
        ({"samples": 100_000}, "stage 'a' has 50000 samples in 1e+03 time steps of 0.001"),
        ({"stages": [{"name": "a", "duration": 1.0}, {"name": "b", "duration": 1e-100}]}, "stage 'b' has 1 sample in"),
    ],
)
def test_sizes_that_would_fill_the_memory_or_take_less_than_a_step(tmp_path, change, words):
    (tmp_path / "a.json").write_text(json.dumps(FLOW | change))
    run = stickslip_here("run", "a.json", "--out", "out", cwd=tmp_path)
    assert (run.returncode, run.stderr.count("\n")) == (2, 1), run.stderr
    assert words in run.stderr


@pytest.mark.parametrize("length", [1e3, 1e20, 1e100])
def test_plates_of_gouge_have_a_size(tmp_path, length):
    tables = json.loads(read_scenario(EXAMPLES / "gouge.toml").text)
    tables["cell"]["length"] = length
    (tmp_path / "a.json").write_text(json.dumps(tables))
    run = stickslip_here("run", "a.json", "--out", "out", cwd=tmp_path)
    assert (run.returncode, run.stderr.count("\n")) == (2, 1), run.stderr
    assert "cell.length and cell.width make plates of" in run.stderr
