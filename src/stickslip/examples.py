"""Examples that come with the package.

names       all examples, each with a description
path        path of an example's file
packing     a packing and its law
scenario    a scenario, for `ss.simulate`
copy        copy examples into a folder, as `stickslip example` does
"""

from .lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
