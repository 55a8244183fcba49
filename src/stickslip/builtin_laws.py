"""Table of built-in contact laws, in the order of their kinds.

All code that lists or describes the laws reads this table.

A new law needs one entry here, its scalar functions in `_core/laws.h`, its constructor in `core/laws/builtin.py`, and
tests.
"""

from typing import NamedTuple


class BuiltinLaw(NamedTuple):
    """Properties of a built-in contact law."""

    name: str
    words: str  # for the command line
    exponent: float  # of the overlap in the elastic normal force
    sources: tuple[str, ...]  # keys of references.bib
    uses_radius: bool = False  # stiffnesses contain √R_eff, so that k_n and k_t follow from elastic constants
    rescales: bool = False  # slip shrinks as the overlap decreases

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
)  # fmt: skip
BY_NAME = {law.name: law for law in BUILTIN_LAWS}
NAMES = tuple(BY_NAME)
