"""Mechanics of one contact, the same for every way of going through the list: scalars in, scalars out.

Sweeps over few contacts and vectorised blocks of many call these functions, so that there is one source of physics.
"""

import numpy as np
from numba import njit

from .laws import MASS, NO_TENSION, SMOOTH, VISCOELASTIC, asks_radius, mobilised, reach, reaches, row
from .state import SLIDE, STICK

# what an evaluation does with the memory: carry it along, but keep to the last bit what has not moved since it was
# committed; carry it along with every mode held; carry it along
FROZEN, HELD, FREE = 0, 1, 2


@njit(cache=True)
def needs_radius(kind, viscous):
    """True if the law asks for R_eff."""
    return asks_radius(kind) or viscous & 3 == VISCOELASTIC


@njit(cache=True)
def needs_mass(viscous):
    """True if the law asks for m_eff."""
    return viscous & 3 in (MASS, VISCOELASTIC)


@njit(cache=True, fastmath=True, error_model="numpy")
def effective_radius(radius, i, j, is_wall):
    """R_eff of a pair."""
    return radius[i] if is_wall else radius[i] * radius[j] / (radius[i] + radius[j])


@njit(cache=True, fastmath=True, error_model="numpy")
def effective_mass(inverse_mass, i, j):
    """m_eff of a pair; what does not move is infinitely heavy."""
    inverse = inverse_mass[i] + inverse_mass[j]
    return 1.0 / inverse if inverse > 0.0 else 0.0


@njit(cache=True, fastmath=True, error_model="numpy")
def effective(kind, viscous, radius, inverse_mass, i, j, is_wall):
    """R_eff and m_eff of a pair, 1 where the law does not ask."""
    r_eff = m_eff = 1.0
    if needs_radius(kind, viscous):
        r_eff = effective_radius(radius, i, j, is_wall)
    if needs_mass(viscous):
        m_eff = effective_mass(inverse_mass, i, j)
    return r_eff, m_eff


@njit(cache=True, fastmath=True, error_model="numpy")
def apart(kind, p, material, radius, inverse_mass, i, j, is_wall, overlap):
    """True if a pair is out of the law's reach."""
    if not reaches(kind):
        return overlap <= 0.0
    r_eff, _ = effective(kind, 0, radius, inverse_mass, i, j, is_wall)
    return overlap <= -reach(kind, row(kind, p, np.uint64(material[i]), np.uint64(material[j])), r_eff)


@njit(cache=True, fastmath=True, error_model="numpy")
def with_dashpot(viscous, elastic, damping, vn, least=0.0):
    """Normal force with its dashpot, clipped at the `least` one where the law knows no tension."""
    fn = elastic - damping * vn
    if viscous & NO_TENSION:
        return fn if fn > least else least
    return fn


@njit(cache=True, fastmath=True, error_model="numpy")
def held_mode(mode, sx, sy, sz):
    """Mode in which a contact is held, of its committed slip: without any it has no direction to slide in, and sticks.

    Such contacts slid under a law without friction. One that has none holds them sliding, whatever their mode.
    """
    return STICK if mode == SLIDE and sx == 0.0 and sy == 0.0 and sz == 0.0 else mode


@njit(cache=True, fastmath=True, error_model="numpy")
def carried_memory(stiffness, limit, sx, sy, sz, mode, memory):
    """Slip truncated at Coulomb's limit, and the mode that follows; with memory HELD the mode decides."""
    pull = stiffness * stiffness * (sx * sx + sy * sy + sz * sz)
    slides = limit == 0.0 or (mode == SLIDE if memory == HELD else pull > limit * limit)
    if slides:
        scale = limit / np.sqrt(pull) if pull > 0.0 else 0.0
        return sx * scale, sy * scale, sz * scale, SLIDE
    return sx, sy, sz, STICK


@njit(cache=True, fastmath=True, error_model="numpy")
def tangential_force(coulomb, stiffness, limit, sx, sy, sz):
    """−k_t (mobilisation) s: the force on i that the slip stands for."""
    factor = -stiffness
    if coulomb == SMOOTH:
        if limit > 0.0:
            factor *= mobilised(coulomb, stiffness * np.sqrt(sx * sx + sy * sy + sz * sz) / limit)
        else:
            factor = 0.0
    return factor * sx, factor * sy, factor * sz


@njit(cache=True, fastmath=True, error_model="numpy")
def damped(tx, ty, tz, damping, limit, vx, vy, vz):
    """Tangential force with its dashpot, truncated at Coulomb's limit."""
    tx, ty, tz = tx - damping * vx, ty - damping * vy, tz - damping * vz
    square = tx * tx + ty * ty + tz * tz
    factor = limit / np.sqrt(square) if square > limit * limit else 1.0
    return tx * factor, ty * factor, tz * factor


@njit(cache=True, fastmath=True, error_model="numpy")
def in_one_go(stiffness, damping, limit, sx, sy, sz, vx, vy, vz, hold):
    """Tangential force and slip when spring and dashpot together are held to Coulomb's limit, as LAMMPS does.

    s ← f (s + c v_t/k_t) − c v_t/k_t, F_t ← f F_t, f = limit/|F_t|. Returns force, slip, and whether it slides.
    """
    tx, ty, tz = -stiffness * sx - damping * vx, -stiffness * sy - damping * vy, -stiffness * sz - damping * vz
    square = tx * tx + ty * ty + tz * tz
    slides = square > limit * limit
    share = limit / np.sqrt(square) if slides else 1.0
    # a contact that slides without ever having been sheared is let go altogether
    grip = share if not slides or sx * sx + sy * sy + sz * sz > 0.0 else 0.0
    slides = slides and not hold
    less = share - 1.0 if slides else 0.0
    stretch = damping / stiffness if stiffness > 0.0 else 0.0
    sx, sy, sz = sx + less * (sx + stretch * vx), sy + less * (sy + stretch * vy), sz + less * (sz + stretch * vz)
    return grip * tx, grip * ty, grip * tz, sx, sy, sz, slides
