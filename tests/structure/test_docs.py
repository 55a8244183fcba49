"""The documentation: every key of every scenario stands in it, links lead somewhere, it builds without a warning."""

import importlib
import importlib.util
import inspect
import os
import re
import subprocess
import sys
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from shutil import which
from threading import Thread

import pytest

import stickslip as ss
from benchmarks.records import LINK
from stickslip.data.schema import tables_in
from stickslip.experiments.registry import EXPERIMENTS
from stickslip.wing import wings
from stickslip.words import public_names

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)
TUTORIALS = sorted((DOCS / "tutorials").glob("*.md"))


def generator(name="scenario_reference"):
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def tables_of(kind):
    """A class of tables and all within it, each once."""
    results = [kind]
    for table in results:
        inner = [nested for field in table.model_fields.values() for nested in tables_in(field.annotation)]
        results += [nested for nested in dict.fromkeys(inner) if nested not in results]
    return results


def test_the_reference_is_that_of_the_schema(tmp_path):
    generator().write(tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {path.name for path in (DOCS / "scenario").iterdir()}
    for name in names:
        kept, now = ((folder / name).read_text(encoding="utf-8") for folder in (DOCS / "scenario", tmp_path))
        assert kept == now, f"docs/scenario/{name} is stale: python docs/scenario_reference.py writes it anew"


def test_the_table_of_foreign_files_is_that_of_the_module(tmp_path):
    kept = (DOCS / "exchange.md").read_text(encoding="utf-8")
    (tmp_path / "page.md").write_text(kept.replace("`bond_write`", ""), encoding="utf-8")
    generator("known_reference").write(tmp_path / "page.md")
    now = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert "`bond_write`" in now and kept == now, "python docs/known_reference.py writes docs/exchange.md anew"


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
    assert f'`experiment = "{name}"`' in page


def test_navigation_has_each_page_once_and_those_of_wings_from_their_heads():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    assert "<!-- pages of wings -->" in index
    text = index.replace("<!-- pages of wings -->", generator("conf").sections_of_wings())
    trees = re.findall(r"^```\{toctree\}\n(?::[^\n]*\n)*\n(.*?)^```", text, flags=re.M | re.S)
    listed = [line for tree in trees for line in tree.split() if "*" not in line and not line.startswith("api/")]
    folders = [line.removesuffix("*") for tree in trees for line in tree.split() if line.endswith("/*")]
    pages = {page.relative_to(DOCS).with_suffix("").as_posix() for page in PAGES} - {"index"}
    unlisted = {page for page in pages - set(listed) if not page.startswith(tuple(folders))}
    assert not {page for page in unlisted if page.split("/")[0] not in ("reference", "numbers", "figures")}
    assert len(listed) == len(set(listed)) and set(listed) <= pages
    assert {page for wing in wings().values() for page in wing.pages} <= set(listed)


API = generator("api_reference")


@pytest.mark.parametrize("namespace", API.NAMESPACES)
def test_the_overview_of_a_namespace_has_a_row_for_each_of_its_names(namespace):
    """A docstring whose columns were lost by reflowing leaves names out."""
    listed = [name for _, rows in API.overview(namespace) for names, _ in rows for name in names]
    public = set(public_names(API.module_of(namespace))) - {"__version__"}
    assert sorted(listed) == sorted(public)


def test_functions_come_before_classes_and_constants():
    names = API.names("packings")
    assert names.index("jammed") < names.index("PackingError") < names.index("TOP")
    assert ":py:obj:`~stickslip.packings.jammed`" in API.page("packings")


def anchors(page: Path) -> set[str]:
    """Of all headings, as code hosts and the built pages make them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    heads = re.findall(r"^#+ (.+)$", text, flags=re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def test_links_among_pages_lead_somewhere():
    lost = []
    for page in PAGES:
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
        for target in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text):
            path, _, anchor = target.partition("#")
            there = page.parent / path if path else page
            if not there.exists() or (anchor and anchor not in anchors(there)):
                lost.append(f"{page.relative_to(DOCS)}: {target}")
    assert not lost


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The folder of the built pages; a warning fails."""
    for library in ("sphinx", "myst_nb", "furo", "sphinx_copybutton"):
        pytest.importorskip(library, reason="`make docs` installs what builds the documentation")
    folder = tmp_path_factory.mktemp("docs")
    arguments = ("-m", "sphinx", "-q", "-W", "--keep-going", "-D", f"nb_execution_cache_path={folder / 'cache'}")
    mine = Path(sys.executable).parent  # as where the environment is not activated
    path = os.pathsep.join(part for part in os.environ["PATH"].split(os.pathsep) if Path(part) != mine)
    run = subprocess.run(
        [sys.executable, *arguments, DOCS, folder / "html"],
        capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(DOCS.parent / "src"), "PATH": path},
    )  # fmt: skip
    assert run.returncode == 0, run.stderr[-4000:]
    return folder / "html"


@pytest.mark.slow
def test_the_pages_build_without_a_warning_and_need_no_network(built):
    first = (built / "index.html").read_text(encoding="utf-8")
    for page in built.rglob("*.html"):
        loaded = re.findall(
            r'<(?:script|link|img)[^>]*(?:src|href)="(https?://[^"]+)"', page.read_text(encoding="utf-8")
        )
        assert not loaded, (page.name, loaded)
    assert "tutorials/pushed_disks.html" in first
    assert (built / "_static/mathjax/tex-chtml.js").exists()


@pytest.mark.slow
def test_tutorials_are_offered_as_notebooks(built):
    offered = {path.name for path in (built / "_downloads").rglob("*.ipynb")}
    assert offered == {f"{page.stem}.ipynb" for page in TUTORIALS}


OPENED = ("index", "gallery", "installation", "exchange", "element_tests", "faults", "scenario/gouge", "api/packings",
          "tutorials/pushed_disks", "theory/gouge", "about/comparison", "about/whats_new")  # fmt: skip
FAULTS = """
const out = [], wide = window.innerWidth, name = e => e.outerHTML.slice(0, 80);
const scrolls = e => e && (/auto|scroll/.test(getComputedStyle(e).overflowX) || scrolls(e.parentElement));
if (document.documentElement.scrollWidth > wide) out.push("the page is wider than the window");
for (const e of document.images)
    if (!e.alt.trim() || !(e.complete && e.naturalWidth)) out.push("no description, or no picture: " + name(e));
for (const e of document.querySelectorAll("article table, article pre"))
    if (e.getBoundingClientRect().right > wide + 1 && !scrolls(e)) out.push("cut off: " + name(e));
return out;
"""
LOADED = "return [...document.images].every(e => e.complete)"
FOUND = "return document.querySelectorAll('#search-results li').length"
CUT = "return [...document.querySelectorAll('pre')].filter(e => e.scrollWidth > e.clientWidth + 1).length"
OPENING = "return [...document.querySelectorAll('.opening > div')].map(e => e.getBoundingClientRect())"


def visit(driver, address: str) -> None:
    """Open a page and wait for it: `get` may return while the page before it is still shown."""
    driver.get("about:blank")
    driver.get(address)
    loaded = "return document.readyState == 'complete' && location.href != 'about:blank'"
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(driver, 30).until(lambda driver: driver.execute_script(loaded))


def test_the_home_page_begins_with_what_this_is_and_how_to_install_it():
    opening = (DOCS / "index.md").read_text(encoding="utf-8").split("\n## ")[0]
    text, picture = opening.split("<div>\n")[1:]
    assert "is a Python package" in text and "pip install" in text and "![" in picture


@contextmanager
def window(width: int):
    """A window of Chromium of this width, without a network."""
    if not (which("chromium") and which("chromedriver")):
        pytest.skip("there is no Chromium: apt-get install chromium chromium-driver (Debian)")
    from selenium import webdriver  # imported by slow tests alone

    options = webdriver.ChromeOptions()
    offline = "host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1"
    for word in ("headless=new", "no-sandbox", "disable-dev-shm-usage", offline):
        options.add_argument(f"--{word}")
    options.binary_location = which("chromium")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(which("chromedriver")))
    sizes = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
    try:
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", sizes)
        yield driver
    finally:
        driver.quit()


@contextmanager
def served(folder: Path):
    """Address of a server of a folder: browsers let no page of a file read another, as the search does."""

    class Silent(SimpleHTTPRequestHandler):
        def log_message(self, *words) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Silent, directory=folder))
    server.handle_error = lambda *of: None  # a browser that leaves a page breaks its connections
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_twelve_pages_have_no_faults_and_the_search_finds(built, width):
    from selenium.webdriver.support.ui import WebDriverWait

    faults = {}
    with window(width) as driver, served(built) as address:
        for page in OPENED:
            visit(driver, f"{address}/{page}.html")
            driver.execute_script("for (const e of document.images) e.loading = 'eager'")
            WebDriverWait(driver, 30).until(lambda driver: driver.execute_script(LOADED))
            faults[page] = driver.execute_script(FAULTS)
            faults[page] += [line["message"] for line in driver.get_log("browser") if line["level"] == "SEVERE"]
        visit(driver, f"{address}/search.html?q=restitution")
        WebDriverWait(driver, 30).until(lambda driver: driver.execute_script(FOUND) > 2)
    assert not {page: found for page, found in faults.items() if found}


@pytest.mark.slow
@pytest.mark.parametrize("width", [360, 1024, 1440, 1920])
def test_no_page_scrolls_sideways(built, width):
    with window(width) as driver:
        wide = {}
        for page in sorted(built.rglob("*.html")):
            if "_static" not in page.parts:
                visit(driver, page.as_uri())
                answer = driver.execute_script("return document.documentElement.scrollWidth")
                if answer > width:
                    wide[str(page.relative_to(built))] = answer
                cut = driver.execute_script(CUT) if width >= 1024 else 0
                if cut:
                    wide[f"code of {page.relative_to(built)}"] = cut
        assert not wide
        visit(driver, (built / "index.html").as_uri())
        text, picture = driver.execute_script(OPENING)
        assert (picture["left"] > text["right"]) if width >= 1024 else (picture["top"] > text["bottom"])


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_the_cells_of_a_tutorial_run_in_an_empty_folder(page, tmp_path):
    cells = re.findall(r"^```\{code-cell\}[^\n]*\n((?:^:[^\n]*\n)*)(.*?)^```", page.read_text(), flags=re.M | re.S)
    script = "\n".join(code for _, code in cells)
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    away = os.environ | {"MPLBACKEND": "Agg", "PATH": path}
    run = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, env=away, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr[-2000:]


WIDTH = 84  # columns of a code block in a window of 1440 px, measured in Chromium


def code_blocks(text: str) -> list[str]:
    """Fenced and indented blocks of a Markdown page, without tables of contents and options of cells."""
    fenced = re.findall(r"^```(?!\{toctree\})[^\n]*\n((?:(?!```).*\n)*)```", text, flags=re.M)
    rest = re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
    return fenced + [re.sub(r"^    ", "", block, flags=re.M) for block in re.findall(r"(?<=\n\n)(?:    .*\n)+", rest)]


def test_no_line_of_code_is_cut():
    for page in (DOCS.parent / "README.md", *PAGES):
        lines = [line for block in code_blocks(page.read_text(encoding="utf-8")) for line in block.splitlines()]
        assert not [line for line in lines if len(line) > WIDTH], page.name


def test_no_example_of_a_docstring_is_cut():
    for namespace in API.NAMESPACES:
        module = API.module_of(namespace)
        docs = [inspect.getdoc(getattr(module, name)) or "" for name in API.names(namespace)]
        blocks = [block for doc in docs for block in re.findall(r"^>>> (?:.+\n?)+", doc, flags=re.M)]  # and output
        lines = [line for block in blocks for line in block.splitlines()]
        assert not [line for line in lines if len(line) > WIDTH], namespace


def prose(page: Path) -> str:
    """Text of a page without code, equations, links and identifiers."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    text = re.sub(r"(?<=\n\n)(?:    .*\n)+", "", text)
    text = re.sub(r"`[^`]*`|\$\$.*?\$\$|\$[^$\n]*\$", "", text, flags=re.S)
    return re.sub(r"\]\([^)]*\)|(?:doi:|arXiv:|https?:)\S+|Phys\. Rev\. E \d+, \d+", "", text)


STYLE = {
    r"(?<![\d.,])\d{5,}(?![\d.])|\d[ \u202f]\d{3}\b|(?<![\d,.])\d,\d{3}(?![\d,])": "10,000, but 1000",
    r"10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]{2,}": "1e-6",
    r"\b\d+(?:\.\d+)?(?:mm|µm|km|ms|µs|GB|MB|[kMG]?Pa|Hz|%)(?!\w)": "5 MPa, 3 %",
}


def test_numbers_are_in_one_style():
    wrong = [
        f"{page.name}: {word}: write as in {rule}"
        for page in (DOCS.parent / "README.md", *PAGES)
        for pattern, rule in STYLE.items()
        for word in re.findall(pattern, prose(page))
    ]
    assert not wrong


def test_papers_have_their_authors_names():
    """Readers do not know numbers of papers; pages, help texts and titles say who wrote them and when."""
    root = DOCS.parent
    texts = (root / "README.md", *PAGES, *(root / "examples").glob("*.*"), *(root / "src").rglob("*.py*"))
    numbered = [
        f"{path.relative_to(root)}: {number}"
        for path in texts
        if path.suffix in (".md", ".py", ".pyi", ".toml")
        for number in re.findall(r"(?i)\bpapers?[ -]00\d", path.read_text(encoding="utf-8"))
    ]
    assert not numbered


def test_each_speed_stands_once():
    """Ratios to other codes are on the page of speeds; the README repeats its first one."""
    found = {}
    for page in (DOCS.parent / "README.md", *PAGES):
        keys = [key for *_, key in LINK.findall(page.read_text(encoding="utf-8"))]
        if keys := [key for key in keys if re.search("ratio to (LAMMPS|YADE)", key)]:
            found[str(page.relative_to(DOCS.parent))] = keys
    assert set(found) == {"README.md", "docs/performance.md"}
    assert found["README.md"] == found["docs/performance.md"][:1]


def test_the_comparison_denies_nothing_that_the_package_has():
    text = (DOCS / "about" / "comparison.md").read_text()
    denied = re.search(r"stickslip does not provide (.*?)\.\n\n", text, re.DOTALL)[1]
    assert denied and "state variable" not in denied and "posterior" not in denied
    assert {"b2", "dc2", "v1", "v2"} <= set(ss.friction.RateState._fields) and callable(ss.friction.posterior)
    assert ss.control.stress_controlled and "ranks" in ss.experiments.flow.FlowScenario.model_fields
