"""What programs get: one object or paths, no colours in pipes, letters of any code page; what shells complete."""

import io
import json
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from rich.table import Table
from rich.text import Text

from stickslip.cli import main
from stickslip.data.run_files import UNFINISHED
from stickslip.experiments.registry import scenario
from stickslip.reports import terminal
from stickslip.reports.claims import claim
from stickslip.runs import json_output as answers
from stickslip.runs.sweep.definition import describe_differences
from stickslip.wings.faults.rate_state.simulate import simulate_slider
from tests.conftest import stickslip_here

SLIDER = 'experiment = "rate-state"\n[samples]\nnumber = 12\n'
SWEEP = SLIDER + '[sweep]\n"{key}" = {values}\n'


def object_of(*arguments, cwd, code=0):
    """The one object on standard output; nothing else may be there."""
    run = stickslip_here(*arguments, "--json", cwd=cwd)
    assert run.returncode == code, run.stderr
    assert run.stdout.count("\n") == 1
    return json.loads(run.stdout, parse_constant=lambda word: pytest.fail(f"{word} is not JSON")), run.stderr


def test_a_run_as_one_object_and_as_paths(tmp_path):
    (tmp_path / "s.toml").write_text(SLIDER)
    answer, err = object_of("run", "s.toml", "--out", "out", cwd=tmp_path)
    assert not err
    assert (answer["command"], answer["status"], answer["folder"]) == ("run", "finished", "out")
    left = {path.name for path in (tmp_path / "out").iterdir()}
    assert left == {"manifest.json"} | {path.split("/")[-1] for path in answer["files"]}
    assert answer["measures"]["reached"]["unit"] == "s"
    assert answer["scenario"]["experiment"] == "rate-state"
    assert re.fullmatch("[0-9a-f]{16}", answer["scenario"]["digest"])
    assert answer["versions"]["numpy"] == np.__version__
    quiet = stickslip_here("run", "s.toml", "--out", "out", "-q", cwd=tmp_path)
    assert quiet.stdout.split() == answer["files"]
    again, _ = object_of("resume", "out", cwd=tmp_path)
    assert again["files"] == answer["files"]
    assert again["scenario"] == answer["scenario"]
    assert not terminal.console.quiet
    assert not terminal.console.stderr


def test_a_run_some_of_whose_realizations_failed_is_incomplete(tmp_path):
    """`resume` can try these again as long as pieces are kept; then it is finished."""
    chosen = scenario(experiment="rate-state")
    complete = simulate_slider(chosen)
    several = SimpleNamespace(**complete._asdict(), failures=("realization 2 failed: not again",))
    made = claim("a", "Fig 1: text", 1.0, float("nan"), "1", 0.1)

    def told(result, claims=None):
        return json.loads(answers.to_json(answers.describe_run("run", tmp_path, result, [], claims)))

    (tmp_path / UNFINISHED).mkdir()
    assert told(several)["status"] == "incomplete"
    assert told(several)["failures"] == ["realization 2 failed: not again"]
    (tmp_path / UNFINISHED).rmdir()
    whole = told(complete, [made])
    assert whole["status"] == "finished"
    assert "failures" not in whole
    assert (whole["claims"][0]["verdict"], whole["claims"][0]["measured"]) == ("undecided", None)
    swept = {"names": ["a", "b"], "found": [{}, None], "failures": ["", "no equilibrium"], "reused": 1, "remarks": ()}
    swept["sweep"] = SimpleNamespace(base={}, digest="0", refused=(("b > a", 3),))
    answer = answers.describe_sweep("run", tmp_path, SimpleNamespace(**swept), {})
    assert answer["status"] == "failed"
    assert answer["members"] == {"total": 2, "finished": 1, "reused": 1, "failed": 1}
    assert answer["failures"] == {"b": "no equilibrium"}
    assert answer["refused"] == {"b > a": 3}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["run", "absent.toml", "--out", "o"], "absent.toml cannot be read"),
        (["reproduce", "disk-aray"], "did you mean 'disk-array'?"),
        (["resume", "absent"], "is not a folder"),
        (["stability", "absent.npz"], "absent.npz"),
        (["fit", "absent.csv"], "no such file"),
        (["cite", "absent.toml"], "absent.toml"),
        (["convert", "absent.npz", "--to", "x.gsd"], "absent.npz"),
    ],
)
def test_errors_are_an_object_too_and_one_line_for_people(arguments, sentence, tmp_path):
    answer, err = object_of(*arguments, cwd=tmp_path, code=2)
    assert (answer["status"], answer["exit_code"]) == ("failed", 2)
    assert sentence in answer["error"]
    assert err == f"stickslip: {answer['error']}\n"
    assert stickslip_here(*arguments, "--quiet", cwd=tmp_path).stdout == ""
    assert not list(tmp_path.iterdir())


def test_a_stopped_run_says_so_in_its_object(monkeypatch, capsys):
    def stop(**_):
        raise KeyboardInterrupt("SIGTERM")

    app = sys.modules["stickslip.cli.app"]  # `stickslip.cli.app` is the object
    monkeypatch.setattr(app, "app", stop)
    monkeypatch.setattr(sys, "argv", ["stickslip", "run", "a.toml", "--json"])
    with pytest.raises(SystemExit) as ended:
        main()
    answer = json.loads(capsys.readouterr().out)
    assert (answer["status"], answer["exit_code"], ended.value.code) == ("stopped", 130, 130)
    assert answer["error"] == "stopped by SIGTERM"


def test_numbers_that_are_none_are_null():
    told = {
        "a": np.nan,
        "b": np.array([1.0, np.inf]),
        "c": [np.float64(2.0), (-np.inf,)],
        "d": np.bool_(True),
        "e": "φ",
    }
    assert answers.to_json(told).isascii()
    assert json.loads(answers.to_json(told)) == {"a": None, "b": [1.0, None], "c": [2.0, [None]], "d": True, "e": "φ"}


@pytest.mark.slow
def test_a_sweep_keeps_its_choice_says_when_nothing_is_left_and_is_replaced_only_when_told(tmp_path):
    def write(key="surface.mu0", values="[0.3, 0.4]"):
        (tmp_path / "s.toml").write_text(SWEEP.format(key=key, values=values))

    write()
    arguments = ("run", "s.toml", "--out", "out", "--workers", "1")
    answer, _ = object_of(*arguments, "--figures", cwd=tmp_path)
    assert answer["members"] == {"total": 2, "finished": 2, "reused": 0, "failed": 0}
    assert answer["ranges"]["final_friction"]["members"] == 2
    gone = sorted((tmp_path / "out" / "members").iterdir())[0] / "measures.json"
    gone.unlink()
    (gone.parent / "fig1_history.png").unlink()
    answer, _ = object_of("resume", "out", "--workers", "1", cwd=tmp_path)
    assert answer["members"]["reused"] == 1
    assert (gone.parent / "fig1_history.png").exists()
    assert "The sweep is finished: there was nothing to run." in " ".join(
        stickslip_here("resume", "out", "--workers", "1", cwd=tmp_path).stdout.split()
    )
    write(values="[0.3, 0.4, 0.5]")
    assert object_of(*arguments, cwd=tmp_path)[0]["members"]["reused"] == 2
    write(key="surface.a", values="[0.01]")
    before = sorted(path.name for path in (tmp_path / "out" / "members").iterdir())
    refused = stickslip_here(*arguments, cwd=tmp_path)
    assert refused.returncode == 2
    assert "contains another sweep (the old sweep has keys surface.mu0, the new one surface.a)" in refused.stderr
    assert sorted(path.name for path in (tmp_path / "out" / "members").iterdir()) == before
    assert object_of(*arguments, "--overwrite", cwd=tmp_path)[0]["members"]["total"] == 1
    assert len(list((tmp_path / "out" / "members").iterdir())) == 1


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({}, ""),
        ({"sweep": {"law.mu": [3, 4]}}, ""),
        ({"experiment": "disk-array"}, ""),
        ({"law": {"kt": 0.2}}, "law.kt was 0.1 and is now 0.2"),
        ({"law": {}}, "law.kt was 0.1 and is now not given"),
        ({"sweep": {"law.kn": [3, 4]}}, "the old sweep has keys law.mu, the new one law.kn"),
        ({"sweep": {"law.mu": [3, 4], "mode": "zip"}}, "the mode was grid and is now zip"),
        ({"seed": 3}, "seed was not given and is now 3"),
    ],
)
def test_what_makes_another_sweep(change, text):
    base = {"law": {"kt": 0.1}, "sweep": {"law.mu": [1, 2]}}
    assert describe_differences(base, base | change) == text


def test_colours_and_live_lines_are_for_terminals(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    # a pipe with FORCE_COLOR
    console = terminal.Console(file=io.StringIO(), force_terminal=True, width=60, markup=False, highlight=False)
    monkeypatch.setattr(terminal, "console", console)
    monkeypatch.setattr(terminal, "LINES", 0.0)
    with terminal.progress() as tell:
        for k in range(3):
            tell("ramp", k / 3, f"push {k}, [unbalanced] 1e-9")
    assert console.file.getvalue() == "ramp …\n  33%: push 1, [unbalanced] 1e-9\n  67%: push 2, [unbalanced] 1e-9\n"
    for term, drawn in (("xterm", True), ("dumb", False)):
        screen = terminal.Console(file=Terminal(), width=60, legacy_windows=False, _environ={"TERM": term})
        monkeypatch.setattr(terminal, "console", screen)
        with terminal.progress() as tell:
            tell("births and deaths of pairs (quarter)", 0.5, "push 0.0850, unbalanced 1e-9, growth rate 1.2e-04")
        said = screen.file.getvalue()
        assert ("\x1b[" in said) == drawn
        assert all(len(re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", line)) <= 60 for line in re.split(r"[\r\n]", said))
        assert not drawn or "unbalanced 1e-9" in said


@pytest.mark.parametrize("encoding", ["ascii", "cp1252"])
def test_code_pages_without_greek_get_spelled_letters(encoding, tmp_path):
    code = "import sys; from stickslip.cli.app import main; from stickslip.cli import app\n"
    code += "@app.command()\ndef greek(): print('λ ± 2 Å'); raise ValueError('φ → ∞')\nmain()"
    env = os.environ | {"PYTHONIOENCODING": encoding, "NO_COLOR": "1"}
    run = subprocess.run([sys.executable, "-c", code, "greek"], capture_output=True, env=env)
    assert run.returncode == 2
    assert run.stdout.decode(encoding).strip() == ("lambda +- 2 A" if encoding == "ascii" else "lambda ± 2 Å")
    assert run.stderr.decode(encoding).strip() == "stickslip: phi ? ?"


BASH = """
{script}
COMP_WORDS=({words}); COMP_CWORD={place}; _stickslip_completion {program}
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.mark.skipif(os.name != "posix", reason="needs bash")
def test_bash_completes_names_and_leaves_files_to_itself(tmp_path):
    main = f"#!{sys.executable}\nfrom stickslip.cli import main\nmain()\n"
    (tmp_path / "stickslip").write_text(main)
    (tmp_path / "stickslip").chmod(0o755)
    asked = os.environ | {"_STICKSLIP_COMPLETE": "source_bash"}  # --show-completion asks which shell has called it
    script = subprocess.run([tmp_path / "stickslip"], env=asked, capture_output=True, text=True)
    assert script.returncode == 0
    assert "complete -o default -F _stickslip_completion stickslip" in script.stdout  # default: names of files
    text = BASH.format(script=script.stdout, words="stickslip re", place=1, program=tmp_path / "stickslip")
    run = subprocess.run(["bash", "--norc", "-c", text], capture_output=True, text=True)
    assert run.stdout.split("\n")[:-1] == ["reproduce", "resume", "report"], run.stderr


@pytest.mark.parametrize(("command", "completions"), [
    ("stickslip re", ["reproduce", "resume", "report"]),
    ("stickslip run s.toml --engine l", ["lammps"]),
    (
        "stickslip stability s.npz --law hertz",
        ["hertz_mindlin", "hertz_mindlin_reff", "hertz_mindlin_rescaled", "hertz_mindlin_reff_rescaled"],
    ),
    ("stickslip run examples/", []),
])  # fmt: skip
def test_what_bash_asks_for_is_answered(command, completions, monkeypatch):
    for name, value in {"_STICKSLIP_COMPLETE": "complete_bash", "COMP_WORDS": command}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("COMP_CWORD", str(len(command.split()) - 1))
    assert stickslip_here().stdout.split() == completions


@pytest.mark.parametrize(
    ("shell", "line", "word"),
    [
        ("zsh", "stickslip reproduce ", '"gouge"'),
        ("fish", "stickslip reproduce ", "gouge\tFerdowsi & Rubin 2021"),
        ("zsh", "stickslip run x", "_files"),
    ],
)
def test_other_shells_are_answered(shell, line, word, monkeypatch):
    env = {
        "_STICKSLIP_COMPLETE": f"complete_{shell}",
        "_TYPER_COMPLETE_ARGS": line,
        "_TYPER_COMPLETE_FISH_ACTION": "get-args",
    }
    for name, value in env.items():
        monkeypatch.setenv(name, value)
    run = stickslip_here()
    assert word in run.stdout, run.stderr


def test_a_table_without_room_becomes_lines(capsys, monkeypatch):
    table = Table("length of a column", "another long heading", title="A title")
    table.add_row("0.071557", Text("4446", "red"))
    monkeypatch.setattr(terminal.console, "width", 30)
    terminal.show_table(table)
    assert capsys.readouterr().out == "A title\n  length of a column: 0.071557\n  another long heading: 4446\n\n"
    monkeypatch.setattr(terminal.console, "width", 80)
    terminal.show_table(table)
    assert "length of a column" in capsys.readouterr().out.splitlines()[2]


def test_a_remaining_time_is_shown_only_if_the_rate_is_steady():
    times = [0.5 * k for k in range(1, 200)]

    def left(share_of, until):
        return terminal.estimate_left([(t, share_of(t)) for t in times if t <= until])

    assert left(lambda t: t / 100, 40) == pytest.approx(60)
    assert left(lambda t: t / 100, 4) is None  # too early
    assert left(lambda t: t / 10_000, 99) is None  # too little is done
    assert left(lambda t: 1 - (1 - t / 100) ** 3, 80) is None  # slower and slower: 20 s would be said, and take longer
    assert left(lambda t: (t / 100) ** 2, 50) is None
    assert left(lambda t: min(t / 100, 0.3), 90) is None  # it hangs
    assert terminal.estimate_left([(0.0, 0.0)]) is None
    told = [terminal.format_duration(seconds) for seconds in (100, 5400, 7200, 2e5)]
    assert told == ["100 s", "90 min", "2 h", "2.31 days"]
