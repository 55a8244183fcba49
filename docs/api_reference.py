"""Write docs/api, one page for each public namespace, and adapt docstrings for Sphinx."""

import ast
import inspect
import re
import sys
import tokenize
from enum import Enum
from importlib import import_module
from io import StringIO
from operator import attrgetter
from pathlib import Path

from pydantic import BaseModel

import stickslip
from stickslip.words import public_names


def module_of(namespace: str):
    """Module of a namespace."""
    return stickslip if namespace == "stickslip" else attrgetter(namespace)(stickslip)


def with_modules(namespace: str) -> tuple[str, ...]:
    """A namespace and the modules among its names."""
    module = module_of(namespace)
    inner = [name for name in module.__all__ if inspect.ismodule(getattr(module, name))]
    return namespace, *(f"{namespace}.{name}" for name in inner)


NAMESPACES = (
    "stickslip", "laws", "packings", "control", "protocols", "measure", "modes", "quasirigid", "friction",
    *with_modules("experiments"), "io", *with_modules("figures"), "results", "ensemble", "examples",
)  # fmt: skip
for _namespace in NAMESPACES[1:]:  # Sphinx imports them by these names; modules of wings have others
    sys.modules.setdefault(f"stickslip.{_namespace}", module_of(_namespace))
LISTED = ("kit",)  # namespaces of internal names: a table, without their docstrings


def full(namespace: str) -> str:
    """Dotted name of a namespace."""
    return namespace if namespace == "stickslip" else f"stickslip.{namespace}"


def names(namespace: str) -> list[str]:
    """Public names of a namespace, without modules: functions, then classes, then constants."""
    module = module_of(namespace)
    things = {name: getattr(module, name) for name in sorted(public_names(module)) if name != "__version__"}

    def rank(name):
        return 1 if inspect.isclass(things[name]) else 0 if callable(things[name]) else 2

    return sorted((name for name, thing in things.items() if not inspect.ismodule(thing)), key=rank)


def _links() -> dict[str, str]:
    """Map public names that occur in exactly one namespace to their dotted names."""
    out, twice = {}, {"names", "path", "copy"}  # functions of `examples`; in text these words mean other things
    for namespace in NAMESPACES:
        for name in names(namespace):
            (twice.add(name) if name in out else None)
            out[name] = f"{full(namespace)}.{name}"
    return {name: where for name, where in out.items() if name not in twice}


PUBLIC = _links()


def write(folder: Path) -> None:
    """Write one page per namespace."""
    folder.mkdir(exist_ok=True)
    for namespace in (*NAMESPACES, *LISTED):
        path, text = folder / f"{namespace}.rst", page(namespace)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def page(namespace: str) -> str:
    """Page of a namespace: a table of its names from its docstring, then each of them."""
    title, head = f"``{full(namespace)}``", overview(namespace)[0][0]
    parts = [title, "=" * len(title), "", marked(head), ""]
    for text, rows in overview(namespace)[1:]:
        parts += [f".. rubric:: {marked(text)}" if rows else marked(text), ""] if text else []
        parts += table(namespace, rows) if rows else []
    return "\n".join(parts + [entry(namespace, name) for name in names(namespace) if namespace not in LISTED])


def overview(namespace: str) -> list[tuple[str, list[tuple[list[str], str]]]]:
    """Paragraphs of a namespace's docstring: text (the title of a table, if there are rows) and rows (names, words).

    A namespace whose docstring has one paragraph gets rows from the first lines of its names' docstrings; modules that
    a docstring does not list, as those of experiments, get theirs in any case.
    """
    module = module_of(namespace)
    out = []
    for paragraph in re.split(r"\n\s*\n", inspect.cleandoc(module.__doc__)):
        found = [re.fullmatch(r" *(\w+(?:, \w+)*) {2,}(\S.*)", line) for line in paragraph.splitlines()]
        rows = [(row[1].split(", "), row[2]) for row in found if row]
        text = " ".join(line for line, row in zip(paragraph.splitlines(), found, strict=True) if not row)
        if rows and not text and out and not out[-1][1]:  # figures: a title stands in a paragraph of its own
            text = out.pop()[0] if len(out) > 1 else ""
        out.append((text, rows))
    listed = {name for _, rows in out for row, _ in rows for name in row}
    modules = {name for name in public_names(module) if inspect.ismodule(getattr(module, name))} - listed
    if more := (names(namespace) if len(out) == 1 else []) + sorted(modules):
        firsts = [(name, inspect.getdoc(getattr(module, name)).split("\n")[0]) for name in more]
        out.append(("Modules" if listed else "", [([name], first.rstrip(".")) for name, first in firsts]))
    return out


def table(namespace: str, rows) -> list[str]:
    """List-table of names, which are links, and what they are."""
    out = [".. list-table::", "   :widths: 35 65", "   :width: 100%", ""]
    for linked, words in rows:
        out += [f"   * - {', '.join(link(namespace, name) for name in linked)}", f"     - {marked(words)}"]
    return [*out, ""]


def link(namespace: str, name: str) -> str:
    """Link to a public name, or to the page of a namespace if there is one."""
    if namespace in LISTED:
        return f":py:obj:`~{PUBLIC[name]}`" if name in PUBLIC else f"``{name}``"
    if not inspect.ismodule(getattr(module_of(namespace), name)):
        return f":py:obj:`~{full(namespace)}.{name}`"
    place = name if namespace == "stickslip" else f"{namespace}.{name}"
    return f":doc:`{name} <{place}>`" if place in NAMESPACES else f"``{name}``"


def entry(namespace: str, name: str) -> str:
    """Sphinx directive for a public name."""
    thing, where = getattr(module_of(namespace), name), f"{full(namespace)}.{name}"
    if inspect.isclass(thing):
        return f".. autoclass:: {where}\n   :members:\n" + ("   :undoc-members:\n" if is_enum(thing) else "")
    if callable(thing):
        return f".. autofunction:: {where}\n"
    value = "" if isinstance(thing, dict) else f"   :value: {thing!r}\n"
    return f".. py:data:: {where}\n{value}\n   {marked(above(namespace, name))}\n"


def is_enum(thing) -> bool:
    """Return True for enumerations."""
    return inspect.isclass(thing) and issubclass(thing, Enum)


def above(namespace: str, name: str) -> str:
    """Return the comment above or after a constant, where it is defined."""
    source = inspect.getsource(_source_module(full(namespace), name))
    found = re.search(rf"((?:^#.*\n)*)^[A-Z_, ]*\b{name}\b.* = [^#\n]*(#.*)?$", source, flags=re.M)
    return " ".join(line.strip("# ") for line in (found[1] + (found[2] or "")).splitlines()) if found else ""


def _source_module(place: str, name: str):
    """Module that defines a name, found by following imports and stubs."""
    module = import_module(place)
    path = Path(module.__file__)
    stub = path.with_suffix(".pyi")
    for node in ast.parse((stub if stub.exists() else path).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and name in [alias.asname or alias.name for alias in node.names]:
            package = place.split(".") if path.stem == "__init__" else place.split(".")[:-1]
            above = package[: len(package) - node.level + 1]
            return _source_module(".".join([*above, *filter(None, [node.module])]), name)
    return module


def fields(thing) -> list[str]:
    """List the fields of a NamedTuple with their comments."""
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
    """Turn names in single backticks into links if they are public, otherwise into code; escape RST markup."""

    def role(found):
        word = found[1]
        return f":py:obj:`~{PUBLIC[word]}`" if word in PUBLIC else f"``{word}``"

    text = re.sub(r"(?<![`:])`([^`\n]+)`(?!`)", role, text)
    return re.sub(r"(?<![\w\\`*|])\|(?=\S)", r"\\|", text)


def described(app, what, name, thing, options, lines) -> None:
    """Treat the text after the name of a parameter as a description, not as a type."""
    rules = [k for k, line in enumerate(lines) if line.strip() and set(line.strip()) == {"-"}]
    for k in reversed(rules):
        end = next((rule - 1 for rule in rules if rule > k), len(lines))
        if lines[k - 1].strip() == "Parameters":
            lines[k + 1 : end] = [part for line in lines[k + 1 : end] for part in _parted(line)]


def _parted(line: str) -> list[str]:
    """Split a line of a section into a name and its description; return other lines unchanged."""
    found = re.fullmatch(r"([\w*][\w*, ]*) : (.*)", line)
    return [found[1], f"    {found[2]}"] if found else [line]


def mend(app, what, name, thing, options, lines) -> None:
    """Adapt docstrings for Sphinx: links, literal equations, and fields of NamedTuples."""
    lines[:] = marked("\n".join(lines)).split("\n")
    for k in [k for k, line in enumerate(lines) if line.startswith(":type: ")]:  # text before a colon
        lines[:] = [f"{lines[k].removeprefix(':type: ')}: {lines[0]}", *lines[1:k], *lines[k + 1 :]]
    if what == "class" and issubclass(thing, tuple) and hasattr(thing, "_fields"):
        lines += ["", ".. rubric:: Fields", "", *fields(thing), ""]
    if what == "class" and issubclass(thing, BaseModel):
        page = thing.model_fields["experiment"].default
        lines += ["", f"Its keys: :doc:`/scenario/{page}`.", ""]


def short(app, what, name, thing, options, signature, back):
    """Omit signatures that would repeat the list of fields or of all tables of a scenario."""
    if what == "class" and (issubclass(thing, tuple | BaseModel | Enum) or is_enum(thing)):
        return "", None
    return None


def skip(app, what, name, thing, skipped, options):
    """Skip fields of NamedTuples, which are listed separately, and attributes added by pydantic."""
    if type(thing).__name__ == "_tuplegetter" or name.startswith("model_"):
        return True
    return None
