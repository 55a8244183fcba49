"""Lazy imports: the names in a stub (`.pyi`) of a package or a namespace are imported on first use.

Type checkers and editors read the same stub, so each name is listed once.
"""

import ast
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import PathFinder
from importlib.util import find_spec, spec_from_loader
from pathlib import Path


def attach(package: str, file: str, more: Callable[[], Mapping[str, str]] = dict):
    """Return `__getattr__`, `__dir__` and `__all__` of a package or a module, from the imports in its stub.

    Parameters
    ----------
    package, file : `__name__` and `__file__` of the package or module
    more : function that returns further public names, each with the path of the module that it denotes; `__all__` is
        then left to `__getattr__`
    """
    if more is not dict:
        sys.meta_path.insert(0, _ByPublicName(package, more))
    above = package if Path(file).stem == "__init__" else package.rpartition(".")[0]
    where: dict[str, tuple[str, str]] = {}
    of_wings: set[str] = set()  # names in the stub that exist only if a head of a wing lists them
    for node in ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            where |= {name.asname or name.name: (module, name.name) for name in node.names}
            if more is not dict and module.startswith("..wings."):
                of_wings |= {name.asname or name.name for name in node.names}

    def names() -> list[str]:
        return sorted({*where} - of_wings | {*more()})

    def get(name: str):
        if name in where:
            module, inner = where[name]
            if module == ".":
                return import_module(f".{inner}", above)
            try:
                source = import_module(module, above)
                return getattr(source, inner) if hasattr(source, inner) else import_module(f".{inner}", source.__name__)
            except ModuleNotFoundError as problem:
                from .wing import without_wing

                error = without_wing(f"{package}.{name}", problem)
                if error is problem and name in of_wings and ".wings." in (problem.name or ""):
                    raise AttributeError(missing_attribute(package, name)) from None
                raise error from None
        if name == "__all__":
            return names()
        if not name.startswith("_") and name in (others := more()):
            return import_module(others[name])
        raise AttributeError(missing_attribute(package, name))

    return get, names, sorted(where)


class _ByPublicName(MetaPathFinder, Loader):
    """Finder that imports `package.name` from the module that this public name denotes."""

    def __init__(self, package: str, more: Callable[[], Mapping[str, str]]):
        self.package, self.more = package, more

    def find_spec(self, fullname: str, path=None, target=None):
        package, _, name = fullname.rpartition(".")
        if package == self.package and not PathFinder.find_spec(fullname, path) and name in (modules := self.more()):
            return spec_from_loader(fullname, self, origin=modules[name])
        if package.startswith(f"{self.package}.") and (own := sys.modules[package].__name__) != package:
            return spec_from_loader(fullname, self, origin=f"{own}.{name}")
        return None

    def create_module(self, spec):
        module = import_module(spec.origin)
        spec.loader_state = module.__spec__  # the import system replaces `__spec__`
        return module

    def exec_module(self, module) -> None:
        module.__spec__ = module.__spec__.loader_state


def lazy_function(package: str, path: str) -> Callable:
    """Return a function that imports `path` ("module.function") from a package when first called.

    Its attribute `resolve` is a function that imports and returns the object itself. If this is a table or another
    value that cannot be called, the lazy function returns it, too.
    """
    module, _, name = path.partition(".")

    def resolve() -> Callable:
        return getattr(import_module(f"{package}.{module}"), name)

    def call(*args, **options):
        found = resolve()
        return found(*args, **options) if callable(found) else found

    call.__name__, call.__qualname__ = name, f"{package}.{path}"
    call.resolve = resolve  # type: ignore[attr-defined]
    return call


def lazy_functions(package: str, module: str, *names: str) -> dict[str, Callable]:
    """Return several lazy functions of one module by name; see `lazy_function`."""
    return {name: lazy_function(package, f"{module}.{name}") for name in names}


def missing_attribute(package: str, name: str) -> str:
    """Error message for a missing attribute, with the places where it exists, or the closest name."""
    if name.startswith("_"):
        return f"module {package!r} has no attribute {name!r}"
    root = package.partition(".")[0]
    if hasattr(import_module(package), "__path__") and find_spec(
        f"{package}.{name}"
    ):  # `from package import module` first looks for an attribute, then imports the module
        return f"{package}.{name} is a module that was not imported: import {package}.{name}"
    from .words import absent, suggestions

    if why := absent(name):
        return f"{package} has no attribute {name!r}: {why}; `stickslip docs comparison` lists codes that have more"
    found = {one: one if one.startswith("`") else f"{root}.{one}" for one in suggestions(name)}
    own = [place for place in found.values() if place.rpartition(".")[0] == package]
    near = own or list(found.values())
    hint = f"did you mean {' or '.join(near)}?" if near else f"see help({package}), and `stickslip docs` for pages"
    return f"{package} has no attribute {name!r}: {hint}"
