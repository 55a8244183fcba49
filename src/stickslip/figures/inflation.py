"""Figure of the displacements around an inflated grain."""

import numpy as np

from ..solve.inclusion import Inflation
from ..solve.screening import ScreeningFits
from .style import BLACK, BLUE, GREEN, PAGE, RED, WIDTH, label_axes, styled, subplots

LOOK = {"elastic": (BLUE, "-"), "dipole": (GREEN, "--"), "odd": (RED, ":")}


@styled
def inclusion(field: Inflation, fits: ScreeningFits | None = None):
    """Radial and tangential displacements around an inflated grain, with elasticity, screening and the moduli.

    Bars are standard errors.

    Parameters
    ----------
    field : from `modes.inflate` or `protocols.inflate`
    fits : `field.fit()` unless given
    """
    fits = field.fit() if fits is None else fits
    rings, size = fits.rings, 1 / field.growth
    figure, panels = subplots(1, len(rings.mean), figsize=((WIDTH, PAGE)[len(rings.mean) > 1], 2.7), squeeze=False)
    r = np.linspace(rings.radius[0], rings.radius[-1], 300)
    for k, (axes, name) in enumerate(zip(panels[0], ("radial", "tangential"), strict=False)):
        axes.errorbar(rings.radius, size * rings.mean[k], size * rings.error[k], fmt="o", color=BLACK, label="grains")
        for fit in fits.models:
            color, dashes = LOOK[fit.model]
            w = size * fit.displacement(r)
            axes.plot(r, (w.real, w.imag)[k], dashes, color=color, label=fit.model)
        if k == 0 and np.isfinite(fits.lame):
            axes.plot(r, size * field.elastic(r), "-.", color=BLACK, lw=0.7, label="elastic, from the moduli")
        axes.axhline(0, color=BLACK, lw=0.4)
        label_axes(axes, x=("distance", "length"), y=(f"{name} displacement\nover growth", "length"))
    panels[0, 0].legend()
    return figure
