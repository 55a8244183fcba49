"""Lazy imports: the names in a package's stub (`__init__.pyi`) are imported on first use.

Type checkers and editors read the same stub, so that each name is listed once.
"""

import ast
import difflib
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path


def attach(package: str, file: str):
    """Return `__getattr__`, `__dir__` and `__all__` of a package, from the imports in its stub.

    Parameters
    ----------
    package, file : `__name__` and `__file__` of the package
    """
    where: dict[str, tuple[str, str]] = {}
    for node in ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            where |= {name.asname or name.name: (module, name.name) for name in node.names}

    def get(name: str):
        if name in where:
            module, inner = where[name]
            if module == ".":
                return import_module(f".{inner}", package)
            return getattr(import_module(module, package), inner)
        raise AttributeError(missing_attribute(package, name, where))

    return get, lambda: sorted(where), sorted(where)


def missing_attribute(package: str, name: str, known: dict[str, tuple[str, str]]) -> str:
    """Error message for a missing attribute, with the namespace that has it or the closest name."""
    if find_spec(f"{package}.{name}"):  # `from package import module` asks first, then imports the module
        return f"{package}.{name} is a module that was not imported: import {package}.{name}"
    spaces = [] if name.startswith("_") else [inner for module, inner in known.values() if module == "."]
    there = [f"{package}.{s}.{name}" for s in spaces if name in import_module(f".{s}", package).__all__]
    near = there or [f"{package}.{one}" for one in difflib.get_close_matches(name, known, n=1, cutoff=0.6)]
    hint = f"did you mean {near[0]}?" if near else f"see dir({package})"
    return f"{package} has no attribute {name!r}: {hint}"
