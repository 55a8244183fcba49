"""Resistance to rolling and twisting: moments with their own memory.

The memory ψ of a contact is the rotation of i relative to j since it closed, perpendicular to the normal. It is
truncated at the cap of the law and transported like the slip:

    ψ ← T (ψ + Δ(angle_i − angle_j)),   T = I − m nᵀ,   |ψ| ≤ cap/k_r,   M_i = −k_r ψ,   M_j = +k_r ψ,

where m is the mid-step normal (see `mid_normal` in `mechanics.h`).

A pair that rotates as one body has angle_i = angle_j and no moment. M and angle_i − angle_j are conjugate, so the
transpose of the matrix that maps coordinates to r, ρ and θ = angle_i − angle_j maps F, T/R and M to loads. The twist
τ ← τ + m·Δ(angle_i − angle_j) has the moment M_i = −k_t τ n. Dashpots are added, and the sums truncated at the caps.

Sources: Iwashita & Oda, doi:10.1061/(ASCE)0733-9399(1998)124:3(285); Ai et al., doi:10.1016/j.powtec.2010.09.030; the
same memory for slip and rolling: Luding, doi:10.1007/s10035-008-0099-x, Sec. 2.
"""

from typing import NamedTuple

import numpy as np

from ..laws.builtin import Law
from ..laws.compiled import TANGENTS, law_struct
from ..laws.properties import resists_rolling
from ..library import core
from .neighbors import shifts
from .tangent import Turn, column, memory_tangent, outer, rowwise, spring_tangent


class _MomentLinearisation(NamedTuple):
    """Quantities of the linearisation of M, one row per contact."""

    before: np.ndarray  # (C, 3) ψ when the memory was committed
    way: np.ndarray  # (C, 3) Δθ since the commit
    secant: np.ndarray  # (C,) φ/|ψ|
    along: np.ndarray  # (C,) ∂φ/∂|ψ|
    by_overlap: np.ndarray  # (C,) ∂φ/∂δ at fixed ψ
    by_force: np.ndarray  # (C,) ∂φ/∂F_n, needed because dashpots change F_n
    reach: np.ndarray  # (C,) |ψ| at the cap
    reach_by_overlap: np.ndarray  # (C,)
    reach_by_force: np.ndarray  # (C,)
    weighted: np.ndarray  # (C,) as in `jacobian.Linearisation`
    damping: np.ndarray  # (C,) coefficient of the rolling dashpot
    slides: np.ndarray  # (C,) 1 if ψ is at its cap
    twisting: np.ndarray  # (C,) k τ
    twisting_along: np.ndarray  # (C,) k, zero at the cap
    twisting_damping: np.ndarray  # (C,)
    twisting_by_force: np.ndarray  # (C,) derivatives of k τ, like those of φ
    twisting_by_overlap: np.ndarray  # (C,)


def with_moments(state, law: Law, here, line, turn: Turn, memory: int, stiff: np.ndarray, damp: np.ndarray):
    """Add moments M to blocks: derivatives (C, 9, 9) of (F, T/R, M) with respect to (r, ρ, θ) at rest; see `jacobian`.

    dM = −[φ/|ψ| (I − ψ̂ψ̂ᵀ) + ∂φ/∂|ψ| ψ̂ψ̂ᵀ] dψ + ∂φ/∂δ ψ̂ (n·dr), with dψ as in `tangent`.
    """
    count = len(stiff)
    out = _MomentLinearisation(
        np.zeros((count, 3)), np.zeros((count, 3)), *np.zeros((len(_MomentLinearisation._fields) - 2, count))
    )
    struct, shift = law_struct(law, members=TANGENTS), shifts(state.contacts, state.cell.vectors)
    core.linearise_moments(struct, state.cell.dim, here, state.contacts, shift, memory, out)
    by_way = np.zeros((count, 3, 6))  # derivatives with respect to r and θ
    by_way[:, :, 3:] = np.eye(3)
    psi, by_psi, by_reach = memory_tangent(
        turn, out.before, out.way, by_way, out.reach, out.reach_by_overlap, out.weighted > 0
    )  # fmt: skip
    spring, hat = spring_tangent(psi, line.remembers * line.closed, out.secant, out.along)
    hat_n, moved = outer(hat, line.normal), spring @ by_psi
    whole, rub = stiff.copy(), damp.copy()
    whole[:, 6:, :3] += moved[:, :, :3] + column(out.by_overlap) * hat_n
    whole[:, 6:, 6:] += moved[:, :, 3:]
    by_force = out.by_force[:, None] * hat - np.einsum("ckl,cl->ck", spring, by_reach * out.reach_by_force[:, None])
    nn, there = outer(line.normal, line.normal), column(line.remembers * line.closed)
    rub[:, 6:, :3] += column(line.damping_n) * (outer(by_force, line.normal) + column(out.twisting_by_force) * nn)
    rub[:, 6:, 6:] -= column(out.damping) * (np.eye(3) - nn - column(out.slides) * outer(hat, hat))
    rub[:, 6:, 6:] -= column(out.twisting_damping) * nn
    by_r = outer(line.normal, rowwise(out.way, turn.by_mid))
    whole[:, 6:, :3] -= there * (column(out.twisting_along) * by_r + column(out.twisting) * turn.by_normal)
    whole[:, 6:, :3] += column(out.twisting_by_overlap) * nn
    whole[:, 6:, 6:] -= there * column(out.twisting_along) * outer(line.normal, turn.mid)
    return whole, rub


def rolling_bound(state, law: Law, here, inverse_inertia) -> float:
    """Upper bound on ω² of the rolling springs alone, from |θ_i − θ_j|² ≤ 2 |θ_i|² + 2 |θ_j|² [1/time²]."""
    if not resists_rolling(law):
        return 0.0
    struct, shift = law_struct(law, members=("range", "rolling")), shifts(state.contacts, state.cell.vectors)
    total = np.zeros(state.n_bodies)
    return core.rolling_bound(struct, state.cell.dim, here, state.contacts, shift, inverse_inertia, total)
