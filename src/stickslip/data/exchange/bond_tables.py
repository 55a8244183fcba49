"""Tables of bonds that accompany a packing: a row for each bond, with its two grains, stiffnesses and strengths.

`NAMES` lists the columns. Those of YADE are attributes of `CohFrictPhys` and `JCFpmPhys`: the stiffnesses of a bond,
and the loads at which it breaks in tension or in shear, whichever comes first. Those of PFC are properties of
`linearpbond` per area of the cement, from which the stiffnesses and strengths of a parallel bond are computed.

Source: documentation of YADE, classes CohFrictPhys and JCFpmPhys; of PFC 7, linear parallel bond model.
"""

from pathlib import Path

import numpy as np

from ...core.contacts.bonding import bonded
from ...core.laws.bonds import BY_BEAM, UNBREAKABLE, beam_bond, coefficients, parallel_bond
from ...core.readable import pluralize
from ...core.state import State
from ..sample import Assumption, PackingError, naming, refusing
from .columns import HEAD, head_text, plain_name, read_content
from .force_lists import ALIASES
from .table_file import names_of, read_columns

NAMES = {  # quantity: column names of this package and YADE, then of PFC
    "i": (*ALIASES["i"], "end1", "ball1", "contactend1"),
    "j": (*ALIASES["j"], "end2", "ball2", "contactend2"),
    "kn": ("kn", "normalstiffness"), "ks": ("ks", "shearstiffness", "kt"),
    "kb": ("kb", "kr", "krb", "bendingstiffness"), "kw": ("kw", "ktw", "twistingstiffness"),
    "tension": ("tension", "normaladhesion", "fnmax", "strengthn"),
    "shear": ("shear", "shearadhesion", "fsmax", "strengths"),
    "bending": ("bending", "rollingadhesion", "strengthb"), "twisting": ("twisting", "twistingadhesion", "strengtht"),
    "broken": ("broken", "cohesionbroken", "isbroken"),
    "pb_kn": ("pbkn",), "pb_ks": ("pbks",), "pb_ten": ("pbten",), "pb_coh": ("pbcoh",), "pb_rmul": ("pbrmul",),
    "pb_state": ("pbstate",), "pb_fa": ("pbfa",),
}  # fmt: skip
KNOWN = {other: name for name, others in NAMES.items() for other in others}
NEEDED = "i, j and kn, ks (forces per length), or i, j and pb_kn, pb_ks (per area, as in PFC)"
BONDED = 3  # `pb_state` of a parallel bond; 1 broke in tension, 2 in shear, 0 was never bonded


def _name(word: str) -> str:
    return KNOWN.get(plain_name(word), "")


def is_table_of_bonds(path: Path) -> bool:
    """Return True for a table whose headings name two grains and the stiffness of a bond between them."""
    lines = [line for line in head_text(read_content(path, HEAD)).splitlines() if line.strip()]
    found = [set(map(_name, names_of(line) or [])) for line in lines[:20]]
    return any({"i", "j"} <= names and names & {"kn", "pb_kn"} for names in found)


def with_listed_bonds(state: State, path: Path) -> tuple[State, list[str]]:
    """State with the bonds of a table, assumed to be at rest at the given positions, and notes on the assumptions.

    Raises
    ------
    PackingError
        If columns are missing or repeated, a stiffness or strength has an invalid value, or a grain does not exist.
    """
    columns, notes = read_columns(path, {}, lambda names: {"i", "j"} <= set(map(_name, names)))
    known = {}
    for word, values in columns.items():
        name = _name(word)
        if name in known:
            raise PackingError(f"{path} has two columns for {name}: keep one")
        if name:
            known[name] = np.asarray(values, float)
    of_pfc = "pb_kn" in known
    if not ({"i", "j"} <= set(known) and {"pb_ks" if of_pfc else "ks", "pb_kn" if of_pfc else "kn"} <= set(known)):
        raise PackingError(f"{path} has the columns {' '.join(list(columns)[:20])}: {NEEDED} are needed")
    _check_values(path, known)
    pairs, counted = _numbers(path, known, len(state.grains.radius), of_pfc)
    there = known["pb_state"] > 0 if "pb_state" in known else np.ones(len(pairs), bool)
    known, pairs = {name: values[there] for name, values in known.items()}, pairs[there]
    with naming(path), refusing():
        made = bonded(state, beam_bond(1.0, 1.0, 1.0, 1.0), pairs=pairs)
    old = 0 if state.bonds is None else len(state.bonds.i)
    if of_pfc:
        stiffness, strength, arm = _parallel(made, known, old)
    else:  # one column for each stiffness and each strength
        zero, endless, arm = np.zeros(len(pairs)), np.full(len(pairs), UNBREAKABLE), made.bonds.arm[old:]
        stiffness = np.stack([known.get(name, zero) for name in ("kn", "ks", "kb", "kw")], axis=1)
        loads = ("tension", "shear", "bending", "twisting")
        strength = np.stack([known.get(name, endless) for name in loads], axis=1)
    broken = known.get("broken", np.zeros(len(pairs))) > 0
    failed = np.zeros(len(pairs), np.int8)
    if "pb_state" in known:
        broken = known["pb_state"] < BONDED
        failed[broken] = known["pb_state"][broken].astype(np.int8)  # numbered as in `FAILURES`
    new = {
        "stiffness": stiffness, "strength": np.minimum(strength, UNBREAKABLE), "arm": arm, "intact": ~broken,
        "failed": failed, "form": np.full(len(pairs), BY_BEAM, np.int8),
    }  # fmt: skip
    parts = {name: np.concatenate([getattr(made.bonds, name)[:old], value]) for name, value in new.items()}
    held = f"{pluralize(len(pairs), 'bond')} of {path.name}, {int(broken.sum())} of them broken"
    notes += [Assumption(f"{held}: taken to be at rest at these positions"), *counted]
    if known.get("pb_fa", np.zeros(1)).any():
        notes.append(Assumption(f"the friction angle pb_fa of {path.name} was left out: shear strength is pb_coh"))
    return made._replace(bonds=made.bonds._replace(**parts)), notes


def _check_values(path: Path, known: dict[str, np.ndarray]) -> None:
    for name, values in known.items():
        positive = name in ("kn", "pb_kn", "pb_rmul", "tension", "shear", "bending", "twisting", "pb_ten", "pb_coh")
        bad = values[~(np.isfinite(values) & (values > 0 if positive else values >= 0))]
        if len(bad) and name not in "ij":
            kind = "positive" if positive else "zero or positive"
            raise PackingError(f"{path} has {name} = {bad[0]:g}: it must be {kind} and finite")
    states = known.get("pb_state", np.zeros(0))
    if len(bad := states[~np.isin(states, range(BONDED + 1))]):
        raise PackingError(f"{path} has pb_state = {bad[0]:g}: it must be 0, 1, 2 or 3")


def _numbers(path: Path, known: dict[str, np.ndarray], n: int, of_pfc: bool) -> tuple[np.ndarray, list[str]]:
    """(K, 2) rows of the bonded grains, from 0, and an assumption if the file may count from 0 or from 1."""
    ends = np.stack([known["i"], known["j"]], axis=1)
    if not len(ends) or not (ends == np.round(ends)).all():
        raise PackingError(f"{path} lists no pairs of grains: i and j must be whole numbers, which count grains from 0")
    unknown = bool(ends.min() >= 1 and ends.max() < n)
    start = int(of_pfc if unknown else ends.min() >= 1)  # PFC counts from 1
    if not (ends.min() >= start and ends.max() < n + start):
        raise PackingError(
            f"{path} has bodies {ends.min():g} to {ends.max():g}, but the packing has {n} grains: number them from 0 "
            "or 1, and leave out bonds to walls, which are not supported"
        )
    counted = f"grains in {path.name} are assumed to be numbered from {start}, as neither 0 nor {n} occurs"
    return ends.astype(np.int64) - start, [Assumption(counted)] * unknown


def _parallel(made: State, known: dict[str, np.ndarray], old: int):
    """Stiffness and strength of cement whose radius is pb_rmul times that of the smaller grain."""
    bonds, radius, dim, k = made.bonds, made.grains.radius, made.cell.dim, len(known["i"])
    ends = radius[bonds.i[old:]], radius[bonds.j[old:]]
    bond = parallel_bond(1.0, 1.0, 1.0, 1.0)._replace(size=known.get("pb_rmul", np.ones(k)))
    stiffness, _, strength, arm = coefficients(bond, dim, *ends, bonds.length[old:])
    tensile, sheared = (known.get(name, np.full(k, UNBREAKABLE)) for name in ("pb_ten", "pb_coh"))
    moduli = np.stack([known["pb_kn"], known["pb_ks"], known["pb_kn"], known["pb_ks"]], axis=1)
    limits = np.stack([tensile, sheared, tensile, sheared], axis=1)
    unlimited = np.full_like(strength, UNBREAKABLE)
    strength = np.multiply(strength, limits, out=unlimited, where=strength < UNBREAKABLE)  # disks do not twist
    return stiffness * moduli, strength, arm
