"""What README and docs show must run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import stickslip

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("page", "number", "words"),
    [
        ("README.md", 0, ("3 complex pairs", "limit")),
        ("README.md", 1, ("oscillatory instability: 1 complex pair",)),
        ("README.md", 2, ("the lid bears ", " events; ")),
        ("docs/quasi_rigid.md", 0, (" events,", " alternatives")),
        ("docs/look.md", 0, ("2 axes",)),
        ("docs/many_runs.md", 0, ("'spring.stiffness': 4, 'seed': 2", "1/m")),
        ("docs/rate_and_state.md", 0, ("reached its end", "all parameters are known", "prefer the slip law")),
    ],
)
def test_the_examples_run_and_are_short(page, number, words, tmp_path):
    code = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), flags=re.S)[number]
    assert len(code.strip().splitlines()) <= 15
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    assert all(w in run.stdout for w in words), run.stdout


def test_links_and_commands_exist():
    for target in re.findall(r"\]\((?!http)([^)]+)\)", README):
        assert (ROOT / target).exists(), target
    makefile = (ROOT / "Makefile").read_text()
    for word in re.findall(r"make (\w+)", README):
        assert re.search(rf"^{word}:", makefile, flags=re.M) or word == "demo", word


@pytest.mark.parametrize("name", stickslip.__all__)
def test_every_public_name_loads_and_is_documented(name):
    thing = getattr(stickslip, name)
    assert name == "__version__" or name.isupper() or thing.__doc__
