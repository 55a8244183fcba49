"""Contact laws from a user's Python file, which is executed only if a scenario or the command line names it.

When a scenario written by hand is read, the checksum of the file's text is added to it, and the law is built and
validated immediately. A scenario that has a checksum was written by this package: reading it executes nothing, and a
run, new or resumed, uses the file only if its text is unchanged.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path

from pydantic import Field, model_serializer, model_validator

from ..core.laws.builtin import Law
from ..core.laws.user import from_file
from .schema import Finite, ScenarioError, ScenarioTable


class LawFile(ScenarioTable):
    """A law in a user's Python file, instead of a kind and its parameters."""

    file: str | None = Field(
        None, description="Python file with a contact law; the path is relative to the scenario, and the file is run"
    )
    parameters: dict[str, Finite] = Field({}, description="of the law in the file, if different from those in the file")
    checksum: str | None = Field(None, description="of the file's text; added automatically")

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
                f"law.file and law.{others[0]} were both given: set parameters of the file in law.parameters"
            )
        if "checksum" in given or not isinstance(given["file"], str):
            return given
        path, parameters = Path(given["file"]).absolute(), given.get("parameters", {})
        if not isinstance(parameters, dict):
            raise ValueError("law.parameters is not a table: give numbers by name")
        from_file(path, **parameters)
        return given | {"file": str(path), "checksum": _checksum(path)}

    @model_serializer(mode="wrap")
    def _serialise_given_fields(self, handler):
        """Omit fields that were not given; a scenario without a file keeps the text and digest of earlier versions."""
        out = handler(self)
        if self.file is None:
            return {k: v for k, v in out.items() if k not in LawFile.model_fields}
        return {k: v for k, v in out.items() if k in (*LawFile.model_fields, "wall")}


def _checksum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def with_laws(tables: dict, change: Callable[[dict], dict]) -> dict:
    """Tables of a scenario with every table `law` changed, whether at the top or in a table `sample`."""
    out = dict(tables)
    if isinstance(tables.get("law"), dict):
        out["law"] = change(tables["law"])
    if isinstance(tables.get("sample"), dict):
        out["sample"] = with_laws(tables["sample"], change)
    return out


def with_checksum(tables: dict) -> dict:
    """Add the checksum of a law's file to tables written by hand; the law is built and validated immediately."""

    def add(law: dict) -> dict:
        if not isinstance(law.get("file"), str) or "checksum" in law:
            return law
        path = Path(law["file"]).absolute()
        from_file(path)
        return law | {"file": str(path), "checksum": _checksum(path)}

    return with_laws(tables, add)


def require_checksum(tables: dict, path: Path) -> None:
    """Raise ScenarioError if the scenario of an earlier run names a law's file without its checksum."""

    def check(law: dict) -> dict:
        if law.get("file") is not None and "checksum" not in law:
            raise ScenarioError(
                f"{path} names law.file = {law['file']} without the checksum that every run writes, so the file is "
                f"not run: name it in a scenario in TOML"
            )
        return law

    with_laws(tables, check)


def load_law(choice: LawFile) -> Law:
    """Load the law from the file that a scenario names; ScenarioError if the file is missing or has changed."""
    path = Path(choice.file)
    if not path.is_file():
        raise ScenarioError(f"law.file = {choice.file} no longer exists: restore it, or name another file")
    if _checksum(path) != choice.checksum:
        raise ScenarioError(f"law.file = {choice.file} has changed since the run began: restore it, or start a new run")
    return from_file(path, **choice.parameters)
