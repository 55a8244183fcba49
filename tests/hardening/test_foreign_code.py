"""Python files that nobody named are not run, wherever a command or its worker processes happen to be."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import stickslip as ss
from stickslip.data import archive
from stickslip.data.exchange.frame import read_mode
from stickslip.data.law_schema import check_law_files
from stickslip.ensemble.worker import WorkerProcess
from stickslip.experiments.registry import ScenarioError, read_tables
from stickslip.runs.bundled import bibtex, read_scenarios
from stickslip.wings.studies.catalogue import read_table
from tests.conftest import stickslip_here


def test_a_worker_does_not_import_from_the_working_directory(tmp_path):
    for name in ("random", "numpy", "pickle"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'was-run')!r}, 'w').close()\n")
    code = (
        "import sys; sys.path.remove('')\n"  # what python -c puts there: a script of the command line has none
        "from stickslip.ensemble import run_members\n"
        "print([m.result for m in run_members(divmod, [(7, 2), (9, 4)], workers=2)])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == "[(3, 1), (2, 1)]\n", done.stderr
    assert not (tmp_path / "was-run").exists()


def test_in_an_interactive_session_functions_beside_it_are_found_and_nothing_is_shadowed(tmp_path):
    (tmp_path / "mine.py").write_text("def twice(x):\n    return 2 * x\n")
    code = (
        "from stickslip.ensemble import run_members\nimport mine\n"
        f"open({str(tmp_path / 'queue.py')!r}, 'w').write('raise SystemExit(3)')\n"
        "print([m.result for m in run_members(mine.twice, [(7,), (9,)], workers=2)])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == "[14, 18]\n", done.stderr


def test_helpers_of_helpers_do_not_either(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    helper = WorkerProcess()
    helper.end()
    assert "-P" in helper.process.args


def law_text(folder) -> str:
    """A law that leaves a trace when it runs, and that nobody has allowed."""
    trace = f"open({str(folder / 'was-run')!r}, 'w').close()\n"
    return trace + "parameters = {'kn': 1.0}\n\n\ndef normal_force(overlap, kn):\n    return kn * overlap\n"


def write_scenario(folder, name):
    """A scenario that names a law beside it, as a stranger can write it: checksum included."""
    text = law_text(folder)
    (folder / "law.py").write_text(text)
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    if name == "array.toml":
        (folder / name).write_text('experiment = "disk-array"\n[law]\nfile = "law.py"\n')
        return
    tables = {"experiment": "disk-array", "law": {"file": "law.py", "checksum": digest}}
    if name == "sweep.json":
        tables["sweep"] = {"seed": [1, 2]}
    (folder / name).write_text(json.dumps(tables))


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("scenario.json", ["resume", "run"]),
        ("sweep.json", ["resume", "run"]),
        ("array.toml", ["run", "run/array.toml", "--out", "out"]),
        ("scenario.json", ["run", "run/scenario.json", "--out", "out"]),
    ],
)
def test_a_law_file_that_nobody_allowed_is_not_run(tmp_path, name, arguments):
    folder = tmp_path / "run"
    folder.mkdir()
    write_scenario(folder, name)
    done = stickslip_here(*arguments, cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert f"{folder / 'law.py'} is a Python program that you have not allowed to run" in done.stderr
    assert not (folder / "was-run").exists() and not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["scenario.json", "sweep.json", "array.toml"])
def test_a_law_is_never_run_to_cite_it_or_to_read_it(tmp_path, name):
    write_scenario(tmp_path, name)
    place = tmp_path / name if name.endswith("toml") else tmp_path
    assert len(bibtex(*read_scenarios(place))) > 1000
    assert Path(read_tables(tmp_path / name)["law"]["file"]) == tmp_path / "law.py"
    assert not (tmp_path / "was-run").exists()


def test_a_device_is_not_read(tmp_path):
    for call in (
        lambda: ss.friction.read_record("/dev/zero"), lambda: ss.io.read_sweep("/dev/zero"),
        lambda: ss.laws.from_file("/dev/zero"), lambda: ss.io.read_packing("/dev/zero"),
        lambda: ss.read_scenario("/dev/zero"), lambda: ss.io.open_dataset("/dev/zero"),
        lambda: archive.read("/dev/zero"), lambda: read_mode("/dev/zero", 0, 5), lambda: read_table("/dev/zero"),
    ):  # fmt: skip
        with pytest.raises(ValueError, match=r"a device or a pipe|is not a file|does not exist"):
            call()
    os.mkfifo(pipe := tmp_path / "fifo")
    for arguments in (["fit", "/dev/random"], ["fit", pipe], ["run", pipe, "--out", "out"], ["cite", pipe]):
        done = stickslip_here(*arguments, cwd=tmp_path)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
        assert "is a device or a pipe, which may never end" in done.stderr


def test_what_was_allowed_once_runs_and_a_changed_text_does_not(tmp_path):
    write_scenario(tmp_path, "array.toml")
    chosen = ss.read_scenario(tmp_path / "array.toml")
    with pytest.raises(ScenarioError, match="that you have not allowed to run"):
        ss.simulate(chosen, folder=tmp_path / "out")
    assert not (tmp_path / "was-run").exists() and not (tmp_path / "out").exists()
    ss.read_scenario(tmp_path / "array.toml", trust=True)
    assert not (tmp_path / "was-run").exists()
    check_law_files(chosen.model_dump())
    assert (tmp_path / "was-run").exists()
    (tmp_path / "law.py").write_text(law_text(tmp_path) + "# changed\n")
    with pytest.raises(ScenarioError, match="that you have not allowed to run"):
        check_law_files(ss.read_scenario(tmp_path / "array.toml").model_dump())


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.json", "[1, 2]", "contains an array, not an object"),
        ("a.json", "3", "contains a number, not an object"),
        ("a.json", "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("a.toml", "x = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
        ("a.toml", "x = " + "[" * 500 + "]" * 500, ""),
        ("a.toml", 'experiment = "flow"\nlaw = ' + "{a = " * 500 + "1" + "}" * 500, ""),
        ("a.json", '{"experiment": "flow", "law": ' + '{"a": ' * 500 + "1" + "}" * 500 + "}", ""),
    ],
)
def test_text_that_is_no_table_ends_with_a_sentence(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    done = stickslip_here("run", name, "--out", "out", cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert message in done.stderr
    assert not (tmp_path / "out").exists()
