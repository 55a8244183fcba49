// build: -ffp-contract=fast -fno-signed-zeros -ffinite-math-only -fno-tree-slp-vectorize
#include "loop.h"
#include "rolling.h"

namespace {

inline Vec<double> at(Vectors rows, int64_t body) {
  const double *v = rows.data + rows.stride * body;
  return {v[0], v[1], v[2]};
}

template <int DIM>
inline void add(double *to, double factor, Vec<double> v) {
  to[0] += factor * v.x;
  to[1] += factor * v.y;
  if (DIM == 3) to[2] += factor * v.z;
}

template <int DIM>
inline void add_rotation(double *to, double factor, Vec<double> v) {
  if (DIM == 3) return add<3>(to, factor, v);
  to[2] += factor * v.z;
}

template <int DIM>
inline Vec<double> difference(Vectors rows, int64_t i, int64_t j) {
  Vec<double> d = at(rows, i) - at(rows, j);
  return DIM == 3 ? d : Vec<double>{0.0, 0.0, d.z};
}

template <int DIM>
inline Vec<double> sum(Vectors rows, int64_t i, int64_t j) {
  Vec<double> d = at(rows, i) + at(rows, j);
  return DIM == 3 ? d : Vec<double>{0.0, 0.0, d.z};
}

void open_contact(const Law &law, const Sweep &sweep, const Contacts &contacts, int64_t c) {
  if (contacts.mode[c] == OPEN) return;
  contacts.mode[c] = OPEN;
  contacts.reached[c] = false;
  store(contacts.slip + 3 * c, {0.0, 0.0, 0.0});
  for (int64_t k = 0; k < law.angular; ++k) contacts.rolling[contacts.width_rolling * c + k] = 0.0;
  record_event(sweep.events, OPENED, contacts, c, sweep.position.data + sweep.position.stride * contacts.i[c]);
}

template <int DIM, bool ANGULAR>
inline void sweep_row(const Law &law, const Sweep &sweep, const Contacts &contacts, int64_t c) {
  const Bodies &bodies = sweep.bodies;
  const Motion &motion = sweep.motion;
  const int64_t i = contacts.i[c], j = contacts.j[c];
  const int16_t *image = contacts.image + 3 * c;
  Pair pair;
  if (sweep.stepping) {
    pair.r = flat<DIM>(at(sweep.position, i) - at(sweep.position, j));
    // written out: in a function shared with batches, compilers fuse other products, which changes last bits
    for (int k = 0; k < 3; ++k)
      if (image[k]) pair.r = pair.r + double(image[k]) * flat<DIM>(read(sweep.vectors + 3 * k));
  } else {
    double place[3];
    pair_vector(contacts, c, sweep.position.data, sweep.vectors, place);
    pair.r = flat<DIM>(read(place));
  }
  find_overlap(pair, bodies, i, j);
  const Vec<double> r = pair.r, n = flat<DIM>(pair.n);
  const double overlap = pair.overlap, inverse = pair.inverse, sum_radii = bodies.radius[i] + bodies.radius[j];
  if (!law.range && overlap <= 0.0) return open_contact(law, sweep, contacts, c);
  find_parameters(pair, law, bodies, i, j, memory_at(law, contacts, c));
  const Parameters q = pair.q;
  const int8_t before = contacts.mode[c];
  const double r_eff = pair.r_eff, m_eff = pair.m_eff;
  double edge = 0.0;
  if (law.range) {
    edge = -reach(law, q, r_eff, before == OPEN);
    if (overlap <= edge) return open_contact(law, sweep, contacts, c);
  }
  Vec<double> d{}, roll{}, v{}, angle{}, mean{}, apart{}, turned{};  // the last two: angle_i − angle_j and its change
  const bool shorter = ANGULAR && law.lever && !pair.wall;
  double *own = nullptr;
  if (ANGULAR) {
    own = contacts.rolling + contacts.width_rolling * c;
    apart = difference<DIM>(sweep.angle, i, j);
    if (before != OPEN) turned = apart - read(own + ANCHOR);
    else if (sweep.stepping && !motion.hold) turned = motion.dt * difference<DIM>(motion.spin, i, j);
  }
  Ratio<double> fraction = {1.0, 1.0};
  bool frozen = motion.hold, still = false;  // whether its slip is always kept; whether it has not moved
  if (sweep.stepping) {
    mean = flat<DIM>(at(motion.velocity, i) - at(motion.velocity, j));
    if (motion.gradient) mean = transform(motion.back, mean + transform(motion.gradient, r));
    d = motion.dt * mean;
    roll = motion.dt * rolled<DIM>(bodies.radius[i], at(motion.spin, i), bodies.radius[j], at(motion.spin, j));
    if (before == OPEN && !law.rate) fraction = touching_fraction(n, inverse, overlap - edge, d);
    if (shorter && !law.rate)
      roll = roll - (motion.dt * mid_shortening(n, inverse, overlap, d)) * sum<DIM>(motion.spin, i, j);
  } else {
    double place[3];
    rolled_length(bodies.radius, sweep.angle.data, i, j, place);
    angle = DIM == 3 ? read(place) : Vec<double>{0.0, 0.0, place[2]};
    Vec<double> was = flat<DIM>(read(contacts.pair + 3 * c)), rolled = read(contacts.roll + 3 * c);
    if (DIM == 2) rolled = {0.0, 0.0, rolled.z};
    if (before != OPEN) d = r - was, roll = angle - rolled;
    still = before != OPEN && is_zero(d) && is_zero(roll) && !(shorter && !is_zero(turned));
    frozen = still && sweep.memory == FROZEN;
    still = still && is_tangential(n, flat<DIM>(read(contacts.slip + 3 * c)));
    if (shorter && !law.rate)
      roll = roll - mid_shortening(n, inverse, overlap, d) * turned_together(bodies.radius, i, j, roll, turned);
  }
  Vec<double> s = flat<DIM>(read(contacts.slip + 3 * c));
  Elastic<double> spring = elastic(law, q, r_eff, overlap);
  double carried = 1.0;
  if (law.keeps_force && before != OPEN)
    carried = kept_force(law, q, r_eff, spring.stiffness, overlap - overlap_increment(n, inverse, d));
  Transport<double> moved = transport_slip(law, bool(law.rate), n, inverse, overlap, d, roll, s, carried);
  if (frozen || still) moved.slip = s, moved.increment = {0.0, 0.0, 0.0};
  double fn = spring.force, damping = 0.0;
  bool moves = false;
  if (law.damping) {
    v = law.rate && sweep.stepping ? mean : flat<DIM>(at(sweep.velocity, i) - at(sweep.velocity, j));
    if (!law.rate && sweep.gradient) v = v + transform(sweep.gradient, r);
    Vec<double> rolling = rolled<DIM>(bodies.radius[i], at(sweep.spin, i), bodies.radius[j], at(sweep.spin, j));
    if (shorter && !law.rate) rolling = rolling - 0.5 * overlap * sum<DIM>(sweep.spin, i, j);
    v = at_contact(n, v, rolling);
    const double vn = dot(v, n), factor = damping_factor(law, r_eff, m_eff, overlap, fn);
    v = v - vn * n;
    fn = with_dashpot(law, fn, factor * q[DAMPING_N], vn);
    damping = factor * q[DAMPING_T];
    moves = vn != 0.0 && !sweep.given;
  }
  const double limit = cap(law, q, r_eff, overlap, fn, law.rate && law.damping);
  const double pull = still ? spring.stiffness * root(dot(s, s)) : 0.0, slack = ROUND_OFF * sum_radii * spring.stiffness;
  const bool slid = before == SLIDE, loose = !law.range || overlap > 0.0;
  const bool hold = frozen || (still && agrees(sweep.memory, slid, pull, limit, slack, loose));
  const bool kept = before != OPEN && (hold || (still && moves && is_kept_in_motion(slid, pull, limit)));
  Loads<double, bool> out = contact_loads<DIM>(law, bool(law.rate), sweep.memory, hold, fn, spring.stiffness, damping,
                                               limit, overlap, sum_radii, moved, fraction, slid, v);
  const double *place = sweep.position.data + sweep.position.stride * i;
  if (!kept) {
    store(contacts.slip + 3 * c, out.slip);
    const int8_t after = out.slides ? SLIDE : STICK;
    if (after != before) contacts.mode[c] = after;
    if (before == OPEN) record_event(sweep.events, CLOSED, contacts, c, place);
    // not only if the mode changes: a contact may have slid while its limit was zero
    if (after == SLIDE && limit > 0.0 && !contacts.reached[c]) {
      contacts.reached[c] = true;
      record_event(sweep.events, REACHED_LIMIT, contacts, c, place);
    }
    if (!sweep.stepping) store(contacts.pair + 3 * c, r), store(contacts.roll + 3 * c, angle);
  }
  double *torque_i = sweep.torque + sweep.stride * i, *torque_j = sweep.torque + sweep.stride * j;
  if (ANGULAR && has_moments(law)) {
    const bool rests = is_zero(turned);
    const RotationStep step = {turned, difference<DIM>(sweep.spin, i, j), n, moved.mid, fraction, sweep.memory,
                               frozen && rests, before != OPEN, still && rests, moves,
                               rotation_round_off(bodies, contacts, pair, c)};
    Vec<double> moment = rolling_moment<DIM>(law, rolling_resistance(law, q, r_eff, overlap, fn, limit), step, own);
    if (DIM == 3 && law.twist_at) {
      const TwistScale<double> scale = twist_scale(law, q, r_eff, overlap, spring.stiffness, 0.0, damping);
      moment = moment + twisting_moment(law, twisting_resistance(law, q, limit, scale), step, own) * n;
    }
    add_rotation<DIM>(torque_i, 1.0, moment);
    add_rotation<DIM>(torque_j, -1.0, moment);
  }
  if (ANGULAR) store(own + ANCHOR, apart);
  if (law.len_memory && !(kept && (frozen || has_own_memory(law, contacts, c))))
    update_memory(law, q, r_eff, overlap, own_memory(law, contacts, c));
  const Vec<double> f = fn * n + out.tangential, turn = cross(out.tangential, n);
  add<DIM>(sweep.force + sweep.stride * i, 1.0, f);
  add<DIM>(sweep.force + sweep.stride * j, -1.0, f);
  const double less = shorter ? 0.5 * overlap : 0.0;
  add_rotation<DIM>(torque_i, bodies.radius[i] - less, turn);
  add_rotation<DIM>(torque_j, bodies.radius[j] - less, turn);
  if (sweep.virial) {
    double *virial = sweep.virial + 9 * i;
    add<DIM>(virial, f.x, r);
    add<DIM>(virial + 3, f.y, r);
    if (DIM == 3) add<3>(virial + 6, f.z, r);
  }
}

template <int DIM, bool ANGULAR>  // with moments or lever arms R − δ/2
void sweep_all(const Law &whole, const Sweep &given, const Contacts &list) {
  const Law law = whole;  // copies, which the compiler knows are not changed by stores
  const Sweep sweep = given;
  const Contacts contacts = list;
  for (int64_t c = 0; c < contacts.count[0]; ++c) sweep_row<DIM, ANGULAR>(law, sweep, contacts, c);
}

}  // namespace

void sweep_contacts(const Law &law, int64_t dim, const Sweep &sweep, const Contacts &contacts) {
  auto plain = dim == 3 ? sweep_all<3, false> : sweep_all<2, false>;
  auto angular = dim == 3 ? sweep_all<3, true> : sweep_all<2, true>;
  (law.angular ? angular : plain)(law, sweep, contacts);
}

void evaluate_contacts(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts,
                       const double *vectors, int64_t memory, double *force, double *torque) {
  Sweep sweep = {memory & ~GIVEN, (memory & GIVEN) != 0, false, {}, {bodies->position, 3}, {bodies->angle, 3}, {bodies->velocity, 3}, {bodies->spin, 3},
                 bodies->rate, *bodies, vectors, force, torque, 3, nullptr, nullptr};
  sweep_contacts(*law, dim, sweep, *contacts);
}
