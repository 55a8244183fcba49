// Moments that resist rolling and twisting, with memory (see `core/contacts/rolling.py`).
#pragma once
#include "mechanics.h"
#include "pairs.h"

template <class T>
struct Resistance {
  T stiffness, cap, damping;  // of a moment
};

// Force to which the Coulomb limit and the caps of moments are proportional.
template <class T>
inline T pressing_force(Parameters q, T limit) {
  return q[MU] > 0.0 ? limit / q[MU] : T{};
}

// k_r and dk_r/dδ.
inline Slopes<double> rolling_stiffness(const Law &law, Parameters q, double r_eff, double overlap) {
  if (law.rolling) return call(law.rolling, q, r_eff, overlap, 0.0);
  return {law.roll_at ? q[law.roll_at] * r_eff * r_eff : 0.0, 0.0};
}

// Of a law without user-defined functions; `limit` is the Coulomb limit.
template <class T>
inline Resistance<T> built_in_rolling(const Law &law, Parameters q, T r_eff, T limit) {
  if (!law.roll_at) return {T{}, T{}, T{}};
  T force = pressing_force(q, limit), damping = q[law.roll_at + 2] * r_eff * r_eff;
  return {q[law.roll_at] * r_eff * r_eff, q[law.roll_at + 1] * r_eff * force,
          law.roll_viscous ? force * damping : damping};
}

// `fn` is the normal force.
inline Resistance<double> rolling_resistance(const Law &law, Parameters q, double r_eff, double overlap, double fn,
                                             double limit) {
  if (!law.rolling) return built_in_rolling(law, q, r_eff, limit);
  return {rolling_stiffness(law, q, r_eff, overlap).first, call(law.rolling_cap, q, r_eff, overlap, fn).first, 0.0};
}

// Factors of the coefficients of scaled twisting: a² and da²/dδ, and the tangential dashpot.
template <class T>
struct TwistScale {
  T radius, slope, damping;  // a, da/dδ
};

template <class T>
inline TwistScale<T> twist_scale(const Law &law, Parameters q, T r_eff, T overlap, T stiffness, T slope, T damping) {
  if (!law.twist_scaled) return {T{} + 1.0, T{}, T{} + 1.0};
  Slopes<T> a = contact_radius(law, q, r_eff, overlap, stiffness, slope);
  return {a.first, a.second, damping};
}

template <class T>
inline Resistance<T> twisting_resistance(const Law &law, Parameters q, T limit, TwistScale<T> scale) {
  if (!law.twist_at) return {T{}, T{}, T{}};
  const T a = scale.radius, square = a * a;
  return {q[law.twist_at] * square, q[law.twist_at + 1] * a * pressing_force(q, limit),
          q[law.twist_at + 2] * square * scale.damping};
}

// Derivatives of a cap, `share` times the pressing force, with respect to F_n and to the overlap.
inline Slopes<double> moment_cap_slopes(const Law &law, Parameters q, double r_eff, double overlap, double fn,
                                        double share) {
  if (!(q[MU] > 0.0)) return {0.0, 0.0};
  Slopes<double> edge = cap_slopes(law, q, r_eff, overlap, fn);
  return {share / q[MU] * edge.first, share / q[MU] * edge.second};
}

// Moment on i of a spring ψ and its dashpot; w is the rate of ψ.
template <class T>
inline Vec<T> rolling_load(const Law &law, Resistance<T> r, Vec<T> psi, Vec<T> w) {
  Vec<T> t = -r.stiffness * psi;
  if (law.roll_viscous) return t - r.damping * w;
  return any(r.damping > 0.0) ? with_tangential_dashpot(t, r.damping, r.cap, w) : t;
}

template <class T>
inline T twisting_load(Resistance<T> r, T twist, T w) {
  return larger(smaller(-r.stiffness * twist - r.damping * w, r.cap), -r.cap);
}

// Resistance of sticking contacts with HELD memory has no cap.
template <class T, class M>
inline Resistance<T> as_held(Resistance<T> r, int64_t memory, M slides) {
  if (memory == HELD) r.cap = select(slides, r.cap, T{} + NO_LIMIT);
  return r;
}

// Moment on i, memory and whether it is at its cap, of a spring ψ that was rotated to `a` and turned by `d` during a step.
template <int DIM, class T, class M>
inline Loads<T, M> rolled_spring(const Law &law, Resistance<T> r, int64_t memory, T slack, Vec<T> a, Vec<T> d, Vec<T> w,
                                 Ratio<T> fraction, M slid) {
  auto elastic = r.stiffness > 0.0;
  if (law.rate && any(elastic))  // spring and dashpot together
    return truncate_as_lammps(T{}, r.stiffness, r.damping, r.cap, slack, a + d, w, M{}, slid);
  Truncated<T, M> out =
      return_mapping<DIM>(false, bool(law.rate), memory, r.stiffness, r.cap, slack, a, d, fraction, slid, T{} + 1.0);
  Vec<T> psi = select(elastic, out.slip, Vec<T>{});
  return {T{}, rolling_load(law, as_held(r, memory, out.slides), psi, w), psi, r.cap, out.slides};
}

// Twist of a spring truncated at its cap; `held`: it stays at its cap or below it.
template <class T, class M>
inline M truncate_twist(Resistance<T> r, T slack, bool held, M slid, T &twist) {
  auto elastic = r.stiffness > 0.0;
  const T pull = r.stiffness * magnitude(twist), most = select(elastic, r.cap / select(elastic, r.stiffness, T{} + 1.0), T{});
  const M cut = M((r.cap == 0.0) | (r.stiffness == 0.0)) | (held ? M(slid & (twist != 0.0)) : M(pull > r.cap));
  twist = select(cut, select(twist > 0.0, most, -most), twist);
  return held ? cut : M(cut | (slid & still_slides(pull * pull, r.cap, slack)));
}

template <class T, class M>
struct Twisted {
  T moment, twist;  // the moment on i along the normal
  M slides;
};

template <class T, class M>
inline Twisted<T, M> twisted_spring(const Law &law, Resistance<T> r, int64_t memory, T slack, T twist, T w, M slid) {
  if (!law.rate) {
    const M slides = truncate_twist(r, slack, memory == HELD, slid, twist);
    return {twisting_load(as_held(r, memory, slides), twist, w), twist, slides};
  }
  const T t = twisting_load(r, twist, w);  // spring and dashpot together
  const M cut = M(magnitude(t) >= r.cap);
  auto elastic = r.stiffness > 0.0;
  twist = select(M(cut & elastic), -(t + r.damping * w) / select(elastic, r.stiffness, T{} + 1.0), twist);
  return {t, twist, M(cut | (slid & still_slides(t * t, r.cap, slack)))};
}

// Round-off of a rotation that is an elastic memory.
inline double rotation_round_off(const Bodies &bodies, const Contacts &contacts, const Pair &pair, int64_t c) {
  const int64_t i = contacts.i[c], j = contacts.j[c];
  return ROUND_OFF * (bodies.radius[i] + bodies.radius[j]) / effective_radius(bodies, i, j, pair.wall);
}

struct RotationStep {
  Vec<double> turned, rate;  // change of angle_i − angle_j, and its rate as dashpots use it
  Vec<double> n, mid;
  Ratio<double> fraction;
  int64_t memory;     // see mechanics.h
  bool kept, closed;  // the memory is kept; the contact touched before
  bool still, moves;  // it has not moved since it was committed; a dashpot acts
  double round_off;   // of a rotation
};

// Treatment of the memory of a rotation (see `agrees`).
struct Keeping {
  double slack;
  bool slid, held, kept;  // its moment is that of the memory; the memory is kept
};

inline Keeping keeping(Resistance<double> r, const RotationStep &step, bool slid, double size) {
  const double slack = r.stiffness * step.round_off, pull = r.stiffness * size;
  const bool held = step.kept || (step.still && agrees(step.memory, slid, pull, r.cap, slack));
  return {slack, slid, held, held || (step.still && step.moves && is_kept_in_motion(slid, pull, r.cap))};
}

// Moment on i that resists rolling; the memory `own` is updated.
template <int DIM>
inline Vec<double> rolling_moment(const Law &law, Resistance<double> r, const RotationStep &step, double *own) {
  Vec<double> psi = {own[0], own[1], own[2]}, w = step.rate - dot(step.rate, step.n) * step.n;
  Keeping keep = keeping(r, step, own[AT_CAP] > 0.0, root(dot(psi, psi)));
  if (!step.kept && !is_tangential(step.n, psi)) keep.held = keep.kept = false;
  if (keep.held) return rolling_load(law, as_held(r, step.memory, keep.slid), psi, w);
  Vec<double> a = step.closed ? onto_plane(step.n, step.mid, psi) : Vec<double>{};
  Loads<double, bool> out = rolled_spring<DIM>(law, r, step.memory, keep.slack, a, onto_plane(step.n, step.mid, step.turned),
                                               w, step.fraction, keep.slid);
  if (!keep.kept || (law.rate && r.stiffness > 0.0))
    own[0] = out.slip.x, own[1] = out.slip.y, own[2] = out.slip.z, own[AT_CAP] = out.slides;
  return out.tangential;
}

// Moment on i along the normal that resists twisting; the memory `own` is updated.
inline double twisting_moment(const Law &law, Resistance<double> r, const RotationStep &step, double *own) {
  const double w = dot(step.rate, step.n);
  const Keeping keep = keeping(r, step, own[TWIST_AT_CAP] > 0.0, magnitude(own[TWIST]));
  if (keep.held) return twisting_load(as_held(r, step.memory, keep.slid), own[TWIST], w);
  double twist = (step.closed ? own[TWIST] : 0.0) + step.fraction.part / step.fraction.whole * dot(step.mid, step.turned);
  Twisted<double, bool> out = twisted_spring(law, r, step.memory, keep.slack, twist, w, keep.slid);
  if (!keep.kept) own[TWIST] = out.twist, own[TWIST_AT_CAP] = out.slides;
  return out.moment;
}
