"""Compiled integration of a slider with rate-and-state friction on a spring.

The unknowns are w = ln(V/V0) and f = ln(V0 θ/D_c), because velocity and state vary over many orders of magnitude during
a hold.

Extrapolation of the linearly implicit Euler method (P. Deuflhard, SIAM Rev. 27, 505 (1985), doi:10.1137/1027140) needs
no table of coefficients, adapts its order, and solves the 2 × 2 systems by Cramer's rule. A step ends at every
requested time, so that nothing is interpolated. `python -m benchmarks --friction` compares its speed with that of
LSODA.
"""

import numpy as np
from numba import njit

from .. import kernel_cache

kernel_cache.install()

AGING, SLIP = 0, 1
DONE, RUNAWAY, STEPS_SPENT = 0, 1, 2
ORDERS = 10  # largest number of columns of the extrapolation
FASTEST = 200.0  # ln(V/V0) above which slip has run away: quasi-static slip does so in finite time
MOST_STEPS = 200_000  # between two requested times


@njit(cache=True, error_model="numpy")
def rates(w, f, p, velocity, normal):
    """Time derivatives dw/dt and df/dt.

    f' = (V0/D_c)(e^{−f} − e^{w}) (aging) or −(V0/D_c) e^{w} (w + f) (slip), and the balance of forces
    n(μ0 + a w + b f) + ηV = k(x_lp − x), differentiated: (n a + ηV) w' = k(V_lp − V) − n b f'.

    Parameters
    ----------
    p : a, b, dc, mu0, v0, stiffness, damping, law
    velocity : of the load point
    normal : normal stress over its reference
    """
    speed = p[4] / p[2]
    e = np.exp(w)
    if p[7] == AGING:
        df = speed * (np.exp(-f) - e)
    else:
        df = -speed * e * (w + f)
    return (p[5] * (velocity - p[4] * e) - normal * p[1] * df) / (normal * p[0] + p[6] * p[4] * e), df


@njit(cache=True, error_model="numpy")
def rate_derivatives(w, f, p, velocity, normal):
    """Derivatives of `rates`: of dw/dt with respect to w and f, and of df/dt with respect to w and f."""
    speed = p[4] / p[2]
    e = np.exp(w)
    if p[7] == AGING:
        fw, ff = -speed * e, -speed * np.exp(-f)
    else:
        fw, ff = -speed * e * (w + f + 1.0), -speed * e
    inertia = normal * p[0] + p[6] * p[4] * e
    dw, _ = rates(w, f, p, velocity, normal)
    ww = (-p[5] * p[4] * e - normal * p[1] * fw - dw * p[6] * p[4] * e) / inertia
    return ww, -normal * p[1] * ff / inertia, fw, ff


@njit(cache=True, error_model="numpy")
def extrapolate(w, f, h, p, velocity, normal, tolerance, table):
    """Take one step of length h; return new w and f and the number of columns used (0 if the tolerance was not met)."""
    ww, wf, fw, ff = rate_derivatives(w, f, p, velocity, normal)
    for j in range(ORDERS):
        d = h / (j + 1)
        det = (1.0 - d * ww) * (1.0 - d * ff) - d * d * wf * fw
        x, y = w, f
        for _ in range(j + 1):
            gx, gy = rates(x, y, p, velocity, normal)
            dx = d * ((1.0 - d * ff) * gx + d * wf * gy) / det
            dy = d * ((1.0 - d * ww) * gy + d * fw * gx) / det
            x, y = x + dx, y + dy
            if not (abs(dx) < 5.0 and abs(dy) < 5.0):
                return w, f, 0
        for m in range(j):  # Aitken and Neville: table holds row j − 1 and becomes row j
            share = (j - m) / (m + 1.0)
            nx, ny = x + (x - table[m, 0]) * share, y + (y - table[m, 1]) * share
            table[m, 0], table[m, 1] = x, y
            gap = max(abs(nx - x), abs(ny - y))
            x, y = nx, ny
        table[j, 0], table[j, 1] = x, y
        if j >= 2 and gap <= tolerance:
            return x, y, j + 1
    return w, f, 0


@njit(cache=True, error_model="numpy")
def after_normal_jump(w, f, p, alpha, old, new):
    """w and f after a jump in the normal stress from `old` to `new`.

    θ → θ (new/old)^(−α/b) (Linker and Dieterich 1992), at constant spring force F = n(μ0 + a w + b f) + ηV.
    """
    a, b, mu0 = p[0], p[1], p[3]
    eta = p[6] * p[4]
    force = old * (mu0 + a * w + b * f) + eta * np.exp(w)
    f -= (alpha / b if b > 0.0 else 0.0) * np.log(new / old)
    w = (force / new - mu0 - b * f) / a
    if eta > 0.0:
        w = min(w, np.log(max(abs(force), eta) / eta))
        for _ in range(100):  # Newton's method; the function is convex and increasing, so it converges from above
            push = eta * np.exp(w)
            step = (new * (mu0 + a * w + b * f) + push - force) / (new * a + push)
            w -= step
            if abs(step) < 1e-14 * (1.0 + abs(w)):
                break
    return w, f


@njit(cache=True, error_model="numpy")
def integrate(w, f, p, alpha, duration, velocity, normal, start_normal, times, tolerance):
    """Integrate w and f to `times` (ascending, from the start of the legs); also return a code and the time reached.

    At the end of a leg, the values are those before the next leg begins.
    """
    out = np.full((len(times), 2), np.nan)
    table = np.empty((ORDERS, 2))
    began, k, before = 0.0, 0, start_normal
    while k < len(times) and times[k] <= 0.0:
        out[k, 0], out[k, 1] = w, f
        k += 1
    for leg in range(len(duration)):
        if normal[leg] != before:
            w, f = after_normal_jump(w, f, p, alpha, before, normal[leg])
            before = normal[leg]
        ends = began + duration[leg]
        last, t = leg == len(duration) - 1, 0.0
        h = min(duration[leg], 0.1 * p[2] / (p[4] * np.exp(w) + abs(velocity[leg])))
        while True:
            asked = k < len(times) and (times[k] <= ends or last)
            target = times[k] - began if asked else duration[leg]
            steps = 0
            while t < target:
                d = min(h, target - t)
                w, f, columns = extrapolate(w, f, d, p, velocity[leg], normal[leg], tolerance, table)
                steps += 1
                if columns == 0:
                    h = 0.25 * d
                    if h < 1e-15 * (t + duration[leg] * 1e-9) or steps > MOST_STEPS:
                        return out, RUNAWAY if h < 1e-12 * duration[leg] else STEPS_SPENT, began + t
                    continue
                t = target if d == target - t else t + d
                if w > FASTEST:
                    return out, RUNAWAY, began + t
                if columns < 7:
                    h = max(h, d * 2.0) if columns < 5 or d < h else d * 1.3
                elif columns > 8:
                    h = 0.7 * d
            if not asked:
                break
            out[k, 0], out[k, 1] = w, f
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
