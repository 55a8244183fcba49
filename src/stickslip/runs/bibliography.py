"""BibTeX entries to cite for a run: this package, the experiment's paper, laws, methods and libraries.

The package's own entry is built from CITATION.cff, which a wheel contains next to this file. All other entries are in
`references.bib` and are selected here by their keys.
"""

import re
from pathlib import Path

from ..data.schema import ScenarioBase
from ..experiments.registry import experiment_of, read_tables
from ..experiments.registry import scenario as make_scenario
from .sweep.definition import members, sweep

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


def read_scenarios(path: Path) -> list[ScenarioBase]:
    """Return the scenario of a TOML file or results folder, or the scenarios of all members of a sweep.

    Raises
    ------
    ScenarioError
        If there is none; the message is one sentence.
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


def _read_entries() -> dict[str, str]:
    """Return the entries of references.bib by key."""
    text = (HERE / "references.bib").read_text(encoding="utf-8")
    return {key: entry for entry, key in re.findall(r"(^@\w+\{(\w+),\n.*?^\})$", text, flags=re.M | re.S)}


def package_entry() -> str:
    """Return the package's own entry, built from CITATION.cff."""
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
    """Read the plain entries of CITATION.cff, and its authors in BibTeX format.

    Only the subset of YAML that the file uses is supported: one entry per line, and a list of authors.
    """
    bundled = HERE / CFF
    text = (bundled if bundled.exists() else HERE.parents[2] / CFF).read_text(encoding="utf-8")
    about = text.partition("\nreferences:")[0]
    entries = {key: value.strip('"') for key, value in re.findall(r"^([\w-]+): (.+)$", about, flags=re.M)}
    people = re.findall(r"^  - (.+?)(?=^  - |^\S|\Z)", about, flags=re.M | re.S)
    entries["authors"] = [_format_author(dict(re.findall(r'([\w-]+): "?([^"\n]+)"?', person))) for person in people]
    return entries


def _format_author(person: dict) -> str:
    return f"{{{person['name']}}}" if "name" in person else f"{person['family-names']}, {person['given-names']}"
