"""Frames for movies: of a mode, Re(mode exp(st)) over one period, and between the stored states of a run."""

from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from ...core.arguments import checked
from ...core.state import State
from ..sample import HUGE, PackingError
from .frame import Frame

REQUIRED = ("translation", "rotation", "exponent")
STRETCH = 1.02  # of a contact between two stored states, above which it is left out there


@checked
def read_mode(path: str | Path, number: int, n: int) -> tuple[np.ndarray, np.ndarray, complex]:
    """Read the translation and rotation, (N, 3) complex, and the exponent s of a mode exp(st) written by `stability`.

    Raises
    ------
    PackingError
        if the file is of another kind, or belongs to another packing.
    """
    if not Path(path).is_file():
        raise PackingError(f"{path} is not a file: give the modes that `stickslip stability` wrote")
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {name: file[name] for name in REQUIRED}
    except Exception:  # numpy and zipfile raise various errors for a damaged file
        raise PackingError(f"{path} contains no modes: give the .npz that `stickslip stability` wrote") from None
    translation, rotation, exponent = (found[name] for name in REQUIRED)
    if any(array.dtype.kind not in "fciu" for array in (translation, rotation, exponent)):
        raise PackingError(f"{path} contains entries that are not numbers: write the modes again")
    if exponent.ndim != 1 or translation.shape != (len(exponent), *translation.shape[1:2], 3):
        raise PackingError(f"{path} contains arrays that do not belong together: write the modes again")
    if not len(exponent):
        raise PackingError(f"{path} contains no modes: the packing has no growing mode")
    if not 0 <= number < len(exponent):
        raise PackingError(f"mode {number} was requested: {path} has 0 to {len(exponent) - 1}, the fastest first")
    if translation.shape[1] != n or rotation.shape != translation.shape:
        raise PackingError(
            f"{path} has modes of {translation.shape[1]} grains, but the packing has {n}: give modes of this packing"
        )
    if not (np.isfinite(translation).all() and np.isfinite(rotation).all() and np.isfinite(exponent).all()):
        raise PackingError(f"{path} contains NaN or infinity: write the modes again")
    return translation[number], rotation[number], complex(exponent[number])


@checked
def mode_frames(
    frame: Frame, translation: np.ndarray, rotation: np.ndarray, exponent: complex, *, count: int = 48,
    amplitude: float = 0.3, grow: bool = False,
) -> list[Frame]:  # fmt: skip
    """Frames of Re(mode exp(st)) over one period 2π/|Im s|.

    A non-oscillating mode is animated with the period 2π/|s|, or 2π if s = 0.

    Parameters
    ----------
    frame : frame of the packing; its contacts and forces are not changed
    translation, rotation : (N, 3) complex displacements, and R·angle
    exponent : s [1/time]
    count : number of frames per period
    amplitude : largest displacement of any grain, divided by its radius
    grow : if False, the growth is left out, so that the animation can be looped; if True, it ends at `amplitude`
    """
    state, radius = frame.state, frame.state.grains.radius[:, None]
    if count < 2 or not 0 < amplitude <= HUGE:
        raise PackingError(
            f"{count} frames of amplitude {amplitude:g} were requested: give at least 2 frames, and an amplitude above "
            f"0 and up to {HUGE:g}"
        )
    largest = float((np.sqrt((np.abs(translation) ** 2).sum(axis=1, keepdims=True)) / radius).max())
    turning = float((np.abs(rotation) / radius).max())
    if not max(largest, turning) > 0:
        raise PackingError("the mode moves no grain: choose another mode")
    scale = amplitude / (largest or turning)
    period = 2 * np.pi / (abs(exponent.imag) or abs(exponent) or 1.0)
    if not np.isfinite(period):
        raise PackingError(f"the mode has the exponent {exponent:.3g}, whose period is not finite: choose another mode")
    out = []
    for t in np.arange(count) / count * period:
        factor = np.exp(1j * (exponent.imag * t if exponent.imag else 2 * np.pi * t / period))
        if grow:
            factor *= np.exp(exponent.real * (t - period))
        out.append(
            _displaced(frame, *((scale * factor * part).real for part in (translation, rotation)), state.time + t)
        )
    return out


def _displaced(frame: Frame, shift: np.ndarray, roll: np.ndarray, time: float) -> Frame:
    state, radius = frame.state, frame.state.grains.radius[:, None]
    grains = state.grains._replace(position=state.grains.position + shift, angle=state.grains.angle + roll / radius)
    moved: State = state._replace(grains=grains, time=float(time))
    c, n = frame.contacts, len(shift)
    step = shift[c["i"]] - np.where((c["j"] < n)[:, None], shift[np.minimum(c["j"], n - 1)], 0.0)
    columns = frame.grains | {"displacement": shift, "rotation": roll / radius}
    turned = grains.angle if state.cell.dim == 2 else roll / radius
    return Frame(moved, frame.law, columns, c | {"branch": c["branch"] + step}, turned, moving=True)


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
