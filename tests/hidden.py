"""Tests without a wing: `python -m tests.hidden status tests/unit` hides its folder and entry point.

`all` hides every wing. Processes started by tests are not affected.
"""

import importlib.abc
import sys

import pytest

from stickslip import wing
from tests import rooms

NAMES = sorted(path.parent.name for path in rooms.PACKAGE.glob("wings/*/wing.py"))


class Hidden(importlib.abc.MetaPathFinder):
    """Finder that raises an error for packages of these names."""

    def __init__(self, packages):
        self.packages = packages

    def find_spec(self, name, path=None, target=None):
        if name in self.packages:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def hide(names) -> None:
    """Hide wings in this process, which has not imported them yet."""
    sys.meta_path.insert(0, Hidden({f"stickslip.wings.{name}" for name in names}))
    found = wing.entry_points
    wing.entry_points = lambda group: [entry for entry in found(group=group) if entry.name not in names]


def main(name: str, *arguments: str) -> int:
    """Run pytest without a wing."""
    if name not in (*NAMES, "all"):
        print(f"{__doc__}\nWings: {', '.join(NAMES)}", file=sys.stderr)
        return 2
    hide(NAMES if name == "all" else [name])
    return pytest.main(["-q", "-p", "no:cacheprovider", *arguments])


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
