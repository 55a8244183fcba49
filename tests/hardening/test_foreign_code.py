"""Python files that nobody named are not run, wherever a command or its worker processes happen to be."""

import json
import subprocess
import sys

import pytest

from stickslip.ensemble.worker import WorkerProcess
from stickslip.experiments.registry import ScenarioError, read_tables
from stickslip.experiments.resume import find_unfinished

LAW = "open('was-run', 'w').close()\n"


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


@pytest.mark.parametrize("name", ["scenario.json", "sweep.json"])
def test_a_law_file_without_checksum_in_somebodys_folder_is_not_run(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "law.py").write_text(LAW)
    tables = {"experiment": "flow", "law": {"file": str(tmp_path / "law.py")}}
    if name == "sweep.json":
        tables["sweep"] = {"gravity": [[0, -1], [0, -2]]}
    (tmp_path / name).write_text(json.dumps(tables))
    with pytest.raises(ScenarioError, match="without the checksum"):
        read_tables(tmp_path / name)
    with pytest.raises(ScenarioError, match="without the checksum"):
        find_unfinished(tmp_path)
    for words in (["cite", "."], ["resume", "."]):
        done = subprocess.run([sys.executable, "-m", "stickslip", *words], capture_output=True, text=True)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
        assert "without the checksum" in done.stderr
    assert not (tmp_path / "was-run").exists()


@pytest.mark.parametrize(
    ("name", "text", "words"),
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
def test_text_that_is_no_table_ends_with_a_sentence(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    call = [sys.executable, "-m", "stickslip", "run", name, "--out", "out"]
    done = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert words in done.stderr
    assert not (tmp_path / "out").exists()
