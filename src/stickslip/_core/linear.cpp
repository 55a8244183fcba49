// build: -ffp-contract=fast -fno-signed-zeros -ffinite-math-only
// Linearisation of contacts and of their rolling moments, and sums over all contacts.
#include "blocks.h"
#include "pairs.h"
#include "rolling.h"

// A sliding contact that has moved back resists, even by less than round-off of its limit.
constexpr double NO_SLACK = 0.0;

// ---- forces

struct Tangent {
  double secant, along, by_overlap, by_force;  // φ/|u|, ∂φ/∂|u|, ∂φ/∂δ and ∂φ/∂F_n
};

// Coefficients of the tangential force φ = k_t |u| (mobilisation) ≤ `limit` at |u| = `stretch`; `slope`: derivatives of
// the springs with respect to δ, `edge`: of the limit with respect to F_n and δ.
static Tangent friction_tangent(bool smooth, double stiffness, Slopes<double> slope, double limit, Slopes<double> edge,
                                double stretch, bool slides) {
  if (slides || limit <= 0.0) {
    return {stretch > 0.0 ? limit / stretch : 0.0, 0.0, edge.first * slope.first + edge.second, edge.first};
  }
  double x = stiffness * stretch / limit, h = smooth ? mobilisation(x) : 1.0, g = smooth ? mobilisation_tangent(x) : 0.0;
  double turned = x * x * g, whole = h + x * g, by_force = -edge.first * turned;
  double changed = by_force * slope.first - edge.second * turned;
  return {stiffness * h, stiffness * whole, slope.second * stretch * whole + changed, by_force};
}

// Memory of contact c carried to the present positions; writes the slip and the way since it was committed.
template <int DIM>
static Transport<double> transported(const Law &law, const Bodies &bodies, const Contacts &contacts, const Pair &pair,
                                     double stiffness, const Linearisation &out, int64_t c) {
  Transport<double> rest = {{}, {}, pair.n, 1.0};
  if (contacts.mode[c] == OPEN) return rest;
  double place[3];
  rolled_length(bodies.radius, bodies.angle, contacts.i[c], contacts.j[c], place);
  const Vec<double> rolled = DIM == 3 ? vector_at(3, place, 0) : Vec<double>{0.0, 0.0, place[2]};
  Vec<double> slip = vector_at(3, contacts.slip, c), way = pair.r - vector_at(3, contacts.pair, c);
  Vec<double> turn = rolled - vector_at(3, contacts.roll, c);
  if (law.lever && !pair.wall) {
    const double *anchor = contacts.rolling + contacts.width_rolling * c + ANCHOR;
    Vec<double> apart = relative_angle(DIM, bodies.angle, contacts.i[c], contacts.j[c]) - vector_at(3, anchor, 0);
    Vec<double> together = turned_together(bodies.radius, contacts.i[c], contacts.j[c], turn, apart);
    out.half_mid[c] = mid_shortening(pair.n, pair.inverse, pair.overlap, way);
    turn = turn - out.half_mid[c] * together;
    store(out.together + 3 * c, together);
  }
  store(out.before + 3 * c, slip), store(out.way + 3 * c, way), store(out.turn + 3 * c, turn);
  const double old = pair.overlap - overlap_increment(pair.n, pair.inverse, way);
  const double kept = kept_force(law, pair.q, pair.r_eff, stiffness, old);
  return transport_slip(law, false, pair.n, pair.inverse, pair.overlap, way, turn, slip, kept);
}

template <int DIM>
static void linearise_contact(const Law &law, const Bodies &bodies, const Contacts &contacts, const Pair &pair,
                              int64_t memory, const Linearisation &out, int64_t c) {
  const Parameters q = pair.q;
  const double r_eff = pair.r_eff, overlap = pair.overlap;
  Elastic<double> spring = elastic(law, q, r_eff, overlap);
  Slopes<double> slope = tangents(law, q, r_eff, overlap);
  double limit = cap(law, q, r_eff, overlap, spring.force);
  Slopes<double> edge = cap_slopes(law, q, r_eff, overlap, spring.force);
  Transport<double> moved = transported<DIM>(law, bodies, contacts, pair, spring.stiffness, out, c);
  bool slid = contacts.mode[c] == SLIDE;
  Vec<double> a = moved.slip, d = moved.increment;
  const double slack = ROUND_OFF * (bodies.radius[contacts.i[c]] + bodies.radius[contacts.j[c]]) * spring.stiffness;
  const bool still = contacts.mode[c] != OPEN && is_zero(vector_at(3, out.way, c)) && is_zero(vector_at(3, out.turn, c));
  bool slides = return_mapping<DIM>(fades(law), false, memory, spring.stiffness, limit, NO_SLACK, a, d,
                                    Ratio<double>{1.0, 1.0}, slid, moved.fade).slides;
  if (still && agrees(memory, slid, spring.stiffness * root(dot(a, a)), limit, slack, !law.range || overlap > 0.0))
    slides = slid;
  bool weighted = DIM == 3 && slides && slid && limit > 0.0;
  if (weighted) {
    Ratio<double> weight = turning_weight(fades(law), spring.stiffness, limit, a, d, moved.fade);
    d = (weight.part / weight.whole) * d;
  }
  Vec<double> slip = a + d;
  Tangent tangent =
      friction_tangent(law.smooth, spring.stiffness, slope, limit, edge, root(dot(slip, slip)), slides);
  double factor = damping_factor(law, r_eff, pair.m_eff, overlap, spring.force);
  store(out.normal + 3 * c, pair.n), store(out.slip + 3 * c, slip);
  out.inverse[c] = pair.inverse, out.weighted[c] = weighted;
  if (law.lever && !pair.wall) out.half[c] = 0.5 * overlap;
  out.closed[c] = 1.0, out.remembers[c] = contacts.mode[c] != OPEN, out.slides[c] = slides;
  out.force_n[c] = spring.force, out.slope_n[c] = slope.first;
  out.stiffness_t[c] = spring.stiffness, out.slope_t[c] = slope.second, out.mu[c] = edge.first, out.limit[c] = limit;
  out.secant[c] = tangent.secant, out.along[c] = tangent.along;
  out.by_overlap[c] = tangent.by_overlap, out.by_force[c] = tangent.by_force;
  out.fade[c] = moved.fade;
  const double gained = overlap_increment(pair.n, pair.inverse, vector_at(3, out.way, c));
  if (law.rescaled && gained < 0.0) out.fading[c] = 0.5 * moved.fade / overlap;
  if (law.keeps_force && contacts.mode[c] != OPEN && spring.stiffness > 0.0)
    out.fading[c] -= moved.fade * slope.second / spring.stiffness;
  out.damping_n[c] = factor * q[DAMPING_N], out.damping_t[c] = factor * q[DAMPING_T];
}

void linearise(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts, const double *shift,
               int64_t memory, const Linearisation *out) {
  for (int64_t c = 0; c < *contacts->count; c++) {
    Pair pair = pair_at(*law, dim, *bodies, *contacts, shift, c);
    if (!pair.touches) continue;
    (dim == 3 ? linearise_contact<3> : linearise_contact<2>)(*law, *bodies, *contacts, pair, memory, *out, c);
  }
}

// ---- rolling moments

template <int DIM>
static void linearise_rolling(const Law &law, const Bodies &bodies, const Contacts &contacts, const Pair &pair,
                              int64_t memory, Slopes<double> edge, double force, double force_limit,
                              const MomentLinearisation &out, int64_t c) {
  const double *own = contacts.rolling + contacts.width_rolling * c;
  const Parameters q = pair.q;
  Vec<double> a = {}, d = {};
  bool still = false;
  if (contacts.mode[c] != OPEN) {
    Vec<double> way = relative_angle(DIM, bodies.angle, contacts.i[c], contacts.j[c]) - vector_at(3, own + ANCHOR, 0);
    Vec<double> mid = mid_normal(pair.n, pair.inverse, pair.r - vector_at(3, contacts.pair, c));
    store(out.before + 3 * c, vector_at(3, own, 0)), store(out.way + 3 * c, way);
    a = onto_plane(pair.n, mid, vector_at(3, own, 0)), d = onto_plane(pair.n, mid, way);
    still = is_zero(way) && is_zero(pair.r - vector_at(3, contacts.pair, c));
  }
  Slopes<double> found = rolling_stiffness(law, q, pair.r_eff, pair.overlap);
  const Resistance<double> r = rolling_resistance(law, q, pair.r_eff, pair.overlap, force, force_limit);
  double stiffness = r.stiffness, limit = r.cap;
  const double slack = stiffness * rotation_round_off(bodies, contacts, pair, c);
  bool slid = own[AT_CAP] > 0.0, slides = return_mapping<DIM>(false, false, memory, stiffness, limit, NO_SLACK, a, d,
                                                              Ratio<double>{1.0, 1.0}, slid, 1.0).slides;
  if (still && agrees(memory, slid, stiffness * root(dot(a, a)), limit, slack)) slides = slid;
  out.damping[c] = r.damping, out.slides[c] = slides && !law.roll_viscous;
  if (slides && stiffness > 0.0) {
    out.by_force[c] = edge.first;
    out.by_overlap[c] = edge.first * tangents(law, q, pair.r_eff, pair.overlap).first + edge.second;
    out.reach[c] = limit / stiffness;
    out.reach_by_overlap[c] = (out.by_overlap[c] - out.reach[c] * found.second) / stiffness;
    out.reach_by_force[c] = edge.first / stiffness;
    if (DIM == 3 && slid && limit > 0.0) {
      Ratio<double> weight = turning_weight(false, stiffness, limit, a, d, 1.0);
      out.weighted[c] = 1.0;
      d = (weight.part / weight.whole) * d;
    }
  }
  Vec<double> turned = a + d;
  double size = root(dot(turned, turned));
  if (slides && stiffness > 0.0) {
    out.secant[c] = size > 0.0 ? limit / size : 0.0;
  } else {
    out.secant[c] = out.along[c] = stiffness;
    out.by_overlap[c] = found.second * size;
  }
}

static void linearise_twisting(const Law &law, const Bodies &bodies, const Contacts &contacts, const Pair &pair,
                               int64_t memory, Elastic<double> spring, double limit, const MomentLinearisation &out,
                               int64_t c) {
  const double *own = contacts.rolling + contacts.width_rolling * c;
  const Slopes<double> slope = tangents(law, pair.q, pair.r_eff, pair.overlap);
  const double factor = damping_factor(law, pair.r_eff, pair.m_eff, pair.overlap, spring.force);
  const TwistScale<double> scale = twist_scale(law, pair.q, pair.r_eff, pair.overlap, spring.stiffness, slope.second,
                                               law.damping ? factor * pair.q[DAMPING_T] : 0.0);
  const Resistance<double> r = twisting_resistance(law, pair.q, limit, scale);
  const double growth = scale.radius > 0.0 ? scale.slope / scale.radius : 0.0;  // d ln a/dδ
  double twist = 0.0;
  bool still = false;
  if (contacts.mode[c] != OPEN) {
    Vec<double> moved = pair.r - vector_at(3, contacts.pair, c), way = vector_at(3, out.way, c);
    twist = own[TWIST] + dot(mid_normal(pair.n, pair.inverse, moved), way);
    still = is_zero(moved) && is_zero(way);
  }
  const double slack = r.stiffness * rotation_round_off(bodies, contacts, pair, c);
  const bool slid = own[TWIST_AT_CAP] > 0.0;
  const bool kept = still && agrees(memory, slid, r.stiffness * magnitude(twist), r.cap, slack);
  const bool slides = kept ? slid : truncate_twist(r, NO_SLACK, memory == HELD, slid, twist);
  out.twisting[c] = r.stiffness * twist;
  if (!slides) {
    out.twisting_along[c] = r.stiffness, out.twisting_damping[c] = r.damping;
    out.twisting_by_overlap[c] = 2.0 * growth * out.twisting[c];
    return;
  }
  Slopes<double> edge = moment_cap_slopes(law, pair.q, pair.r_eff, pair.overlap, spring.force,
                                          pair.q[law.twist_at + 1] * scale.radius * (twist > 0.0 ? 1.0 : -1.0));
  out.twisting_by_force[c] = edge.first;
  out.twisting_by_overlap[c] = edge.first * slope.first + edge.second + growth * out.twisting[c];
}

template <int DIM>
static void linearise_moment(const Law &law, const Bodies &bodies, const Contacts &contacts, const Pair &pair,
                             int64_t memory, const MomentLinearisation &out, int64_t c) {
  const Parameters q = pair.q;
  const Elastic<double> spring = elastic(law, q, pair.r_eff, pair.overlap);
  const double force = spring.force, limit = cap(law, q, pair.r_eff, pair.overlap, force);
  Slopes<double> edge = {0.0, 0.0};
  if (law.rolling) edge = call(law.rolling_slopes, q, pair.r_eff, pair.overlap, force);
  else if (law.roll_at)
    edge = moment_cap_slopes(law, q, pair.r_eff, pair.overlap, force, q[law.roll_at + 1] * pair.r_eff);
  linearise_rolling<DIM>(law, bodies, contacts, pair, memory, edge, force, limit, out, c);
  if (law.twist_at) linearise_twisting(law, bodies, contacts, pair, memory, spring, limit, out, c);
}

void linearise_moments(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts,
                       const double *shift, int64_t memory, const MomentLinearisation *out) {
  for (int64_t c = 0; c < *contacts->count; c++) {
    Pair pair = pair_at(*law, dim, *bodies, *contacts, shift, c);
    if (!pair.touches) continue;
    (dim == 3 ? linearise_moment<3> : linearise_moment<2>)(*law, *bodies, *contacts, pair, memory, *out, c);
  }
}

double rolling_bound(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts, const double *shift,
                     const double *inverse_inertia, double *total) {
  double most = 0.0;
  for (int64_t c = 0; c < *contacts->count; c++) {
    Pair pair = pair_at(*law, dim, *bodies, *contacts, shift, c);
    if (!pair.touches) continue;
    const TwistScale<double> scale =
        twist_scale(*law, pair.q, pair.r_eff, pair.overlap,
                    elastic(*law, pair.q, pair.r_eff, pair.overlap).stiffness, 0.0, 0.0);
    double k = 2.0 * larger(rolling_stiffness(*law, pair.q, pair.r_eff, pair.overlap).first,
                            twisting_resistance(*law, pair.q, 0.0, scale).stiffness);
    int64_t ends[] = {contacts->i[c], contacts->j[c]};
    for (int64_t a : ends) most = larger(most, total[a] += k * inverse_inertia[a]);
  }
  return most;
}

// ---- sums

void add_virial(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts, const double *shift,
                double *out) {
  int64_t grains = bodies->len_radius - bodies->len_normal;
  for (int64_t c = 0; c < *contacts->count; c++) {
    if (contacts->mode[c] == OPEN || contacts->j[c] >= grains) continue;
    const Pair pair = pair_at(*law, dim, *bodies, *contacts, shift, c);
    const Vec<double> force = elastic_force(*law, *contacts, pair, c);
    double f[] = {force.x, force.y, force.z}, r[] = {pair.r.x, pair.r.y, pair.r.z};
    for (int a = 0; a < 3; a++)
      for (int b = 0; b < 3; b++) out[3 * a + b] += f[a] * r[b];
  }
}

double elastic_energy(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts,
                      const double *shift) {
  double total = 0.0;
  for (int64_t c = 0; c < *contacts->count; c++) {
    Pair pair = pair_at(*law, dim, *bodies, *contacts, shift, c);
    if (pair.touches) total += normal_energy(*law, pair.q, pair.r_eff, pair.overlap);
  }
  return total;
}
