"""Tests of one room of the package: `python -m tests.rooms solve` prints test files that use it, for `make test-solve`.

A test file belongs to a room if it imports from the room, or uses a public name defined there.
"""

import ast
import re
import sys
from functools import cache
from pathlib import Path

from stickslip.wing import installed

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "stickslip"
SPACES = ("control", "io", "laws", "measure", "modes", "packings", "protocols", "results")


def rooms() -> list[str]:
    """Names of all rooms and wings."""
    folders = [path.parent.name for glob in ("*/__init__.py", "wings/*/__init__.py") for path in PACKAGE.glob(glob)]
    return sorted({*folders} - {"wings"})


def room_of(module: str) -> str:
    """Room or wing of a module, named without the package."""
    first, *rest = module.split(".")
    return rest[0] if first == "wings" and rest else first


@cache
def _tree(path: Path) -> ast.AST:
    return ast.parse(path.read_text(encoding="utf-8"))


def _imports(path: Path) -> dict[str, str]:
    """Rooms of the names imported by a file."""
    values = {}
    for node in ast.walk(_tree(path)):
        if isinstance(node, ast.ImportFrom) and node.module:
            module = node.module.removeprefix("stickslip.") if not node.level else node.module
            if node.level or node.module.startswith("stickslip."):
                values |= {alias.asname or alias.name: room_of(module) for alias in node.names}
            elif node.module == "stickslip":
                values |= {alias.asname or alias.name: alias.name for alias in node.names}
    return values


@cache
def public() -> dict[str, str]:
    """Room of each public name, with its namespace if it has one."""
    names = _imports(PACKAGE / "__init__.pyi")
    for space in SPACES:
        names |= {f"{space}.{name}": room for name, room in _imports(PACKAGE / f"{space}.pyi").items()}
    return names


@cache
def used(path: Path) -> frozenset[str]:
    """Rooms that a test file uses."""
    needed, names = set(), public()
    for name, room in _imports(path).items():
        needed.add(names.get(name, room) if room in SPACES or room == name else room)
    for first, second in re.findall(r"\bss\.(\w+)(?:\.(\w+))?", path.read_text(encoding="utf-8")):
        needed |= {names.get(f"{first}.{second}" if second else first, first), names.get(first, first)}
    return frozenset(needed)


def files(room: str) -> list[Path]:
    """Test files of a room: those that use it, and all files in the folder of its name."""
    return [
        path
        for path in sorted((ROOT / "tests").rglob("test_*.py"))
        if room in used(path) or room in path.relative_to(ROOT / "tests").parts
    ]


@cache
def _words_of_wings() -> re.Pattern:
    """Words that identify a wing in a test: its package, its experiments, its tests."""
    names = {name for wing in installed().values() for name in wing.experiments} - {"flow", "fault"}
    words = [
        r"\"(?:watch|fit)\"",
        r"wings\.",
        "experiment",
        r"ss\.scenario\(",
        "reproduce",
        r"tests\.(?:published|peers|wings)",
    ]
    return re.compile("|".join([*words, *names, *(name.replace("-", "_") for name in names)]))


def of_laboratory() -> list[Path]:
    """Test files that do not refer to any wing, its experiments or public names, and use no such files."""
    wings = {"friction", "quasirigid", "experiments", *(path.parent.name for path in PACKAGE.glob("wings/*/wing.py"))}
    folders = {"wings", "peers", "published", "device", "structure"}

    every = [path for path in (ROOT / "tests").rglob("test_*.py") if not folders & {*path.relative_to(ROOT).parts}]
    texts = {path: path.read_text(encoding="utf-8") for path in every}
    own = {path: text for path, text in texts.items() if not (used(path) & wings or _words_of_wings().search(text))}
    foreign = "|".join(re.escape(f"tests.{path.parent.name}.{path.stem} ") for path in texts if path not in own)
    return sorted(path for path, text in own.items() if not re.search(foreign, text))


if __name__ == "__main__":
    if len(sys.argv) != 2 or not (found := files(sys.argv[1])):
        sys.exit(f"no tests of {' '.join(sys.argv[1:]) or 'no room'}: name one of {', '.join(rooms())}")
    print(*(path.relative_to(ROOT) for path in found))
