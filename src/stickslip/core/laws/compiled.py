"""Laws as the compiled core takes them: the struct `Law` of `core.h`."""

from ...builtin_laws import BUILTIN_LAWS
from .builtin import NO_TENSION, SMOOTH, Law, damping_model

_FUNCTIONS = (
    "force", "cap", "slopes", "cap_slopes", "energy", "range", "rolling", "rolling_cap", "rolling_slopes",
)  # fmt: skip


def law_struct(law: Law, *, rate: bool = False) -> dict:
    """Members of the struct of a law; `rate`: slip update as in LAMMPS."""
    known = BUILTIN_LAWS[law.kind]
    return {
        "hertz": known.exponent == 1.5, "uses_radius": known.uses_radius, "rescaled": known.rescales,
        "smooth": law.coulomb == SMOOTH, "damping": damping_model(law) & 3, "tension": not law.damping & NO_TENSION,
        "rate": rate, "len_table": len(law.table), "width": law.table.shape[2], "table": law.table,
        **dict.fromkeys(_FUNCTIONS),
    }  # fmt: skip
