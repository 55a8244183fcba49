"""The documentation: every key of every scenario stands in it, links lead somewhere, it builds without a warning."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from stickslip.data.schema import tables_in
from stickslip.experiments.registry import EXPERIMENTS

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)


def generator():
    spec = importlib.util.spec_from_file_location("scenario_reference", DOCS / "scenario_reference.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def tables_of(kind):
    """A class of tables and all within it, each once."""
    found = [kind]
    for table in found:
        inner = [one for field in table.model_fields.values() for one in tables_in(field.annotation)]
        found += [one for one in dict.fromkeys(inner) if one not in found]
    return found


def test_the_reference_is_that_of_the_schema(tmp_path):
    generator().write(tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {path.name for path in (DOCS / "scenario").iterdir()}
    for name in names:
        kept, now = ((folder / name).read_text(encoding="utf-8") for folder in (DOCS / "scenario", tmp_path))
        assert kept == now, f"docs/scenario/{name} is stale: python docs/scenario_reference.py writes it anew"


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_key_of_a_scenario_has_its_line_and_says_what_it_is(name):
    page = (DOCS / "scenario" / f"{name}.md").read_text(encoding="utf-8")
    sections = page.split("\n## ")
    for table in tables_of(EXPERIMENTS[name].scenario):
        keys = [f"| `{key}` |" for key in table.model_fields]
        assert any(all(key in section for key in keys) for section in sections), table.__name__
        for key, field in table.model_fields.items():
            silent = key in ("experiment", "kind") or tables_in(field.annotation)  # tables say it by their docstrings
            assert silent or field.description, f"{table.__name__}.{key} has no description"
    assert f'experiment = "{name}"' in page.split("## Example", 1)[1]


def anchors(page: Path) -> set[str]:
    """Of all headings, as code hosts and the built pages make them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    heads = re.findall(r"^#+ (.+)$", text, flags=re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(DOCS)))
def test_links_among_pages_lead_somewhere(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    for target in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text):
        path, _, anchor = target.partition("#")
        there = page.parent / path if path else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), target


@pytest.mark.slow
def test_the_pages_build_without_a_warning_and_need_no_network(tmp_path):
    for library in ("sphinx", "myst_nb", "furo", "sphinx_copybutton"):
        pytest.importorskip(library, reason="`make docs` installs what builds the documentation")
    words = ("-m", "sphinx", "-q", "-W", "--keep-going", "-D", f"nb_execution_cache_path={tmp_path / 'cache'}")
    mine = Path(sys.executable).parent  # as where the environment is not activated
    path = os.pathsep.join(part for part in os.environ["PATH"].split(os.pathsep) if Path(part) != mine)
    run = subprocess.run(
        [sys.executable, *words, DOCS, tmp_path / "html"],
        capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(DOCS.parent / "src"), "PATH": path},
    )  # fmt: skip
    assert run.returncode == 0, run.stderr[-4000:]
    first = (tmp_path / "html/index.html").read_text(encoding="utf-8")
    for page in (tmp_path / "html").rglob("*.html"):
        loaded = re.findall(
            r'<(?:script|link|img)[^>]*(?:src|href)="(https?://[^"]+)"', page.read_text(encoding="utf-8")
        )
        assert not loaded, (page.name, loaded)
    assert "tutorials/pushed_disks.html" in first
    assert (tmp_path / "html/_static/mathjax/tex-chtml.js").exists()
