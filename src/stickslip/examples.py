"""Examples that come with the package.

names       all examples, each with a description
path        path of an example's file
packing     a packing and its law
scenario    a scenario, for `ss.simulate`
copy        copy examples into a folder, as `stickslip example` does
"""

from .experiments.bundled import copy, names, packing, path, scenario
from .lazy import unknown

__all__ = ["copy", "names", "packing", "path", "scenario"]

__getattr__ = unknown(__name__)
