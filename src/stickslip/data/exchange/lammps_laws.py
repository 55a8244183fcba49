"""Contact laws in the words of LAMMPS, in both directions; what has no equal here is named.

A law, a model of damping or an effect that is added to this package needs one line in a table.

Source: LAMMPS documentation of `pair_style gran`, `pair_style granular` and `fix wall/gran`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...builtin_laws import NAMES
from ...core.laws.builtin import DAMPING, NO_TENSION, SHARP, Law, elastic_constants
from ...core.text import parse_number

MODELS = {  # normal and tangential model of `pair_style granular`
    "linear": ("hooke", "linear_history"),
    "hertz_mindlin_reff": ("hertz", "mindlin"),
    "hertz_mindlin_reff_rescaled": ("hertz", "mindlin_rescale"),
}
HISTORY = {"hooke/history": ("linear", "mass_velocity"), "hertz/history": ("hertz_mindlin_reff", "viscoelastic")}
NORMAL = {  # number of coefficients, and the normal model with the same elastic force
    "hooke": (2, "hooke"), "hertz": (2, "hertz"), "hertz/material": (3, "hertz"), "dmt": (4, ""), "jkr": (4, ""),
    "mdr": (6, ""),
}  # fmt: skip
TANGENTIAL = {  # number of coefficients
    "none": 0, "linear_nohistory": 2, "linear_history": 3, "linear_history_classic": 3, "mindlin_classic": 3,
    "mindlin": 3, "mindlin/force": 3, "mindlin_rescale": 3, "mindlin_rescale/force": 3,
}  # fmt: skip
OTHERS = {  # number of coefficients of the models that may follow
    "damping": {"velocity": 0, "mass_velocity": 0, "viscoelastic": 0, "tsuji": 0, "coeff_restitution": 0},
    "rolling": {"none": 0, "sds": 3}, "twisting": {"none": 0, "marshall": 0, "sds": 3},
    "heat": {"none": 0, "radius": 1, "area": 1},
}  # fmt: skip
NO_EQUAL = {"damping tsuji", "damping coeff_restitution", "rolling sds", "twisting marshall", "twisting sds"}
SAME_UNITS = ("lj", "si", "cgs", "micro", "nano")  # in which forces are mass times acceleration
WALL_CLASSIC = (
    "the k_t of fix wall/gran hooke/history, which LAMMPS up to 2025 multiplies by the contact radius sqrt(delta R) "
    "(taken at its mean over contacts)"
)
LEVER_ARMS = "the lever arms R - delta/2 of pair_style granular, in place of R"


class Contact(NamedTuple):
    """Law of a pair of types, or of a type and a wall: coefficients for `law_by_name`, and what has no equal here."""

    law: str
    damping: str
    coefficients: tuple[float, ...]  # kn, kt, mu, damping_n, damping_t
    tension: bool = True
    lacks: tuple[str, ...] = ()
    elastic: tuple[float, ...] = ()  # Young's modulus, Poisson's ratio, 1 if kt follows from them; empty if kn is given


def contact_of(style: str, words: Sequence[str]) -> tuple[Contact, list[str]]:
    """Law of a pair style or a wall, and the words that follow its coefficients.

    Parameters
    ----------
    style : such as hooke/history, or granular

    Raises
    ------
    ValueError
        if the words are not those of the style, or the style is not known.
    """
    if style == "granular":
        return _granular(list(words))
    if style not in HISTORY:
        raise ValueError(f"the style {style}")
    law, damping = HISTORY[style]
    kn, kt, damping_n, damping_t, mu, flag = (None if w == "NULL" else parse_number(w) for w in words[:6])
    kt = 2 / 7 * kn if kt is None else kt
    damping_t = damping_n / 2 if damping_t is None else damping_t
    rest = list(words[6:])
    tension = "limit_damping" not in rest[:1]
    return Contact(law, damping, (kn, kt, mu, damping_n, damping_t if flag else 0.0), tension), rest[not tension :]


def wall_contact(style: str, words: Sequence[str]) -> tuple[Contact, list[str]]:
    """Law of a wall, as `contact_of`: the lever arms at walls are R."""
    contact, rest = contact_of(style, words)
    return contact._replace(lacks=tuple(lack for lack in contact.lacks if lack != LEVER_ARMS)), rest


def _granular(words: list[str]) -> tuple[Contact, list[str]]:
    name, elastic, lacks = words.pop(0), (), [LEVER_ARMS]
    if name not in NORMAL:
        raise ValueError(f"the normal model {name}")
    count, normal = NORMAL[name]
    numbers, words = [parse_number(w) for w in words[:count]], words[count:]
    if count == 2:
        kn, damping_n = numbers
    else:
        elastic, damping_n = (numbers[0], numbers[2]), numbers[1]
        kn = elastic_constants(*elastic)[0]
    lacks += [] if normal else [f"the normal model {name}"]
    tangential, values, damping, tension = "none", [0.0, 0.0, 0.0], "viscoelastic", True
    while words and words[0] in ("tangential", "limit_damping", "cutoff", *OTHERS):
        key = words.pop(0)
        if key == "limit_damping":
            tension = False
        elif key == "cutoff":
            words.pop(0)
        elif key == "tangential":
            tangential = words.pop(0)
            count = TANGENTIAL[tangential]
            values, words = [None if w == "NULL" else parse_number(w) for w in words[:count]], words[count:]
        else:
            model = words.pop(0)
            words = words[OTHERS[key][model] :]
            damping = model if key == "damping" else damping
            lacks += [f"{key} {model}"] if f"{key} {model}" in NO_EQUAL else []
    return _combined(normal or "hertz", tangential, [kn, damping_n, *values], (damping, tension, lacks, elastic)), words


def _combined(normal: str, tangential: str, numbers: list, more) -> Contact:
    damping, tension, lacks, elastic = more
    kn, damping_n, *rest = numbers
    law = next((law for law, model in MODELS.items() if model == (normal, tangential)), None)
    kt, share, mu = rest if len(rest) == 3 else (0.0, *rest, 0.0)[:3]
    if law is None:
        law = "linear" if normal == "hooke" else "hertz_mindlin_reff"
        lacks = lacks if tangential == "none" else [*lacks, f"tangential {tangential} with normal {normal}"]
    elastic = (*elastic, float(kt is None)) if elastic else ()
    if kt is None:
        kt = elastic_constants(*elastic[:2])[1]
    damping = damping if damping in DAMPING else "viscoelastic"
    return Contact(
        law, damping, (kn, kt, mu, damping_n, share * damping_n), tension, tuple(dict.fromkeys(lacks)), elastic
    )


def mixed(a: Contact, b: Contact) -> Contact:
    """Law of two types whose own laws are given, as LAMMPS mixes them: geometric means, except of elastic constants."""
    values = np.sqrt(np.array(a.coefficients) * np.array(b.coefficients))
    if a.elastic and b.elastic:
        young = 1 / sum((1 - poisson**2) / young for young, poisson, _ in (a.elastic, b.elastic))
        poisson = np.sqrt(a.elastic[1] * b.elastic[1])
        values[0] = 4 / 3 * young
        if a.elastic[2] and b.elastic[2]:
            values[1] = elastic_constants(young, poisson)[1]
    return a._replace(coefficients=tuple(values.tolist()), lacks=tuple(dict.fromkeys(a.lacks + b.lacks)))


def law_of_contacts(table: dict[tuple[int, int], Contact], types: int, walls: int) -> tuple[Law, list[str]]:
    """Law from its pairs of materials, and what of them has no equal here; pairs that are not given never meet."""
    first = table[min(table)]
    values = np.tile(np.array(first.coefficients), (types + walls, types + walls, 1))
    lacks = [words for contact in table.values() for words in contact.lacks]
    for (a, b), contact in table.items():
        values[a, b] = values[b, a] = contact.coefficients
        if (contact.law, contact.damping, contact.tension) != (first.law, first.damping, first.tension):
            other = f"type {b + 1}" if b < types else f"wall {b - types + 1}"
            lacks.append(f"the model of type {a + 1} and {other}, which differs from that of type {min(table)[0] + 1}")
    damping = DAMPING[first.damping] + (0 if first.tension else NO_TENSION)
    return Law(NAMES.index(first.law), SHARP, values, damping), list(dict.fromkeys(lacks))
