"""Values of a contact law at given overlaps, from the compiled core."""

import numpy as np

from ..library import core
from .builtin import KT, NO_TENSION, STEP, Law, parameter_names
from .compiled import law_struct
from .kinds import Kind, evaluate_role, find_user_law

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


def largest_stiffness(law: Law, r_eff: float, deepest: float) -> float:
    """Largest stiffness of a law, of its first materials, between the end of its range and an overlap [force/length].

    That of a built-in law grows with the overlap. The rolling stiffness of a user-defined law is converted to k_r m/I,
    with the I of spheres.
    """
    values = law.table[0, 0].tolist()
    if not isinstance(law.kind, Kind):
        own = dict(zip(parameter_names(law), values, strict=True))
        slopes, tangential = evaluate(law, "slopes", "stiffness", overlap=deepest, r_eff=r_eff)
        return max(slopes[0], tangential, own.get("k_unload", 0.0))
    functions, most = find_user_law(law.kind).functions, 0.0
    end = evaluate_role(law.kind, "contact_range", values, r_eff=r_eff) if "contact_range" in functions else 0.0
    for x in np.append(np.linspace(-end, 0, 33)[1:-1] if end else [], np.geomspace(1e-6, 1, 33) * deepest):
        at = {"overlap": complex(x, STEP), "r_eff": r_eff}
        most = max(most, abs(np.imag(evaluate_role(law.kind, "normal_force", values, **at))) / STEP)
        if "tangential_stiffness" in functions:
            most = max(most, np.real(evaluate_role(law.kind, "tangential_stiffness", values, **at)))
        if "rolling_stiffness" in functions:
            most = max(
                most, np.real(evaluate_role(law.kind, "rolling_stiffness", values, **at)) / (0.4 * (2 * r_eff) ** 2)
            )
    return max(float(most), float(values[KT]) if "tangential_stiffness" not in functions else 0.0)
