"""What a run rests on, as BibTeX: this package, the experiment's paper, laws, methods and libraries.

The package's own entry is made of CITATION.cff, which a wheel holds beside this file; all others stand in
`references.bib`, and are chosen here by their keys.
"""

import re
from pathlib import Path

from ..data.schema import Whole
from .registry import experiment_of, tables_of
from .registry import scenario as judged
from .sweep.definition import members, sweep

LIBRARIES = ("NumPy", "SciPy", "Numba", "h5py", "Matplotlib")
HERE, CFF = Path(__file__).parent, "CITATION.cff"


def bibtex(*scenarios: Whole) -> str:
    """BibTeX entries of what runs of scenarios rest on, in groups under a line of comment each.

    Examples
    --------
    >>> from .registry import scenario
    >>> "Charan2020" in bibtex(scenario())
    True
    """
    entries = _read_entries()
    parts = ["% the package\n" + package_entry()]
    groups: dict[str, dict] = {}
    for scenario in scenarios:
        for title, keys in reference_keys(scenario).items():
            groups.setdefault(title, {}).update(dict.fromkeys(keys))
    libraries = groups.pop("libraries", {})
    for title, keys in (groups | {"libraries": libraries}).items():
        parts.append(f"% {title}\n" + "\n\n".join(entries[key] for key in keys))
    return "\n\n".join(parts) + "\n"


def scenarios_of(path: Path) -> list[Whole]:
    """The scenario of a TOML file or of a folder of results; of a sweep those of all its members.

    Raises
    ------
    ScenarioError
        with one sentence, if there is none.
    """
    if path.is_dir():
        path = path / ("sweep.json" if (path / "sweep.json").exists() else "scenario.json")
    tables = tables_of(path)
    return [one.scenario for one in members(sweep(**tables))] if "sweep" in tables else [judged(**tables)]


def reference_keys(scenario: Whole) -> dict[str, tuple[str, ...]]:
    """Keys of references by what they are for; groups that would be empty are left out."""
    groups = experiment_of(scenario).references(scenario)
    groups["libraries"] = LIBRARIES + (("LAMMPS",) if getattr(scenario, "engine", "") == "lammps" else ())
    return {title: keys for title, keys in groups.items() if keys}


def _read_entries() -> dict[str, str]:
    """Entries of references.bib by key."""
    text = (HERE / "references.bib").read_text(encoding="utf-8")
    return {key: entry for entry, key in re.findall(r"(^@\w+\{(\w+),\n.*?^\})$", text, flags=re.M | re.S)}


def package_entry() -> str:
    """The package's own entry, from CITATION.cff."""
    about = _read_citation()
    fields = {
        "author": " and ".join(about["authors"]),
        "title": "{" + about["title"] + "}",
        "howpublished": "Python package",
        "note": f"Version {about['version']}, {about['license']}",
        "year": about["date-released"][:4],
    }
    fields |= {key: about[key] for key in ("doi", "url") if key in about}
    return "@misc{stickslip,\n" + "".join(f"  {k} = {{{v}}},\n" for k, v in fields.items()) + "}"


def _read_citation() -> dict:
    """What CITATION.cff says of the package: its plain entries, and authors as BibTeX writes them.

    A reader of the subset of YAML that the file uses: one entry a line, and a list of authors.
    """
    beside = HERE / CFF
    text = (beside if beside.exists() else HERE.parents[2] / CFF).read_text(encoding="utf-8")
    about = text.partition("\nreferences:")[0]
    found = {key: value.strip('"') for key, value in re.findall(r"^([\w-]+): (.+)$", about, flags=re.M)}
    people = re.findall(r"^  - (.+?)(?=^  - |^\S|\Z)", about, flags=re.M | re.S)
    found["authors"] = [_format_author(dict(re.findall(r'([\w-]+): "?([^"\n]+)"?', person))) for person in people]
    return found


def _format_author(person: dict) -> str:
    return f"{{{person['name']}}}" if "name" in person else f"{person['family-names']}, {person['given-names']}"
