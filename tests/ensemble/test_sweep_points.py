"""Points of a sweep: conditions, hostile expressions, Sobol' sequences, and tables of draws."""

import itertools
import json
import math

import numpy as np
import pytest
from scipy.stats import qmc

from stickslip.experiments.registry import ScenarioError
from stickslip.runs.sweep.dataset import open_sweep
from stickslip.runs.sweep.definition import DEEPEST, LONGEST, members, parse_conditions, read_sweep, sweep
from stickslip.runs.sweep.run import run_sweep
from tests.conftest import stickslip_here

SLIDER = {"experiment": "rate-state", "samples": {"number": 12}, "legs": [{"velocity": 0.02, "distance": 1e-3}]}
KEYS = ("surface.a", "surface.b", "legs.1.velocity", "spring.stiffness")
BOX = {"surface.a": {"uniform": [0.005, 0.015]}, "surface.b": {"uniform": [0.005, 0.015]}}
ODD = [  # what a condition must refuse, with the reason
    ("__import__('os').system('true')", "is neither true nor false"),
    ("__import__('os') > 1", "is not a number or the name"),
    ("().__class__.__bases__[0] < 1", "is not a number or the name"),
    ("a.__class__ > 1", "'a.__class__' is not a swept key"),
    ("(lambda: a)() > b", "is not a number or the name"),
    ("[a for a in (1, 2)] > 1", "is not a number or the name"),
    ("(a := 3) > 1", "is not a number or the name"),
    ("a if b else a", "is neither true nor false"),
    ("a in (1, 2)", "is neither true nor false"),
    ("a is b", "is neither true nor false"),
    ("f'{a}' > b", "is not a number or the name"),
    ("a[0] > 1", "is not a number or the name"),
    ("a % 2 > 1", "is not a number or the name"),
    ("a << 2 > 1", "is not a number or the name"),
    ("~a > 1", "is not a number or the name"),
    ("1j < a", "is not a number or the name"),
    ("True", "is neither true nor false"),
    ("a > True", "is not a number or the name"),
    ("a", "is neither true nor false"),
    ("a and b", "is neither true nor false"),
    ("(a > b) > 0", "is not a number or the name"),
    ("a > b; import os", "it cannot be read"),
    ("a >", "it cannot be read"),
    ("", "it cannot be read"),
    ("a > \0", "it cannot be read"),
    ("velocity > mu0", "'mu0' is not a swept key"),
    ("1e300 < a", "a number that is too large"),
    ("9" * 400 + " < a", "a number that is too large"),
    ("-" * (DEEPEST + 5) + "a < b", "it is nested too deeply"),
    ("not " * (LONGEST // 5) + "a < b", "it is nested too deeply"),
    ("a < b " + " " * LONGEST, "characters: at most"),
    ("(" * 400 + "a" + ")" * 400 + "< b", "it cannot be read"),
]


@pytest.mark.parametrize(("text", "words"), ODD)
def test_only_conditions_are_understood(text, words):
    with pytest.raises(ScenarioError, match=r"sweep\.where") as caught:
        parse_conditions(text, KEYS)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("where", [3, [], {}, [1], None])
def test_a_condition_is_a_text(where):
    with pytest.raises(ScenarioError, match=r"sweep.where must be a condition such as 'b > a'"):
        parse_conditions(where, KEYS)


@pytest.mark.parametrize(
    ("text", "twin"),
    [
        ("b > a", lambda a, b: b > a),
        ("surface.b >= 2*a - 1", lambda a, b: b >= 2 * a - 1),
        ("0.5 < a < b <= 2", lambda a, b: 0.5 < a < b <= 2),
        ("not a > b or a == 1", lambda a, b: not a > b or a == 1),
        ("(a - b)/(a + b) != 0", lambda a, b: (a - b) / (a + b) != 0),
        ("a**b < -(-1.5)", lambda a, b: a**b < 1.5),
        ("'surface.a' < +b", lambda a, b: a < b),
        ("a > b and b > 1 or a < 1", lambda a, b: (a > b and b > 1) or a < 1),
    ],
)
def test_a_condition_means_what_python_means(text, twin):
    conditions = parse_conditions(text, KEYS)
    for a, b in itertools.product([0.25, 1, 1.5, 2.0], repeat=2):
        found = all(one.holds({"surface.a": a, "surface.b": b}) for one in conditions)
        assert found == twin(a, b), (a, b)


def test_names_are_those_of_swept_keys():
    (one,) = parse_conditions("'legs.1.velocity' < 2 * velocity", KEYS)
    assert one.holds({"legs.1.velocity": 1.0})
    with pytest.raises(ScenarioError, match=r"'x' may be p.x or q.x: give the whole name"):
        parse_conditions("x > 1", ("p.x", "q.x"))
    assert [one.text for one in parse_conditions(["a > b and a < 1", "b > 0"], KEYS)] == ["a > b", "a < 1", "b > 0"]


@pytest.mark.parametrize(
    ("text", "values", "words"),
    [
        ("1/a > 1", {"surface.a": 0}, "it is undefined at surface.a = 0"),
        ("(-a)**0.5 > 1", {"surface.a": 1}, "it is undefined"),
        ("a**a**a > 1", {"surface.a": 1e3}, "it is undefined"),
        ("a > 1", {"surface.a": "slip"}, "surface.a has the value 'slip': only numbers"),
        ("a > 1", {"surface.a": True}, "only numbers can be compared"),
    ],
)
def test_a_condition_that_is_not_defined_is_one_sentence(text, values, words):
    (one,) = parse_conditions(text, KEYS)
    with pytest.raises(ScenarioError, match=r"sweep\.where") as caught:
        one.holds(values)
    assert words in str(caught.value)


def test_points_of_a_grid_that_are_refused_are_counted():
    table = {"surface.a": [0.01, 0.02, 0.03], "surface.b": [0.01, 0.02, 0.03], "seed": {"count": 2}}
    found = sweep(**SLIDER, sweep=table | {"where": ["b > a", "b - a < 0.015"]})
    pairs = [(one.values["surface.a"], one.values["surface.b"], one.values["seed"]) for one in members(found)]
    assert pairs == [(a, b, seed) for a, b in ((0.01, 0.02), (0.02, 0.03)) for seed in (0, 1)]
    assert (found.tried, dict(found.refused)) == (9, {"b > a": 6, "b - a < 0.015": 1})
    assert found.refusals == "7 of 9 points were rejected: 6 by b > a, 1 by b - a < 0.015."
    assert found.shape == (2, 2)


@pytest.mark.parametrize("draw", ["latin-hypercube", "sobol"])
def test_a_sample_with_a_condition_has_as_many_points_as_without(draw):
    found = sweep(**SLIDER, sweep={"mode": "sample", "number": 64, "draw": draw, "where": "b > a"} | BOX)
    values = np.array([[one.values["surface.a"], one.values["surface.b"]] for one in members(found)])
    assert values.shape == (64, 2)
    assert (values[:, 1] > values[:, 0]).all()
    assert found.tried == 64 + dict(found.refused)["b > a"]
    free = sweep(**SLIDER, sweep={"mode": "sample", "number": 64, "draw": draw} | BOX)
    points = np.array([[one.values["surface.a"], one.values["surface.b"]] for one in members(free)])
    first = points[points[:, 1] > points[:, 0]]  # a condition only leaves out points, and adds further ones at the end
    assert np.array_equal(values[: len(first)], first)
    assert (free.tried, free.refusals) == (0, "")


def test_conditions_that_refuse_nearly_everything_are_one_sentence():
    with pytest.raises(
        ScenarioError, match=r"sweep.where rejects \d+ of \d+ points \(\d+ by b > a \+ 0.00999\): use a"
    ):
        sweep(**SLIDER, sweep={"mode": "sample", "number": 8, "where": "b > a + 0.00999"} | BOX)
    with pytest.raises(ScenarioError, match=r"sweep.where rejects all 4 points: 4 by a > 1"):
        sweep(**SLIDER, sweep={"surface.a": [0.1, 0.2], "surface.b": [0.1, 0.2], "where": "a > 1"})
    with pytest.raises(ScenarioError, match=r"'seed' is not a swept key"):
        sweep(**SLIDER, sweep={"surface.a": [0.1, 0.2], "seed": {"count": 2}, "where": "seed > 0"})


def _unit(number, seed=0, keys=("surface.a", "surface.b")):
    table = {key: {"uniform": [1.0, 2.0]} for key in keys}
    found = sweep(**SLIDER, sweep={"mode": "sample", "number": number, "draw": "sobol", "draw_seed": seed} | table)
    return np.array([axis.values for axis in found.axes]).T - 1.0


def test_sobol_points_are_a_net():
    """Every dyadic rectangle of area 1/64 holds one of 64 points: a (0, 6, 2)-net, which scrambling preserves."""
    points = _unit(64)
    for k in range(7):
        cells = np.floor(points * [2**k, 2 ** (6 - k)]).astype(int)
        assert len({tuple(cell) for cell in cells}) == 64
    assert not np.array_equal(points, _unit(64, seed=1))
    assert np.array_equal(points, _unit(64))
    assert np.array_equal(points[:24], _unit(24))
    assert np.array_equal(points[:, 0], _unit(64, keys=("surface.a", "surface.dc", "surface.b"))[:, 0])


def test_sobol_points_are_scipys():
    ours = _unit(16, keys=("surface.a",))[:, 0]
    plain = qmc.Sobol(1, scramble=False).random_base2(4)[:, 0]
    assert np.array_equal(np.sort(np.floor(16 * ours)), np.sort(16 * plain))


def test_sobol_points_integrate_better_than_random_ones():
    """Mean of a smooth function: the error of 256 points is far below that of independent ones, σ/√256."""
    errors = [np.mean(np.exp(_unit(256, seed).sum(axis=1))) - (math.e - 1) ** 2 for seed in range(5)]
    deviation = math.sqrt(((math.e**2 - 1) / 2) ** 2 - (math.e - 1) ** 4)
    assert np.abs(errors).max() < 0.05 * deviation / 16


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"draw": "sobol", "surface.a": [0.1]}, "sweep.draw requires sweep.mode"),
        ({"draw": "halton", "mode": "sample", "number": 2, "surface.a": [0.1]},
         "sweep.draw must be 'latin-hypercube' or 'sobol', got 'halton'"),
        ({"draws": "x.csv", "surface.a": [0.1]}, "sweep.draws is not used by any key"),
        ({"draws": "absent.csv", "surface.a": {"column": "a"}}, "absent.csv"),
        ({"draws": {"b": [1.0]}, "surface.a": {"column": "a"}}, "has no column 'a': its columns are b"),
        ({"draws": {"a": []}, "surface.a": {"column": "a"}}, "not a list of 1 to"),
        ({"draws": {"a": [1.0, math.nan]}, "surface.a": {"column": "a"}}, "not a list of 1 to"),
        ({"draws": {"a": ["x"]}, "surface.a": {"column": "a"}}, "not a list of 1 to"),
        ({"draws": 3, "surface.a": {"column": "a"}}, "must be the path of a CSV file"),
        ({"draws": {"a": [1.0]}, "surface.a": {"column": 3}}, "sweep.surface.a.column must be a valid string, got 3"),
        ({"surface.a": {"column": "a"}}, "give its file in sweep.draws"),
        ({"draws": {"a": [1.0]}, "surface.a": {"column": "a", "times": 0}}, "use a number other than 0"),
        ({"surface.a": {"uniform": [1, 2], "number": 3, "times": 2}}, "times, a factor for the values of a column, "
        "requires column"),
        ({"draws": {"a": [1.0, 2.0], "b": [1.0]}, "surface.a": {"column": "a"}, "surface.b": {"column": "b"}},
         "have different lengths"),
    ],
)  # fmt: skip
def test_bad_tables_are_one_sentence(table, words):
    with pytest.raises(ScenarioError) as caught:
        sweep(**SLIDER, sweep=table)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.fixture
def study(tmp_path):
    """A scenario file beside a table of three draws."""
    (tmp_path / "draws.csv").write_text(
        "# posterior\na [-], b [-], dc [m]\n0.01, 0.02, 1e-5\n0.02, 0.03, 2e-5\n0.03, 0.01, 3e-5\n"
    )
    text = 'experiment = "rate-state"\nlegs = [{velocity = 0.02, distance = 1e-3}]\nsamples = {number = 12}\n'
    text += '[sweep]\ndraws = "draws.csv"\n'
    path = tmp_path / "study.toml"

    def write(more):
        path.write_text(text + '"surface.a" = {column = "a"}\n"surface.dc" = {column = "dc"}\n' + more)
        return read_sweep(path)

    return write


def test_rows_of_a_table_are_members(study, tmp_path):
    found = study('"spring.stiffness" = [100.0, 200.0]\nseed = {count = 2}\n')
    assert found.shape == (3, 2, 2)
    rows = [(v["surface.a"], v["surface.dc"], v["spring.stiffness"]) for v in (one.values for one in members(found))]
    assert rows[::4] == [(0.01, 1e-5, 100.0), (0.02, 2e-5, 100.0), (0.03, 3e-5, 100.0)]
    (tmp_path / "draws.csv").unlink()  # the values are in the text of the sweep
    again = sweep(**json.loads(found.text))
    assert [one.name for one in members(again)] == [one.name for one in members(found)]
    run_sweep(found, tmp_path / "out")
    data = open_sweep(tmp_path / "out")
    assert dict(data.sizes) == {"draw": 3, "spring.stiffness": 2, "seed": 2}
    assert np.allclose(data["surface.dc"], [1e-5, 2e-5, 3e-5])
    assert data["surface.dc"].attrs["units"] == "m"


def test_rows_of_a_table_can_be_sampled_with_other_keys(study):
    found = study('mode = "sample"\nnumber = 6\n"spring.stiffness" = {loguniform = [100.0, 1000.0]}\n')
    rows = [(v["surface.a"], v["surface.dc"]) for v in (one.values for one in members(found))]
    assert sorted(rows) == sorted([(0.01, 1e-5), (0.02, 2e-5), (0.03, 3e-5)] * 2)  # each row of three in six points


def test_units_of_columns_must_be_those_of_keys(study, tmp_path):
    for unit, told in (("", "-"), (" [um]", "um")):
        (tmp_path / "draws.csv").write_text(f"a, dc{unit}\n0.01, 10\n")
        with pytest.raises(ScenarioError, match=rf"column 'dc' is in \[{told}\] and the key in \[m\]: give the factor"):
            study("")
    text = (tmp_path / "study.toml").read_text().replace('column = "dc"', 'column = "dc", times = 1e-6')
    (tmp_path / "study.toml").write_text(text)
    assert next(members(read_sweep(tmp_path / "study.toml"))).values["surface.dc"] == pytest.approx(1e-5)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "contains no data"),
        ("a [-], dc [m]\n", "has 0 rows"),
        ("a, a\n1, 2\n", "two columns of the same name"),
        ("a [-], dc [m]\n0.01, nan\n", "line 2: dc is 'nan', not a finite number"),
        ("a [-], dc [m]\n0.01, x\n", "line 2: dc is 'x', not a finite number"),
        ("a [-], dc [m]\n0.01\n", "line 2, has 1 fields but the header has 2"),
    ],
)
def test_bad_files_of_draws_are_one_sentence(study, tmp_path, text, words):
    (tmp_path / "draws.csv").write_text(text)
    with pytest.raises(ScenarioError) as caught:
        study("")
    assert words in str(caught.value)


def test_refusals_are_printed_and_in_the_dataset(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(
        'experiment = "rate-state"\nlegs = [{velocity = 0.02, distance = 1e-3}]\n[samples]\nnumber = 12\n[sweep]\n'
        'where = "b > a"\n"surface.a" = [0.01, 0.02]\n"surface.b" = [0.01, 0.02]\n'
    )
    done = stickslip_here("run", path, "--out", tmp_path / "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "3 of 4 points were rejected: 3 by b > a." in " ".join(done.stdout.split())
    assert open_sweep(tmp_path / "out").attrs["refusals"] == "3 of 4 points were rejected: 3 by b > a."
