// build: -ffp-contract=fast -fno-signed-zeros -ffinite-math-only
// Values of a contact law, one contact after the other.
#include "laws.h"

static void put(double *to, int64_t k, Slopes<double> value) {
  to[2 * k] = value.first;
  to[2 * k + 1] = value.second;
}

void law_values(const Law *law, const LawValues *at) {
  for (int64_t k = 0; k < at->len_a; k++) {
    const double *own = at->memory ? at->memory + k * law->len_memory : law->memory;
    const Parameters q = {parameters(*law, at->a[k], at->b[k]), own};
    double overlap = at->overlap[k], r_eff = at->r_eff[k], fn = at->fn[k];
    if (at->force) at->force[k] = elastic(*law, q, r_eff, overlap).force;
    if (at->stiffness) at->stiffness[k] = elastic(*law, q, r_eff, overlap).stiffness;
    if (at->energy) at->energy[k] = normal_energy(*law, q, r_eff, overlap);
    if (at->slopes) put(at->slopes, k, tangents(*law, q, r_eff, overlap));
    if (at->cap) at->cap[k] = cap(*law, q, r_eff, overlap, fn);
    if (at->cap_slopes) put(at->cap_slopes, k, cap_slopes(*law, q, r_eff, overlap, fn));
    if (at->range) at->range[k] = range(*law, q, r_eff);
    if (at->damping)
      at->damping[k] = damping_factor(*law, r_eff, at->m_eff[k], overlap, elastic(*law, q, r_eff, overlap).force);
  }
}
