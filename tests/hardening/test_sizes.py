"""Numbers of scenarios whose products overflow are refused, whichever key they stand at; what is left runs quietly."""

import copy
import gc
import json
import tracemalloc
import warnings

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.progress import LIMITS
from stickslip.data.exchange.frame import mode_frames
from stickslip.experiments.registry import EXPERIMENTS, ScenarioError, read_scenario, scenario
from tests.conftest import stickslip_here
from tests.unit.test_scenario import EXAMPLES

SMALL = """experiment = "rate-state"
legs = [{{velocity = {velocity}, distance = 0.01}}, {{velocity = 0.1, distance = 0.01}}]
samples = {{number = 10, noise = {noise}}}
"""


def numbers(tree, kind, above=()):
    """Paths to all numbers of a kind in nested dictionaries and lists."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        if type(value) is kind:
            yield (*above, key)
        yield from numbers(value, kind, (*above, key))


def with_number(tables, place, value):
    """Copy of nested tables with one number replaced."""
    changed = holder = copy.deepcopy(tables)
    for key in place[:-1]:
        holder = holder[key]
    holder[place[-1]] = value
    return changed


def scenarios():
    """The tables of all examples that are one scenario, and of the smallest ones of other experiments."""
    texts = [path for path in sorted(EXAMPLES.glob("*.toml")) if "\n[sweep]" not in path.read_text(encoding="utf-8")]
    values = {path.stem: json.loads(read_scenario(path).text) for path in texts}
    shown = {tables["experiment"] for tables in values.values()}
    return values | {
        name: json.loads(scenario(experiment=name, **EXPERIMENTS[name].smallest[0]).text)
        for name in EXPERIMENTS
        if name not in shown
    }


@pytest.mark.parametrize("value", [1e308, -1e308, 1e101, -1e101])
def test_no_number_of_a_scenario_is_larger_than_what_may_be_squared(value):
    for name, tables in scenarios().items():
        for place in numbers(tables, float):
            with pytest.raises(ScenarioError):
                scenario(**with_number(tables, place, value))
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
def test_sizes_are_reported(tmp_path, key, value, given):
    table = {"noise": "samples", "mu0": "surface"}[key]
    (tmp_path / "a.json").write_text(json.dumps({"experiment": "rate-state", table: {key: value}}))
    run = stickslip_here("run", "a.json", "--out", "out", cwd=tmp_path)
    assert run.returncode == 2
    assert run.stderr.count("\n") == 1
    allowed = "beyond 64 bits" if isinstance(value, int) else "its magnitude must be 0, or between 1e-100 and 1e+100"
    assert allowed in run.stderr
    assert f"{table}.{key}" in run.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("noise", "velocity"), [(1e100, 0.02), (1e-100, 0.02), (0.0, 1e100), (0.0, 1e-100)])
def test_sizes_that_are_allowed_run_without_a_warning(tmp_path, noise, velocity):
    (tmp_path / "a.toml").write_text(SMALL.format(noise=noise, velocity=velocity))
    gc.disable()  # what earlier tests left must not warn here
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            run = stickslip_here("run", "a.toml", "--out", "out", cwd=tmp_path)
    finally:
        gc.enable()
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
    ("change", "message"),
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
def test_sizes_that_would_fill_the_memory_or_take_less_than_a_step(tmp_path, change, message):
    (tmp_path / "a.json").write_text(json.dumps(FLOW | change))
    run = stickslip_here("run", "a.json", "--out", "out", cwd=tmp_path)
    assert (run.returncode, run.stderr.count("\n")) == (2, 1), run.stderr
    assert message in run.stderr


@pytest.mark.parametrize("length", [1e3, 1e20, 1e100])
def test_plates_of_gouge_have_a_size(tmp_path, length):
    tables = json.loads(read_scenario(EXAMPLES / "gouge.toml").text)
    tables["cell"]["length"] = length
    (tmp_path / "a.json").write_text(json.dumps(tables))
    run = stickslip_here("run", "a.json", "--out", "out", cwd=tmp_path)
    assert (run.returncode, run.stderr.count("\n")) == (2, 1), run.stderr
    assert "cell.length and cell.width make plates of" in run.stderr


def test_every_size_of_a_scenario_is_within_its_limit_before_anything_is_allocated(request):
    """Whichever number is huge or tiny, the scenario is refused in a sentence, or all its sizes are allowed."""
    refused, taken, seen = 0, 0, set()
    request.addfinalizer(tracemalloc.stop)  # also after a failure, as it makes all that follows three times slower
    tracemalloc.start()
    for tables in scenarios().values():
        for kind, values in ((float, (1e90, 4e12, 1e-12, 1e-90)), (int, (4_000_000_000, 10**18))):
            for place in numbers(tables, kind):
                key = (tables["experiment"], *(word for word in place if isinstance(word, str)))
                for value in () if key in seen else values:  # each key of an experiment once
                    try:
                        chosen = scenario(**with_number(tables, place, value))
                    except ScenarioError as problem:
                        refused += 1
                        assert "\n" not in str(problem), (place, value)
                        assert len(str(problem)) < 1000, (place, value)
                    else:
                        taken += 1
                        assert all(size.number <= LIMITS[size.kind] for size in chosen.sizes()), (place, value)
                seen.add(key)
    _, peak = tracemalloc.get_traced_memory()
    assert peak < 100e6  # the largest fault that is allowed takes 8 MB for each of its properties
    assert refused > 200
    assert taken > 200


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("fault", {"line": {"width": 4e12}}, "line.width and line.cell make 4e+10 cells: at most 1000000 are allowed"),
        ("fault", {"line": {"width": 4e9, "cell": 5.0}}, "8e+08 cells"),
        ("fault", {"run": {"interval": 1e-90}}, "profiles: at most 100000 are allowed; use a longer interval"),
        ("fault", {"run": {"seismic_interval": 1e-90}}, "run.seismic_interval makes"),
        ("fault", {"run": {"spacing": 1e-6}}, "run.spacing makes 4e+10 points"),
        ("gouge", {"grains": {"number": 4_000_000_000}}, "less than or equal to 1000000"),
        ("gouge", {"branches": 4_000_000_000}, "the protocol makes 4e+09 branches: at most 100000 are allowed"),
        ("biaxial", {"loading": {"increment": 1e-12}}, "loading.increment makes 1e+12 load steps"),
        ("sphere_shear", {"release": {"dt": 1e-12}}, "time steps: at most 1e+09 are allowed; use a longer release.dt"),
    ],
)
@pytest.mark.parametrize("swept", [False, True])
def test_sizes_of_scenarios_and_sweeps_are_refused_before_anything_is_written(tmp_path, name, change, message, swept):
    tables = json.loads(read_scenario(EXAMPLES / f"{name}.toml").text)
    for key, value in change.items():
        if key == "branches":
            tables["protocol"][0]["branches"] = value
        else:
            tables[key] |= value
    if swept:
        tables["sweep"] = {"seed": [0, 1]}
    (tmp_path / "a.json").write_text(json.dumps(tables))
    run = stickslip_here("run", "a.json", "--out", "out", cwd=tmp_path)
    assert (run.returncode, run.stderr.count("\n")) == (2, 1), run.stderr
    assert message in run.stderr
    assert not (tmp_path / "out").exists()


def test_exports_are_refused_before_anything_is_written(tmp_path):
    tables = json.loads(read_scenario(EXAMPLES / "gouge.toml").text)
    tables["protocol"][0]["branches"] = 4_000_000_000
    (tmp_path / "a.json").write_text(json.dumps(tables))
    run = stickslip_here("run", "a.json", "--engine", "lammps", "--export", "out", cwd=tmp_path)
    assert (run.returncode, run.stderr.count("\n")) == (2, 1), run.stderr
    assert "branches: at most 100000 are allowed" in run.stderr
    assert not (tmp_path / "out").exists()


def test_sizes_of_protocols_are_refused():
    law, huge = ss.laws.linear(1.0, 0.5, 0.5), 10**12
    state = ss.packings.from_arrays([[0.0, 0.0], [0.99, 0.0]], np.full(2, 0.5), law, cell=[8.0, 8.0], dim=2)
    requests = [
        lambda: ss.protocols.load_path([0.0, 1.0], 1e-12),
        lambda: ss.packings.disk_array(huge, press=5e-5),
        lambda: ss.packings.jammed(huge, packing_fraction=0.7),
        lambda: ss.packings.compressed(huge, mu=0.5, pressure=1e-3),
        lambda: ss.packings.biaxial_box(huge),
        lambda: ss.packings.sheared_box(huge),
        lambda: ss.run(state, law, huge, 1e-3, every=1),
        lambda: ss.protocols.free_run(state, law, duration=1e9, dt=1e-3, sample=1e-3),
        lambda: ss.modes.transient_growth(state, law, samples=huge),
        lambda: mode_frames(ss.io.frame_of(state, law), np.ones((2, 3)), np.ones((2, 3)), 1j, count=huge),
    ]
    for number, request in enumerate(requests):
        with pytest.raises(
            ValueError, match=r"^[^\n]* [\de.+]+ (GiB|[a-z ]+): at most [\de.+]+( GiB)? are allowed; [^\n]*$"
        ):
            pytest.fail(f"{number}: {request()}")
    with pytest.raises(ValueError, match="turning_points contains NaN"):
        ss.protocols.load_path([0.0, np.nan], 0.1)
