"""Figures of responses to probes: envelopes of stress, second-order work by direction, and its cones."""

from typing import Annotated, Any

import numpy as np

from ..core.arguments import Requirement, Result, require_filled
from .style import BLACK, COLORS, PAGE, RED, label_axes, styled, subplots

_Envelope = Annotated[Any, Result("Envelope", ("angle", "plane", "strain", "stress", "elastic"))]


@styled
def response_envelopes(
    envelopes: Annotated[list[_Envelope] | tuple[_Envelope, ...], Requirement(require_filled)],
    labels: list[str] | tuple[str, ...] = (),
    names: tuple[str, str] = ("yy", "xx"),
):
    """Responses of several states to probes in one plane: stress per unit strain, and second-order work by direction.

    Dashed curves are the elastic part, if contacts at the limit stick. Red bands are directions of strain with negative
    second-order work.

    Parameters
    ----------
    envelopes : results of `protocols.response_envelope` with control="strain"
    labels : one for each
    names : of the components along the two axes of the plane
    """
    figure, (left, right) = subplots(1, 2, figsize=(PAGE, 3.0))
    closed = [np.append(np.arange(len(e.angle)), 0) for e in envelopes]
    for k, (envelope, rows) in enumerate(zip(envelopes, closed, strict=True)):
        color, label = COLORS[k % len(COLORS)], labels[k] if k < len(labels) else None
        left.plot(*envelope.components("elastic")[rows, ::-1].T, "--", color=color, lw=0.6)
        left.plot(*envelope.components("stress")[rows, ::-1].T, color=color, label=label)
        angle = np.degrees(np.append(envelope.angle, 2 * np.pi))
        right.plot(angle, envelope.normalised_work[rows], color=color, label=label)
        for begin, end in np.degrees(envelope.cones):
            for turn in (0, 360):
                right.axvspan(begin + turn, end + turn, color=RED, alpha=0.15, lw=0)
    left.axhline(0, color=BLACK, lw=0.4)
    left.axvline(0, color=BLACK, lw=0.4)
    left.set_aspect("equal", "datalim")
    unit = "force/length" if envelopes[0].stress.shape[-1] == 2 else "force/length^2"
    label_axes(left, **{k: (f"dσ/|dε| along {name}", unit) for k, name in zip("yx", names, strict=True)})
    right.axhline(0, color=BLACK, lw=0.4)
    right.set(xlim=(0, 360), xticks=range(0, 361, 90), ylabel="dσ:dε/(|dσ||dε|)")
    right.set_xlabel(f"direction of the strain [°]: 0 is {names[0]}, 90 is {names[1]}")
    if labels:
        right.legend(loc="best", fontsize="small")
    return figure
