"""Preparation, loading and release of packings."""
