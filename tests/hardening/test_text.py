"""Text that other editors wrote, and numbers longer than Python reads, end in a reading or in one sentence."""

import json

import numpy as np
import pytest

import stickslip as ss
from stickslip.core.laws.builtin import laws_equal
from stickslip.core.text import LONGEST, bounded
from stickslip.data.exchange.files import write_packing
from stickslip.ensemble import pool
from stickslip.experiments.registry import read_scenario, read_tables
from stickslip.loading.reading import read_packing
from tests.conftest import stickslip_here

DIGITS = "7" * 5000
SLIDER = 'experiment = "rate-state"\n'
SERIES = "time [s], load_point [um], friction [-]\n" + "".join(f"{k},{10 * k},0.4\n" for k in range(20))
LAW = "kn = 1.0\ndef normal_force(overlap, kn):\n    return kn * overlap\n"
DUMP = """ITEM: TIMESTEP
0
ITEM: NUMBER OF ATOMS
2
ITEM: BOX BOUNDS pp pp pp
0 3
0 3
0 3
ITEM: ATOMS id radius x y z
1 0.5 1 1 1
2 0.5 1.9 1 1
"""


def saved(path, text, encoding="utf-8-sig"):
    path.write_bytes(text.encode(encoding))
    return path


def data_file(folder):
    state = ss.packings.from_arrays([[1, 1, 1], [1.9, 1, 1]], [0.5, 0.5], law := ss.laws.linear(), cell=3 * np.eye(3))
    write_packing(folder / "p.data", state, law)
    return (folder / "p.data").read_text()


def refused(message, *more, cwd=None):
    run = stickslip_here(*more, cwd=cwd)
    assert run.returncode == 2
    assert run.stderr.count("\n") == 1
    assert message in run.stderr
    assert "Exceeds the limit" not in run.stderr
    assert len(run.stderr) < 400


def test_a_byte_order_mark_is_no_part_of_a_text(tmp_path):
    assert read_tables(saved(tmp_path / "a.toml", SLIDER)) == {"experiment": "rate-state"}
    assert read_scenario(saved(tmp_path / "a.json", json.dumps({"experiment": "rate-state"}))) == read_scenario(
        tmp_path / "a.toml"
    )
    assert ss.friction.read_record(saved(tmp_path / "a.csv", SERIES)).time[-1] == 19
    marked = ss.laws.from_file(saved(tmp_path / "a.py", LAW))
    assert laws_equal(marked, ss.laws.from_file(saved(tmp_path / "b.py", LAW, "utf-8")))
    for name, text in (("a.dump", DUMP), ("a.data", data_file(tmp_path))):
        assert len(read_packing(saved(tmp_path / name, text), law="linear")[0].grains.radius) == 2
    assert pool._read_json(saved(tmp_path / "s.json", '{"address": "tcp://a:1"}')) == {"address": "tcp://a:1"}


READ = {
    "a.toml": (SLIDER, ["cite", "a.toml"]),
    "a.json": ('{"experiment": "rate-state"}', ["cite", "a.json"]),
    "a.csv": (SERIES, ["fit", "a.csv"]),
    "a.dump": (DUMP, ["stability", "a.dump", "--json"]),
    "a.py": (LAW, ["stability", "b.dump", "--law", "a.py", "--modes", "m.npz"]),
}


@pytest.mark.parametrize(
    ("encoding", "name"),
    [*(("utf-16-le", name) for name in READ), *((code, "a.toml") for code in ("utf-16", "utf-16-be", "utf-32"))],
)
def test_text_in_utf_16_is_reported(tmp_path, encoding, name):
    text, arguments = READ[name]
    saved(tmp_path / name, text, encoding)
    saved(tmp_path / "b.dump", DUMP, "utf-8")
    run = stickslip_here(*arguments, cwd=tmp_path)
    assert run.returncode == 2
    assert run.stderr == f"stickslip: {name} is text in UTF-16 or UTF-32: save it as UTF-8\n"


@pytest.mark.parametrize("name", ["a.toml", "a.json", "sweep.toml", "noise.toml", "parts.toml"])
def test_whole_numbers_of_thousands_of_digits_in_scenarios(tmp_path, name):
    text = {
        "a.toml": f"{SLIDER}seed = {DIGITS}\n",
        "a.json": f'{{"experiment": "rate-state",\n"seed": {DIGITS}}}',
        "sweep.toml": f'{SLIDER}sweep."spring.stiffness" = [1, {DIGITS}]\n',
        "noise.toml": f"{SLIDER}samples.noise = -{DIGITS}\n",
        "parts.toml": f"{SLIDER}seed = {'_'.join(DIGITS)}\n",
    }[name]
    (tmp_path / name).write_text(text)
    refused(f"the scenario {name}, line 2, contains an integer of 5000 digits", "cite", name, cwd=tmp_path)


@pytest.mark.parametrize("number", ["1_0", "١٠"])
def test_numbers_that_only_python_reads_are_refused_everywhere(tmp_path, number):
    """`float` and `int` take an underscore between digits, and the digits of all scripts."""
    (tmp_path / "a.csv").write_text(SERIES + f"{number}0,200,0.4\n", encoding="utf-8")
    refused(f"line 22: time is '{number}0', not a number", "fit", "a.csv", "--free-stiffness", cwd=tmp_path)
    (tmp_path / "a.csv").write_text(SERIES, encoding="utf-8")
    refused(f"'{number}' is not a number", "fit", "a.csv", "--stiffness", number, cwd=tmp_path)
    refused("", "fit", "a.csv", "--columns", f"time=0,load_point=1,friction={number}", cwd=tmp_path)
    data = data_file(tmp_path)
    for name, text, old, new in (
        ("a.dump", DUMP, "1.9 1 1", f"1.9 1 {number}"), ("a.dump", DUMP, "0 3", f"0 {number}"),
        ("a.dump", DUMP, "ATOMS\n2", f"ATOMS\n{number}"), ("p.data", data, "timestep = 0", f"timestep = {number}"),
        ("p.data", data, "1.9", f"1.{number}"),
    ):  # fmt: skip
        assert old in text
        (tmp_path / name).write_text(text.replace(old, new, 1), encoding="utf-8")
        with pytest.raises(ss.packings.PackingError):
            read_packing(tmp_path / name, law="linear")


@pytest.mark.parametrize("entry", ["seed = X", "samples.number = X", "samples.noise = X", "seed = [X]", "x = X"])
def test_whole_numbers_that_are_read_and_too_long_for_a_sentence(tmp_path, entry):
    for value in ("-" + "9" * 4000, *(["0x" + "f" * 5000, "1" + "0" * 400] if "x =" not in entry else [])):
        (tmp_path / "a.toml").write_text(SLIDER + entry.replace("X", value) + "\n")
        refused("", "cite", "a.toml", cwd=tmp_path)


@pytest.mark.parametrize(
    "entry",
    [
        '"spring.stiffness" = [X]', '"spring.stiffness" = {linspace = [1, X], number = 3}', "seed = {count = X}",
        '"samples.number" = {integers = [1, X], number = 3}', '"surface.a" = {normal = {mean = X, sd = 1}, number = 2}',
        "draw_seed = X\nseed = [1]", 'mode = "sample"\nnumber = X\nseed = [1]', '"spring.stiffness" = X',
        '"surface.a" = {linspace = [1e308, -1e308], number = 3}',
        '"surface.a" = {normal = {mean = 1e308, sd = 1e308}, number = 9}',
        '"surface.a" = {loguniform = [1e-300, 1e300], number = 3}', '"seed" = {linspace = [0, X], number = 3}',
    ],
)  # fmt: skip
def test_huge_numbers_in_sweeps(tmp_path, entry):
    for value in ("0x" + "f" * 5000, "1" + "0" * 400, "1" + "0" * 25) if "X" in entry else ("",):
        (tmp_path / "a.toml").write_text(f"{SLIDER}[sweep]\n{entry.replace('X', value)}\n")
        refused("", "run", "a.toml", "--out", "out", cwd=tmp_path)
        assert not (tmp_path / "out").exists()


def test_whole_numbers_of_thousands_of_digits_in_tables(tmp_path):
    (tmp_path / "a.csv").write_text(SERIES + f"{DIGITS},200,0.4\n")
    refused("line 22: time is 7777", "fit", "a.csv", cwd=tmp_path)
    refused("not a finite number", "fit", "a.csv", cwd=tmp_path)
    (tmp_path / "a.csv").write_text(SERIES.replace("[um]", f"[{DIGITS}]"))
    refused("load_point has the unit '7777", "fit", "a.csv", cwd=tmp_path)
    for old in ("TIMESTEP\n0", "ATOMS\n2"):
        (tmp_path / "a.dump").write_text(DUMP.replace(old, f"{old[:-1]}{DIGITS}"))
        refused("has 5000 digits: at most 40 are allowed", "stability", "a.dump", "--json", cwd=tmp_path)
    text = data_file(tmp_path)
    (tmp_path / "p.data").write_text(text.replace("2 atoms", f"{DIGITS} atoms"))
    refused("has 5000 digits: at most 40 are allowed", "stability", "p.data", "--json", cwd=tmp_path)
    (tmp_path / "p.data").write_text(text.replace("timestep = 0", f"timestep = {DIGITS}"))
    refused("has 5000 digits: at most 40 are allowed", "stability", "p.data", "--json", cwd=tmp_path)


def huge_messages(folder):
    """Calls whose messages quote the argument, in each of the ways in which errors are raised."""
    word, many = "x" * 3000, ["x" * 40] * 200
    np.savez(folder / "p.npz", position=np.zeros((2, 3)), radius=np.ones(2), **{word: 1.0})
    scene = {"experiment": "rate-state"}
    return [
        lambda: ss.scenario(**scene, **{word: 1}),
        lambda: ss.scenario(experiment="quasi-rigid", disks={"radius": many}),
        lambda: ss.scenario(experiment="threshold", load={"loads": [0.1, 0.2] * 3000}),
        lambda: ss.sweep(**scene, sweep={"seed": word}),
        lambda: ss.sweep(**scene, sweep={"surface.a": [0.1], "where": [word]}),
        lambda: ss.io.read_packing(folder / "p.npz"),
        lambda: ss.io.read_packing(folder / "p.npz", law=word),
        lambda: ss.packings.jammed(30, packing_fraction=0.7, radius=[-1.0] * 3000),
        lambda: ss.laws.from_file(folder / word[:200] / "x.py", **{word: 1.0}),
        lambda: ss.friction.line_fault(1e3, 10.0, a=word, b=0.1, dc=1.0, normal=1.0),
    ]


def test_messages_stay_short_for_any_quoted_value(tmp_path):
    """The beginning says what was got, and the end what to do: what was given is shortened in between."""
    for number, call in enumerate(huge_messages(tmp_path)):
        with pytest.raises(ValueError) as caught:
            pytest.fail(f"{number}: {call()}")
        assert 20 < len(str(caught.value)) <= LONGEST, (number, len(str(caught.value)))
        assert "\n" not in str(caught.value)


def test_what_is_quoted_is_shortened_and_the_remedy_stays():
    assert bounded("a short one: leave it") == "a short one: leave it"
    told = bounded(f"'{'y' * 5000}' was given: use y")
    assert told.startswith("'yyy") and told.endswith("was given: use y") and "(5002 characters)" in told
    told = bounded(f"loads = {[0.1] * 5000} were given: sort them")
    assert told.startswith("loads = [0.1, ") and told.endswith("were given: sort them") and len(told) <= LONGEST


def test_the_command_line_keeps_the_remedy(tmp_path):
    path = saved(tmp_path / "a.toml", f'experiment = "{"z" * 2000}"\n' + SLIDER.replace("experiment", "x"))
    for arguments in (["run", path, "--out", "o"], ["cite", tmp_path / ("q" * 100) / ("q" * 100) / ("q" * 100)]):
        run = stickslip_here(*arguments, cwd=tmp_path)
        assert run.returncode == 2
        assert len(run.stderr) <= LONGEST + len("stickslip: \n")
