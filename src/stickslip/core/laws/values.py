"""Values of a contact law at given overlaps, from the compiled core."""

import numpy as np

from ..library import core
from .builtin import NO_TENSION, Law
from .compiled import law_struct

_PAIRS = "slopes", "cap_slopes"
_MEMBERS = {"stiffness": "force"}  # function of a user's law that gives a result, if it has another name


def evaluate(law: Law, *wanted: str, overlap, r_eff=1.0, a=0, b=0, m_eff=1.0, normal_force=0.0):
    """Values of a law by contact, an array for each name that is given, or the only one.

    Overlaps are positive, or within the range of the law. All arguments are numbers or arrays of the same shape.

    Parameters
    ----------
    wanted : "force" and "energy" of the normal spring; "stiffness" of the tangential one; "slopes" (…, 2), the
        derivatives of force and stiffness; "cap" and "cap_slopes" (…, 2), its derivatives with respect to the normal
        force and the overlap; "range"; "damping", the factor on the damping coefficients
    overlap, r_eff : δ and R_eff [length]
    a, b : materials of the two bodies
    m_eff : effective mass, for dashpots [mass]
    normal_force : force including that of the dashpot, for caps [force]
    """
    given = np.broadcast_arrays(a, b, overlap, r_eff, m_eff, normal_force)
    types, shape = (np.int64, np.int64, *4 * [float]), given[0].shape
    names = "a", "b", "overlap", "r_eff", "m_eff", "fn"
    points = {n: np.array(x, t).ravel() for n, x, t in zip(names, given, types, strict=True)}
    results = dict.fromkeys(("force", "stiffness", "energy", "slopes", "cap", "cap_slopes", "range", "damping"))
    results |= {"memory": None}
    results |= {name: np.empty((*shape, 2) if name in _PAIRS else shape) for name in wanted}
    struct = law_struct(law, members=tuple(_MEMBERS.get(name, name) for name in wanted if name != "damping"))
    core.law_values(struct | {"damping": law.damping & ~NO_TENSION}, points | results)
    values = tuple(results[name] for name in wanted)
    return values if len(values) > 1 else values[0]
