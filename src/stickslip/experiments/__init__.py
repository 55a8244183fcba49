"""Experiments: one package for each, with its scenario, simulation, measures and report.

disk_array, sphere_shear, quasi_rigid, gouge    the four papers
flow, rate_state    flows of grains; a spring slider
EXPERIMENTS, Experiment     the list of experiments, and what one consists of
ScenarioError       what is wrong with a scenario, in one sentence
"""

from ..lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
