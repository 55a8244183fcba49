"""Conversion of contact laws to and from LAMMPS; messages name LAMMPS models that have no equivalent here.

A new law, damping model or effect needs one line in a table.

Source: LAMMPS documentation of `pair_style gran`, `pair_style granular` and `fix wall/gran`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...builtin_laws import BY_NAME, NAMES
from ...core.laws.builtin import (
    DAMPING,
    KEEPS_FORCE,
    LEVER,
    NO_TENSION,
    PARAMETERS,
    ROLLING,
    SCALED,
    SHARP,
    TWISTING,
    Law,
    elastic_constants,
    marshall_values,
    parameter_names,
)
from ...core.laws.properties import critical_coefficient, dashpot_coefficients, restitution_of
from ...core.text import parse_number

MODELS = {  # normal and tangential model of `pair_style granular`
    "linear": ("hooke", "linear_history"),
    "hertz_mindlin_reff": ("hertz", "mindlin"),
    "hertz_mindlin_reff_rescaled": ("hertz", "mindlin_rescale"),
    "jkr": ("jkr", "mindlin"),
    "dmt": ("dmt", "mindlin"),
}
HISTORY = {"hooke/history": ("linear", "mass_velocity"), "hertz/history": ("hertz_mindlin_reff", "viscoelastic")}
NORMAL = {  # number of coefficients, and the normal model with the same elastic force
    "hooke": (2, "hooke"), "hertz": (2, "hertz"), "hertz/material": (3, "hertz"), "dmt": (4, "dmt"), "jkr": (4, "jkr"),
    "mdr": (6, ""),
}  # fmt: skip
NEAREST = {"hooke": "linear", "hertz": "hertz_mindlin_reff", "jkr": "jkr", "dmt": "dmt"}  # nearest law for other models
TANGENTIAL = {  # numbers of coefficients, and of memory values of a contact
    "none": (0, 0), "linear_nohistory": (2, 0), "linear_history": (3, 3), "linear_history_classic": (3, 3),
    "mindlin_classic": (3, 3), "mindlin": (3, 3), "mindlin/force": (3, 3), "mindlin_rescale": (3, 4),
    "mindlin_rescale/force": (3, 4),
}  # fmt: skip
OTHERS = {  # numbers of coefficients of the models that may follow these two
    "damping": {"velocity": 0, "mass_velocity": 0, "viscoelastic": 0, "tsuji": 0, "coeff_restitution": 0},
    "rolling": {"none": 0, "sds": 3}, "twisting": {"none": 0, "marshall": 0, "sds": 3},
    "heat": {"none": 0, "radius": 1, "area": 1},
}  # fmt: skip
SDS = {  # coefficients of a model `sds`, in the order of LAMMPS, and the corresponding property
    "rolling": (ROLLING, ("k_roll", "gamma_roll", "mu_roll")),
    "twisting": (TWISTING, ("k_twist", "gamma_twist", "mu_twist")),
}  # fmt: skip
FORCE = "/force"  # suffix of tangential models whose memory is the force
RESTITUTION = ("tsuji", "coeff_restitution")
SAME_UNITS = ("lj", "si", "cgs", "micro", "nano")  # units in which force is mass times acceleration
TSUJI_FACTOR = 2025  # last year of LAMMPS releases whose tsuji lacks the factor √2
TSUJI = (
    f"damping tsuji lacks a factor of sqrt(2) in LAMMPS up to {TSUJI_FACTOR}: here it is coeff_restitution with the "
    "same dashpots"
)
LIMITED = (
    "limit_damping opens contacts before they attract: the coefficient of restitution here is that of a "
    "collision with these dashpots, larger than the number in LAMMPS"
)
WALL_CLASSIC = (
    "the k_t of fix wall/gran hooke/history, which LAMMPS 2022 to 2025 multiplies by the contact radius "
    "sqrt(delta R) (here its mean over contacts)"
)
LEVER_ARMS = (
    "pair_style granular uses lever arms R - delta/2 for torques and R for slip: here both are R - delta/2, "
    'except with slip_update="rate"'
)
COHESIVE_DASHPOTS = (
    "dashpots of {} differ in LAMMPS while grains move: they act across gaps, or increase in another way"
)
PULL_OFF = "LAMMPS separates jkr contacts at 0.48 of the pull-off gap: here they last up to this gap"
REVERSED = (
    "LAMMPS reverses the memory of rolling and twisting where grains cross a periodic boundary or change their "
    "order in its lists: here it is the memory in the next step of LAMMPS"
)


class Contact(NamedTuple):
    """Law of a pair of types, or of a type and a wall: its parameters, and features without an equivalent here."""

    law: str
    damping: str
    values: dict[str, float]
    tension: bool = True
    properties: int = 0
    lacks: tuple[str, ...] = ()
    elastic: tuple[float, ...] = ()  # Young's modulus, Poisson's ratio, 1 if kt follows from them; empty if kn is given
    slots: int = 3  # number of memory values of the tangential force


def contact_of(style: str, arguments: Sequence[str]) -> tuple[Contact, list[str]]:
    """Law of a pair style or a wall, and the arguments that follow its coefficients.

    Parameters
    ----------
    style : name of the style, such as hooke/history or granular

    Raises
    ------
    ValueError
        If the arguments are not those of the style, or the style is unknown.
    """
    if style == "granular":
        return _granular(list(arguments))
    if style not in HISTORY:
        raise ValueError(f"the style {style}")
    law, damping = HISTORY[style]
    kn, kt, damping_n, damping_t, mu, flag = (None if w == "NULL" else parse_number(w) for w in arguments[:6])
    kt = 2 / 7 * kn if kt is None else kt
    damping_t = damping_n / 2 if damping_t is None else damping_t
    rest = list(arguments[6:])
    tension = "limit_damping" not in rest[:1]
    values = dict(zip(PARAMETERS, (kn, kt, mu, damping_n, damping_t if flag else 0.0), strict=True))
    return Contact(law, damping, values, tension), rest[not tension :]


def no_equal(style: str) -> str:
    """Reason why a pair style has no equivalent law."""
    if style.removeprefix("gran/") == "hooke":
        springs = "it has no tangential springs, so that friction cannot hold grains at rest"
        return f"{springs}, and no equivalent law exists here"
    return "no equivalent law exists here"


def wall_contact(style: str, arguments: Sequence[str]) -> tuple[Contact, list[str]]:
    """Law of a wall, as from `contact_of`, but with lever arms R."""
    contact, rest = contact_of(style, arguments)
    return contact._replace(properties=contact.properties & ~LEVER), rest


def _granular(arguments: list[str]) -> tuple[Contact, list[str]]:
    name, more, lacks = arguments.pop(0), {}, []
    if name not in NORMAL:
        raise ValueError(f"the normal model {name}")
    (count, normal), (tangential, *rest) = NORMAL[name], ("none",)
    numbers, arguments = [parse_number(w) for w in arguments[:count]], arguments[count:]
    lacks += [] if normal else [f"the normal model {name}"]
    damping, tension, properties = "viscoelastic", True, LEVER
    while arguments and arguments[0] in ("tangential", "limit_damping", "cutoff", *OTHERS):
        key = arguments.pop(0)
        if key == "limit_damping":
            tension = False
        elif key == "cutoff":
            arguments.pop(0)
        elif key == "tangential":
            tangential = arguments.pop(0)
            properties |= KEEPS_FORCE if tangential.endswith(FORCE) else 0
            count = TANGENTIAL[tangential][0]
            rest, arguments = [None if w == "NULL" else parse_number(w) for w in arguments[:count]], arguments[count:]
        else:
            model = arguments.pop(0)
            own, arguments = arguments[: OTHERS[key][model]], arguments[OTHERS[key][model] :]
            damping = model if key == "damping" else damping
            if model == "marshall":
                properties |= TWISTING | SCALED
            elif model == "sds":
                properties |= SDS[key][0]
                more |= dict(zip(SDS[key][1], map(parse_number, own), strict=True))
    contact = Contact("", damping, more, tension, properties, tuple(lacks), slots=TANGENTIAL[tangential][1])
    return _combine(contact, normal or "hertz", tangential, numbers, rest), arguments


def _combine(contact: Contact, normal: str, tangential: str, numbers: list, rest: list) -> Contact:
    """Law with given normal and tangential models, and parameters computed from their coefficients."""
    law = next((law for law, model in MODELS.items() if model == (normal, tangential.removesuffix(FORCE))), None)
    lacks, more, elastic = list(contact.lacks), dict(contact.values), ()
    if law is None:
        law = NEAREST[normal]
        lacks += [] if tangential == "none" else [f"tangential {tangential} with normal {normal}"]
    kt, share, mu = rest if len(rest) == 3 else (0.0, *rest, 0.0, 0.0)[:3]
    if len(numbers) == 2:
        kn, damping_n = numbers
    else:
        young, damping_n, poisson, *adhesion = numbers
        elastic, kn = (young, poisson, float(kt is None)), elastic_constants(young, poisson)[0]
        more |= {"work": 2 * adhesion[0]} if BY_NAME[law].parameters else {}
    if kt is None:
        kt = elastic_constants(*elastic[:2])[1]
    damping_t = share if contact.damping in RESTITUTION else share * damping_n
    if contact.damping in RESTITUTION and not (0 < damping_n <= 1):
        lacks.append(f"damping {contact.damping} with the coefficient {damping_n:g}")
        damping_n = 0.0
    more |= marshall_values(kt, mu) if contact.properties & SCALED else {}
    lacks += [f"{name} = 0" for name in ("k_roll", "k_twist") if more.get(name, 1.0) == 0]
    if mu == 0 and (more.get("mu_roll") or more.get("mu_twist")):
        lacks.append("rolling or twisting without friction")
    values = dict(zip(PARAMETERS, (kn, kt, mu, damping_n, damping_t), strict=True)) | more
    return contact._replace(law=law, values=values, elastic=elastic, lacks=tuple(dict.fromkeys(lacks)))


def mix(a: Contact, b: Contact) -> Contact:
    """Law of two types from the laws of each, as LAMMPS mixes them: geometric means, except for elastic constants."""
    values = {name: float(np.sqrt(value * b.values.get(name, 0.0))) for name, value in a.values.items()}
    if a.elastic and b.elastic:
        young = 1 / sum((1 - poisson**2) / young for young, poisson, _ in (a.elastic, b.elastic))
        poisson = np.sqrt(a.elastic[1] * b.elastic[1])
        values["kn"] = 4 / 3 * young
        if a.elastic[2] and b.elastic[2]:
            values["kt"] = elastic_constants(young, poisson)[1]
    values |= marshall_values(values["kt"], values["mu"]) if a.properties & SCALED else {}
    return a._replace(values=values, lacks=tuple(dict.fromkeys(a.lacks + b.lacks)))


def of_release(contact: Contact, year: int) -> Contact:
    """Law of a contact with the coefficient of restitution that gives the dashpots of LAMMPS in a given year.

    `tsuji` lacked a factor √2, and `limit_damping` opens contacts earlier: see `dashpot_coefficients`.
    """
    old = contact.damping == "tsuji" and year <= TSUJI_FACTOR
    if not old and (contact.damping != "coeff_restitution" or contact.tension):
        return contact
    model, factor = DAMPING[contact.damping], 1 / np.sqrt(2) if old else 1.0
    restitution = as_restitution(contact.law, model, contact.values["damping_n"], factor, tension=contact.tension)
    return contact._replace(damping="coeff_restitution", values=contact.values | {"damping_n": restitution})


def as_restitution(law: str, damping: int, damping_n: float, factor: float = 1.0, *, tension: bool = True) -> float:
    """Coefficient of restitution for which coeff_restitution gives the α of a damping model times a factor.

    LAMMPS uses the α of contacts that may attract (`tension`), even with `limit_damping`.
    """
    like = Law(NAMES.index(law), SHARP, np.array([[[1.0, 0.0, 0.0, damping_n, 0.0]]]), damping)
    alpha = factor * float(dashpot_coefficients(like)[0, 0, 0])
    return restitution_of(alpha / critical_coefficient(like.kind), tension=tension)


def _table(contact: Contact, names: Sequence[str]) -> np.ndarray:
    """(1, 1, parameters) table of a contact; a moment without a spring has the stiffness 1 and no cap."""
    absent = {"k_roll": 1.0, "k_twist": 1.0}
    return np.array([contact.values.get(name) or absent.get(name, 0.0) for name in names])[None, None]


def _model(contact: Contact, properties: int) -> tuple:
    """Law, damping and properties common to all pairs of materials; some pairs may be without twisting."""
    own = contact.properties if contact.properties & TWISTING else properties
    return contact.law, contact.damping, contact.tension, contact.properties & KEEPS_FORCE, own & SCALED


def law_of_contacts(table: dict[tuple[int, int], Contact], types: int, walls: int) -> tuple[Law, list[str]]:
    """Law from its pairs of materials, and features without an equivalent here; pairs not in `table` never meet."""
    first = table[min(table)]
    properties = int(np.bitwise_or.reduce([contact.properties for contact in table.values()]))
    damping = DAMPING[first.damping] + (0 if first.tension else NO_TENSION)
    law = Law(NAMES.index(first.law), SHARP, np.zeros((1, 1, 0)), damping, properties)
    names = parameter_names(law)
    values = np.tile(_table(first, names), (types + walls, types + walls, 1))
    lacks = [lack for contact in table.values() for lack in contact.lacks]
    for (a, b), contact in table.items():
        values[a, b] = values[b, a] = _table(contact, names)[0, 0]
        if _model(contact, properties) != _model(first, properties):
            other = f"type {b + 1}" if b < types else f"wall {b - types + 1}"
            lacks.append(
                f"the model between type {a + 1} and {other}, which differs from that of type {min(table)[0] + 1}"
            )
    return law._replace(table=values), list(dict.fromkeys(lacks))


def differences(table: dict[tuple[int, int], Contact]) -> list[str]:
    """Describe differences from LAMMPS that leave the forces at rest unchanged."""
    notes = [LEVER_ARMS] if any(contact.properties & LEVER for contact in table.values()) else []
    for c in table.values():
        notes += [PULL_OFF] if c.law == "jkr" else []
        notes += [REVERSED] if c.properties & (ROLLING | TWISTING) else []
        if BY_NAME[c.law].parameters and c.values["damping_n"] and (c.law == "jkr" or c.damping in RESTITUTION):
            notes.append(COHESIVE_DASHPOTS.format(c.law))
    return list(dict.fromkeys(notes))


def memory_layout(contacts: Sequence[Contact]) -> tuple[int, int]:
    """Positions of rolling and twisting in the memory of contacts, after slip; −1 if absent."""
    properties = int(np.bitwise_or.reduce([0, *(contact.properties for contact in contacts)]))
    slots = max((contact.slots for contact in contacts), default=3) - 3
    rolls = slots if properties & ROLLING else -1
    return rolls, (slots + 3 * (rolls >= 0) if properties & TWISTING else -1)
