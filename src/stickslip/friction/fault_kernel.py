"""Compiled rates of a fault with rate-and-state friction, and the pieces of an embedded Runge–Kutta step.

The unknowns of each cell are its slip in excess of plate motion, u = δ − V_p t, and s = ln(V0 θ/D_c) of each of its one
or two states. The slip velocity V = V0 e^w follows from the balance of stress and friction, τ₀ + τ(u) = σ f(w, s, s2) +
η V, by Newton's method for w.

The laws are the scalar functions of `laws`, which the slider and fits share.
"""

import numpy as np
from numba import njit
from scipy.integrate import DOP853

from .. import kernel_cache
from . import laws

kernel_cache.install()

MOST_ITERATIONS = 60
ROUND_OFF = 1e-15  # of a stress: where friction hardly depends on w, steps do not become smaller than what it makes

# Order 8 with error estimates of order 5 and 3: Hairer, Nørsett and Wanner, Solving Ordinary Differential Equations I,
# section II.5, with the coefficients of SciPy
NUMBER = DOP853.n_stages
STAGES = np.vstack([DOP853.A[1:], DOP853.B])  # weights of the earlier stages in each later one, and in the step
ERROR_5, ERROR_3 = DOP853.E5, DOP853.E3
EXPONENT = 1 / 8  # of the error in the choice of the step


@njit(cache=True, error_model="numpy")
def log_velocity(form, w, s, s2, stress, a, b, b2, mu0, cut, cut2, normal, damping):
    """Solve σ f(w, s, s2) + η V0 e^w = stress for w, starting from a guess; NaN if Newton's method fails.

    Parameters
    ----------
    damping : η V0 [stress]
    """
    for _ in range(MOST_ITERATIONS):
        f, df = laws.friction(form, w, s, s2, a, b, b2, mu0, cut, cut2)
        push = damping * np.exp(w)
        missing = normal * f + push - stress
        step = missing / (normal * df + push)
        if step > 5.0:
            step = 5.0
        elif step < -5.0:
            step = -5.0
        w -= step
        if abs(step) < 1e-12 or abs(missing) < ROUND_OFF * abs(stress):
            return w
    return np.nan


@njit(cache=True, error_model="numpy")
def rates(codes, constants, cells, transferred, y, w, out, power):
    """Rates of the unknowns, and powers per unit length of the fault; return False if a velocity cannot be found.

    Parameters
    ----------
    codes : form, evolution law
    constants : mu0, v0, damping η, plate rate, cell length, V0/V1, V0/V2
    cells : (7, N) a, b, dc, normal stress σ, initial stress τ₀, b2, dc2
    transferred : (N,) stress due to u
    y : (1 + S, N) u, and s of S = 1 or 2 states
    w : (N,) ln(V/V0), a guess that is replaced by the solution
    out : (1 + S, N) rates of the unknowns, overwritten
    power : (3,) of loading τ V_p, friction σ f V and radiation η V², overwritten
    """
    form, law = codes
    mu0, v0, eta, plate, cell, cut, cut2 = constants
    loading = rubbed = radiated = 0.0
    two = len(y) > 2
    for i in range(len(w)):
        a, b, dc, normal = cells[0, i], cells[1, i], cells[2, i], cells[3, i]
        stress, s, b2 = cells[4, i] + transferred[i], y[1, i], cells[5, i]
        s2 = y[2, i] if two else 0.0
        x = log_velocity(form, w[i], s, s2, stress, a, b, b2, mu0, cut, cut2, normal, eta * v0)
        if not np.isfinite(x):
            return False
        w[i] = x
        v = v0 * np.exp(x)
        out[0, i] = v - plate
        out[1, i] = laws.state_rate(law, v / v0, x, s, v0 / dc)
        if two:
            out[2, i] = laws.state_rate(law, v / v0, x, s2, v0 / cells[6, i])
        loading += stress
        radiated += v * v
        rubbed += (stress - eta * v) * v
    power[0], power[1], power[2] = plate * cell * loading, cell * rubbed, eta * cell * radiated
    return True


@njit(cache=True, error_model="numpy")
def advance(y, stages, number, weights, step, out):
    """Add step × Σ weights × stages, over the first `number` stages, to y."""
    out[:] = y
    for j in range(number):
        if weights[j] != 0.0:
            factor = step * weights[j]
            for k in range(y.shape[0]):
                for i in range(y.shape[1]):
                    out[k, i] += factor * stages[j, k, i]


@njit(cache=True, error_model="numpy")
def error_norm(stages, step, dc):
    """Root mean square of the estimated errors of u/D_c and of each s in a step, as `scipy.integrate.DOP853` has it."""
    rows, n = stages.shape[1], len(dc)
    five, three = np.empty(n), np.empty(n)
    sum_five = sum_three = 0.0
    for k in range(rows):
        five[:] = 0.0
        three[:] = 0.0
        for j in range(NUMBER + 1):
            if ERROR_5[j] != 0.0 or ERROR_3[j] != 0.0:
                for i in range(n):
                    five[i] += ERROR_5[j] * stages[j, k, i]
                    three[i] += ERROR_3[j] * stages[j, k, i]
        for i in range(n):
            scale = dc[i] if k == 0 else 1.0
            sum_five += (five[i] / scale) ** 2
            sum_three += (three[i] / scale) ** 2
    if sum_five == 0.0:
        return 0.0
    return abs(step) * sum_five / np.sqrt((sum_five + 0.01 * sum_three) * rows * n)
