// build: -ffp-contract=fast -fno-signed-zeros -ffinite-math-only
// Largest frequency of the contact network: an upper bound, and by power iteration.
#include <string.h>

#include "pairs.h"

constexpr double UNLOADING = 1e-6;  // of the overlap

struct Springs {
  double normal, tangential, branch;  // k_n, k_t and |r|
};

static Springs springs_of(const Law &law, const Pair &pair) {
  // cohesion may have negative stiffness; its absolute value gives a safe bound
  double along = magnitude(tangents(law, pair.q, pair.r_eff, pair.overlap).first);
  Elastic<double> spring = elastic(law, pair.q, pair.r_eff, pair.overlap);
  if (law.len_memory) {  // stiffness as the overlap decreases
    double less = UNLOADING * pair.overlap;
    along = larger(along, (spring.force - elastic(law, pair.q, pair.r_eff, pair.overlap - less).force) / less);
  }
  return {along, spring.stiffness, root(dot(pair.r, pair.r))};
}

// (a − b)² ≤ 2a² + 2b² in every contact, (a − b + c + d)² ≤ 4 (a² + b² + c² + d²) along it; a free cell adds one term.
double frequency_bound(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts, const double *shift,
                       const double *inverse_inertia, const double *cell, double *total) {
  double weight = 0.0, strains = 0.0, most = 0.0;
  for (int k = 0; k < 9; k++) weight = larger(weight, cell[k]);
  double more = weight > 0.0 ? 1.0 : 0.0;
  for (int64_t c = 0; c < *contacts->count; c++) {
    Pair pair = pair_at(*law, dim, *bodies, *contacts, shift, c);
    if (!pair.touches) continue;
    Springs k = springs_of(*law, pair);
    double along = (2.0 + more) * k.normal, across = (4.0 + more) * k.tangential;
    int64_t ends[] = {contacts->i[c], contacts->j[c]};
    for (int64_t a : ends) {
      double radius = bodies->radius[a];
      most = larger(most, total[2 * a] += larger(along, across) * bodies->inverse_mass[a]);
      most = larger(most, total[2 * a + 1] += across * radius * radius * inverse_inertia[a]);
    }
    strains += 5.0 * larger(k.normal, k.tangential) * k.branch * k.branch * weight;
  }
  return larger(most, strains);
}

static void find_springs(const Law &law, int dim, const Bodies &bodies, const Contacts &contacts, const double *shift,
                         double *springs) {
  for (int64_t c = 0; c < *contacts.count; c++) {
    Pair pair = pair_at(law, dim, bodies, contacts, shift, c);
    Springs k = pair.touches ? springs_of(law, pair) : Springs{};
    store(springs + 6 * c, pair.n), store(springs + 6 * c + 3, {k.normal, k.tangential, k.branch});
  }
}

static void add(double *to, Vec<double> v) { to[0] += v.x, to[1] += v.y, to[2] += v.z; }

// Adds K x to y and, for the cell, K e to `pull`.
static void add_spring_forces(const Contacts &contacts, const double *springs, const double *x, const double *e,
                              double *y, double *pull) {
  Vec<double> e0 = vector_at(3, e, 0), e1 = vector_at(3, e, 1), e2 = vector_at(3, e, 2);
  for (int64_t c = 0; c < *contacts.count; c++) {
    int64_t i = contacts.i[c], j = contacts.j[c];
    const double *k = springs + 6 * c + 3;
    Vec<double> n = vector_at(3, springs, 2 * c), b = k[2] * n;
    Vec<double> d = vector_at(3, x, 2 * i) - vector_at(3, x, 2 * j) + Vec<double>{dot(e0, b), dot(e1, b), dot(e2, b)};
    Vec<double> t = at_contact(n, d, vector_at(3, x, 2 * i + 1) + vector_at(3, x, 2 * j + 1));
    Vec<double> f = (k[0] * dot(d, n)) * n + k[1] * (t - dot(t, n) * n), turn = cross(f, n);
    add(y + 6 * i, f), add(y + 6 * j, -1.0 * f);
    add(y + 6 * i + 3, turn), add(y + 6 * j + 3, turn);
    add(pull, f.x * b), add(pull + 3, f.y * b), add(pull + 6, f.z * b);
  }
}

// |x|² summed by component, in a fixed order.
static double squared_length(const double *x, int64_t rows) {
  double sum[6] = {};
  for (int64_t a = 0; a < rows; a++)
    for (int k = 0; k < 6; k++) sum[k] += x[6 * a + k] * x[6 * a + k];
  return sum[0] + sum[1] + sum[2] + sum[3] + sum[4] + sum[5];
}

// x ← factor M^(−1/2) x
static void scale(const Bodies &bodies, const double *inverse_inertia, double factor, double *x) {
  for (int64_t a = 0; a < bodies.len_radius; a++) {
    double moves = factor * root(bodies.inverse_mass[a]), turns = factor * bodies.radius[a] * root(inverse_inertia[a]);
    for (int k = 0; k < 3; k++) x[6 * a + k] *= moves, x[6 * a + 3 + k] *= turns;
  }
}

// Power iteration on M^(−1/2) K M^(−1/2).
double largest_squared_frequency(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts,
                                 const double *shift, const double *inverse_inertia, const double *cell,
                                 int64_t rounds, double *x, double *y, double *springs) {
  int64_t count = bodies->len_radius;
  double value = 0.0, e[9], weight[9];
  for (int k = 0; k < 9; k++) e[k] = weight[k] = root(cell[k]);
  find_springs(*law, dim, *bodies, *contacts, shift, springs);
  for (int64_t round = 0; round < rounds; round++) {
    double strain = 0.0, pull[9] = {};
    for (int k = 0; k < 9; k++) strain += e[k] * e[k];
    value = root(squared_length(x, count) + strain);
    if (value == 0.0) return 0.0;
    scale(*bodies, inverse_inertia, 1.0 / value, x);
    for (int k = 0; k < 9; k++) e[k] *= weight[k] / value;
    memset(y, 0, 6 * count * sizeof *y);
    add_spring_forces(*contacts, springs, x, e, y, pull);
    scale(*bodies, inverse_inertia, 1.0, y);
    for (int k = 0; k < 9; k++) e[k] = pull[k] * weight[k];
    double *other = x;
    x = y, y = other;
  }
  return value;
}
