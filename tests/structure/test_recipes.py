"""The page of recipes: every block of Python runs, in the order of the page."""

import re
import shutil
from pathlib import Path

import pytest

from tests.conftest import stickslip_here

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how_do_i.md").read_text()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_recipes_run_as_printed(tmp_path, monkeypatch, capsys):
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    space = {"__name__": "recipes"}
    for block in re.findall(r"```python\n(.*?)```", PAGE, flags=re.S):
        exec(compile(block, block.strip().splitlines()[0], "exec"), space)
    found = space["found"]
    assert found.verdict.startswith("oscillatory instability")
    assert space["exponent"].real == pytest.approx(found.growth_rate[0])
    assert space["fit"].values["dc"] == pytest.approx(1e-5, rel=1e-6)
    for command in re.findall(r"^    stickslip (.+)$", PAGE, flags=re.M):
        assert stickslip_here(*command.split()).returncode == 0
