"""What the README shows must run."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import stickslip

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("number", "words"), [(0, ("3 complex pairs", "limit")), (1, ("oscillatory instability: 1 complex pair",))]
)
def test_the_examples_run_and_are_short(number, words, tmp_path):
    code = re.findall(r"```python\n(.*?)```", README, flags=re.S)[number]
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
