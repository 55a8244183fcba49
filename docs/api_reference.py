"""Writes docs/api: the public names of stickslip, room by room, and mends docstrings for Sphinx."""

import ast
import inspect
import re
import tokenize
from enum import Enum
from importlib import import_module
from io import StringIO
from pathlib import Path

from pydantic import BaseModel

import stickslip

ROOMS = {
    "core": "Grains, contacts, laws, forces, dynamics",
    "solve": "Equilibrium and stability",
    "quasirigid": "Quasi-rigidity: contact status, load paths",
    "loading": "Samples and what is done to them",
    "friction": "Rate-and-state friction",
    "data": "Scenarios, files, exchange",
    "ensemble": "Many runs at once",
    "experiments": "Sweeps",
}
PUBLIC = {name: where for name, where in stickslip._ROOM.items() if name in stickslip.__all__}


def write(folder: Path) -> None:
    """One page for every room."""
    folder.mkdir(exist_ok=True)
    for place in dict.fromkeys(where.partition(".")[0] for where in PUBLIC.values()):
        path, text = folder / f"{place}.rst", page(place)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def page(place: str) -> str:
    """Modules of a room with their first sentence, and their public names."""
    title = f"{ROOMS.get(place, place)}: ``{place}``"
    parts = [title, "=" * len(title), ".. py:currentmodule:: stickslip", ""]
    for module in (where for where in stickslip._WHERE if where.partition(".")[0] == place):
        head = module.partition(".")[2] or module
        said = import_module(f"stickslip.{module}").__doc__ or ""
        parts += [f"``{head}``", "-" * (len(head) + 4), "", marked(said.split("\n\n")[0].replace("\n", " ")), ""]
        parts += [entry(name) for name, where in PUBLIC.items() if where == module]
    return "\n".join(parts)


def entry(name: str) -> str:
    """What Sphinx is to document of a public name."""
    thing = getattr(stickslip, name)
    if inspect.isclass(thing):
        return f".. autoclass:: stickslip.{name}\n   :members:\n" + ("   :undoc-members:\n" if is_enum(thing) else "")
    if callable(thing):
        return f".. autofunction:: stickslip.{name}\n"
    return f".. py:data:: {name}\n   :value: {thing!r}\n\n   {marked(above(name))}\n"


def is_enum(thing) -> bool:
    """Whether members are values."""
    return inspect.isclass(thing) and issubclass(thing, Enum)


def above(name: str) -> str:
    """The comment at a constant."""
    source = inspect.getsource(import_module(f"stickslip.{PUBLIC[name]}"))
    found = re.search(rf"((?:^#.*\n)*)^[A-Z, ]*\b{name}\b.* = [^#\n]*(#.*)?$", source, flags=re.M)
    return " ".join(line.strip("# ") for line in (found[1] + (found[2] or "")).splitlines()) if found else ""


def fields(thing) -> list[str]:
    """The fields of a NamedTuple with the comments that stand beside them, as a list."""
    try:
        source = inspect.cleandoc("\n" + inspect.getsource(thing))
    except (OSError, TypeError):
        return []
    comments = {
        token.start[0]: token.string.strip("# ")
        for token in tokenize.generate_tokens(StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    out = []
    for node in ast.parse(source).body[0].body:
        if isinstance(node, ast.AnnAssign) and not node.target.id.startswith("_"):
            words = next((comments[k] for k in range(node.lineno, node.end_lineno + 1) if k in comments), "")
            kind = ast.unparse(node.annotation).replace("np.ndarray", "array").strip("'\"")
            out.append(f"* **{node.target.id}** (*{kind}*)" + (f": {marked(words)}" if words else ""))
    return out


def marked(text: str) -> str:
    """Names in single backticks become links if they are public, else code; what RST would take as markup is kept."""

    def role(found):
        word = found[1]
        return f":py:obj:`~stickslip.{word}`" if word in PUBLIC else f"``{word}``"

    text = re.sub(r"(?<![`:])`([^`\n]+)`(?!`)", role, text)
    return re.sub(r"(?<![\w\\`*|])\|(?=\S)", r"\\|", text)


def described(app, what, name, thing, options, lines) -> None:
    """What follows the name of a parameter is a description in this house, not a type."""
    rules = [k for k, line in enumerate(lines) if line.strip() and set(line.strip()) == {"-"}]
    for k in reversed(rules):
        end = next((rule - 1 for rule in rules if rule > k), len(lines))
        if lines[k - 1].strip() == "Parameters":
            lines[k + 1 : end] = [part for line in lines[k + 1 : end] for part in _parted(line)]


def _parted(line: str) -> list[str]:
    """A line of a section as it is, or a name and its description below it."""
    found = re.fullmatch(r"([\w*][\w*, ]*) : (.*)", line)
    return [found[1], f"    {found[2]}"] if found else [line]


def mend(app, what, name, thing, options, lines) -> None:
    """Docstrings as Sphinx reads them: links, literal equations, and fields of NamedTuples."""
    lines[:] = marked("\n".join(lines)).split("\n")
    for k in [k for k, line in enumerate(lines) if line.startswith(":type: ")]:  # what stood before a colon
        lines[:] = [f"{lines[k].removeprefix(':type: ')}: {lines[0]}", *lines[1:k], *lines[k + 1 :]]
    if what == "class" and issubclass(thing, tuple) and hasattr(thing, "_fields"):
        lines += ["", ".. rubric:: Fields", "", *fields(thing), ""]
    if what == "class" and issubclass(thing, BaseModel):
        page = thing.model_fields["experiment"].default
        lines += ["", f"Its keys: :doc:`/scenario/{page}`.", ""]


def short(app, what, name, thing, options, signature, back):
    """No signature where it would be a list of fields that stands below, or of all tables of a scenario."""
    if what == "class" and (issubclass(thing, tuple | BaseModel | Enum) or is_enum(thing)):
        return "", None
    return None


def skip(app, what, name, thing, skipped, options):
    """Leave out what says nothing: fields of NamedTuples, which stand in a list, and what pydantic adds."""
    if type(thing).__name__ == "_tuplegetter" or name.startswith("model_"):
        return True
    return None
