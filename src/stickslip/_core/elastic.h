// Elastic force of a contact at rest.
#pragma once
#include "pairs.h"

struct ElasticPair {
  Vec<double> r, force;  // pair vector, and force on i
};

// Contact c of the list, which touches and whose memory is committed.
inline ElasticPair elastic_pair(const Law &law, int dim, const Bodies &bodies, const Contacts &contacts,
                                const double *shift, int64_t c) {
  Pair pair = pair_at(law, dim, bodies, contacts, shift, c);
  Elastic<double> spring = elastic(law, pair.q, pair.r_eff, pair.overlap);
  double limit = cap(law, pair.q, pair.r_eff, pair.overlap, spring.force);
  Vec<double> slip = vector_at(3, contacts.slip, c);
  return {pair.r, spring.force * pair.n + tangential_force(law.smooth, spring.stiffness, limit, slip)};
}
