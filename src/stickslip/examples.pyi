from .runs.bundled import copy as copy
from .runs.bundled import names as names
from .runs.bundled import packing as packing
from .runs.bundled import path as path
from .runs.bundled import scenario as scenario
