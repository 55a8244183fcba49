// Moments that resist rolling and twisting, with memory (see `core/contacts/rolling.py`).
#pragma once
#include "mechanics.h"
#include "pairs.h"

struct Resistance {
  double stiffness, cap, damping;  // of a moment
};

// Force to which the Coulomb limit and the caps of moments are proportional.
inline double pressing_force(Parameters q, double limit) { return q[MU] > 0.0 ? limit / q[MU] : 0.0; }

// k_r and dk_r/dδ.
inline Slopes<double> rolling_stiffness(const Law &law, Parameters q, double r_eff, double overlap) {
  if (law.rolling) return call(law.rolling, q, r_eff, overlap, 0.0);
  return {law.roll_at ? q[law.roll_at] * r_eff * r_eff : 0.0, 0.0};
}

// `fn` is the normal force and `limit` the Coulomb limit.
inline Resistance rolling_resistance(const Law &law, Parameters q, double r_eff, double overlap, double fn,
                                     double limit) {
  double stiffness = rolling_stiffness(law, q, r_eff, overlap).first;
  if (law.rolling) return {stiffness, call(law.rolling_cap, q, r_eff, overlap, fn).first, 0.0};
  if (!law.roll_at) return {};
  double force = pressing_force(q, limit), damping = q[law.roll_at + 2] * r_eff * r_eff;
  return {stiffness, q[law.roll_at + 1] * r_eff * force, law.roll_viscous ? force * damping : damping};
}

// Factors of the coefficients of scaled twisting: a² and da²/dδ, and the tangential dashpot.
struct TwistScale {
  double radius, slope, damping;  // a, da/dδ
};

inline TwistScale twist_scale(const Law &law, Parameters q, double r_eff, double overlap, Elastic<double> spring,
                              double slope, double damping) {
  if (!law.twist_scaled) return {1.0, 0.0, 1.0};
  Slopes<double> a = contact_radius(law, q, r_eff, overlap, spring.stiffness, slope);
  return {a.first, a.second, damping};
}

inline Resistance twisting_resistance(const Law &law, Parameters q, double limit, TwistScale scale) {
  if (!law.twist_at) return {};
  const double a = scale.radius, square = a * a;
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
inline Vec<double> rolling_load(const Law &law, Resistance r, Vec<double> psi, Vec<double> w) {
  Vec<double> t = -r.stiffness * psi;
  if (law.roll_viscous) return t - r.damping * w;
  return r.damping > 0.0 ? with_tangential_dashpot(t, r.damping, r.cap, w) : t;
}

inline double twisting_load(Resistance r, double twist, double w) {
  double t = -r.stiffness * twist - r.damping * w;
  return larger(smaller(t, r.cap), -r.cap);
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

inline Keeping keeping(Resistance r, const RotationStep &step, bool slid, double size) {
  const double slack = r.stiffness * step.round_off, pull = r.stiffness * size;
  const bool held = step.kept || (step.still && agrees(step.memory, slid, pull, r.cap, slack));
  return {slack, slid, held, held || (step.still && step.moves && is_kept_in_motion(slid, pull, r.cap))};
}

// Resistance of sticking contacts with HELD memory has no cap.
inline Resistance as_held(Resistance r, int64_t memory, bool slides) {
  if (memory == HELD && !slides) r.cap = NO_LIMIT;
  return r;
}

// Moment on i that resists rolling; the memory `own` is updated.
template <int DIM>
inline Vec<double> rolling_moment(const Law &law, Resistance r, const RotationStep &step, double *own) {
  Vec<double> psi = {own[0], own[1], own[2]}, w = step.rate - dot(step.rate, step.n) * step.n;
  Keeping keep = keeping(r, step, own[AT_CAP] > 0.0, root(dot(psi, psi)));
  if (!step.kept && !is_tangential(step.n, psi)) keep.held = keep.kept = false;
  if (keep.held) return rolling_load(law, as_held(r, step.memory, keep.slid), psi, w);
  Vec<double> a = step.closed ? onto_plane(step.n, step.mid, psi) : Vec<double>{};
  Vec<double> d = onto_plane(step.n, step.mid, step.turned);
  if (law.rate && r.stiffness > 0.0) {  // spring and dashpot together
    Loads<double, bool> out =
        truncate_as_lammps(0.0, r.stiffness, r.damping, r.cap, keep.slack, a + d, w, false, keep.slid);
    own[0] = out.slip.x, own[1] = out.slip.y, own[2] = out.slip.z, own[AT_CAP] = out.slides;
    return out.tangential;
  }
  Truncated<double, bool> out = return_mapping<DIM, double, bool>(false, law.rate, step.memory, r.stiffness, r.cap,
                                                                keep.slack, a, d, step.fraction, keep.slid, 1.0);
  psi = r.stiffness > 0.0 ? out.slip : Vec<double>{};
  if (!keep.kept) own[0] = psi.x, own[1] = psi.y, own[2] = psi.z, own[AT_CAP] = out.slides;
  return rolling_load(law, as_held(r, step.memory, out.slides), psi, w);
}

// Twist of a spring truncated at its cap; `held`: it stays at its cap or below it.
inline bool truncate_twist(Resistance r, double slack, bool held, bool slid, double &twist) {
  const double pull = r.stiffness * magnitude(twist), most = r.stiffness > 0.0 ? r.cap / r.stiffness : 0.0;
  const bool cut = r.cap == 0.0 || r.stiffness == 0.0 || (held ? slid && twist != 0.0 : pull > r.cap);
  if (cut) twist = twist > 0.0 ? most : -most;
  return cut || (!held && slid && still_slides(pull * pull, r.cap, slack));
}

// Moment on i along the normal that resists twisting; the memory `own` is updated.
inline double twisting_moment(const Law &law, Resistance r, const RotationStep &step, double *own) {
  const double w = dot(step.rate, step.n);
  const Keeping keep = keeping(r, step, own[TWIST_AT_CAP] > 0.0, magnitude(own[TWIST]));
  if (keep.held) return twisting_load(as_held(r, step.memory, keep.slid), own[TWIST], w);
  double twist = (step.closed ? own[TWIST] : 0.0) + step.fraction.part / step.fraction.whole * dot(step.mid, step.turned);
  const double t = twisting_load(r, twist, w);
  bool slides;
  if (law.rate) {  // spring and dashpot together
    slides = magnitude(t) >= r.cap;
    if (slides && r.stiffness > 0.0) twist = -(t + r.damping * w) / r.stiffness;
    slides = slides || (keep.slid && still_slides(t * t, r.cap, keep.slack));
  } else {
    slides = truncate_twist(r, keep.slack, step.memory == HELD, keep.slid, twist);
  }
  if (!keep.kept) own[TWIST] = twist, own[TWIST_AT_CAP] = slides;
  return law.rate ? t : twisting_load(as_held(r, step.memory, slides), twist, w);
}
