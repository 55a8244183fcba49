"""Experiments: one package each, found in the heads of wings, with its scenario, its result and its simulation.

EXPERIMENTS, Experiment     the list of experiments, and the description of one
ScenarioError       raised for an invalid scenario, with a one-sentence message
"""

from ..lazy import attach
from ..wing import experiment_packages

__getattr__, __dir__, _ = attach(__name__, __file__, experiment_packages)
