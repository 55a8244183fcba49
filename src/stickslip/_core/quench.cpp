// build: -ffp-contract=fast -fno-signed-zeros -ffinite-math-only
// Descent of the elastic energy by FIRE (see `solve.equilibrate`).
#include <string.h>

#include "pairs.h"

constexpr double SMALL = 1e-4;  // largest unbalanced force over the mean contact force, at most
constexpr double FINEST = 0.25 * 2.2e-16;  // of the largest coordinate, times stiffness: forces balance no better
constexpr double LATENCY = 5.0, FASTER = 1.1, SLOWER = 0.5, MIXING = 0.1, LESS_MIXING = 0.99;
constexpr int64_t MEASURE_EVERY = 50;  // steps between two measurements of the stiffness

struct Fire {  // the array `pace`
  double dt, mixing, downhill, longest, balanced;
};

static void add(double *to, double factor, Vec<double> v) {
  to[0] += factor * v.x, to[1] += factor * v.y, to[2] += factor * v.z;
}

// Adds the normal forces of all pairs; returns the mean of |F_n| over those that touch.
template <int DIM>
static double add_normal_forces(const Law &law, const Bodies &bodies, const Contacts &contacts, const double *shift,
                                double *force) {
  double total = 0.0, touching = 0.0;
  for (int64_t c = 0; c < *contacts.count; c++) {
    Pair pair = pair_at(law, DIM, bodies, contacts, shift, c);
    if (!pair.touches) continue;
    double fn = elastic(law, pair.q, pair.r_eff, pair.overlap).force;
    total += magnitude(fn), touching += 1.0;
    add(force + 3 * contacts.i[c], fn, pair.n);
    add(force + 3 * contacts.j[c], -fn, pair.n);
  }
  return total / larger(touching, 1.0);
}

// Largest sum of |dF_n/dδ| over the contacts of a grain, which bounds ω² ≤ 2 Σ k for m = 1.
template <int DIM>
static double largest_stiffness(const Law &law, const Bodies &bodies, const Contacts &contacts, const double *shift,
                                double *stiffness) {
  double most = 0.0;
  for (int64_t a = 0; a < bodies.len_radius; a++) stiffness[a] = 0.0;
  for (int64_t c = 0; c < *contacts.count; c++) {
    Pair pair = pair_at(law, DIM, bodies, contacts, shift, c);
    if (!pair.touches) continue;
    double k = magnitude(tangents(law, pair.q, pair.r_eff, pair.overlap).first);
    int64_t ends[] = {contacts.i[c], contacts.j[c]};
    for (int64_t a : ends) most = larger(most, stiffness[a] += k);
  }
  return most;
}

struct Sums {
  double worst, power, speed, size;  // largest |f|, v·f, v·v and f·f
};

static double largest(const double *x, int64_t n) {
  double most = 0.0;
  for (int64_t k = 0; k < n; k++) most = larger(most, magnitude(x[k]));
  return most;
}

static double total(Real x) {
  double sum = 0.0;
  for (int k = 0; k < W; k++) sum += x[k];
  return sum;
}

static Sums sums_of(const double *v, const double *f, int64_t n) {
  Real worst = {}, power = {}, speed = {}, size = {};
  int64_t k = 0;
  for (; k + W <= n; k += W) {
    Real u = load(v + k), g = load(f + k);
    worst = larger(worst, magnitude(g)), power += u * g, speed += u * u, size += g * g;
  }
  Sums sums = {0.0, total(power), total(speed), total(size)};
  for (int lane = 0; lane < W; lane++) sums.worst = larger(sums.worst, worst[lane]);
  for (; k < n; k++) {
    sums.worst = larger(sums.worst, magnitude(f[k]));
    sums.power += v[k] * f[k], sums.speed += v[k] * v[k], sums.size += f[k] * f[k];
  }
  return sums;
}

// Moves by one step and clears the forces; returns the largest displacement since the list was built.
static double move(double *x, double *v, double *f, const double *origin, int64_t n, double dt, double keep,
                   double along) {
  double far = 0.0;
  for (int64_t k = 0; k < n; k++) {
    v[k] = keep * (v[k] + dt * f[k]) + along * f[k];
    x[k] += dt * v[k];
    f[k] = 0.0;
    far = larger(far, magnitude(x[k] - origin[k]));
  }
  return far;
}

template <int DIM>
static int64_t descend_in(const Law &law, const Bodies &bodies, const Contacts &contacts, const double *shift,
                          double *v, double *f, double *stiffness, Fire &pace, double reach, double tolerance,
                          int64_t steps) {
  double *x = bodies.position;
  int64_t n = 3 * bodies.len_radius;
  memset(f, 0, n * sizeof *f);
  double mean = add_normal_forces<DIM>(law, bodies, contacts, shift, f), least = tolerance;
  for (int64_t step = 0; step < steps; step++) {
    Sums now = sums_of(v, f, n);
    pace.balanced = now.worst <= least && (now.worst <= SMALL * mean || mean <= SMALL * tolerance);
    if (pace.balanced) return step;
    if (step % MEASURE_EVERY == 0) {
      double k = largest_stiffness<DIM>(law, bodies, contacts, shift, stiffness);
      if (k > 0.0) pace.longest = root(2.0 / k);
      least = larger(tolerance, FINEST * k * largest(x, n));
      pace.dt = pace.dt > 0.0 ? smaller(pace.dt, pace.longest) : 0.1 * pace.longest;
    }
    if (now.power > 0.0) {
      pace.downhill += 1.0;
      if (pace.downhill > LATENCY) pace.dt = smaller(FASTER * pace.dt, pace.longest), pace.mixing *= LESS_MIXING;
    } else {
      pace.downhill = 0.0, pace.mixing = MIXING, now.speed = 0.0;
      if (step > LATENCY) pace.dt *= SLOWER;
      for (int64_t k = 0; k < n; k++) x[k] -= 0.5 * pace.dt * v[k], v[k] = 0.0;
    }
    double along = now.size > 0.0 ? pace.mixing * root(now.speed / now.size) : 0.0;
    if (move(x, v, f, contacts.origin, n, pace.dt, 1.0 - pace.mixing, along) > reach) return step + 1;
    mean = add_normal_forces<DIM>(law, bodies, contacts, shift, f);
  }
  return steps;
}

int64_t descend(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts, const double *shift,
                double reach, double *velocity, double *force, double *stiffness, double *pace, double tolerance,
                int64_t steps) {
  Fire &now = *reinterpret_cast<Fire *>(pace);
  return (dim == 3 ? descend_in<3> : descend_in<2>)(*law, *bodies, *contacts, shift, velocity, force, stiffness, now,
                                                    reach, tolerance, steps);
}
