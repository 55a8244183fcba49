"""Complex elastic moduli: response of the stress to a small oscillating strain of the cell."""

from typing import NamedTuple

import numpy as np
from scipy import sparse

from ..core.arguments import Values, checked, require_not_negative
from ..core.contacts.jacobian import blocks_of, linearise
from ..core.laws.builtin import Law
from ..core.measure import volume
from ..core.progress import Report, silent
from ..core.readable import readable
from ..core.sizes import Size, require_sizes
from ..core.state import State
from .balance import balanced
from .freedom import assembled
from .frontal import dissect
from .moduli import check_cell, elastic_moduli, isotropic, with_free_cell
from .response import as_frequencies, drag_rates, solve_directly


@readable
class ComplexModuli(NamedTuple):
    """C*_abcd(ω) of a strain Re G exp(iωt): the stress is −Re C* G exp(iωt) [force/length^(dim−1)]."""

    frequency: np.ndarray  # (F,) ω, in the order given [1/time]
    tensor: np.ndarray  # (F, dim, dim, dim, dim) complex: storage + i loss
    affine: np.ndarray  # the same, if grains moved affinely with the cell and did not rotate

    @property
    def bulk(self) -> np.ndarray:
        """(F,) complex K* = K′ + iK″ of the nearest isotropic tensor."""
        return _isotropic(self.tensor)[:, 0]

    @property
    def shear(self) -> np.ndarray:
        """(F,) complex G* = G′ + iG″ of the nearest isotropic tensor."""
        return _isotropic(self.tensor)[:, 1]


def _isotropic(tensor: np.ndarray) -> np.ndarray:
    """(F, 2) complex bulk and shear moduli."""
    return np.array([np.array(isotropic(c.real)) + 1j * np.array(isotropic(c.imag)) for c in tensor]).reshape(-1, 2)


@checked
def complex_moduli(
    state: State, law: Law, frequency: Values, *, drag: float = 0.0, spin_drag: float | None = None,
    report: Report = silent,
) -> ComplexModuli:  # fmt: skip
    """Storage and loss moduli C* = −(ℓ²/V) (K_cc + K_cg u), (−ω²M + iωMν − K_gg) u = K_gc, K = J + iωC.

    c denotes the coordinates ℓG of the cell and g those of the grains, C the derivatives of forces to velocities: the
    dashpots also resist the affine motion. As in `run`, velocities are relative to the flow of the cell, ẋ = v + Lx:
    the affine motion has no inertia, and drag acts on v only. Each contact is held in its mode. At ω = 0 the moduli are
    those of `elastic_moduli`. Without dashpots, grains move affinely at high frequencies. Rattlers are excluded.

    In runs of 20 disks whose cell was sheared to and fro by 1e-7, storage and loss of the elastic forces differed from
    these equations by 2e-5 of the modulus (`tests/modes/test_complex_moduli.py`).

    Parameters
    ----------
    state : State, in equilibrium, in a fully periodic cell, without walls, rigid groups or springs
    frequency : ω, or (F,) of them, zero or positive [1/time]
    drag, spin_drag : ν of translations and of rotations, as in `run`; spin_drag defaults to drag [1/time]
    report : called as report(stage, share done, text)

    Raises
    ------
    ValueError
        if the forces do not balance; if the state has walls, rigid groups, springs or open sides; if a frequency is
        negative, or that of a resonance without damping; at ω = 0 where `elastic_moduli` raises it.

    Source
    ------
    Lemaître & Maloney, doi:10.1007/s10955-005-9015-5, for the viscoelastic moduli of a damped packing.

    Examples
    --------
    >>> import stickslip as ss
    >>> law = ss.laws.hertz_mindlin(mu=0.5)
    >>> state, _ = ss.packings.jammed(20, packing_fraction=0.68, seed=1)
    >>> answer = complex_moduli(state, law, [0.1, 0.2], drag=0.5)
    >>> answer.tensor.shape, bool((answer.shear.imag > 0).all())
    ((2, 3, 3, 3, 3), True)
    """
    require_not_negative(drag=drag, spin_drag=spin_drag)
    frequency = as_frequencies(frequency)
    check_cell(state, "complex moduli")
    state, stiff, free, grain, cell = with_free_cell(balanced(state, law).state, law)
    size = 32.0 * len(frequency) * len(cell) ** 2
    require_sizes([Size(f"{len(frequency)} frequencies take", size, "bytes", "use fewer of them")])
    damp = assembled(state, blocks_of(state, law, linearise(state, law))[1], free)
    inertia, rate = free.mass[grain], drag_rates(free.axis[grain], drag, spin_drag)
    scale, order = np.abs(stiff.data).max(), None
    answer = np.empty((2, len(frequency), len(cell), len(cell)), complex)
    for k, omega in enumerate(frequency):
        report("complex moduli", k / len(frequency), f"frequency {omega:.4g}")
        if omega == 0:
            still = elastic_moduli(state, law)
            answer[:, k] = np.reshape([still.tensor, still.affine], answer[:, k].shape)
            continue
        whole = sparse.csr_array(stiff + 1j * omega * damp)
        rows, columns = whole[cell], whole[grain][:, cell].toarray()
        own = sparse.diags_array(inertia * (1j * omega * rate - omega**2))
        matrix = sparse.csr_array(own - whole[grain][:, grain])
        if order is None:
            order = dissect(state, free, grain, matrix)
        motion = solve_directly(matrix, columns, order, omega, scale)
        affine = rows[:, cell].toarray()
        answer[:, k] = -(free.length**2) / volume(state) * np.array([affine + rows[:, grain] @ motion, affine])
    tensor, affine = answer.reshape(2, len(frequency), *(state.cell.dim,) * 4)
    return ComplexModuli(frequency, tensor, affine)
