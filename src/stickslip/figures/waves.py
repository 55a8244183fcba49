"""Figure of the dispersion and damping of waves."""

import numpy as np

from ..solve.waves import Dispersion
from .style import COLORS, PAGE, label_axes, styled, subplots


@styled
def dispersion(waves: Dispersion, speeds: np.ndarray | None = None):
    """Frequency and damping of each branch against the length of the wave vector.

    Parameters
    ----------
    waves : from `modes.dispersion`
    speeds : (K, dim) from `modes.elastic_speeds` for these wave vectors, drawn as lines ω = c k with their means
    """
    if speeds is not None and (speeds.ndim != 2 or not len(speeds)):
        raise ValueError(f"speeds has shape {speeds.shape}: give one of `elastic_speeds`, (K, dim)")
    figure, (left, right) = subplots(1, 2, figsize=(PAGE, 3.0))
    k, names = np.linalg.norm(waves.wavevector, axis=1), waves.names
    order, kinds = np.argsort(k, kind="stable"), list(dict.fromkeys(names))
    for name, marker in zip(kinds, "os^", strict=True):
        color, columns = COLORS[kinds.index(name)], np.flatnonzero(np.array(names) == name)
        for axes, values in ((left, waves.frequency), (right, waves.damping)):
            lines = axes.plot(k[order], values[order][:, columns], marker, ms=3.5, color=color)
            lines[0].set_label(name)
        if speeds is not None and columns[0] < speeds.shape[1]:
            for c in np.unique(speeds[:, columns].mean(axis=0)):
                left.plot([0, k.max()], [0, c * k.max()], color=color, lw=0.8)
    label_axes(left, x=("wave number k", "1/length"), y=("frequency ω", "1/time"))
    label_axes(right, x=("wave number k", "1/length"), y=("damping −Re s", "1/time"))
    for axes in (left, right):
        axes.set_xlim(0, None)
        axes.set_ylim(min(0, axes.get_ylim()[0]) if axes is right else 0, None)
    left.legend()
    return figure
