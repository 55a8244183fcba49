"""Command line: a thin layer in which every command calls one function of the layer below and shows its result."""

from .app import app, main

__all__ = ["app", "main"]
