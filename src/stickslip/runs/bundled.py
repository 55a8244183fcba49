"""Files that come with the package: examples, pages of documentation, and BibTeX entries to cite for a run.

The package's own entry is built from CITATION.cff, which a wheel contains next to this file. All other entries are in
`references.bib` and are selected here by their keys.
"""

import re
import shutil
from difflib import get_close_matches
from itertools import takewhile
from pathlib import Path

from ..core.arguments import checked
from ..core.laws.builtin import Law
from ..core.state import State
from ..data.run_files import check_free
from ..data.schema import ScenarioBase
from ..experiments.registry import EXPERIMENTS, experiment_of, read_scenario, read_tables
from ..experiments.registry import scenario as make_scenario
from ..loading.reading import read_packing
from ..wing import wings
from .sweep.definition import members, sweep


def _bundled_folder(name: str) -> Path:
    """Folder of bundled files, in a wheel or a clone."""
    installed = Path(__file__).parents[1] / f"_{name}"
    return installed if installed.is_dir() else Path(__file__).parents[3] / name


FOLDER, PAGES = _bundled_folder("examples"), _bundled_folder("docs")
_WITHOUT_TEXT = {
    "lecture.ipynb": "A notebook for a lecture hour, with exercises: press and shear a packing until a pair is born",
    "wing": "A wing, a package that adds an experiment to `stickslip run` when it is installed",
    "sheared": "Output of LAMMPS for shear.lammps: 27 grains, three frames, for `stickslip watch`",
    "sheared_spheres.npz": "Fifty spheres, sheared until a complex pair exists, with the slip of every contact",
}


def headings() -> dict[str, str]:
    """Return the headings of each page of documentation."""
    return {name: " ".join(re.findall(r"^#+ (.*)$", text, re.M)) for name, text in _texts().items()}


def names() -> dict[str, str]:
    """Return the names of all examples, each with a description.

    Examples
    --------
    >>> names()["column_collapse.toml"]
    'Collapse of a column of disks when a gate is removed'
    """
    files = sorted(entry.name for entry in FOLDER.iterdir() if not entry.name.startswith(("_", ".")))
    found = {}
    for name in files:  # described by the first sentence of the comment or docstring at its beginning
        lines = () if name in _WITHOUT_TEXT else (FOLDER / name).read_text(encoding="utf-8").splitlines()
        comment = " ".join(takewhile(bool, (line.strip('#" ') for line in lines)))
        found[name] = _WITHOUT_TEXT.get(name) or comment.split("  ")[0].split(". ")[0].rstrip(".:")
    return found


@checked
def path(name: str) -> Path:
    """Return the path of an example; the extension may be left out if there is only one example with this name.

    Raises
    ------
    ValueError
        If there is no such example; the message lists them.
    """
    examples = names()
    matches = [example for example in examples if name in (example, example.partition(".")[0])]
    if name in examples or len(matches) == 1:
        return FOLDER / (name if name in examples else matches[0])
    raise ValueError(f"there is no example {name!r}: use {', '.join(matches or examples)}")


@checked
def packing(name: str = "sheared_spheres.npz") -> tuple[State, Law]:
    """Return the packing of an example and its law.

    Examples
    --------
    >>> state, law = packing()
    >>> state.grains.radius.shape
    (50,)
    """
    state, law, _ = read_packing(path(name))
    return state, law


@checked
def scenario(name: str) -> ScenarioBase:
    """Return the scenario of an example, for `ss.simulate`.

    Examples
    --------
    >>> scenario("rate_state").experiment
    'rate-state'
    """
    return read_scenario(path(name if "." in name else f"{name}.toml"))


@checked
def copy(*chosen: str, to: str | Path = "examples", overwrite: bool = False) -> list[Path]:
    """Copy examples, by default all of them, into a folder, which is created if needed; return the paths of the copies.

    Raises
    ------
    ValueError
        If there is no such example, or a file of this name exists there and `overwrite` is False; nothing is copied.
    """
    sources = [path(name) for name in chosen or names()]
    found = [file for source in sources for file in (sorted(source.rglob("*")) if source.is_dir() else [source])]
    files = [file for file in found if file.is_file() and "__pycache__" not in file.parts]
    targets = [Path(to) / file.relative_to(FOLDER) for file in files]
    if (taken := Path(to)).exists() and not taken.is_dir():
        raise ValueError(f"{to} is a file: give a folder")
    check_free(targets, overwrite=overwrite, made_from=files)
    for source, target in zip(files, targets, strict=True):
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    return targets


def pages() -> dict[str, str]:
    """Return the names of all installed pages of documentation, each with its title."""
    return {name: f"\n{text}".partition("\n# ")[2].partition("\n")[0] for name, text in _texts().items()}


def _texts() -> dict[str, str]:
    """Texts of all installed pages; characters that are not UTF-8, in pages of other packages, are replaced."""
    return {name: file.read_text(encoding="utf-8", errors="replace") for name, file in _pages().items()}


def _pages() -> dict[str, Path]:
    """Files of the documentation pages of this package and of installed wings, by name."""
    files = sorted([*PAGES.glob("*.md"), *PAGES.glob("[!_]*/**/*.md")])
    names = [file.relative_to(PAGES).with_suffix("").as_posix() for file in files if file.name != "README.md"]
    wing_pages = [(name, folder) for wing in wings().values() for folder in wing.folders() for name in wing.pages]
    wing_pages = [
        (name, folder) for name, folder in wing_pages if name not in names and (folder / f"{name}.md").is_file()
    ]
    return {name: folder / f"{name}.md" for name, folder in [*((name, PAGES) for name in names), *wing_pages]}


@checked
def page(name: str) -> str:
    """Return a page of documentation as Markdown; the last part of its name suffices if unique.

    Raises
    ------
    ValueError
        If there is no such page; the message lists pages with similar names.
    """
    installed = _pages()
    meant = [name] if name in installed else [key for key in installed if key.rpartition("/")[2] == name]
    if len(meant) != 1:
        wing, _ = EXPERIMENTS.entries().get(name.removeprefix("scenario/"), (None, None))
        if wing and not installed.keys() & set(wing.pages):
            raise ValueError(f"there is no page {name!r}: the package of this experiment, {wing.package}, has no pages")
        near = (
            [key for key in (wing.pages if wing else ()) if key in installed]
            or [key for key in installed if name.rpartition("/")[2] in key]
            or get_close_matches(name, installed, 3)
            or installed
        )
        raise ValueError(f"there is no page {name!r}: use {', '.join(near)}")
    return installed[meant[0]].read_text(encoding="utf-8", errors="replace")


LIBRARIES = ("NumPy", "SciPy", "Numba", "h5py", "Matplotlib")
HERE, CFF = Path(__file__).parent, "CITATION.cff"


def bibtex(*scenarios: ScenarioBase) -> str:
    """Return the BibTeX entries to cite for runs of scenarios, in groups that each start with a comment line.

    Examples
    --------
    >>> from stickslip.experiments.registry import scenario
    >>> "Charan2020" in bibtex(scenario())
    True
    """
    text = (HERE / "references.bib").read_text(encoding="utf-8")
    entries = {key: entry for entry, key in re.findall(r"(^@\w+\{(\w+),\n.*?^\})$", text, flags=re.M | re.S)}
    parts = ["% the package\n" + package_entry()]
    groups: dict[str, dict] = {}
    for scenario in scenarios:
        for title, keys in reference_keys(scenario).items():
            groups.setdefault(title, {}).update(dict.fromkeys(keys))
    libraries = groups.pop("libraries", {})
    for title, keys in (groups | {"libraries": libraries}).items():
        parts.append(f"% {title}\n" + "\n\n".join(entries[key] for key in keys))
    return "\n\n".join(parts) + "\n"


def read_scenarios(path: Path) -> list[ScenarioBase]:
    """Return the scenario of a TOML file or results folder, or the scenarios of all members of a sweep.

    Raises
    ------
    ScenarioError
        If there is no scenario.
    """
    if path.is_dir():
        path = path / ("sweep.json" if (path / "sweep.json").exists() else "scenario.json")
    tables = read_tables(path)
    return [member.scenario for member in members(sweep(**tables))] if "sweep" in tables else [make_scenario(**tables)]


def reference_keys(scenario: ScenarioBase) -> dict[str, tuple[str, ...]]:
    """Return reference keys grouped by purpose, without empty groups."""
    groups = experiment_of(scenario).references(scenario)
    groups["libraries"] = LIBRARIES + (("LAMMPS",) if getattr(scenario, "engine", "") == "lammps" else ())
    return {title: keys for title, keys in groups.items() if keys}


def package_entry() -> str:
    """Return the package's own entry, built from CITATION.cff.

    Only the subset of YAML that this file uses is supported: one entry per line, and a list of authors.
    """
    bundled = HERE / CFF
    text = (bundled if bundled.exists() else HERE.parents[2] / CFF).read_text(encoding="utf-8")
    text = text.partition("\nreferences:")[0]
    about = {key: value.strip('"') for key, value in re.findall(r"^([\w-]+): (.+)$", text, flags=re.M)}
    people = re.findall(r"^  - (.+?)(?=^  - |^\S|\Z)", text, flags=re.M | re.S)
    people = [dict(re.findall(r'([\w-]+): "?([^"\n]+)"?', person)) for person in people]
    authors = [
        f"{{{one['name']}}}" if "name" in one else f"{one['family-names']}, {one['given-names']}" for one in people
    ]
    fields = {
        "author": " and ".join(authors),
        "title": "{" + about["title"] + "}",
        "howpublished": "Python package",
        "note": f"Version {about['version']}, {about['license']}",
        "year": about["date-released"][:4],
    }
    fields |= {key: about[key] for key in ("doi", "url") if key in about}
    return "@misc{stickslip,\n" + "".join(f"  {k} = {{{v}}},\n" for k, v in fields.items()) + "}"
