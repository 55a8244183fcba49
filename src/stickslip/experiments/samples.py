"""Contact law, jammed packing and references of a scenario, from its tables."""

import numpy as np

from ..builtin_laws import BUILTIN_LAWS, BY_NAME
from ..core.laws.builtin import KN, MOMENTS, ROLLING, TWISTING, Law, for_pair, with_values
from ..core.laws.properties import with_lever, with_memory, with_rolling, with_twisting
from ..core.state import State
from ..data.law_schema import SUBSTRATE, LawTable, Packing, load_law
from ..data.sample import law_by_name
from ..loading.packing import PackingInfo, jammed
from ..solve.collision import eq8_damping, with_restitution

RESTITUTION = ("tsuji", "coeff_restitution")
DEFAULT_FRACTION = {2: 0.86, 3: 0.68}
SOURCES = {law.name: law.sources for law in BUILTIN_LAWS}


def make_law(chosen: LawTable, *, radius: float = np.nan, mass: float = np.nan) -> Law:
    """Contact law that a scenario selects, with separate parameters for walls if its table has them.

    `radius` and `mass` are those of the two grains whose collision has the given restitution.
    """
    law = _law_by_kind(chosen) if chosen.file is None else load_law(chosen)
    if chosen.restitution is not None:
        law = _with_restitution(law, chosen, radius, mass)
    law = _with_properties(law, chosen)
    if chosen.wall is None:
        return law
    return for_pair(law, 0, SUBSTRATE, **{k: v for k, v in chosen.wall.model_dump().items() if v is not None})


def _law_by_kind(chosen: LawTable) -> Law:
    kt = 2 / 7 * chosen.kn if chosen.kt is None and chosen.kn is not None else chosen.kt
    damping_n, damping_t = chosen.damping_n or 0.0, chosen.damping_t
    if damping_t is None:  # that of a restitution is a ratio
        damping_t = (chosen.damping_ratio or 0.0) * (1.0 if chosen.damping in RESTITUTION else damping_n)
    return law_by_name(
        chosen.kind, chosen.coulomb, chosen.kn, kt, chosen.mu, young=chosen.young, poisson=chosen.poisson,
        damping=chosen.dashpots, damping_n=damping_n,
        damping_t=damping_t, tension=chosen.tension,
        **{p.name: getattr(chosen, p.name) for p in BY_NAME[chosen.kind].parameters},
    )  # fmt: skip


def _with_properties(law: Law, chosen: LawTable) -> Law:
    """Law with the lever arms, the memory and the moments of a law table."""
    law = law if chosen.lever is None else with_lever(law, chosen.lever)
    law = law if chosen.memory is None else with_memory(law, chosen.memory)
    given = {name: getattr(chosen, name) or 0.0 for part in MOMENTS.values() for name in part}
    rolls, twists = ({name: given[name] for name in MOMENTS[part]} for part in (ROLLING, TWISTING))
    law = law if chosen.rolling is None else with_rolling(law, chosen.rolling, **rolls)
    return law if chosen.twisting is None else with_twisting(law, chosen.twisting, **twists)


def _with_restitution(law: Law, chosen: LawTable, radius: float, mass: float) -> Law:
    ratio = 0.5 if chosen.damping_ratio is None else chosen.damping_ratio
    # the restitution of a linear law does not depend on the speed: any value of a suitable magnitude works
    speed = chosen.speed or 0.01 * radius * float(np.sqrt(law.table[0, 0, KN] / mass))
    meeting = {"radius": radius, "mass": mass, "speed": speed, "ratio": ratio}
    if chosen.reading != "eq8":
        return with_restitution(law, chosen.restitution, **meeting)
    gamma = eq8_damping(chosen.restitution, young=chosen.young, poisson=chosen.poisson, **meeting)
    return with_values(law, damping_n=gamma, damping_t=ratio * gamma)


def law_references(law: LawTable | str) -> tuple[str, ...]:
    """Return the references of a built-in law, given by a table or a name; a law from a file has none."""
    return SOURCES[law] if isinstance(law, str) else SOURCES[law.kind] if law.file is None else ()


def make_packing(chosen: Packing, law: Law, seed: int, tolerance: float | None = None) -> tuple[State, PackingInfo]:
    """Make the packing of a scenario; return State and PackingInfo (see `jammed`)."""
    fraction = chosen.packing_fraction
    if fraction is None and chosen.pressure is None:
        fraction = DEFAULT_FRACTION[chosen.dim]
    return jammed(
        chosen.grains,
        packing_fraction=fraction,
        pressure=chosen.pressure,
        dim=chosen.dim,
        radius=chosen.radius,
        mass=chosen.mass,
        i0=chosen.i0,
        law=law,
        seed=seed,
        tolerance=tolerance,
    )
