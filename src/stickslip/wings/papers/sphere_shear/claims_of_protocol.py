"""Statements of Bonfanti et al. 2020 on the drag that finds equilibria, and on the isotropy of the packings."""

import numpy as np
from scipy.special import chdtri

from .... import State, spectrum
from ....core.state import volume
from ....kit import Claim, claim
from ....measure import fabric, touching
from ....solve.freedom import ZERO_BELOW
from .medians import describe_range, median_claim
from .simulate import ShearPath, ShearResult

DRAG = 2.2e-2  # η_0 of the paper [1/time]
DIAMETER = 1.0  # 2σ_1, the unit of length
LEVEL = 0.05  # level of the test of isotropy


def protocol_claims(main: ShearResult) -> list[Claim]:
    """Claims about the drag, from moduli and spectra of the paths, and about the fabric at the first pairs."""
    said = (
        'Sec. III: "this value of eta_0 ensures that the dynamics is overdamped as the damping timescale is of the '
        'order of the time that sounds needs to travel one particle diameter"'
    )
    times = [sound_time(path) for path in main.paths]
    spectra = [spectrum(path.last, main.law, modes=False).eigenvalues for path in main.paths]
    shares, softest = zip(*map(damping_shares, spectra), strict=True)
    return [
        median_claim(
            "drag-time-over-sound-time", said, 1.0, [1 / (DRAG * time) for time in times], "1", "drag",
            f"1/eta_0 = {1 / DRAG:.3g}; sound of the slower, transverse kind takes {describe_range(times)}, from the "
            f"shear modulus of the first step",
        ),
        claim(
            "dynamics-overdamped", said, True, max(shares) > 0.5, "", 0.0,
            f"share of the modes with omega <= eta_0/2, which that drag overdamps: {describe_range(shares)}; softest "
            f"mode: {describe_range(softest)}",
        ),
        _isotropy(main),
    ]  # fmt: skip


def sound_time(path: ShearPath) -> float:
    """Time in which transverse sound travels a diameter 2σ_1, d √(ρ/G), with G from the first strain step."""
    modulus = (path.shear_stress[1] - path.shear_stress[0]) / (path.strain[1] - path.strain[0])
    density = path.last.grains.mass.sum() / volume(path.last)
    return float(DIAMETER * np.sqrt(density / modulus)) if modulus > 0 else np.nan


def damping_shares(eigenvalues: np.ndarray) -> tuple[float, float]:
    """Share of the modes with ω ≤ η_0/2, without zero modes, and the smallest ω [1/time]."""
    size = np.abs(eigenvalues)
    frequency = np.sqrt(size[size > ZERO_BELOW * size.max()])
    return float(np.mean(frequency <= DRAG / 2)), float(frequency.min())


def isotropy_statistic(state: State) -> float:
    """Sum of squares that has a χ² distribution for many independent, isotropic normals.

    With the deviator D of the fabric tensor of n contacts, it is n d (d + 2)/2 |D|², with d (d + 1)/2 − 1 degrees of
    freedom in d dimensions, as a component has the variance 2/(n d (d + 2)).
    """
    dim = state.cell.dim
    deviator = fabric(state)[:dim, :dim] - np.eye(dim) / dim
    return float(len(touching(state)) * dim * (dim + 2) / 2 * (deviator**2).sum())


def _isotropy(main: ShearResult) -> Claim:
    """Claim about the fabric, which is isotropic if the test does not reject it."""
    dim = main.scenario.packing.dim
    first = [path.single for path in main.paths if path.single is not None]
    values, last = ([isotropy_statistic(s) for s in some] for some in (first, [path.last for path in main.paths]))
    limit = chdtri(max(len(first), 1) * (dim * (dim + 1) // 2 - 1), LEVEL)
    return claim(
        "isotropic-contacts", 'Sec. V: "prepared in a way that leads to an isotropic contact distribution"', True,
        sum(values) < limit if first else None, "", 0.0,
        f"chi-square of the fabric tensor in the states with one pair: {describe_range(values)}, together "
        f"{sum(values):.3g}, and {limit:.3g} would reject isotropy at {LEVEL:.0%}; at the last strain "
        f"{describe_range(last)}",
    )  # fmt: skip
