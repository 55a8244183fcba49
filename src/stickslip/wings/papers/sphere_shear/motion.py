"""What grows in a run from a complex pair: whether trajectories are plane spirals, and how the stress oscillates."""

from typing import NamedTuple

import numpy as np

from .... import Law, State, freedom, jacobian
from ....measure import touching
from ....results import Released

PARTS = 10  # of the window of the fit, in each of which the amplitude of the stress is taken


def axis_ratios(turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Second and third over first singular value of every grain's displacements in a turn, (L, H) each.

    The second is 0 on a line, the third in a plane.

    The motion of a single pair is Re(c e^{iωt}) with a complex vector c for each grain, so that a grain moves in the
    plane of Re c and Im c, which contains its position at rest.

    Parameters
    ----------
    turns : (L, T, H, 3) displacements from rest, T samples of each turn [length]
    """
    values = np.linalg.svd(turns.transpose(0, 2, 1, 3), compute_uv=False)
    return values[..., 1] / values[..., 0], values[..., 2] / values[..., 0]


class Oscillation(NamedTuple):
    """Change δσ of the shear stress in the window of the fit of M."""

    offset: float  # mean of δσ e^{−ω_i t} over its root mean square: 0 for an oscillation around zero
    exponent: float  # of the amplitude of δσ against M: 1/2 if the stress is linear in the displacements


def stress_oscillation(run: Released) -> Oscillation | None:
    """Oscillation of the shear stress while M grows exponentially; None if M did not cross the window of its fit."""
    if run.growth is None:
        return None
    inside = (run.time >= run.growth.start) & (run.time <= run.growth.stop)
    change = (run.shear_stress - run.shear_stress[0])[inside]
    scaled = change * np.exp(-run.growth_rate * run.time[inside])
    amplitude = [np.sqrt(np.mean(part**2)) for part in np.array_split(change, PARTS)]
    level = [np.mean(part) for part in np.array_split(run.msd[inside], PARTS)]
    slope = np.polyfit(np.log(level), np.log(amplitude), 1)[0]
    return Oscillation(float(scaled.mean() / np.sqrt(np.mean(scaled**2))), float(slope))


def block_asymmetry(state: State, law: Law) -> dict[str, float]:
    """Largest violation of the symmetries of J under exchange of two grains, over the largest entry of the block.

    A = ∂F/∂r and D = ∂(T/R)/∂(R·angle) are the same for (i, j) and (j, i); C = ∂F/∂(R·angle) and B = ∂(T/R)/∂r change
    sign. "axes" is that of A under exchange of its axes, which a tangential force violates.

    Source
    ------
    Bonfanti et al., doi:10.1103/PhysRevE.101.052902, Appendix B.
    """
    free, c, rows = freedom(state), state.contacts, touching(state)
    dim = state.cell.dim
    width = 6 if dim == 3 else 3
    full = jacobian(state, law, free).toarray().reshape(len(state.grains.radius), width, -1, width)
    there, back = full[c.i[rows], :, c.j[rows]], full[c.j[rows], :, c.i[rows]]
    move, turn = slice(0, dim), slice(dim, None)
    a = there[:, move, move]
    axes = float(np.abs(a - a.transpose(0, 2, 1)).max() / np.abs(a).max())
    blocks = {"A": (move, move, 1), "B": (turn, move, -1), "C": (move, turn, -1), "D": (turn, turn, 1)}
    return {"axes": axes} | {
        name: float(np.abs(there[:, a, b] - sign * back[:, a, b]).max() / np.abs(there[:, a, b]).max())
        for name, (a, b, sign) in blocks.items()
    }
