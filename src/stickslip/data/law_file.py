"""Contact laws from Python files that scenarios name.

A law file is a program, and scenarios come from anywhere. Reading a scenario therefore executes nothing: it stores the
checksum of the file's text, so that a resumed run notices a change. The file is executed when a run builds its law, and
only if this user has allowed this text. Digests of allowed texts are in the user's cache folder, where the author of a
scenario cannot write.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path

from pydantic import Field, model_serializer, model_validator

from ..core.laws.builtin import Law
from ..core.laws.compiled import FORCES, law_struct
from ..core.laws.user import from_text
from ..core.text import read_text
from ..extras import cache_folder
from .schema import Finite, ScenarioError, ScenarioTable, validate_scenario

TRUSTED = "trusted_laws.txt"  # in the user's cache folder: the SHA-256 of every text that may be executed


class LawOrFile(ScenarioTable):
    """Law table that may name a file, if it has the keys of `LawFile`."""

    @model_validator(mode="before")
    @classmethod
    def _of_a_file(cls, given):
        if "file" not in cls.model_fields:
            return given
        if not isinstance(given, dict) or given.get("file") is None:
            if isinstance(given, dict) and {"parameters", "checksum"} & set(given):
                raise ValueError("law.parameters was given without law.file: name the file, or give kn, kt, mu …")
            return given
        others = [name for name in given if name not in ("file", "parameters", "checksum", "wall")]
        if others:
            raise ValueError(
                f"law.file and law.{others[0]} were both given: set parameters of the file in law.parameters"
            )
        return _with_checksum(given)

    @model_serializer(mode="wrap")
    def _serialise_given_fields(self, handler):
        """Omit fields that were not given; a scenario without a file keeps the text and digest of earlier versions."""
        out = handler(self)
        if self.file is None:
            return {k: v for k, v in out.items() if k not in LawFile.model_fields}
        return {k: v for k, v in out.items() if k in (*LawFile.model_fields, "wall")}


class LawFile(LawOrFile):
    """A law in a user's Python file, instead of a kind and its parameters."""

    file: str | None = Field(
        None,
        description="Python file with a contact law; the path is relative to the scenario, and a run executes the file "
        "if `--trust` has allowed it",
    )
    parameters: dict[str, Finite] = Field({}, description="of the law in the file, if different from those in the file")
    checksum: str | None = Field(None, description="of the file's text; added automatically")


def _read(path: Path) -> str:
    if not path.is_file():
        raise ScenarioError(f"law.file = {path} is not a file: give a Python file with a function normal_force")
    return read_text(path, remedy="give a Python file")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _checksum(text: str) -> str:
    return _digest(text)[:16]


def _with_checksum(law: dict) -> dict:
    """Table of a law with the checksum of its file, if there is a file and the checksum is missing."""
    if not isinstance(law.get("file"), str) or "checksum" in law:
        return law
    path = Path(law["file"]).absolute()
    return law | {"file": str(path), "checksum": _checksum(_read(path))}


def with_laws(tables: dict, change: Callable[[dict], dict]) -> dict:
    """Tables of a scenario with every table `law` changed, whether at the top or in a table `sample`."""
    out = dict(tables)
    if isinstance(tables.get("law"), dict):
        out["law"] = change(tables["law"])
    if isinstance(tables.get("sample"), dict):
        out["sample"] = with_laws(tables["sample"], change)
    return out


def with_checksums(tables: dict) -> dict:
    """Add the checksums of law files to the tables of a scenario; nothing is executed."""
    return with_laws(tables, _with_checksum)


def trust_law_files(tables: dict) -> None:
    """Allow this user's runs to execute the present texts of the law files that a scenario names."""

    def trust(law: dict) -> dict:
        if isinstance(law.get("file"), str) and not _is_trusted(text := _read(Path(law["file"]))):
            with (cache_folder() / TRUSTED).open("a", encoding="ascii") as file:
                file.write(f"{_digest(text)}\n")
        return law

    with_laws(with_checksums(tables), trust)


def _is_trusted(text: str) -> bool:
    path = cache_folder() / TRUSTED
    return path.is_file() and _digest(text) in path.read_text(encoding="ascii", errors="replace").split()


def check_law_files(tables: dict) -> None:
    """Build and compile the laws that a scenario names, before anything is written.

    Raises
    ------
    ScenarioError
        as `load_law`; ValueError as `laws.from_file`.
    """

    def check(law: dict) -> dict:
        if law.get("file") is not None:
            choice = {k: v for k, v in law.items() if k in LawFile.model_fields}
            law_struct(load_law(validate_scenario(LawFile, **choice)), members=FORCES)
        return law

    with_laws(tables, check)


def load_law(choice: LawFile) -> Law:
    """Load the law from the file that a scenario names.

    Raises
    ------
    ScenarioError
        if the file is missing, has changed since the scenario was read, or may not be executed.
    """
    path = Path(choice.file)
    if not path.is_file():
        raise ScenarioError(f"law.file = {choice.file} no longer exists: restore it, or name another file")
    text = _read(path)
    if _checksum(text) != choice.checksum:
        raise ScenarioError(f"law.file = {choice.file} has changed since the run began: restore it, or start a new run")
    if not _is_trusted(text):
        raise ScenarioError(
            f"law.file = {choice.file} is a Python program that you have not allowed to run: read it, then add --trust "
            f"(in Python, trust=True)"
        )
    return from_text(text, path, choice.parameters)
