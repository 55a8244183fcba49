"""Examples in docstrings do what they say."""

import doctest
import pkgutil
from importlib import import_module

import pytest

import stickslip

MODULES = [m.name for m in pkgutil.walk_packages(stickslip.__path__, "stickslip.") if "__main__" not in m.name]


@pytest.mark.slow
@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    assert doctest.testmod(import_module(name)).failed == 0
