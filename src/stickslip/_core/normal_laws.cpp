// build: -ffp-contract=fast
// Normal laws with additional parameters, as functions that the core calls like those of user-defined laws. Their
// slopes come from dual numbers. See the constructors in `core/laws/builtin.py` for equations and sources.
#include <math.h>

#include "laws.h"

namespace {

constexpr int64_t OWN = DAMPING_T + 1;  // first additional parameter

// One contact; the overlap may be a dual number.
template <class T>
struct At {
  const double *q;
  double r_eff;
  T overlap;
  const double *memory;
};

inline double cube_root(double x) { return cbrt(x); }
inline Dual cube_root(Dual x) {
  double value = cbrt(x.value);
  return {value, x.slope / (3.0 * value * value)};
}

template <class T>
T positive_root(T x) {
  return x > T{} ? root(x) : T{};
}

template <class T>
Elastic<T> hertz(const At<T> &at) {
  T radius = positive_root(at.r_eff * at.overlap);
  return {at.q[KN] * at.overlap * radius, at.q[KT] * radius};
}

double hertz_energy(const At<double> &at) { return 0.4 * hertz(at).force * larger(at.overlap, 0.0); }

struct Plain {  // defaults of a law
  static constexpr bool REMEMBERS = false, BRIDGES = false, CAPPED = false;
  static double range(const double *, double) { return 0.0; }
  template <class T>
  static T pressing(const At<T> &) { return T{}; }
  static double updated(const At<double> &) { return 0.0; }
};

// Contact radius a with δ = a²/R − √(2πwa/E*) in closed form, k_n = 4E*/3.
struct Jkr : Plain {
  static constexpr bool BRIDGES = true, CAPPED = true;

  static double spread(const double *q, double r_eff) { return 8.0 / 3.0 * M_PI * q[OWN] * r_eff * r_eff / q[KN]; }

  static double range(const double *q, double r_eff) {
    double c = spread(q, r_eff);
    return cbrt(27.0 / 256.0 * c * c) / r_eff;
  }

  template <class T>
  static T radius(const At<T> &at) {
    double c = spread(at.q, at.r_eff);
    T x = at.r_eff * at.overlap;
    T cube = x * x * x / 27.0, u = cube_root(c * positive_root(cube + c * c / 256.0) + 8.0 * cube + c * c / 16.0);
    T w = positive_root(2.0 * u + 8.0 / 9.0 * x * x / u + 4.0 / 3.0 * x);
    T a = 0.5 * (w + positive_root(4.0 * x - w * w + 2.0 * c / w));
    if (!(x > T{})) return a;
    // half of the digits are lost if adhesion is weak: a step of Newton's method restores them
    return a - (a * a - x - positive_root(c * a)) / (2.0 * a - 0.5 * positive_root(c / a));
  }

  template <class T>
  static T force(const At<T> &at, T a) {
    T cube = a * a * a;
    return at.q[KN] / at.r_eff * cube - sqrt(6.0 * M_PI * at.q[OWN] * at.q[KN]) * positive_root(cube);
  }

  template <class T>
  static Elastic<T> spring(const At<T> &at) {
    T a = radius(at);
    return {force(at, a), at.q[KT] * a};
  }

  static double stored(const At<double> &at, double a) {
    double one = 0.4 * at.q[KN] / (at.r_eff * at.r_eff) * a * a * a * a * a;
    double two = 2.0 / 3.0 * sqrt(6.0 * M_PI * at.q[OWN] * at.q[KN]) / at.r_eff * a * a * a * sqrt(a);
    return one - two + M_PI * at.q[OWN] * a * a;
  }

  static double energy(const At<double> &at) {
    return stored(at, radius(at)) - stored(at, cbrt(spread(at.q, at.r_eff) / 16.0));
  }

  template <class T>
  static T pressing(const At<T> &at) {
    return magnitude(spring(at).force + 3.0 * M_PI * at.q[OWN] * at.r_eff);
  }
};

struct Dmt : Plain {
  static constexpr bool CAPPED = true;
  static double pull(const double *q, double r_eff) { return 2.0 * M_PI * q[OWN] * r_eff; }

  template <class T>
  static Elastic<T> spring(const At<T> &at) {
    Elastic<T> out = hertz(at);
    return {out.force - pull(at.q, at.r_eff), out.stiffness};
  }

  static double energy(const At<double> &at) { return hertz_energy(at) - pull(at.q, at.r_eff) * at.overlap; }

  template <class T>
  static T pressing(const At<T> &at) {
    return magnitude(spring(at).force + 2.0 * pull(at.q, at.r_eff));
  }
};

struct WaltonBraun : Plain {
  static constexpr bool REMEMBERS = true;

  template <class T>
  static T compressed(const At<T> &at) {  // from the overlap at which the force vanishes
    T memory = T{} + at.memory[0], deepest = at.overlap < memory ? memory : at.overlap;
    return larger(at.overlap + (at.q[KN] / at.q[OWN] - 1.0) * deepest, T{});
  }

  template <class T>
  static Elastic<T> spring(const At<T> &at) {
    return {at.q[OWN] * compressed(at), T{} + at.q[KT]};
  }

  static double energy(const At<double> &at) {
    double x = compressed(at);
    return 0.5 * at.q[OWN] * x * x;
  }

  static double updated(const At<double> &at) { return larger(at.overlap, at.memory[0]); }
};

struct LiquidBridge : Plain {
  static constexpr bool BRIDGES = true, CAPPED = true;

  static double range(const double *q, double) { return cbrt(q[OWN + 1]); }
  static double length(const double *q, double r_eff) { return q[OWN + 1] / (M_PI * r_eff); }  // squared

  // Attraction over 4πγR_eff before that at rupture is subtracted; spheres of radius 2 R_eff.
  template <class T>
  static T hold(T gap, double length) {
    return T{} + 1.0 - gap / root(gap * gap + length);
  }

  template <class T>
  static Elastic<T> spring(const At<T> &at) {
    double square = length(at.q, at.r_eff), reach = range(at.q, at.r_eff);
    if (!(reach > 0.0)) return hertz(at);
    Elastic<T> out = hertz(at);
    T bridge = hold(larger(-at.overlap, T{}), square) - hold(reach, square);
    return {out.force - 4.0 * M_PI * at.q[OWN] * at.r_eff * bridge, out.stiffness};
  }

  static double energy(const At<double> &at) {  // ∫ hold dg = g − √(g² + V/(πR_eff))
    double square = length(at.q, at.r_eff), reach = range(at.q, at.r_eff), gap = larger(-at.overlap, 0.0);
    if (!(reach > 0.0)) return hertz_energy(at);
    double last = hold(reach, square), deep = (1.0 - last) * larger(at.overlap, 0.0);
    double work = (1.0 - last) * (reach - gap) - sqrt(reach * reach + square) + sqrt(gap * gap + square);
    return hertz_energy(at) - 4.0 * M_PI * at.q[OWN] * at.r_eff * (work + deep);
  }

  template <class T>
  static T pressing(const At<T> &at) {
    return hertz(at).force;
  }
};

enum Member { FORCE, CAP, SLOPES, CAP_SLOPES, ENERGY, RANGE, UPDATE };

template <class L, Member WHAT>
void evaluate(const double *q, int64_t n, const double *r_eff, const double *overlap, const double *, const double *memory,
              double *one, double *two) {
  for (int64_t k = 0; k < n; ++k) {
    const At<double> at = {q, r_eff[k], overlap[k], memory};
    const At<Dual> moved = {q, r_eff[k], {overlap[k], 1.0}, memory};
    if constexpr (WHAT == FORCE) {
      Elastic<double> out = L::spring(at);
      one[k] = out.force, two[k] = out.stiffness;
    } else if constexpr (WHAT == SLOPES) {
      Elastic<Dual> out = L::spring(moved);
      one[k] = out.force.slope, two[k] = out.stiffness.slope;
    } else if constexpr (WHAT == CAP) {  // independent of dashpots, as in LAMMPS
      one[k] = q[MU] * L::pressing(at);
    } else if constexpr (WHAT == CAP_SLOPES) {
      one[k] = 0.0, two[k] = q[MU] * L::pressing(moved).slope;
    } else if constexpr (WHAT == ENERGY) {
      one[k] = L::energy(at);
    } else if constexpr (WHAT == RANGE) {
      one[k] = L::range(q, r_eff[k]);
    } else {
      one[k] = L::updated(at);
    }
  }
}

template <class L>
LawFunction function(int64_t member) {
  const LawFunction all[] = {evaluate<L, FORCE>,
                             L::CAPPED ? evaluate<L, CAP> : nullptr,
                             evaluate<L, SLOPES>,
                             L::CAPPED ? evaluate<L, CAP_SLOPES> : nullptr,
                             evaluate<L, ENERGY>,
                             L::BRIDGES ? evaluate<L, RANGE> : nullptr,
                             L::REMEMBERS ? evaluate<L, UPDATE> : nullptr};
  return all[member];
}

}  // namespace

void *law_function(int64_t law, int64_t member) {
  LawFunction (*const laws[])(int64_t) = {function<Jkr>, function<Dmt>, function<WaltonBraun>, function<LiquidBridge>};
  return reinterpret_cast<void *>(laws[law](member));
}
