"""Animation of a mode: the packing displaced by Re(mode exp(st)) over one period."""

from pathlib import Path

import numpy as np

from ...core.arguments import checked, require_shape
from ...core.reading import read_arrays
from ...core.sizes import STATE, Size, require_sizes
from ...core.state import State
from ..sample import HUGE, PackingError
from .frame import Frame

REQUIRED = ("translation", "rotation", "exponent")


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
        arrays = read_arrays(path, remedy="write the modes again", names=REQUIRED)
    except Exception:  # numpy and zipfile raise various errors for a damaged file
        raise PackingError(f"{path} contains no modes: give the .npz that `stickslip stability` wrote") from None
    translation, rotation, exponent = (arrays[name] for name in REQUIRED)
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
    memory = 2 * STATE * len(radius) * count
    require_sizes([Size(f"{count} frames take", memory, "bytes", "use fewer")], PackingError)
    if count < 2 or not 0 < amplitude <= HUGE:
        raise PackingError(
            f"{count} frames of amplitude {amplitude:g} were requested: give at least 2 frames, and an amplitude above "
            f"0 and up to {HUGE:g}"
        )
    require_shape((len(radius), 3), translation=translation, rotation=rotation)
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
