"""Compiled integration of a slider with rate-and-state friction on a spring.

The unknowns are w = ln(V/V0) and f = ln(V0 θ/D_c), because velocity and state vary over many orders of magnitude during
a hold, and g = ln(V0 θ2/D_c2) if there is a second state. The laws are those of `laws`.

Extrapolation of the linearly implicit Euler method (P. Deuflhard, SIAM Rev. 27, 505 (1985), doi:10.1137/1027140) needs
no table of coefficients, adapts its order, and solves its systems by elimination, since the states are coupled through
w alone. A step ends at every requested time, so that nothing is interpolated. `python -m benchmarks --friction`
compares its speed with that of LSODA.
"""

import numpy as np
from numba import njit

from .. import kernel_cache
from .laws import AGING, curvatures, friction, log_velocity, slopes, state_rate, state_slopes

kernel_cache.install()

DONE, RUNAWAY, STEPS_SPENT = 0, 1, 2
ORDERS = 10  # largest number of columns of the extrapolation
FASTEST = 200.0  # ln(V/V0) above which slip has run away: quasi-static slip does so in finite time
MOST_STEPS = 200_000  # between two requested times


@njit(cache=True, error_model="numpy")
def rates(w, f, g, p, velocity, normal):
    """Time derivatives dw/dt, df/dt and dg/dt; the last is 0 if b2 = 0.

    The balance of forces n μ(w, f, g) + ηV = k(x_lp − x), differentiated, is
    (n ∂μ/∂w + ηV) w' = k(V_lp − V) − n (∂μ/∂f f' + ∂μ/∂g g').

    Parameters
    ----------
    p : a, b, dc, mu0, v0, stiffness, damping, evolution law, form, b2, dc2, V0/V1, V0/V2
    velocity : of the load point
    normal : normal stress over its reference
    """
    e = np.exp(w)
    mw, mf, mg = slopes(p[8], w, f, g, p[0], p[1], p[9], p[3], p[11], p[12])
    df, dg = state_rate(p[7], e, w, f, p[4] / p[2]), 0.0
    if p[9] != 0.0:
        dg = state_rate(p[7], e, w, g, p[4] / p[10])
    return (p[5] * (velocity - p[4] * e) - normal * (mf * df + mg * dg)) / (normal * mw + p[6] * p[4] * e), df, dg


@njit(cache=True, error_model="numpy")
def rate_derivatives(w, f, g, p, velocity, normal):
    """Derivatives of `rates`: of dw/dt with respect to w, f and g; of df/dt to w and f; of dg/dt to w and g."""
    e = p[4] * np.exp(w)
    mw, mf, mg = slopes(p[8], w, f, g, p[0], p[1], p[9], p[3], p[11], p[12])
    cww, cwf, cwg, cff, cfg, cgg = curvatures(p[8], w, f, g, p[0], p[1], p[9], p[3], p[11], p[12])
    fw, ff = state_slopes(p[7], w, f, p[4] / p[2])
    gw, gg = 0.0, 0.0
    if p[9] != 0.0:
        gw, gg = state_slopes(p[7], w, g, p[4] / p[10])
    dw, df, dg = rates(w, f, g, p, velocity, normal)
    inertia = normal * mw + p[6] * e
    ww = (-p[5] * e - normal * (cwf * df + mf * fw + cwg * dg + mg * gw) - dw * (normal * cww + p[6] * e)) / inertia
    wf = -normal * (cff * df + mf * ff + cfg * dg + dw * cwf) / inertia
    wg = -normal * (cfg * df + cgg * dg + mg * gg + dw * cwg) / inertia
    return ww, wf, wg, fw, ff, gw, gg


@njit(cache=True, error_model="numpy")
def extrapolate(w, f, g, h, p, velocity, normal, tolerance, table):
    """Take one step of length h; return new w, f, g and the number of columns used (0 if the tolerance was not met)."""
    ww, wf, wg, fw, ff, gw, gg = rate_derivatives(w, f, g, p, velocity, normal)
    two = p[9] != 0.0
    for j in range(ORDERS):
        d = h / (j + 1)
        of, og = 1.0 / (1.0 - d * ff), 1.0 / (1.0 - d * gg)
        pf, pg = d * wf * of, d * wg * og
        od = 1.0 / (1.0 - d * ww - d * (pf * fw + pg * gw))
        x, y, z = w, f, g
        for _ in range(j + 1):
            gx, gy, gz = rates(x, y, z, p, velocity, normal)
            dx = (d * (gx + pf * gy + pg * gz)) * od
            dy = d * (gy + fw * dx) * of
            x, y = x + dx, y + dy
            if not (abs(dx) < 5.0 and abs(dy) < 5.0):
                return w, f, g, 0
            if two:
                dz = d * (gz + gw * dx) * og
                z += dz
                if not abs(dz) < 5.0:
                    return w, f, g, 0
        gap = 0.0
        for m in range(j):  # Aitken and Neville: table holds row j − 1 and becomes row j
            share = (j - m) / (m + 1.0)
            nx, ny = x + (x - table[m, 0]) * share, y + (y - table[m, 1]) * share
            table[m, 0], table[m, 1] = x, y
            gap = max(abs(nx - x), abs(ny - y))
            x, y = nx, ny
            if two:
                nz = z + (z - table[m, 2]) * share
                table[m, 2] = z
                gap = max(gap, abs(nz - z))
                z = nz
        table[j, 0], table[j, 1], table[j, 2] = x, y, z
        if j >= 2 and gap <= tolerance:
            return x, y, z, j + 1
    return w, f, g, 0


@njit(cache=True, error_model="numpy")
def after_normal_jump(w, f, g, p, alpha, old, new):
    """w, f and g after a jump in the normal stress from `old` to `new`.

    θ → θ (new/old)^(−α/(b + b2)) for each state (Linker and Dieterich 1992), at constant spring force n μ + ηV.
    """
    a, b, b2, mu0, form, cut, cut2 = p[0], p[1], p[9], p[3], p[8], p[11], p[12]
    eta = p[6] * p[4]
    force = old * friction(form, w, f, g, a, b, b2, mu0, cut, cut2)[0] + eta * np.exp(w)
    shift = (alpha / (b + b2) if b + b2 > 0.0 else 0.0) * np.log(new / old)
    f -= shift
    g -= shift
    w = (force / new - mu0 - b * f - b2 * g) / a
    if eta > 0.0:
        w = min(w, np.log(max(abs(force), eta) / eta))
    return log_velocity(force, w, f, g, form, a, b, b2, mu0, cut, cut2, new, eta), f, g


@njit(cache=True, error_model="numpy")
def friction_along(out, p):
    """Friction coefficient of rows (w, f, g)."""
    mu = np.empty(len(out))
    for k in range(len(out)):
        mu[k] = friction(p[8], out[k, 0], out[k, 1], out[k, 2], p[0], p[1], p[9], p[3], p[11], p[12])[0]
    return mu


@njit(cache=True, error_model="numpy")
def integrate(w, f, g, p, alpha, duration, velocity, normal, start_normal, times, tolerance):
    """Integrate w, f and g to `times` (ascending, from the start of the legs); also return a code and the time reached.

    At the end of a leg, the values are those before the next leg begins.
    """
    out = np.full((len(times), 3), np.nan)
    table = np.empty((ORDERS, 3))
    began, k, before = 0.0, 0, start_normal
    while k < len(times) and times[k] <= 0.0:
        out[k, 0], out[k, 1], out[k, 2] = w, f, g
        k += 1
    for leg in range(len(duration)):
        if normal[leg] != before:
            w, f, g = after_normal_jump(w, f, g, p, alpha, before, normal[leg])
            before = normal[leg]
        ends = began + duration[leg]
        last, stop = leg == len(duration) - 1, 0.0
        h = min(duration[leg], 0.1 * p[2] / (p[4] * np.exp(w) + abs(velocity[leg])))
        while True:
            asked = k < len(times) and (times[k] <= ends or last)
            target = times[k] - began if asked else duration[leg]
            # time since the last stop, since steps during fast slip may be below the resolution of the whole time
            t, span, steps = 0.0, target - stop, 0
            while t < span:
                d = min(h, span - t)
                w, f, g, columns = extrapolate(w, f, g, d, p, velocity[leg], normal[leg], tolerance, table)
                steps += 1
                if columns == 0:
                    h = 0.25 * d
                    if h < 1e-15 * (t + span * 1e-9) or steps > MOST_STEPS:
                        return out, RUNAWAY if h < 1e-12 * span else STEPS_SPENT, began + stop + t
                    continue
                t = span if d == span - t else t + d
                if w > FASTEST:
                    return out, RUNAWAY, began + stop + t
                if columns < 7:
                    h = max(h, d * 2.0) if columns < 5 or d < h else d * 1.3
                elif columns > 8:
                    h = 0.7 * d
            stop = target
            if not asked:
                break
            out[k, 0], out[k, 1], out[k, 2] = w, f, g
            k += 1
        began = ends
        if k == len(times):
            break
    return out, DONE, began


@njit(cache=True, error_model="numpy")
def state_history(f, duration, velocity, v0, dc, law):
    """Exact ln(V0 θ/D_c) at the ends of pieces of constant slip velocity, from its initial value f."""
    out = np.empty(len(duration))
    for k in range(len(duration)):
        x, v = velocity[k] * duration[k] / dc, velocity[k]
        if v == 0.0:
            f = np.log(np.exp(f) + duration[k] * v0 / dc) if law == AGING else f
        elif law == AGING:
            f = np.log(np.exp(f) * np.exp(-x) - np.expm1(-x) * v0 / v)
        else:
            w = np.log(v / v0)
            f = (w + f) * np.exp(-x) - w
        out[k] = f
    return out
