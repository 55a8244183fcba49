"""Experiments: each is a package with its scenario, its result and its simulation, listed in the head of a wing.

EXPERIMENTS, Experiment     the list of experiments, and the description of one
ScenarioError       raised for an invalid scenario, with a one-sentence message
"""

from ..lazy import attach
from ..wing import experiment_packages

__getattr__, __dir__, _ = attach(__name__, __file__, experiment_packages)
