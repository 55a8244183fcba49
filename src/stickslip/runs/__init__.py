"""Run folders: written, resumed, swept, opened as datasets, and shown as pages and JSON."""
