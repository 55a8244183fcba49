"""Contact status and strain under small increments of stress of a periodic cell: probes without a finite size."""

from typing import NamedTuple

import numpy as np

from ... import Law, State
from ...control import stress_controlled
from ...kit import checked, require_not_negative
from ...measure import stress
from .apex_status import contact_status
from .increment import external_force
from .matrices import linear_system
from .status import ContactStatus


class Probed(NamedTuple):
    """Answer to one increment of stress."""

    status: ContactStatus
    strain: np.ndarray  # (dim, dim) per unit of the stress, compression positive; NaN without a consistent status


@checked
def probe_statuses(state: State, law: Law, stresses: np.ndarray, *, unique: bool | None = True) -> tuple[Probed, ...]:
    """Find the contact status under each of several rates of stress of a periodic cell.

    Small increments of stress, as `protocols.response_envelope` takes them, made the same contacts slide, and strained
    30 disks and 60 spheres in which contacts slide as stated to 1.5e-4 of the largest strain
    (`tests/unit/test_envelope.py`).

    Parameters
    ----------
    state : State in equilibrium, in a fully periodic cell
    stresses : (M, dim, dim) symmetric, compression positive, for example those of `protocols.response_envelope`
    unique : as in `contact_status`, but by default every status comes with its certificate

    Raises
    ------
    ValueError
        with a one-sentence message, for stresses of another shape, and as `linear_system`.

    Source
    ------
    McNamara and Herrmann, Quasi-rigidity: some uniqueness issues, Sec. IV, with the strain of the cell as coordinates.

    Examples
    --------
    >>> import stickslip as ss
    >>> state, _ = ss.packings.jammed(30, pressure=1e-3, dim=2, seed=1)
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> (probed,) = ss.quasirigid.probe_statuses(state, law, [[[1.0, 0.0], [0.0, 1.0]]])
    >>> probed.status.ok, bool(probed.strain.trace() > 0)
    (True, True)
    """
    dim = state.cell.dim
    stresses = np.asarray(stresses, float)
    require_not_negative(stresses=float(np.abs(stresses).max(initial=0.0)))
    if stresses.shape[1:] != (dim, dim) or not np.allclose(stresses, stresses.transpose(0, 2, 1)):
        raise ValueError(
            f"stresses of shape {stresses.shape} were given: symmetric ones of shape (M, {dim}, {dim}) are needed"
        )
    matrix = linear_system(_under(state, stress(state, law)[:dim, :dim]), law)
    still = external_force(_under(state, np.zeros((dim, dim))), matrix.free)
    answers = []
    for rate in stresses:
        load = external_force(_under(state, rate), matrix.free) - still
        status = contact_status(matrix, load, unique=unique)
        gradient = matrix.free.strain(status.velocity)[:dim, :dim]
        answers.append(Probed(status, -0.5 * (gradient + gradient.T) if status.ok else np.full((dim, dim), np.nan)))
    return tuple(answers)


def _under(state: State, target: np.ndarray) -> State:
    return state._replace(control=stress_controlled(state.control, target))
