"""Table of built-in contact laws, in the order of their kinds.

All code that lists or describes the laws reads this table.

A new law needs an entry here; scalar functions in `_core/laws.h` or, with additional parameters, in
`_core/normal_laws.cpp`; a constructor of the same name in `core/laws/builtin.py`; a Python form in `tests/laws/forms`,
with which tests compare it; and a line in `docs/contact_laws.md`.
"""

from typing import NamedTuple


class Parameter(NamedTuple):
    """Nonnegative parameter that only some laws have."""

    name: str
    unit: str
    words: str
    positive: bool = False  # zero is not allowed


class BuiltinLaw(NamedTuple):
    """Properties of a built-in contact law."""

    name: str
    words: str  # description for the command line
    exponent: float  # exponent of the overlap in the elastic normal force
    sources: tuple[str, ...]  # keys of references.bib
    uses_radius: bool = False  # stiffnesses contain √R_eff, so k_n and k_t follow from elastic constants
    rescales: bool = False  # slip shrinks as the overlap decreases
    parameters: tuple[Parameter, ...] = ()  # parameters that only some laws in `_core/normal_laws.cpp` have
    memory: tuple[str, ...] = ()  # additional memory of a contact, zero when it closes
    bonds: bool = False  # once grains have touched, the law acts across gaps up to a range

    @property
    def damping(self) -> str:
        """Default damping model for scenarios."""
        return "viscoelastic" if self.uses_radius else "mass_velocity"

    @property
    def stiffness_unit(self) -> str:
        """Unit of k_n and k_t."""
        return f"force/length^{'2' if self.uses_radius else '(3/2)'}" if self.exponent > 1 else "force/length"


_HERTZ = "Hertz1882", "Mindlin1949", "Cundall1979"
_ELASTIC = "Hertz1882", "Mindlin1953", "Silbert2001"
_WORK = Parameter("work", "energy/length^2", "work of adhesion")
BUILTIN_LAWS = (
    BuiltinLaw("hertz_mindlin", "k δ^(3/2), as in Charan et al. 2020 and Bonfanti et al. 2020", 1.5, _HERTZ),
    BuiltinLaw("linear", "k δ, as in McNamara & Herrmann 2006", 1.0, ("Cundall1979",)),
    BuiltinLaw("hertz_mindlin_reff", "k √R δ^(3/2), as in LAMMPS", 1.5, _ELASTIC, uses_radius=True),
    BuiltinLaw(
        "hertz_mindlin_rescaled", "k δ^(3/2), slip shrinks with the overlap", 1.5, (*_HERTZ, "LAMMPS"), rescales=True
    ),
    BuiltinLaw(
        "hertz_mindlin_reff_rescaled", "as LAMMPS mindlin_rescale", 1.5, (*_ELASTIC, "LAMMPS"), uses_radius=True,
        rescales=True,
    ),
    BuiltinLaw(
        "jkr", "adhesive spheres of Johnson, Kendall & Roberts, with pull-off", 1.5, ("Johnson1971", "Parteli2014"),
        uses_radius=True, parameters=(_WORK,), bonds=True,
    ),
    BuiltinLaw(
        "dmt", "adhesive spheres of Derjaguin, Muller & Toporov", 1.5, ("Derjaguin1975", "LAMMPS"), uses_radius=True,
        parameters=(_WORK,),
    ),
    BuiltinLaw(
        "walton_braun", "plastic contacts of Walton & Braun: k_n δ, and stiffer as the overlap decreases", 1.0,
        ("Walton1986",),
        parameters=(Parameter("k_unload", "force/length", "stiffness as the overlap decreases", positive=True),),
        memory=("deepest",),
    ),
    BuiltinLaw(
        "liquid_bridge", "wet spheres: k √R δ^(3/2), and bridges that form at touch", 1.5,
        ("Rabinovich2005", "Lian1993"), uses_radius=True, bonds=True,
        parameters=(
            Parameter("surface_tension", "force/length", "of the liquid"),
            Parameter("volume", "length^3", "of a bridge"),
        ),
    ),
)  # fmt: skip
BY_NAME = {law.name: law for law in BUILTIN_LAWS}
NAMES = tuple(BY_NAME)
FIRST_OF_OWN = NAMES.index("jkr")  # the first law in `_core/normal_laws.cpp`
