"""Sphinx configuration; `make docs` builds the documentation with warnings as errors."""

import os
import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent)]
# tutorials call `stickslip` by name, even if the environment is not activated
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])

import api_reference  # noqa: E402
import known_reference  # noqa: E402
import scenario_reference  # noqa: E402

import stickslip  # noqa: E402
from benchmarks import records  # noqa: E402
from stickslip.wing import wings  # noqa: E402

project = "stickslip"
author = "The stickslip developers"
project_copyright = author
version = release = stickslip.__version__

extensions = [
    "myst_nb",  # markdown pages and executed tutorials
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # equations work offline
    "sphinx_copybutton",
]
exclude_patterns = ["_build", "figures", "reference", "numbers"]
nitpicky = True  # broken cross-references are errors
nitpick_ignore_regex = [("py:exc", r"\w+Error")]  # exceptions of other packages and of internal modules

myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3  # same anchors as on code hosts
myst_dmath_double_inline = True
nb_execution_mode = "cache"  # tutorials are run again when their code changes
nb_execution_cache_path = str(HERE / "_build" / ".jupyter_cache")
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True

napoleon_google_docstring = False
napoleon_use_param = napoleon_use_rtype = False  # types are plain text, not references
napoleon_custom_sections = ["Source"]
autodoc_typehints = "none"  # docstrings state units, shapes and allowed values
autodoc_member_order = "bysource"
python_use_unqualified_type_names = True

html_theme = "furo"
# a release writes the address of the repository, and those of Binder and Colab, into the metadata
METADATA = tomllib.loads((HERE.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
html_theme_options = {
    "footer_icons": [
        {"name": name, "url": url, "html": name, "class": ""} for name, url in METADATA.get("urls", {}).items()
    ]
}
html_favicon = "_static/icon.svg"
html_static_path = ["_static"]
html_css_files = ["wide.css"]
html_title = f"stickslip {version}"
html_copy_source = False
html_show_sphinx = False
copybutton_exclude = ".linenos, .gp, .go"


def name_older_numbers(app, page, source):
    """Add the numbers that are older than the code to the page of all numbers."""
    if page == "numbers":
        source[0] += records.older(records.read())


def sections_of_wings() -> str:
    """Sections of the navigation with the pages that the head of each wing lists."""
    out = []
    for wing in wings().values():
        caption = wing.words.partition(",")[0]
        pages = [page for page in wing.pages if (HERE / f"{page}.md").is_file()]
        if pages:
            options = f":hidden:\n:caption: {caption[:1].upper()}{caption[1:]}\n"
            out.append("\n".join(["```{toctree}", options, *pages, "```"]))
    return "\n\n".join(out)


def complete_navigation(app, page, source):
    """Add the pages of wings to the navigation."""
    if page == "index":
        source[0] = source[0].replace("<!-- pages of wings -->", sections_of_wings())


def setup(app):
    """Write the generated pages and connect the handlers that adapt docstrings."""
    scenario_reference.write(HERE / "scenario")
    api_reference.write(HERE / "api")
    known_reference.write()
    app.connect("source-read", name_older_numbers)
    app.connect("source-read", complete_navigation)
    app.connect("autodoc-process-docstring", api_reference.described, priority=400)  # before napoleon
    app.connect("autodoc-process-docstring", api_reference.mend)
    app.connect("autodoc-process-signature", api_reference.short)
    app.connect("autodoc-skip-member", api_reference.skip)
