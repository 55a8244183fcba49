"""Size and shape of the package: `python -m tests.structure.size` prints them.

Lines are those of Python and C++ files, with comments and blank ones. Internal names are those that wings import and
that are neither public nor in `stickslip.kit`. A private helper is a function or method with a leading underscore.
"""

import ast
import re
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from inspect import ismodule

from rich.console import Console
from rich.table import Table

from stickslip import kit
from tests import rooms

PACKAGE = rooms.PACKAGE
OPEN = ("kit", "wing", "lazy")  # modules for wings, beside the public names
VERDICT = (
    "import sys; from stickslip.cli import main; sys.argv = ['stickslip', 'stability', sys.argv[1]]\n"
    "try:\n    main()\nexcept SystemExit:\n    pass\n"
    "print('modules', sum(name.split('.')[0] == 'stickslip' for name in sys.modules))"
)


def lines() -> dict[str, int]:
    """Lines of the laboratory and of each wing."""
    counts: Counter[str] = Counter()
    for path in PACKAGE.rglob("*"):
        if path.suffix in {".py", ".pyi", ".cpp", ".h", ".cu"}:
            parts = path.relative_to(PACKAGE).parts
            counts[parts[1] if parts[0] == "wings" and len(parts) > 2 else "laboratory"] += len(
                path.read_text(encoding="utf-8").splitlines()
            )
    return dict(counts)


def internal_names(within: str = "") -> dict[str, set[str]]:
    """Names of the laboratory that wings, or a folder of one, import from elsewhere than public names and `OPEN`."""
    found: dict[str, set[str]] = defaultdict(set)
    spaces = (*OPEN, *rooms.SPACES, "experiments", "figures", "friction", "quasirigid")
    allowed = {"stickslip", *(f"stickslip.{name}" for name in spaces)}
    for path in (PACKAGE / "wings" / within).rglob("*.py"):
        package = ["stickslip", *path.relative_to(PACKAGE).parts[:-1]]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level:
                module = ".".join([*package[: len(package) + 1 - node.level], *filter(None, [node.module])])
                if module not in allowed and not module.startswith("stickslip.wings"):
                    found[package[2]] |= {f"{module}.{alias.name}" for alias in node.names}
    return found


def attributes_of_modules() -> set[str]:
    """Attributes that wings reach through modules of the laboratory which the kit contains, such as `kit.style`."""
    modules = {name: value.__name__ for name in kit.__all__ if ismodule(value := getattr(kit, name))}
    found = set()
    for path in (PACKAGE / "wings").rglob("*.py"):
        nodes = [*ast.walk(ast.parse(path.read_text(encoding="utf-8")))]
        imports = [node for node in nodes if isinstance(node, ast.ImportFrom) and (node.module or "").endswith("kit")]
        names = {
            one.asname or one.name: modules[one.name] for node in imports for one in node.names if one.name in modules
        }
        for node in nodes:
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in names:
                found.add(f"{names[node.value.id]}.{node.attr}")
    return found


def helpers() -> tuple[int, int]:
    """Number of private helpers that are used once, and of all functions."""
    texts = [path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")]
    every = [node for text in texts for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
    uses = Counter(re.findall(r"\w+", "\n".join(texts)))
    private = [node.name for node in every if node.name.startswith("_") and not node.name.startswith("__")]
    return sum(uses[name] == 2 for name in private), len(every)  # its definition and one use


def main() -> None:
    """Print the table."""
    from tests.structure.test_extending import CHANGED, EXPERIMENT

    counts, inner, (once, every) = lines(), internal_names(), helpers()
    sample = PACKAGE.parents[1] / "examples" / "sheared_spheres.npz"
    with tempfile.TemporaryDirectory() as folder:
        call = [sys.executable, "-c", VERDICT, sample]
        run = subprocess.run(call, cwd=folder, capture_output=True, text=True, check=True)
    files = [path for path in PACKAGE.rglob("*") if path.suffix in {".py", ".cpp", ".h", ".cu"}]
    table = Table("", "now", "floor", "aim")
    largest = max((name for name in counts if name != "laboratory"), key=counts.__getitem__)
    rows = [
        ("laboratory, lines", f"{counts['laboratory']:,}", "42,000", "38,000"),
        ("everything, lines", f"{sum(counts.values()):,}", "70,500", "67,000"),
        (f"largest wing ({largest}), lines", f"{counts[largest]:,}", "9,500", "8,000"),
        ("files", f"{len(files)}", "330", "280"),
        ("internal names that wings import", f"{len(set().union(*inner.values()))}", "0", "0"),
        ("names that wings reach through modules of the kit", f"{len(attributes_of_modules())}", "–", "–"),
        ("files of a new experiment + changed ones", f"{len(EXPERIMENT)} + {len(CHANGED)}", "–", "–"),
        ("own modules of `stickslip stability`", run.stdout.split()[-1], "80", "60"),
        ("private helpers used once", f"{once / every:.1%}", "15 %", "11 %"),
    ]
    for row in rows:
        table.add_row(*row)
    Console().print(table)


if __name__ == "__main__":
    main()
