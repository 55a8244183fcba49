"""Experiments: one package each, with its scenario, simulation, measures and report.

disk_array, sphere_shear, quasi_rigid, gouge    the four papers
flow, rate_state, fault    granular flows; a spring-slider; earthquake cycles on a fault
catalogue           events of sheared packings, and what announces them
threshold           static and kinetic friction of a sample
element_test        triaxial, oedometric, undrained and other tests of soils
cyclic_shear        modulus, damping ratio and work of soils under cyclic shear
EXPERIMENTS, Experiment     the list of experiments, and the description of one
ScenarioError       raised for an invalid scenario, with a one-sentence message
"""

from ..lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
