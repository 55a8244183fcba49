"""What a run rests on, as BibTeX: this package, the experiment's paper, laws, methods and libraries.

The package's own entry is made of CITATION.cff, which a wheel holds beside this file; all others stand in
`references.bib`, and are chosen here by their keys.
"""

import re
from pathlib import Path

from .flow_scenario import FlowScenario
from .gouge_scenario import GougeScenario
from .parts import Whole
from .quasi_scenario import QuasiScenario
from .ratestate_scenario import RateStateScenario
from .scenario import Scenario, ShearScenario, tables_of
from .scenario import scenario as judged
from .sweep import members, sweep

LIBRARIES = ("NumPy", "SciPy", "Numba", "h5py", "Matplotlib")
CONTACT = {
    "hertz_mindlin": ("Hertz1882", "Mindlin1949", "Cundall1979"),
    "hertz_mindlin_reff": ("Hertz1882", "Mindlin1953", "Silbert2001"),
    "linear": ("Cundall1979",),
}
CONTACT |= {f"{name}_rescaled": (*CONTACT[name], "LAMMPS") for name in ("hertz_mindlin", "hertz_mindlin_reff")}
STATE = {"aging": ("Dieterich1979", "Ruina1983"), "slip": ("Ruina1983",)}
HERE, CFF = Path(__file__).parent, "CITATION.cff"


def bibtex(*scenarios: Whole) -> str:
    """BibTeX entries of what runs of scenarios rest on, in groups under a line of comment each.

    Examples
    --------
    >>> from .scenario import scenario
    >>> "Charan2020" in bibtex(scenario())
    True
    """
    entries = _entries()
    parts = ["% the package\n" + software()]
    groups: dict[str, dict] = {}
    for scenario in scenarios:
        for title, keys in rests_on(scenario).items():
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


def rests_on(scenario: Whole) -> dict[str, tuple[str, ...]]:
    """Keys of references by what they are for; groups that would be empty are left out."""
    groups = _GROUPS[type(scenario)](scenario)
    groups["libraries"] = LIBRARIES + (("LAMMPS",) if getattr(scenario, "engine", "") == "lammps" else ())
    return {title: keys for title, keys in groups.items() if keys}


def _contact(law) -> tuple[str, ...]:
    """Sources of a built-in law; those of a law in a file are its author's to name."""
    return CONTACT[law.kind] if law.file is None else ()


def _array(scenario: Scenario) -> dict:
    return {"the experiment (paper 000)": ("Charan2020",), "contact law": _contact(scenario.law)}


def _sheared(scenario: ShearScenario) -> dict:
    return {"the experiment (paper 001)": ("Bonfanti2020",), "contact law": _contact(scenario.law)}


def _quasi_rigid(scenario: QuasiScenario) -> dict:
    return {"the experiment and its method (paper 002)": ("McNamara2006",), "contact law": CONTACT["linear"]}


def _gouge(scenario: GougeScenario) -> dict:
    return {
        "the experiment (paper 003 is the supplement of the first)": ("Ferdowsi2021", "Ferdowsi2020"),
        "contact law": CONTACT["hertz_mindlin_reff"],
        "rate-and-state friction, with which it is compared": STATE["aging"],
    }


def _flow(scenario: FlowScenario) -> dict:
    law = scenario.law
    dashpots = law.damping or ("viscoelastic" if law.kind.startswith("hertz_mindlin_reff") else "mass_velocity")
    damped = law.restitution is not None or law.damping_n or law.damping_t
    more = ("Silbert2001",) if damped and dashpots != "velocity" else ()
    contact = _contact(law)
    return {
        "contact law": contact + tuple(key for key in more if key not in contact),
        "inertial number of plane shear": ("GDRMiDi2004",) if scenario.plates else (),
    }


def _slider(scenario: RateStateScenario) -> dict:
    surface = scenario.surface
    more = ("Linker1992",) if surface.alpha else ()
    return {"rate-and-state friction": STATE[surface.law] + more}


_GROUPS = {
    Scenario: _array, ShearScenario: _sheared, QuasiScenario: _quasi_rigid, GougeScenario: _gouge,
    FlowScenario: _flow, RateStateScenario: _slider,
}  # fmt: skip


def _entries() -> dict[str, str]:
    """Entries of references.bib by key."""
    text = (HERE / "references.bib").read_text(encoding="utf-8")
    return {key: entry for entry, key in re.findall(r"(^@\w+\{(\w+),\n.*?^\})$", text, flags=re.M | re.S)}


def software() -> str:
    """The package's own entry, from CITATION.cff."""
    about = _citation()
    fields = {
        "author": " and ".join(about["authors"]),
        "title": "{" + about["title"] + "}",
        "howpublished": "Python package",
        "note": f"Version {about['version']}, {about['license']}",
        "year": about["date-released"][:4],
    }
    fields |= {key: about[key] for key in ("doi", "url") if key in about}
    return "@misc{stickslip,\n" + "".join(f"  {k} = {{{v}}},\n" for k, v in fields.items()) + "}"


def _citation() -> dict:
    """What CITATION.cff says of the package: its plain entries, and authors as BibTeX writes them.

    A reader of the subset of YAML that the file uses: one entry a line, and a list of authors.
    """
    beside = HERE / CFF
    text = (beside if beside.exists() else HERE.parents[2] / CFF).read_text(encoding="utf-8")
    about = text.partition("\nreferences:")[0]
    found = {key: value.strip('"') for key, value in re.findall(r"^([\w-]+): (.+)$", about, flags=re.M)}
    people = re.findall(r"^  - (.+?)(?=^  - |^\S|\Z)", about, flags=re.M | re.S)
    found["authors"] = [_name(dict(re.findall(r'([\w-]+): "?([^"\n]+)"?', person))) for person in people]
    return found


def _name(person: dict) -> str:
    return f"{{{person['name']}}}" if "name" in person else f"{person['family-names']}, {person['given-names']}"
