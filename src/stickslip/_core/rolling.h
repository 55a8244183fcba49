// Rolling resistance: a moment with its own memory ψ, see `core/contacts/rolling.py`.
#pragma once
#include "mechanics.h"

struct RollingStep {
  Vec<double> turned;  // change of angle_i − angle_j
  bool kept, closed;   // the memory is kept; the contact touched before
};

// Moment on j, k_r ψ, of a contact that touches; its ψ is updated.
template <int DIM>
inline Vec<double> rolling_moment(const Law &law, Parameters q, double r_eff, double overlap, double fn,
                                  int64_t memory, Vec<double> n, Vec<double> m, Ratio<double> fraction,
                                  RollingStep step, double *own) {
  const Vec<double> psi = {own[0], own[1], own[2]};
  const double stiffness = call(law.rolling, q, r_eff, overlap, fn).first;
  if (step.kept) return stiffness * psi;
  const Vec<double> a = step.closed ? onto_plane(n, m, psi) : Vec<double>{}, d = onto_plane(n, m, step.turned);
  const double limit = call(law.rolling_cap, q, r_eff, overlap, fn).first;
  Truncated<double, bool> found = return_mapping<DIM, double, bool>(false, memory, stiffness, limit, a, d, fraction,
                                                                   own[AT_CAP] > 0.0, 1.0);
  own[0] = found.slip.x, own[1] = found.slip.y, own[2] = found.slip.z;
  own[AT_CAP] = found.slides;
  return stiffness * found.slip;
}
