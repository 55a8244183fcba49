"""Frames between the stored states of a run, for movies: interpolated, not simulated."""

import numpy as np
from scipy.interpolate import PchipInterpolator

from ..data.exchange.frame import Frame

STRETCH = 1.02  # of a contact between two stored states, above which it is left out there


def frames_between(frames: list[Frame], count: int) -> list[Frame]:
    """`count` frames at equal intervals from the first stored frame to the last.

    Positions and angles follow monotone cubic interpolation in time (in number, if time does not advance): smooth
    curves through the stored values that do not overshoot. Cells, walls and velocities are interpolated linearly. A
    contact that only one of the two neighbouring stored frames has fades with the distance to that frame, and is left
    out where its grains are apart; forces of a contact that both have are interpolated. All else is that of the nearer
    stored frame.

    Parameters
    ----------
    frames : of the same grains, in order

    Source
    ------
    Fritsch and Butland, doi:10.1137/0905021.
    """
    times = np.array([frame.state.time for frame in frames], float)
    if not (np.diff(times) > 0).all():
        times = np.arange(len(frames), dtype=float)
    if len(frames) < 2:
        return frames * count
    position, angle = (
        PchipInterpolator(times, np.stack([getattr(frame.state.grains, name) for frame in frames]))
        for name in ("position", "angle")
    )
    out = []
    for t in np.linspace(times[0], times[-1], count):
        k = int(np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2))
        share = float((t - times[k]) / (times[k + 1] - times[k]))
        out.append(_mixed(frames[k], frames[k + 1], share, position(t), angle(t)))
    return out


def _mixed(before: Frame, after: Frame, share: float, position: np.ndarray, angle: np.ndarray) -> Frame:
    """Frame between two others, with given positions and angles; `share` is 0 at the first and 1 at the second."""
    first, last, near = before.state, after.state, before if share < 0.5 else after

    def mix(a, b):
        return (1 - share) * a + share * b

    velocity, spin = (mix(getattr(first.grains, name), getattr(last.grains, name)) for name in ("velocity", "spin"))
    grains = near.state.grains._replace(position=position, angle=angle, velocity=velocity, spin=spin)
    cell = near.state.cell._replace(vectors=mix(first.cell.vectors, last.cell.vectors))
    walls = near.state.walls
    if first.walls.point.shape == last.walls.point.shape:
        walls = walls._replace(point=mix(first.walls.point, last.walls.point))
    state = near.state._replace(grains=grains, cell=cell, walls=walls, time=float(mix(first.time, last.time)))
    contacts = _mixed_contacts(before, after, share, position)
    return Frame(state, near.law, near.grains, contacts, moving=True)


def _mixed_contacts(before: Frame, after: Frame, share: float, position: np.ndarray) -> dict[str, np.ndarray]:
    """Contacts of two frames: their branch vectors at given positions, and weighted forces."""
    parts = []
    for frame, weight in ((before, 1 - share), (after, share)):
        c, n, shift = frame.contacts, len(position), position - frame.state.grains.position
        step = shift[c["i"]] - np.where((c["j"] < n)[:, None], shift[np.minimum(c["j"], n - 1)], 0.0)
        branch = c["branch"] + step
        long, stored = (np.linalg.norm(b, axis=1) for b in (branch, c["branch"]))
        force = weight * c.get("force_n", np.ones(len(c["i"])))
        image = c.get("image", np.zeros(len(c["i"]), int))
        key = np.column_stack([c["i"], c["j"], image.reshape(len(c["i"]), -1)])
        kept = (long <= STRETCH * stored) & (weight > 0)
        parts.append([column[kept] for column in (key, branch, force, c["mode"], np.full(len(key), weight))])
    key, branch, force, mode, weight = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    _, rows, number = np.unique(key, axis=0, return_index=True, return_inverse=True)
    number, total = number.ravel(), np.zeros(len(rows))
    np.add.at(total, number, weight)
    mean = np.zeros((len(rows), 3))
    np.add.at(mean, number, weight[:, None] * branch)
    loads = np.bincount(number, force, minlength=len(rows))
    order = np.lexsort((weight, number))  # the mode is that of the nearer frame, the last of each group
    last = np.zeros(len(rows), int)
    last[number[order]] = order
    mean /= total[:, None]
    return {"i": key[rows, 0], "j": key[rows, 1], "mode": mode[last], "branch": mean, "force_n": loads}
