// Laws of rate-and-state friction, for sliders, fits and faults.
//
// w = ln(V/V0), s = ln(V0 θ/D_c), and s2 for a second state θ2 with D_c2; with one state, b2 = 0. To add a form or an
// evolution law, write its functions, add it to the list of its kind, and name it in `friction/laws.py`.
#pragma once
#include <math.h>
#include <string.h>
#include "core.h"

struct Logs {
  double w, s, s2;
};

struct Surface {
  double a, b, b2, mu0, cut, cut2;  // cuts are V0 over the cut-off velocities
};

struct Friction {
  double value, slope;  // the slope is the derivative with respect to w
};

struct Curvatures {
  double ww, ws, ws2, ss, ss2, s2s2;
};

template <class T>
inline T take(const double *from) {
  T value;
  __builtin_memcpy(&value, from, sizeof value);
  return value;
}

template <class T>
inline void put(double *to, const T &value) {
  __builtin_memcpy(to, &value, sizeof value);
}

template <class... Laws>
struct List {};

// e^x to 1 unit in the last place; without branches, so compilers evaluate it for several numbers at once. It is
// e^−708 below −708 and e^709 above 709.
inline double exponential(double x) {
  x = x < -708.0 ? -708.0 : x > 709.0 ? 709.0 : x;
  double shifted = x * 0x1.71547652b82fep+0 + 0x1.8p52;  // its last bits are those of k = x/ln 2, rounded
  double k = shifted - 0x1.8p52;
  double r = (x - k * 0x1.62e42fefa0000p-1) - k * 0x1.cf79abc9e3b39p-40;
  double sum = 1.0 / 6227020800.0;  // Taylor series, |r| ≤ ln(2)/2
  sum = sum * r + 1.0 / 479001600.0;
  sum = sum * r + 1.0 / 39916800.0;
  sum = sum * r + 1.0 / 3628800.0;
  sum = sum * r + 1.0 / 362880.0;
  sum = sum * r + 1.0 / 40320.0;
  sum = sum * r + 1.0 / 5040.0;
  sum = sum * r + 1.0 / 720.0;
  sum = sum * r + 1.0 / 120.0;
  sum = sum * r + 1.0 / 24.0;
  sum = sum * r + 1.0 / 6.0;
  sum = sum * r + 0.5;
  sum = sum * r * r + r + 1.0;
  int64_t bits;
  __builtin_memcpy(&bits, &shifted, 8);
  bits = (bits + 1023) << 52;  // 2^k
  double power;
  __builtin_memcpy(&power, &bits, 8);
  return sum * power;
}

// ---- forms: friction coefficient, its derivatives, and whether it equals μ0 + a w + b s + b2 s2 in double precision

// μ0 + a w + b s + b2 s2
struct Logarithmic {
  static bool linear(const Surface &, const Logs &) { return true; }
  static Friction friction(const Surface &q, const Logs &x) {
    return {q.mu0 + q.a * x.w + q.b * x.s + q.b2 * x.s2, q.a};
  }
  static Logs slopes(const Surface &q, const Logs &) { return {q.a, q.b, q.b2}; }
  static Curvatures curvatures(const Surface &, const Logs &) { return {}; }
};

// a arcsinh(e^x/2) with x = (μ0 + a w + b s + b2 s2)/a. Rice, Lapusta and Ranjith 2001,
// doi:10.1016/S0022-5096(01)00042-4.
struct Regularized {
  static constexpr double LARGE = 20.0;  // exponent above which arcsinh(e^x/2) equals x in double precision
  static bool linear(const Surface &q, const Logs &x) { return exponent(q, x) > LARGE; }
  static double exponent(const Surface &q, const Logs &x) { return x.w + (q.mu0 + q.b * x.s + q.b2 * x.s2) / q.a; }
  static Friction friction(const Surface &q, const Logs &logs) {
    double x = exponent(q, logs);
    if (x > LARGE) return {q.a * x, q.a};
    double y = 0.5 * exp(x);
    return {q.a * asinh(y), q.a * y / sqrt(1.0 + y * y)};
  }
  // Derivative of arcsinh(e^x/2), from 0 at rest to 1.
  static double saturation(double x) {
    if (x > LARGE) return 1.0;
    double y = 0.5 * exp(x);
    return y / sqrt(1.0 + y * y);
  }
  static Logs slopes(const Surface &q, const Logs &logs) {
    double t = saturation(exponent(q, logs));
    return {q.a * t, q.b * t, q.b2 * t};
  }
  static Curvatures curvatures(const Surface &q, const Logs &logs) {
    double t = saturation(exponent(q, logs)), c = t * (1.0 - t * t);
    return {q.a * c, q.b * c, q.b2 * c, q.b * q.b / q.a * c, q.b * q.b2 / q.a * c, q.b2 * q.b2 / q.a * c};
  }
};

// μ0 − a ln(V0/V + cut) + b ln(e^s + cut2) + b2 ln(e^s2 + cut2). Okubo 1989, doi:10.1029/JB094iB09p12321; Shibazaki and
// Iio 2003, doi:10.1029/2003GL017047.
struct CutOff {
  static bool linear(const Surface &, const Logs &) { return false; }
  static Friction friction(const Surface &q, const Logs &x) {
    double state = q.b * log(exp(x.s) + q.cut2) + q.b2 * log(exp(x.s2) + q.cut2);
    return {q.mu0 - q.a * log(exp(-x.w) + q.cut) + state, q.a / (1.0 + q.cut * exp(x.w))};
  }
  static Logs divisors(const Surface &q, const Logs &x) {
    return {1.0 + q.cut * exp(x.w), 1.0 + q.cut2 * exp(-x.s), 1.0 + q.cut2 * exp(-x.s2)};
  }
  static Logs slopes(const Surface &q, const Logs &x) {
    Logs d = divisors(q, x);
    return {q.a / d.w, q.b / d.s, q.b2 / d.s2};
  }
  static Curvatures curvatures(const Surface &q, const Logs &x) {
    Logs d = divisors(q, x), t = {1.0 / d.w, 1.0 / d.s, 1.0 / d.s2};
    return {-q.a * t.w * (1.0 - t.w), 0.0, 0.0, q.b * t.s * (1.0 - t.s), 0.0, q.b2 * t.s2 * (1.0 - t.s2)};
  }
};

using Forms = List<Logarithmic, Regularized, CutOff>;

// ---- evolution laws: ds/dt, its derivatives with respect to w and s, and s after a time at constant velocity

struct StateSlopes {
  double w, s;
};

// θ' = 1 − Vθ/D_c
struct Aging {
  template <double (*power)(double) = exp>
  static double rate(double e, double, double s, double speed) {
    return speed * (power(-s) - e);
  }
  static StateSlopes slopes(double w, double s, double speed) { return {-speed * exp(w), -speed * exp(-s)}; }
  static double later(double s, double v, double duration, double v0, double dc) {
    double x = v * duration / dc;
    if (v == 0.0) return log(exp(s) + duration * v0 / dc);
    return log(exp(s) * exp(-x) - expm1(-x) * v0 / v);
  }
};

// θ' = −(Vθ/D_c) ln(Vθ/D_c)
struct Slip {
  template <double (*)(double) = exp>
  static double rate(double e, double w, double s, double speed) { return -speed * e * (w + s); }
  static StateSlopes slopes(double w, double s, double speed) {
    double e = speed * exp(w);
    return {-e * (w + s + 1.0), -e};
  }
  static double later(double s, double v, double duration, double v0, double dc) {
    if (v == 0.0) return s;
    double w = log(v / v0);
    return (w + s) * exp(-v * duration / dc) - w;
  }
};

using Evolutions = List<Aging, Slip>;

// ---- choice and velocity

// Calls `body` with the law of a list that has a code.
template <class First, class... Rest, class Body>
inline auto with(List<First, Rest...>, int64_t code, const Body &body) {
  if constexpr (sizeof...(Rest) > 0)
    if (code > 0) return with(List<Rest...>{}, code - 1, body);
  return body(First{});
}

template <class Body>
inline auto with_laws(int64_t form, int64_t evolution, const Body &body) {
  return with(Forms{}, form, [&](auto chosen) {
    return with(Evolutions{}, evolution, [&](auto law) { return body(chosen, law); });
  });
}

constexpr int MOST_ITERATIONS = 200;
constexpr double ROUND_OFF = 1e-15;  // of a stress: if friction hardly depends on w, steps do not become smaller

// Solves σ μ(w, s, s2) + η V0 e^w = stress for w by Newton's method from a guess; steps are limited to 5. NaN if it
// does not converge.
template <class Form>
inline double log_velocity(const Surface &q, Logs x, double stress, double normal, double damping) {
  for (int k = 0; k < MOST_ITERATIONS; ++k) {
    Friction f = Form::friction(q, x);
    double push = damping * exp(x.w), missing = normal * f.value + push - stress;
    double step = missing / (normal * f.slope + push);
    step = step > 5.0 ? 5.0 : step < -5.0 ? -5.0 : step;
    x.w -= step;
    if (fabs(step) < 1e-12 || fabs(missing) < ROUND_OFF * fabs(stress)) return x.w;
  }
  return NAN;
}
