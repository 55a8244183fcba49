"""Mechanics of one contact, the same for every way of going through the list: scalars in, scalars out.

Sweeps over few contacts and vectorised blocks of many call these functions, so that there is one source of physics.
"""

import numpy as np
from numba import njit

from .laws import HERTZ_MINDLIN_REFF, MASS, NO_TENSION, SMOOTH, VISCOELASTIC, mobilised
from .state import SLIDE, STICK

# what an evaluation does with the memory: carry it along, but keep to the last bit what has not moved since it was
# committed; carry it along with every mode held; carry it along
FROZEN, HELD, FREE = 0, 1, 2


@njit(fastmath=True, error_model="numpy")
def effective(kind, viscous, radius, inverse_mass, i, j, is_wall):
    """R_eff and m_eff of a pair, 1 where the law does not ask; what does not move is infinitely heavy."""
    model = viscous & 3
    r_eff = m_eff = 1.0
    if kind == HERTZ_MINDLIN_REFF or model == VISCOELASTIC:
        r_eff = radius[i] if is_wall else radius[i] * radius[j] / (radius[i] + radius[j])
    if model in (VISCOELASTIC, MASS):
        inverse = inverse_mass[i] + inverse_mass[j]
        m_eff = 1.0 / inverse if inverse > 0.0 else 0.0
    return r_eff, m_eff


@njit(fastmath=True, error_model="numpy")
def with_dashpot(viscous, elastic, damping, vn):
    """Normal force with its dashpot, clipped where the law knows no tension."""
    fn = elastic - damping * vn
    if viscous & NO_TENSION:
        return fn if fn > 0.0 else 0.0
    return fn


@njit(fastmath=True, error_model="numpy")
def carried_memory(stiffness, limit, sx, sy, sz, mode, memory):
    """Slip truncated at Coulomb's limit, and the mode that follows; with memory HELD the mode decides."""
    pull = stiffness * stiffness * (sx * sx + sy * sy + sz * sz)
    slides = mode == SLIDE if memory == HELD else pull > limit * limit or limit == 0.0
    if slides:
        scale = limit / np.sqrt(pull) if pull > 0.0 else 0.0
        return sx * scale, sy * scale, sz * scale, SLIDE
    return sx, sy, sz, STICK


@njit(fastmath=True, error_model="numpy")
def tangential_force(coulomb, stiffness, limit, sx, sy, sz):
    """−k_t (mobilisation) s: the force on i that the slip stands for."""
    factor = -stiffness
    if coulomb == SMOOTH:
        if limit > 0.0:
            factor *= mobilised(coulomb, stiffness * np.sqrt(sx * sx + sy * sy + sz * sz) / limit)
        else:
            factor = 0.0
    return factor * sx, factor * sy, factor * sz


@njit(fastmath=True, error_model="numpy")
def damped(tx, ty, tz, damping, limit, vx, vy, vz):
    """Tangential force with its dashpot, truncated at Coulomb's limit."""
    tx, ty, tz = tx - damping * vx, ty - damping * vy, tz - damping * vz
    square = tx * tx + ty * ty + tz * tz
    factor = limit / np.sqrt(square) if square > limit * limit else 1.0
    return tx * factor, ty * factor, tz * factor
