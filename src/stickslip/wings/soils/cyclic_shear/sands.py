"""Curves of sands: reduction of the shear modulus and damping ratio against the amplitude of the shear strain.

G/Gmax = 1/(1 + (γ/γ_r)^a). The damping is b (G/Gmax)^0.1 times that of Masing's rule, without the small-strain part,
which does not come from loops that steps without a rate can have. The coefficients are those of Darendeli (2001,
PI = 0, OCR = 1) and Menq (2003) as implemented in pystrata (github.com/arkottke/pystrata, `site.py`, commit 020a5c3),
not taken from the theses themselves.
"""

from typing import NamedTuple

import numpy as np

ATMOSPHERE = 101.325e3  # [Pa]
CYCLES = 10  # of loading, for which curves are drawn; they hardly depend on it
UNIFORMITY = (1.0, 10.0)  # D60/D10 of uniform and of well-graded sands


class Curve(NamedTuple):
    """Reference strain and curvature of a modified hyperbola."""

    reference: float  # γ_r, at which G is half of Gmax
    curvature: float  # a

    def ratio(self, gamma: np.ndarray) -> np.ndarray:
        """G/Gmax at amplitudes.

        Examples
        --------
        >>> Curve(1e-3, 0.9).ratio(np.array([1e-3]))
        array([0.5])
        """
        return 1 / (1 + (gamma / self.reference) ** self.curvature)

    def damping(self, gamma: np.ndarray) -> np.ndarray:
        """Damping ratio of loops at amplitudes."""
        a, x = self.curvature, gamma / self.reference
        masing = 100 / np.pi * (4 * (x - np.log1p(x)) * (1 + x) / x**2 - 2)  # [%] of a hyperbola with a = 1
        powers = (-1.1143 * a**2 + 1.8618 * a + 0.2523, 0.0805 * a**2 - 0.0710 * a - 0.0095,
                  -0.0005 * a**2 + 0.0002 * a + 0.0003)  # fmt: skip
        masing = sum(c * masing**k for k, c in enumerate(powers, start=1))
        scaled = (0.6329 - 0.00566 * np.log(CYCLES)) * self.ratio(gamma) ** 0.1 * masing / 100
        return np.maximum.accumulate(scaled)


def darendeli(pressure: float) -> Curve:
    """Curve of Darendeli (2001) for soils without plasticity at a mean effective stress [Pa]."""
    return Curve(3.52e-4 * (pressure / ATMOSPHERE) ** 0.3483, 0.9190)


def menq(pressure: float, uniformity: float) -> Curve:
    """Curve of Menq (2003) for sands of a coefficient of uniformity D60/D10 at a mean effective stress [Pa]."""
    p = pressure / ATMOSPHERE
    reference = 1.2e-3 * uniformity**-0.6 * p ** (0.5 * uniformity**-0.15)
    return Curve(reference, 0.86 + 0.1 * float(np.log10(p)))


def band(pressure: float, gamma: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Least and largest G/Gmax and damping ratio of sands at amplitudes: Darendeli's curve, and those of Menq."""
    curves = [darendeli(pressure), *(menq(pressure, uniformity) for uniformity in UNIFORMITY)]
    values = {"G_ratio": [c.ratio(gamma) for c in curves], "damping": [c.damping(gamma) for c in curves]}
    return {name: (np.min(rows, axis=0), np.max(rows, axis=0)) for name, rows in values.items()}
