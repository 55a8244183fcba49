"""Examples in docstrings do what they say."""

import doctest
import inspect
import pkgutil
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import stickslip

MODULES = [m.name for m in pkgutil.walk_packages(stickslip.__path__, "stickslip.")]
MODULES = [name for name in MODULES if "__main__" not in name and "-" not in name]  # nor compiled libraries
EXAMPLES = [name for name in MODULES if ">>>" in Path(find_spec(name).origin).read_text(encoding="utf-8")]


class Finder(doctest.DocTestFinder):
    """Finds examples of decorated functions, too."""

    def _from_module(self, module, object):
        return super()._from_module(module, inspect.unwrap(object) if inspect.isfunction(object) else object)


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples(name):
    runner = doctest.DocTestRunner()
    for test in Finder().find(import_module(name), name):
        runner.run(test)
    assert runner.failures == 0


def test_every_module_can_be_imported():
    for name in MODULES:
        import_module(name)


def test_examples_of_decorated_functions_are_found():
    values = {test.name: len(test.examples) for test in Finder().find(import_module("stickslip.solve.stability"))}
    assert values["stickslip.solve.stability.stability"] > 0
