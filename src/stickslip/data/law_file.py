"""Contact laws that a user's own Python file holds: named in a scenario or on the command line, and run there only.

A scenario that was written by hand is given the checksum of the file's text when it is read, and the law is made and
judged at once. A scenario that carries a checksum was written by this package: reading it runs nothing, and a run, or
one that goes on, takes the file only if its text is the same.
"""

import hashlib
from pathlib import Path

from pydantic import Field, model_serializer, model_validator

from ..core.laws.builtin import Law, with_values
from ..core.laws.user import from_file
from .schema import Finite, Part, ScenarioError


class LawFile(Part):
    """A law in a Python file of the user's, in place of a kind and its parameters."""

    file: str | None = Field(None, description="Python file with a contact law, from the scenario's folder; it is run")
    parameters: dict[str, Finite] = Field({}, description="of the law in the file, where they are not as there")
    checksum: str | None = Field(None, description="of the file's text; left out by people")

    @model_validator(mode="before")
    @classmethod
    def _of_a_file(cls, given):
        if not isinstance(given, dict) or given.get("file") is None:
            if isinstance(given, dict) and {"parameters", "checksum"} & set(given):
                raise ValueError("law.parameters was given without law.file: name the file, or give kn, kt, mu …")
            return given
        others = [name for name in given if name not in ("file", "parameters", "checksum", "wall")]
        if others:
            raise ValueError(
                f"law.file and law.{others[0]} were both given: what is in the file is changed by law.parameters"
            )
        if "checksum" in given or not isinstance(given["file"], str):
            return given
        path, parameters = Path(given["file"]).absolute(), given.get("parameters", {})
        if not isinstance(parameters, dict):
            raise ValueError("law.parameters is no table: give numbers by name")
        from_file(path, **parameters)
        return given | {"file": str(path), "checksum": _checksum(path)}

    @model_serializer(mode="wrap")
    def _without_what_is_not_given(self, handler):
        """Scenarios without a file have the text, and the digest, that they had before there were files."""
        out = handler(self)
        if self.file is None:
            return {k: v for k, v in out.items() if k not in LawFile.model_fields}
        return {k: v for k, v in out.items() if k in (*LawFile.model_fields, "wall")}


def _checksum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def sealed(tables: dict) -> dict:
    """Tables written by hand, in which a law's file gets its checksum; the law is made and judged at once."""
    law = tables.get("law")
    if not isinstance(law, dict) or not isinstance(law.get("file"), str) or "checksum" in law:
        return tables
    path = Path(law["file"]).absolute()
    from_file(path)
    return tables | {"law": law | {"file": str(path), "checksum": _checksum(path)}}


def check_sealed(tables: dict, path: Path) -> None:
    """Raise ScenarioError if text that a run is said to have left names a law's file without its checksum."""
    law = tables.get("law")
    if isinstance(law, dict) and law.get("file") is not None and "checksum" not in law:
        raise ScenarioError(
            f"{path} names law.file = {law['file']} without its checksum, which every run writes: it would be run "
            f"unseen; give a scenario in TOML that names it"
        )


def law_in(choice: LawFile) -> Law:
    """The law of the file that a scenario names; ScenarioError if the file is not the one that was named."""
    path = Path(choice.file)
    if not path.is_file():
        raise ScenarioError(f"law.file = {choice.file} is not there any more: put it back, or name another")
    if _checksum(path) != choice.checksum:
        raise ScenarioError(f"law.file = {choice.file} has changed since the run began: put it back, or run anew")
    return from_file(path, **choice.parameters)


def split_law_options(path: str, given: dict) -> tuple[Law, dict]:
    """The law of a file that was named on the command line, and the options that are not parameters of it."""
    law = from_file(path)
    values = {name: given[name] for name in ("kn", "kt", "mu", "damping_n", "damping_t") if name in given}
    return with_values(law, **values), {name: value for name, value in given.items() if name not in values}
