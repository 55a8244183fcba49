// Rolling resistance: a moment with its own memory ψ, see `core/contacts/rolling.py`.
#pragma once
#include "mechanics.h"

constexpr int64_t ANCHOR = 3, AT_CAP = 6;  // columns of rolling memory: ψ; angle_i − angle_j; at the cap

inline void forget_rolling(double *own) {
  for (int64_t k = 0; k < ROLLING; ++k) own[k] = 0.0;
}

struct RollingStep {
  Vec<double> angle;    // angle_i − angle_j now
  Vec<double> turned;   // change of that during a step
  bool stepping, kept;  // during a run; the memory is kept
  bool closed;          // the contact touched before
};

// Moment on j, k_r ψ, of a contact that touches; its ψ is updated.
template <int DIM>
inline Vec<double> rolling_moment(const Law &law, Parameters q, double r_eff, double overlap, double fn,
                                  int64_t memory, Vec<double> n, Vec<double> m, Ratio<double> fraction,
                                  RollingStep step, double *own) {
  Vec<double> t = step.angle, turned = step.turned, psi = {own[0], own[1], own[2]};
  if (DIM == 2) t = {0.0, 0.0, t.z}, turned = {0.0, 0.0, turned.z};
  const double stiffness = call(law.rolling, q, r_eff, overlap, fn).first;
  if (step.kept && t.x == own[3] && t.y == own[4] && t.z == own[5]) return stiffness * psi;
  Vec<double> a{}, d{};
  if (step.closed) {
    a = onto_plane(n, m, psi);
    d = onto_plane(n, m, t - Vec<double>{own[3], own[4], own[5]});
  } else if (step.stepping) {
    d = onto_plane(n, m, turned);
  }
  const double limit = call(law.rolling_cap, q, r_eff, overlap, fn).first;
  Truncated<double, bool> found = return_mapping<DIM, double, bool>(false, memory, stiffness, limit, a, d, fraction,
                                                                   own[AT_CAP] > 0.0, 1.0);
  own[0] = found.slip.x, own[1] = found.slip.y, own[2] = found.slip.z;
  own[3] = t.x, own[4] = t.y, own[5] = t.z;
  own[AT_CAP] = found.slides;
  return stiffness * found.slip;
}
