"""`stickslip doctor`: it tells what is there, and fails when a number is wrong."""

import json

import numpy as np
import pytest

from stickslip import doctor, extras
from stickslip._core import build
from stickslip.doctor import BITS, PROBLEM, TOLERANCES, compare
from tests.conftest import stickslip_here as stickslip
from tests.conftest import stickslip_process

STORED = json.loads(doctor.STORED.read_text())


@pytest.fixture(scope="module")
def found():
    return doctor.measure()


def test_the_numbers_are_the_stored_ones(found):
    assert PROBLEM not in found
    assert found.keys() > STORED["numbers"].keys()
    assert {"rate and state, after a hold", "quasi-rigid, slip rate"} < found.keys()  # of wings
    wrong = [check for check in compare(found, STORED) if not check.ok]
    assert not wrong


@pytest.mark.parametrize("name", [name for name in STORED["numbers"] if name != BITS])
@pytest.mark.parametrize("by", [2.0, 1e-3])
def test_a_number_off_by_more_than_its_tolerance_fails(found, name, by):
    tolerance = next(rule[0] for start, rule in TOLERANCES.items() if name.startswith(start))
    off = found | {name: STORED["numbers"][name] * (1 + by * tolerance)}
    check = next(check for check in compare(off, STORED) if check.name == name)
    # the smallest tolerance is 4500 times the round-off of the product above
    assert check.ok == (by < 1)


def test_other_bits_are_reported_and_allowed_but_not_missing_ones(found):
    other = next(check for check in compare(found | {BITS: "0" * 16}, STORED) if check.name == BITS)
    assert other.ok
    assert other.note == "other bits: allowed"
    none = next(check for check in compare({}, STORED) if check.name == BITS)
    assert not none.ok


def test_what_breaks_on_the_way_is_reported_and_the_rest_goes_on(monkeypatch, capsys):
    def broken():
        raise TypeError("no\nsuch compiler")

    monkeypatch.setattr("stickslip.wings.faults.friction.laws.selfchecks", broken)
    monkeypatch.setattr(doctor, "measure_array", lambda law: {})
    result = doctor.selfcheck()
    assert not result.ok
    assert result.problem == "faults: TypeError: no such compiler"
    assert [check.ok for check in result.checks if check.name.startswith(("contact", "quasi"))] == [True] * 4
    doctor.show_checks(result)
    said = capsys.readouterr().out
    assert "no such compiler" in said
    assert "4 of 8 numbers are wrong" in said
    doctor.show_checks(result._replace(checks=result.checks[:-1], problem=""))
    assert f"{3 + result.checks[-1].ok} of 7 numbers are wrong" in capsys.readouterr().out
    wrong = [row for row in json.loads(doctor.to_json({}, {}, {}, [], result))["selfcheck"] if not row["ok"]]
    assert [row["deviation"] for row in wrong] == [None] * 4
    assert [row["measured"] for row in wrong if row["name"] != BITS] == [None] * 3


def test_the_command_tells_and_succeeds(tmp_path):
    run = stickslip_process("doctor", cwd=tmp_path)  # its output is a pipe
    assert run.returncode == 0, run.stderr
    assert "all is well" in run.stdout
    assert "\x1b" not in run.stdout
    assert max(map(len, run.stdout.splitlines())) <= 80
    for word in ("numpy", "cores", "compiler", "level", "fast", "exchange", "Self-check"):
        assert word in run.stdout, word
    assert not list(tmp_path.iterdir())


def test_json_is_one_object_and_a_wrong_number_ends_with_1(tmp_path, monkeypatch):
    stored = STORED | {"numbers": STORED["numbers"] | {"contact force, normal": 1.0}}
    (tmp_path / "numbers.json").write_text(json.dumps(stored))
    monkeypatch.setattr(doctor, "STORED", tmp_path / "numbers.json")
    run = stickslip("doctor", "--json")
    assert run.returncode == 1
    out = json.loads(run.stdout)
    assert out["ok"] is False
    assert [check["name"] for check in out["selfcheck"] if not check["ok"]] == ["contact force, normal"]
    assert out["versions"]["numpy"] == np.__version__
    assert {part["name"] for part in out["parts"]} == {*extras.EXTRAS, "YADE"}


def test_missing_and_broken_parts_say_what_installs_them(monkeypatch):
    monkeypatch.setattr(extras, "is_installed", lambda library: library not in ("gsd", "furo"))
    monkeypatch.setattr(doctor, "factorised", lambda matrix, method: 1 / 0)
    monkeypatch.setattr("stickslip.wings.lammps.run.load_error", lambda: "libmpi.so.12: cannot open shared object file")
    monkeypatch.setattr(doctor, "which", lambda name: None)
    parts = {part.name: part for part in doctor.parts()}
    assert parts["exchange"].remedy == '`pip install "stickslip[exchange]"`'
    assert parts["exchange"].found.endswith("gsd missing")
    assert parts["docs"].found.endswith("furo missing")
    assert "it cannot be loaded (division by zero)" in parts["fast"].found
    assert parts["fast"].remedy == '`pip install --force-reinstall "stickslip[fast]"`'
    assert "libmpi.so.12" in parts["bench"].found
    assert parts["bench"].remedy.startswith("`pip install mpich`")
    assert not parts["YADE"].ok


def test_doctor_tells_the_level_and_compiler_of_the_core(monkeypatch):
    told = doctor.compiled_core()
    assert told["level"] in build.LEVELS and told["level"] in told["levels"]
    assert told["compiler"]
    monkeypatch.setenv("STICKSLIP_LEVEL", "base")
    assert doctor.compiled_core()["level"] == "base"


def test_another_folder_remembers_if_none_can_be_written(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.delenv("STICKSLIP_CACHE", raising=False)
    folder = extras.cache_folder()
    assert folder.is_dir() and folder == extras.cache_folder()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert extras.cache_folder() == tmp_path / "stickslip"
