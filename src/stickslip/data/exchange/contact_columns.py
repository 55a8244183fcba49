"""Columns of contacts without names, identified by what they contain: ids, distances, branch vectors and forces."""

from pathlib import Path

import numpy as np

from ..sample import PackingError
from .content import Packing

SLACK = 1e-3  # relative deviation of what has few digits
MOST = 40  # columns
TOTAL = "Fx", "Fy", "Fz"


def pair_branches(packing: Packing, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """(M, 3) vectors from grain j to the nearest image of grain i [length]."""
    place = np.asarray(packing.arrays["position"])
    branch = place[i] - place[j]
    if "cell" in packing.arrays:
        cell, periodic = np.asarray(packing.arrays["cell"]), np.asarray(packing.arrays.get("periodic", (True,) * 3))
        for axis in (2, 1, 0):
            if periodic[axis]:
                branch = branch - np.round(branch[:, axis] / cell[axis, axis])[:, None] * cell[axis]
    return branch


def group_hint(packing: Packing) -> str:
    """Sentence on grains that are those of a group, by gaps in their numbers; empty for all grains."""
    ids = np.zeros(0, int) if packing.ids is None else packing.ids
    if not len(ids) or ids[-1] == len(ids):
        return ""
    return f"the {len(ids)} grains have ids up to {ids[-1]}, as in the dump of a group; give one of all grains"


def name_contact_columns(values: np.ndarray, packing: Packing, path: Path) -> list[str]:
    """Names of columns of contacts, in the order in which they are; "" for what is not needed.

    The two columns of ids name grains that touch. The distance and the branch vector of each pair follow from the
    positions of its grains. A normal force is parallel to the branch vector, a tangential one perpendicular to it. If
    there is neither, the last three columns that are neither positions nor distances are the total force.

    Parameters
    ----------
    values : (M, columns)

    Raises
    ------
    PackingError
        if no columns fit.
    """
    names, ids = [""] * values.shape[1], packing.ids
    ends = next((k for k in range(min(values.shape[1], MOST) - 1) if _are_pairs(values[:, k : k + 2], packing)), None)
    if ends is None or ids is None:
        raise PackingError(
            f"{path} has {values.shape[1]} columns without names, none of which are the ids of grains that touch: "
            f"{group_hint(packing) or 'its grains are those of another time step or run, or name its columns'}"
        )
    i, j = np.searchsorted(ids, values[:, ends : ends + 2].astype(np.int64)).T
    names[ends : ends + 2] = "i", "j"
    branch = pair_branches(packing, i, j)
    length = np.linalg.norm(branch, axis=1)
    for k in range(values.shape[1]):
        if not names[k] and _is_small(values[:, k] - length, length):
            names[k] = "dist"
            break
    normal, at = branch / length[:, None], 0
    while at + 3 <= min(values.shape[1], MOST):
        kind = "" if any(names[at : at + 3]) else _kind_of_vector(values[:, at : at + 3], branch, normal, names)
        names[at : at + 3] = [kind + axis for axis in "xyz"] if kind else names[at : at + 3]
        at += 3 if kind else 1
    if "tx" in names:
        return names
    return _with_total_force(names, values, packing, (i, j), normal)


def _is_small(rest: np.ndarray, whole: np.ndarray) -> bool:
    """Return True if what remains is a small share of the whole."""
    return bool(np.abs(rest).sum() <= SLACK * np.abs(whole).sum())


def _are_pairs(columns: np.ndarray, packing: Packing) -> bool:
    """Return True if two columns are ids of grains of which nearly all pairs touch."""
    if not (columns == np.round(columns)).all() or not np.isin(columns, packing.ids).all():
        return False
    i, j = np.searchsorted(packing.ids, columns.astype(np.int64)).T
    reach = np.asarray(packing.arrays["radius"])[i] + np.asarray(packing.arrays["radius"])[j]
    near = np.linalg.norm(pair_branches(packing, i, j), axis=1) < (1 + SLACK) * reach
    return bool((i != j).all() and near.mean() > 0.9)


def _kind_of_vector(vector: np.ndarray, branch: np.ndarray, normal: np.ndarray, names: list[str]) -> str:
    """Kind of three columns: "d" branch vector, "f" normal force, "t" tangential force, or "" for something else."""
    along = np.einsum("ck,ck->c", vector, normal)
    across = vector - along[:, None] * normal
    if "dx" not in names and _is_small(vector - branch, branch):
        return "d"
    if "fx" not in names and along.any() and _is_small(across, along) and along.sum() > 0:
        return "f"
    known = across.any() or "fx" in names  # without friction, tangential forces are zero
    return "t" if "tx" not in names and known and _is_small(along, across) else ""


def _with_total_force(names: list[str], values: np.ndarray, packing: Packing, ends, normal: np.ndarray) -> list[str]:
    """Name the columns of the total force on the first grain, which presses the grains apart."""
    place = np.asarray(packing.arrays["position"])
    flags = (values == np.round(values)).all(axis=0)
    for at in range(values.shape[1] - 3, -1, -1):
        vector = values[:, at : at + 3]
        known = any(names[at : at + 3]) or flags[at : at + 3].all()
        if known or any(_is_small(vector - place[end], place[end]) for end in ends):
            continue
        along = np.einsum("ck,ck->c", vector, normal)
        if along.sum() > 0.5 * np.linalg.norm(vector, axis=1).sum():
            names[at : at + 3] = TOTAL
            break
    return names
