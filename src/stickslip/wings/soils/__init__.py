"""Tests of soils: element tests and cyclic shear."""
