"""Command line: a thin layer in which every command calls one function of the layer below and shows its result."""

from ..wing import add_commands

# isort: off
from . import running, packings  # in the order of stickslip --help

add_commands()  # commands of wings
from . import about  # noqa: E402

# isort: on
from .app import app, main  # noqa: E402

__all__ = ["about", "app", "main", "packings", "running"]
