"""Quantities that colour the grains: columns of a frame, each with its unit."""

import numpy as np

from ..core.state import SLIDE
from ..core.units import current_units, unit_name
from ..data.exchange.frame import Frame

Mode = tuple[np.ndarray, np.ndarray, complex]  # translation, rotation (N, 3) complex; exponent, as from `read_mode`
DISPLACEMENT = "mode displacement"


def quantities(
    frame: Frame, *, first: Frame | None = None, mode: Mode | None = None
) -> dict[str, tuple[np.ndarray, str]]:
    """Quantities by which the grains of a frame can be coloured, as {name: (values per grain, unit)}.

    The pressure of a grain is p = (1/(d V)) Σ_c f·l, with l from its centre to the contact, V its own volume (area in
    two dimensions) and compression positive. It is absent if the law, and therefore the forces, are unknown.

    Parameters
    ----------
    frame : from `frame_of`
    first : an earlier frame, for displacements since then
    mode : translation, rotation and exponent; its displacements are relative to the largest

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin()
    >>> pair = ss.packings.from_arrays([[0, 0, 0], [0.99, 0, 0]], [0.5, 0.5], law)
    >>> quantities(ss.io.frame_of(pair, law))["coordination"][0]
    array([1, 1])
    """
    grains, dim = frame.state.grains, frame.state.cell.dim
    length, speed = unit_name("length"), unit_name("length/time")
    out = {
        "radius": (grains.radius, length),
        "material": (grains.material, ""),
        "coordination": (frame.grains["coordination"], ""),
        "sliding contacts": (_count_sliding(frame), ""),
    }
    if "force_n" in frame.contacts:
        plain = "force/length" if dim == 2 else "force/length²"
        unit = unit_name("force/length^(dim-1)", dim) if current_units() else plain
        out["pressure"] = (_pressure(frame), unit)
    out["speed"] = (np.linalg.norm(grains.velocity, axis=1), speed)
    if first is not None and first is not frame and len(first.state.grains.radius) == len(grains.radius):
        moved = grains.position - first.state.grains.position
        out["displacement"] = (np.linalg.norm(moved, axis=1), length)
    if mode is not None:
        for name, part in ((DISPLACEMENT, mode[0]), ("mode rotation", mode[1])):
            size = np.sqrt((np.abs(part) ** 2).sum(axis=1))
            out[name] = (size / size.max() if size.max() > 0 else size, "share of the largest")
    return {name: (np.asarray(values), unit) for name, (values, unit) in out.items()}


def _by_grain(frame: Frame, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Sum contributions of contacts to their two grains; walls are ignored."""
    c, n = frame.contacts, len(frame.state.grains.radius)
    ends, values = np.concatenate([c["i"], c["j"]]), np.concatenate([i, j])
    return np.bincount(ends[ends < n], values[ends < n], minlength=n)


def _count_sliding(frame: Frame) -> np.ndarray:
    slides = (frame.contacts["mode"] == SLIDE).astype(float)
    return _by_grain(frame, slides, slides).astype(int)


def _pressure(frame: Frame) -> np.ndarray:
    c, radius, dim = frame.contacts, frame.state.grains.radius, frame.state.cell.dim
    force = c["force_n"] * np.linalg.norm(
        c["branch"], axis=1
    )  # f·l: the tangential force has no component along the branch
    other = np.where(c["j"] < len(radius), radius[np.minimum(c["j"], len(radius) - 1)], 0.0)
    share = radius[c["i"]] / (radius[c["i"]] + other)
    volume = np.pi * radius**2 if dim == 2 else 4 / 3 * np.pi * radius**3
    return _by_grain(frame, share * force, (1 - share) * force) / (dim * volume)
