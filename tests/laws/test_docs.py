"""What docs/contact_laws.md shows is what the examples hold, and runs."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "contact_laws.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, flags=re.S)


def test_the_laws_shown_are_the_examples():
    files, scripts = [b for b in BLOCKS if "import stickslip" not in b], [b for b in BLOCKS if "import stickslip" in b]
    names = "cohesive", "rolling", "walton_braun"
    assert len(scripts) == 2
    for text, name in zip(files, names, strict=True):
        assert text == (ROOT / "examples" / f"{name}_law.py").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 1])
def test_the_scripts_run_and_print_what_the_page_says(number):
    script = [b for b in BLOCKS if "import stickslip" in b][number]
    assert len(script.strip().splitlines()) <= 15
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT / "examples")
    assert run.returncode == 0, run.stderr
    shown = re.findall(r"It prints\n\n((?:    .*\n)+)", PAGE)[number]
    for line in shown.splitlines():  # in words and to two digits: solvers promise tolerances, not bits
        text = re.sub(r"e-folding time.*", "", line.strip())
        assert text in run.stdout, run.stdout
