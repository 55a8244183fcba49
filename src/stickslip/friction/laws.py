"""Laws of rate-and-state friction as scalar functions, shared by the slider, fits and faults.

With w = ln(V/V0) and s = ln(V0 θ/D_c), and s2 for a second state θ2 with D_c2:

    friction(form, w, s, s2, a, b, b2, mu0, cut, cut2)   friction coefficient and its derivative with respect to w
    slopes(form, w, s, s2, a, b, b2, mu0, cut, cut2)     its derivatives with respect to w, s and s2
    curvatures(form, w, s, s2, a, b, b2, mu0, cut, cut2) its second derivatives (ww, ws, ws2, ss, ss2, s2s2)
    state_rate(law, e, w, s, speed)                      ds/dt, with e = V/V0 and speed = V0/D_c
    state_slopes(law, w, s, speed)                       its derivatives with respect to w and s

Codes of forms and evolution laws come from `form_code` and `EVOLUTIONS`. One state: b2 = 0. To add a law, give it a
number and a name here, and a branch.
"""

import numpy as np
from numba import njit

from .. import kernel_cache

kernel_cache.install()

AGING, SLIP = 0, 1
LOGARITHMIC, REGULARIZED, CUT_OFF = 0, 1, 2
EVOLUTIONS = {"aging": AGING, "slip": SLIP}
FORMS = {"logarithmic": LOGARITHMIC, "regularized": REGULARIZED}
LARGE = 20.0  # exponent above which arcsinh(e^x/2) equals x in double precision


def form_code(form: str, cut: float, cut2: float) -> int:
    """Code of a form of the law, which is another one with cut-off velocities."""
    return CUT_OFF if cut > 0 or cut2 > 0 else FORMS[form]


@njit(cache=True, error_model="numpy", inline="always")
def friction(form, w, s, s2, a, b, b2, mu0, cut, cut2):
    """Friction coefficient and its derivative with respect to w.

    Regularized: a arcsinh[e^x/2] with x = (μ0 + a w + b s + b2 s2)/a (Rice, Lapusta and Ranjith 2001,
    doi:10.1016/S0022-5096(01)00042-4). Logarithmic: μ0 − a ln(V0/V + cut) + b ln(e^s + cut2) + b2 ln(e^s2 + cut2),
    with cut = V0/V1 and cut2 = V0/V2 for the cut-off velocities V1 and V2 (Okubo 1989, doi:10.1029/JB094iB09p12321;
    Shibazaki and Iio 2003, doi:10.1029/2003GL017047); both are 0 in the usual law.
    """
    if form == REGULARIZED:
        x = w + (mu0 + b * s + b2 * s2) / a
        if x > LARGE:
            return a * x, a
        y = 0.5 * np.exp(x)
        return a * np.arcsinh(y), a * y / np.sqrt(1.0 + y * y)
    if form == CUT_OFF:
        state = b * np.log(np.exp(s) + cut2) + b2 * np.log(np.exp(s2) + cut2)
        return mu0 - a * np.log(np.exp(-w) + cut) + state, a / (1.0 + cut * np.exp(w))
    return mu0 + a * w + b * s + b2 * s2, a


@njit(cache=True, error_model="numpy", inline="always")
def slopes(form, w, s, s2, a, b, b2, mu0, cut, cut2):
    """Derivatives of `friction` with respect to w, s and s2."""
    if form == LOGARITHMIC:
        return a, b, b2
    if form == REGULARIZED:
        t = _saturation(w + (mu0 + b * s + b2 * s2) / a)
        return a * t, b * t, b2 * t
    ds, ds2 = b / (1.0 + cut2 * np.exp(-s)), b2 / (1.0 + cut2 * np.exp(-s2))
    return a / (1.0 + cut * np.exp(w)), ds, ds2


@njit(cache=True, error_model="numpy", inline="always")
def curvatures(form, w, s, s2, a, b, b2, mu0, cut, cut2):
    """Second derivatives of `friction`: ww, ws, ws2, ss, ss2, s2s2."""
    if form == REGULARIZED:
        t = _saturation(w + (mu0 + b * s + b2 * s2) / a)
        c = t * (1.0 - t * t)
        return a * c, b * c, b2 * c, b * b / a * c, b * b2 / a * c, b2 * b2 / a * c
    if form == CUT_OFF:
        t, q, q2 = 1.0 / (1.0 + cut * np.exp(w)), 1.0 / (1.0 + cut2 * np.exp(-s)), 1.0 / (1.0 + cut2 * np.exp(-s2))
        return -a * t * (1.0 - t), 0.0, 0.0, b * q * (1.0 - q), 0.0, b2 * q2 * (1.0 - q2)
    return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


@njit(cache=True, error_model="numpy", inline="always")
def _saturation(x):
    """Derivative of arcsinh(e^x/2), from 0 at rest to 1."""
    if x > LARGE:
        return 1.0
    y = 0.5 * np.exp(x)
    return y / np.sqrt(1.0 + y * y)


@njit(cache=True, error_model="numpy", inline="always")
def state_rate(law, e, w, s, speed):
    """Time derivative of s: (V0/D_c)(e^{−s} − e^w) (aging) or −(V0/D_c) e^w (w + s) (slip)."""
    if law == AGING:
        return speed * (np.exp(-s) - e)
    return -speed * e * (w + s)


@njit(cache=True, error_model="numpy", inline="always")
def state_slopes(law, w, s, speed):
    """Derivatives of `state_rate` with respect to w and s."""
    e = speed * np.exp(w)
    if law == AGING:
        return -e, -speed * np.exp(-s)
    return -e * (w + s + 1.0), -e


@njit(cache=True, error_model="numpy", inline="always")
def log_velocity(force, w, s, s2, form, a, b, b2, mu0, cut, cut2, normal, damping):
    """Solve n μ(w, s, s2) + η V0 e^w = force for w by Newton's method from a guess; steps are limited to 5.

    Parameters
    ----------
    damping : η V0
    """
    for _ in range(200):
        mu, slope = friction(form, w, s, s2, a, b, b2, mu0, cut, cut2)
        push = damping * np.exp(w)
        step = (normal * mu + push - force) / (normal * slope + push)
        w -= min(max(step, -5.0), 5.0)
        if abs(step) < 1e-14 * (1.0 + abs(w)) or abs(w) > 700.0:
            break
    return w
