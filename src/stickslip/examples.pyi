from .experiments.bundled import copy as copy
from .experiments.bundled import names as names
from .experiments.bundled import packing as packing
from .experiments.bundled import path as path
from .experiments.bundled import scenario as scenario
