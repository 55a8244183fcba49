"""Folders of runs: written, resumed, swept, opened as datasets, and shown as pages and JSON."""
