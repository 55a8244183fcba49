"""Command line: a thin layer in which every command calls one function of the layer below and shows its result."""

# isort: off
from . import running, packings, view, watching, records, about  # in the order of stickslip --help

# isort: on
from .app import app
from .entry_point import main

__all__ = ["about", "app", "main", "packings", "records", "running", "view", "watching"]
