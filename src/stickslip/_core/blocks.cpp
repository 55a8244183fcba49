// build: -ffp-contract=fast -fno-signed-zeros -ffinite-math-only
#include "loop.h"
#include "rolling.h"

namespace {

// ---- transposition between rows of bodies and planes of lanes, four at a time; compilers move one number at a time
// instead, which takes longer than evaluating the contact law

#if defined(__AVX__)
typedef double Four __attribute__((vector_size(32)));

#if defined(__clang__)
#define SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
typedef int64_t Four64 __attribute__((vector_size(32)));
#define SHUFFLE(a, b, ...) __builtin_shuffle(a, b, Four64{__VA_ARGS__})
#endif

inline void transpose(Four rows[4]) {
  Four low = SHUFFLE(rows[0], rows[1], 0, 4, 2, 6), high = SHUFFLE(rows[0], rows[1], 1, 5, 3, 7);
  Four low_two = SHUFFLE(rows[2], rows[3], 0, 4, 2, 6), high_two = SHUFFLE(rows[2], rows[3], 1, 5, 3, 7);
  rows[0] = SHUFFLE(low, low_two, 0, 1, 4, 5);
  rows[1] = SHUFFLE(high, high_two, 0, 1, 4, 5);
  rows[2] = SHUFFLE(low, low_two, 2, 3, 6, 7);
  rows[3] = SHUFFLE(high, high_two, 2, 3, 6, 7);
}
#else
struct Four {  // registers hold two numbers; compilers keep wider vectors in memory
  Real low, high;
};

inline Four operator+(Four a, Four b) { return {a.low + b.low, a.high + b.high}; }
inline Four operator-(Four a, Four b) { return {a.low - b.low, a.high - b.high}; }
inline Four operator*(Four a, Four b) { return {a.low * b.low, a.high * b.high}; }
inline Four operator*(double a, Four b) { return {a * b.low, a * b.high}; }

inline void transpose(Four rows[4]) {
  const Four a = rows[0], b = rows[1], c = rows[2], d = rows[3];
  rows[0] = {Real{a.low[0], b.low[0]}, Real{c.low[0], d.low[0]}};
  rows[1] = {Real{a.low[1], b.low[1]}, Real{c.low[1], d.low[1]}};
  rows[2] = {Real{a.high[0], b.high[0]}, Real{c.high[0], d.high[0]}};
  rows[3] = {Real{a.high[1], b.high[1]}, Real{c.high[1], d.high[1]}};
}
#endif

inline Four four(const double *from) {
  Four value;
  __builtin_memcpy(&value, from, sizeof value);
  return value;
}

// In one piece where registers are that wide: a vector that was stored in pieces cannot be loaded before they reach the
// cache.
inline void store_eight(double *to, Four a, Four b) {
#if defined(__AVX512F__) && __has_builtin(__builtin_shufflevector)
  auto both = __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
  __builtin_memcpy(to, &both, sizeof both);
#else
  __builtin_memcpy(to, &a, sizeof a);
  __builtin_memcpy(to + 4, &b, sizeof b);
#endif
}

// x_i − x_j and R_i + R_j of the pairs of a block.
template <int DIM>
inline void gather_positions(int64_t used, const uint32_t *i, const uint32_t *j, const double *body, double *scratch) {
  const double signs[4] = {1.0, 1.0, 1.0, -1.0};
  const Four sign = four(signs);
  for (int64_t at = 0; at < used; at += 8) {
    Four rows[2][4];
    for (int q = 0; q < 8; ++q)
      rows[q / 4][q % 4] = four(body + i[at + q] * BODY) - sign * four(body + j[at + q] * BODY);
    transpose(rows[0]), transpose(rows[1]);
    for (int k = 0; k < DIM; ++k) store_eight(scratch + PAIR + k * LANES + at, rows[0][k], rows[1][k]);
    store_eight(scratch + RADII + at, rows[0][3], rows[1][3]);
  }
}

// v_i − v_j and R_i ω_i + R_j ω_j of the pairs of a block, from rows with velocity and spin at the given columns.
template <int DIM>
inline void gather_rates(int64_t used, const uint32_t *i, const uint32_t *j, const double *body, const double *rates,
                         int64_t stride, int64_t velocity, int64_t spin, double *motion, double *roll) {
  for (int64_t at = 0; at < used; at += 8) {
    Four moves[2][4], turns[2][4];
    for (int q = 0; q < 8; ++q) {
      const int64_t a = i[at + q], b = j[at + q];
      const double *one = rates + a * stride, *other = rates + b * stride;
      moves[q / 4][q % 4] = four(one + velocity) - four(other + velocity);
      turns[q / 4][q % 4] = body[b * BODY + RADIUS] * four(other + spin) + body[a * BODY + RADIUS] * four(one + spin);
    }
    transpose(moves[0]), transpose(moves[1]), transpose(turns[0]), transpose(turns[1]);
    for (int k = 0; k < DIM; ++k) store_eight(motion + k * LANES + at, moves[0][k], moves[1][k]);
    for (int k = DIM == 3 ? 0 : 2; k < 3; ++k) store_eight(roll + k * LANES + at, turns[0][k], turns[1][k]);
  }
}

template <int DIM>
inline void gather_motion(bool predict, int64_t used, const uint32_t *i, const uint32_t *j, const double *body, const double *ahead,
                          double *scratch) {
  gather_rates<DIM>(used, i, j, body, body, BODY, VELOCITY, SPIN, scratch + MOTION, scratch + ROLL);
  if (predict)
    gather_rates<DIM>(used, i, j, body, ahead, BODY_AHEAD, VELOCITY_AHEAD, SPIN_AHEAD, scratch + MOTION_AHEAD,
                      scratch + ROLL_AHEAD);
}

// ω_i − ω_j of the pairs of a block.
template <int DIM>
inline void gather_turns(int64_t used, const uint32_t *i, const uint32_t *j, const double *spins, int64_t stride,
                         double *turn) {
  for (int64_t at = 0; at < used; at += 8) {
    Four rows[2][4];
    for (int q = 0; q < 8; ++q)
      rows[q / 4][q % 4] = four(spins + i[at + q] * stride) - four(spins + j[at + q] * stride);
    transpose(rows[0]), transpose(rows[1]);
    for (int k = DIM == 3 ? 0 : 2; k < 3; ++k) store_eight(turn + k * LANES + at, rows[0][k], rows[1][k]);
  }
}

// Six planes of scratch, forces and −n × F_t, to rows of loads, and if `more` a seventh; the rest of each is zero.
inline void scatter_loads(bool more, int64_t used, const double *scratch, double *load) {
  for (int64_t at = 0; at < used; at += 4) {
    Four first[4], second[4] = {four(scratch + 4 * LANES + at), four(scratch + 5 * LANES + at), Four{}, Four{}};
    if (more) second[2] = four(scratch + 6 * LANES + at);
    for (int k = 0; k < 4; ++k) first[k] = four(scratch + k * LANES + at);
    transpose(first);
    transpose(second);
    for (int q = 0; q < 4; ++q) store_eight(load + (at + q) * WIDTH, first[q], second[q]);
  }
}

// Three planes of scratch to rows of moments.
inline void scatter_moments(int64_t used, const double *scratch, double *moment) {
  for (int64_t at = 0; at < used; at += 4) {
    Four first[4] = {Four{}, Four{}, Four{}, four(scratch + at)};
    Four second[4] = {four(scratch + LANES + at), four(scratch + 2 * LANES + at), Four{}, Four{}};
    transpose(first);
    transpose(second);
    for (int q = 0; q < 4; ++q) store_eight(moment + (at + q) * WIDTH, first[q], second[q]);
  }
}

// ---- evaluation

constexpr double SQUARE_MARGIN = 1.0 + 1e-9;  // on squared distances beyond which no contact is possible, despite rounding

template <int DIM>
inline Vec<Real> planes(const double *at) {
  return {load(at), load(at + LANES), DIM == 3 ? load(at + 2 * LANES) : Real{}};
}

template <int DIM>
inline Vec<Real> rotation(const double *at) {
  if (DIM == 2) return {Real{}, Real{}, load(at + 2 * LANES)};
  return planes<3>(at);
}

inline void prefetch_body(const double *body) {  // two cache lines
  __builtin_prefetch(body);
  __builtin_prefetch(body + 8);
}

void prefetch_pairs(const Blocks &blocks, const double *body, int64_t b) {
  for (int64_t s = LANES * b; s < LANES * (b + 1); ++s) {
    prefetch_body(body + BODY * blocks.i.data[s]);
    prefetch_body(body + BODY * blocks.j.data[s]);
  }
}

template <int DIM>
void gather_pair_vectors(const Flow *flow, const Blocks &blocks, const double *body, int64_t b, double *scratch) {
  const int64_t used = blocks.used.data[b];
  gather_positions<DIM>(used, blocks.i.data + LANES * b, blocks.j.data + LANES * b, body, scratch);
  if (blocks.at.data[b] < 0 || blocks.wall.data[b]) return;
  const double *shift = blocks.vector.data + blocks.at.data[b], *h = flow ? flow->matrix + 9 * VECTORS : nullptr;
  for (int64_t l = 0; l < used; l += W) {
    Real p = load(shift + l), q = load(shift + LANES + l), r = load(shift + 2 * LANES + l);
    for (int k = 0; k < DIM; ++k) {
      double *to = scratch + PAIR + k * LANES + l;
      store(to, load(to) + (h ? p * h[k] + q * h[3 + k] + r * h[6 + k] : k == 0 ? p : k == 1 ? q : r));
    }
  }
}

// Adds the contribution L r of a deforming cell to relative velocities: (1 + ½ dt L)⁻¹ (Δv + L r), with r at the end of
// the step, is the change of r during the step divided by dt.
template <int DIM>
void add_flow(const Flow &flow, bool predict, int64_t used, double *scratch) {
  const double *rate = flow.matrix + 9 * RATE, *back = flow.matrix + 9 * INVERSE_HALF;
  for (int64_t l = 0; l < used; l += W) {
    Vec<Real> r = planes<DIM>(scratch + PAIR + l);
    Vec<Real> v = transform(back, planes<DIM>(scratch + MOTION + l) + transform(rate, r));
    Vec<Real> ahead = transform(flow.matrix + 9 * RATE_AHEAD, r);
    const Real *mean = &v.x, *more = &ahead.x;
    for (int k = 0; k < DIM; ++k) {
      store(scratch + MOTION + k * LANES + l, mean[k]);
      double *to = scratch + MOTION_AHEAD + k * LANES + l;
      if (predict) store(to, load(to) + more[k]);
    }
  }
}

struct Block {
  const Law &law;
  const double *q;
  const double *size, *mass, *vector;  // null where they are not used
  const double *scratch;
  const int64_t *modes;
  double *memory;  // additional memory of each lane, or null
  bool predict;
  int64_t used;  // lanes
};

struct Geometry {
  Vec<Real> n;
  Real inverse, overlap, edge, r_eff, reach;
  Mask touches;
};

template <int DIM>
inline Geometry geometry(const Block &block, int64_t l) {
  Vec<Real> r = planes<DIM>(block.scratch + PAIR + l);
  Geometry out;
  Real distance;
  if (block.vector) {
    out.n = planes<DIM>(block.vector + l);
    distance = dot(r, out.n);
    out.inverse = Real{};
  } else {
    distance = root(dot(r, r));
    out.inverse = 1.0 / distance;
    out.n = out.inverse * r;
  }
  out.reach = load(block.scratch + RADII + l);
  Real overlap = out.reach - distance;
  out.r_eff = block.size ? load(block.size + l) : Real{} + 1.0;
  out.edge = block.law.range ? -load(block.scratch + EDGE + l) : Real{};
  if (block.law.bonds) out.edge = select(load(block.modes + l) == OPEN, Real{}, out.edge);
  out.touches = overlap > out.edge;
  out.overlap = select(out.touches, overlap, out.edge);
  return out;
}

// Makes lever arms in Σ R ω shorter: halfway through the step for the slip, at its end for dashpots.
template <int DIM>
void shorten_arms(const Block &block, const uint32_t *i, const uint32_t *j, const Moving &moving, double dt,
                  double *scratch) {
  for (int64_t l = 0; l < block.used; l += W) {
    Geometry at = geometry<DIM>(block, l);
    Real less = mid_shortening(at.n, at.inverse, at.overlap, dt * planes<DIM>(scratch + MOTION + l));
    for (int k = DIM == 3 ? 0 : 2; k < 3; ++k) {
      double mean[W], ahead[W];
      for (int64_t q = 0; q < W; ++q) {
        const int64_t a = i[l + q], b = j[l + q];
        mean[q] = moving.body[BODY * a + SPIN + k] + moving.body[BODY * b + SPIN + k];
        if (block.predict)
          ahead[q] = moving.ahead[BODY_AHEAD * a + SPIN_AHEAD + k] + moving.ahead[BODY_AHEAD * b + SPIN_AHEAD + k];
      }
      double *roll = scratch + ROLL + k * LANES + l, *roll_ahead = scratch + ROLL_AHEAD + k * LANES + l;
      store(roll, load(roll) - less * load(mean));
      if (block.predict) store(roll_ahead, load(roll_ahead) - 0.5 * at.overlap * load(ahead));
    }
  }
}

struct NormalForce {
  Real total, stiffness, factor;  // the last one on damping coefficients
  Vec<Real> velocity;             // tangential
};

template <int DIM>
inline NormalForce normal_force(const Block &block, const Geometry &at, int64_t l) {
  const Law &law = block.law;
  Elastic<Real> spring;
  if (law.force) {
    spring = {select(at.touches, load(block.scratch + ELASTIC + l), Real{}), load(block.scratch + STIFFNESS + l)};
  } else {
    spring = built_in(law, block.q, at.r_eff, at.overlap);
  }
  NormalForce out{spring.force, spring.stiffness, Real{}, {}};
  if (law.damping) {
    const double *scratch = block.scratch + l;
    Vec<Real> v = at_contact(at.n, planes<DIM>(scratch + (block.predict ? MOTION_AHEAD : MOTION)),
                             rotation<DIM>(scratch + (block.predict ? ROLL_AHEAD : ROLL)));
    Real m_eff = block.mass ? load(block.mass + l) : Real{} + 1.0, vn = dot(v, at.n);
    out.velocity = v - vn * at.n;
    out.factor = select(at.touches, damping_factor(law, at.r_eff, m_eff, at.overlap, spring.force), Real{});
    out.total = with_dashpot(law, spring.force, out.factor * block.q[DAMPING_N], vn);
  }
  return out;
}

// Calls a function of a user-defined law for all lanes.
inline void call_lanes(const Block &block, void *function, const double *size, const double *overlap, const double *fn,
                       double *one, double *two) {
  const LawFunction call = reinterpret_cast<LawFunction>(function);
  if (!block.memory) return call(block.q, block.used, size, overlap, fn, nullptr, one, two);
  for (int64_t l = 0; l < block.used; ++l)
    call(block.q, 1, size + l, overlap + l, fn + l, block.memory + block.law.len_memory * l, one + l, two + l);
}

// Additional memory of all lanes at the end of a step; `touched`: where the pairs were closed before.
void update_memories(const Block &block, bool hold, const int64_t *touched, const double *overlap) {
  const Law &law = block.law;
  const double none = 0.0;
  for (int64_t l = 0; l < block.used; ++l) {
    double *own = block.memory + law.len_memory * l, unused;
    if (block.modes[l] == OPEN) {
      for (int64_t m = 0; m < law.len_memory; ++m) own[m] = law.memory[m];
    } else if (!hold || touched[l] == OPEN) {
      const double r_eff = block.size ? block.size[l] : 1.0;
      reinterpret_cast<LawFunction>(law.update)(block.q, 1, &r_eff, overlap + l, &none, own, own, &unused);
    }
  }
}

// Evaluates the functions of a user-defined law for all lanes.
template <int DIM>
void evaluate_user_law(const Block &block, double dt, double *scratch) {
  const Law &law = block.law;
  for (int64_t l = 0; l < block.used; l += W) store(scratch + OVERLAP + l, geometry<DIM>(block, l).overlap);
  double unused[LANES];
  const double *size = block.size ? block.size : unused;
  if (!block.size)
    for (double &value : unused) value = 1.0;
  auto call_all = [&](void *function, int64_t one, int64_t two) {
    call_lanes(block, function, size, scratch + OVERLAP, scratch + TOTAL, scratch + one, scratch + two);
  };
  call_all(law.force, ELASTIC, STIFFNESS);
  if (law.cap || law.rolling)
    for (int64_t l = 0; l < block.used; l += W)
      store(scratch + TOTAL + l, normal_force<DIM>(block, geometry<DIM>(block, l), l).total);
  if (law.cap) call_all(law.cap, LIMIT, UNUSED);
  if (law.rolling) call_all(law.rolling, ROLL_STIFFNESS, UNUSED), call_all(law.rolling_cap, ROLL_CAP, UNUSED);
  if (!law.keeps_force) return;
  for (int64_t l = 0; l < block.used; l += W) {
    Geometry at = geometry<DIM>(block, l);
    Vec<Real> d = dt * planes<DIM>(scratch + MOTION + l);
    store(scratch + TOTAL + l, at.overlap - overlap_increment(at.n, at.inverse, d));
  }
  call_lanes(block, law.force, size, scratch + TOTAL, scratch + TOTAL, scratch + UNUSED, scratch + FORMER);
}

constexpr int64_t MOMENT = 7 * LANES;  // planes for results, of which those below are no longer needed

// Moments and memory of rotations in W lanes; `spring` is the tangential stiffness, `damping` of the tangential dashpot.
template <int DIM>
inline void evaluate_moments(const Block &block, const Geometry &at, int64_t l, double dt, bool hold, Real limit,
                             Real spring, Real damping, Vec<Real> mid, Ratio<Real> fraction, double *own,
                             double *scratch) {
  const Law &law = block.law;
  const Vec<Real> rate = rotation<DIM>(scratch + (block.predict ? ROTATION_AHEAD : ROTATION) + l), n = at.n;
  const Vec<Real> turned = dt * rotation<DIM>(scratch + ROTATION + l), psi = rotation<DIM>(own), none = {};
  const Real along = dot(rate, n), round_off = ROUND_OFF * at.reach / at.r_eff, zero = {};
  const Vec<Real> w = rate - along * n;
  Resistance<Real> r = law.rolling ? Resistance<Real>{load(scratch + ROLL_STIFFNESS + l), load(scratch + ROLL_CAP + l), zero}
                                   : built_in_rolling(law, block.q, at.r_eff, limit);
  Vec<Real> moment;
  if (hold) {
    moment = rolling_load(law, r, psi, w);
  } else {
    Loads<Real, Mask> out = rolled_spring<DIM>(
        law, r, FREE, r.stiffness * round_off, onto_plane(n, mid, psi), onto_plane(n, mid, turned), w, fraction,
        Mask(load(own + CAPPED * LANES) > 0.0));
    moment = out.tangential;
    Vec<Real> after = select(at.touches, out.slip, none);
    if (DIM == 3) store(own, after.x), store(own + LANES, after.y);
    store(own + 2 * LANES, after.z);
    store(own + CAPPED * LANES, select(at.touches & out.slides, zero + 1.0, zero));
  }
  if (DIM == 3 && law.twist_at) {
    r = twisting_resistance(law, block.q, limit, twist_scale(law, block.q, at.r_eff, at.overlap, spring, zero, damping));
    Real twist = load(own + TWISTED * LANES);
    if (hold) {
      moment = moment + twisting_load(r, twist, along) * n;
    } else {
      twist = twist + fraction.part / fraction.whole * dot(mid, turned);
      Twisted<Real, Mask> out = twisted_spring(law, r, FREE, r.stiffness * round_off, twist, along,
                                               Mask(load(own + TWIST_CAPPED * LANES) > 0.0));
      moment = moment + out.moment * n;
      store(own + TWISTED * LANES, select(at.touches, out.twist, zero));
      store(own + TWIST_CAPPED * LANES, select(at.touches & out.slides, zero + 1.0, zero));
    }
  }
  moment = select(at.touches, moment, none);
  store(scratch + MOMENT + l, DIM == 3 ? moment.x : zero);
  store(scratch + MOMENT + LANES + l, DIM == 3 ? moment.y : zero);
  store(scratch + MOMENT + 2 * LANES + l, moment.z);
}

// Forces and memory of one block. Lanes that do not touch get zeros.
template <int DIM, bool MOMENTS>
void evaluate_block(const Block &block, const Blocks &blocks, int64_t b, double dt, bool hold, double *scratch) {
  const Law &law = block.law;
  bool rate = law.rate;
  double *slips = blocks.slip.data + 3 * LANES * b;
  int64_t *modes = blocks.mode.data + LANES * b;
  const Mask held = Mask{} - int64_t(hold);
  for (int64_t l = 0; l < block.used; l += W) {
    Geometry at = geometry<DIM>(block, l);
    NormalForce normal = normal_force<DIM>(block, at, l);
    Mask before = load(modes + l), open = before == OPEN;
    Vec<Real> d = dt * planes<DIM>(scratch + MOTION + l), roll = dt * rotation<DIM>(scratch + ROLL + l);
    Vec<Real> s = planes<DIM>(slips + l);
    Ratio<Real> fraction = {Real{} + 1.0, Real{} + 1.0};
    if (!rate && any(open & at.touches)) {
      Ratio<Real> touched = touching_fraction(at.n, at.inverse, at.overlap - at.edge, d);
      fraction = {select(open, touched.part, fraction.part), select(open, touched.whole, fraction.whole)};
    }
    Real kept = Real{} + 1.0;
    if (law.keeps_force) {
      Real former = larger(at.overlap - overlap_increment(at.n, at.inverse, d), Real{});
      former = law.force ? load(scratch + FORMER + l) : built_in(law, block.q, at.r_eff, former).stiffness;
      kept = select(open, kept, kept_force(normal.stiffness, former));
    }
    Transport<Real> moved = transport_slip(law, rate, at.n, at.inverse, at.overlap, d, roll, s, kept);
    if (hold) moved.slip = s, moved.increment = {Real{}, Real{}, Real{}};
    Real limit = law.cap ? select(at.touches, load(scratch + LIMIT + l), Real{})
                         : coulomb_limit(block.q, normal.total, rate && law.damping && !law.force);
    const Real touching_limit = select(at.touches, limit, Real{});
    limit = select(at.touches, limit, Real{} + NO_LIMIT);  // lanes that do not touch do not slide, which takes longer
    Mask slid = (before == SLIDE) | (before == LOOSE);
    Loads<Real, Mask> out =
        contact_loads<DIM>(law, rate, FREE, held, normal.total, normal.stiffness, normal.factor * block.q[DAMPING_T],
                           limit, at.overlap, at.reach, moved, fraction, slid, normal.velocity);
    Vec<Real> none = {Real{}, Real{}, Real{}}, t = select(at.touches, out.tangential, none), force = out.normal * at.n + t;
    Vec<Real> slip = select(at.touches, out.slip, none), turn = cross(t, at.n);
    store(slips + l, slip.x), store(slips + LANES + l, slip.y);
    if (DIM == 3) store(slips + 2 * LANES + l, slip.z);
    Mask reached = (before == SLIDE) | (before == STUCK_AGAIN), zero = {};
    Mask sliding = select(reached | (limit > 0.0), zero + SLIDE, zero + LOOSE);
    Mask after = select(out.slides, sliding, select(reached, zero + STUCK_AGAIN, zero + STICK));
    if (hold) after = select(open, after, before);
    store(modes + l, select(at.touches, after, zero + OPEN));
    store(scratch + l, force.x), store(scratch + LANES + l, force.y), store(scratch + 5 * LANES + l, turn.z);
    if (MOMENTS)
      evaluate_moments<DIM>(block, at, l, dt, hold, touching_limit, normal.stiffness, normal.factor * block.q[DAMPING_T],
                            moved.mid, fraction, blocks.turn.data + TURNS * LANES * b + l, scratch);
    if (law.lever) store(scratch + 6 * LANES + l, block.vector ? Real{} : 0.5 * at.overlap);
    store(scratch + 2 * LANES + l, DIM == 3 ? force.z : Real{});
    store(scratch + 3 * LANES + l, DIM == 3 ? turn.x : Real{});
    store(scratch + 4 * LANES + l, DIM == 3 ? turn.y : Real{});
  }
}

// Whether no pair in a block touches or has touched before; may be false if a pair nearly touches.
template <int DIM>
bool is_idle(const Block &block, const int64_t *modes) {
  Real least = Real{} + 1.0;
  Mask held = {};
  for (int64_t l = 0; l < block.used; l += W) {
    Vec<Real> r = planes<DIM>(block.scratch + PAIR + l);
    Real reach = load(block.scratch + RADII + l), square;
    if (block.law.range && !block.law.bonds) reach += load(block.scratch + EDGE + l);
    if (block.vector) {
      square = dot(r, planes<DIM>(block.vector + l));
      square = square * magnitude(square), reach = reach * magnitude(reach);
    } else {
      square = dot(r, r), reach = reach * reach;
    }
    least = smaller(least, square - SQUARE_MARGIN * reach);
    held |= load(modes + l);
  }
  return !any(Mask(least <= 0.0) | Mask(held != 0));
}

template <int DIM, bool MOMENTS>
void evaluate(const Law &law, int64_t first, int64_t last, bool crossing, int64_t begin, int64_t end,
              const Blocks &blocks, const Moving &moving, double dt, bool hold, const Flow *flow, double *scratch) {
  const double *body = moving.body;
  const bool predict = law.damping && !law.rate;
  const int64_t share = (end - begin) / (last - first > 1 ? last - first : 1) + 1;
  for (int64_t b = first; b < last; ++b) {
    if (crossing) {
      if (moving.len_tile > 2) prefetch_pairs(blocks, body, b + 1 < last ? b + 1 : b);
    } else {
      for (int64_t at = begin * BODY; at < (begin + share < end ? begin + share : end) * BODY; at += 8)
        __builtin_prefetch(body + at, 1);
      begin += share;
    }
    gather_pair_vectors<DIM>(flow, blocks, body, b, scratch);
    const double *q = parameters(law, blocks.material.data[2 * b], blocks.material.data[2 * b + 1]);
    const int64_t used = blocks.used.data[b];
    Block block = {law, q, needs_radius(law) ? blocks.size.data + LANES * b : nullptr,
                   needs_mass(law) ? blocks.mass.data + LANES * b : nullptr,
                   blocks.wall.data[b] ? blocks.vector.data + blocks.at.data[b] : nullptr, scratch,
                   blocks.mode.data + LANES * b,
                   law.len_memory ? blocks.memory.data + law.len_memory * LANES * b : nullptr, predict, used};
    if (law.range) {
      double unused[LANES];
      reinterpret_cast<LawFunction>(law.range)(q, used, block.size ? block.size : unused, unused, unused,
                                               nullptr, scratch + EDGE, unused);
    }
    const int64_t place = blocks.place.data[b];
    if (is_idle<DIM>(block, blocks.mode.data + LANES * b)) {
      __builtin_memset(blocks.load.data + WIDTH * place, 0, sizeof(double) * WIDTH * used);
      if (MOMENTS) __builtin_memset(blocks.moment.data + WIDTH * place, 0, sizeof(double) * WIDTH * used);
      if (flow) __builtin_memset(blocks.pair.data + 3 * place, 0, sizeof(double) * 3 * used);
      continue;
    }
    if (MOMENTS) {
      const uint32_t *i = blocks.i.data + LANES * b, *j = blocks.j.data + LANES * b;
      gather_turns<DIM>(used, i, j, body + SPIN, BODY, scratch + ROTATION);
      if (predict) gather_turns<DIM>(used, i, j, moving.ahead + SPIN_AHEAD, BODY_AHEAD, scratch + ROTATION_AHEAD);
    }
    gather_motion<DIM>(predict, used, blocks.i.data + LANES * b, blocks.j.data + LANES * b, body, moving.ahead, scratch);
    if (flow) {
      add_flow<DIM>(*flow, predict, used, scratch);
      for (int64_t l = 0; l < used; ++l)
        for (int64_t k = 0; k < 3; ++k)
          blocks.pair.data[3 * (place + l) + k] = k < DIM ? scratch[PAIR + k * LANES + l] : 0.0;
    }
    if (law.lever && !law.rate && !block.vector)
      shorten_arms<DIM>(block, blocks.i.data + LANES * b, blocks.j.data + LANES * b, moving, dt, scratch);
    if (law.force) evaluate_user_law<DIM>(block, dt, scratch);
    int64_t touched[LANES];
    if (block.memory) __builtin_memcpy(touched, block.modes, sizeof touched);
    evaluate_block<DIM, MOMENTS>(block, blocks, b, dt, hold, scratch);
    if (block.memory) update_memories(block, hold, touched, scratch + OVERLAP);
    scatter_loads(law.lever, used, scratch, blocks.load.data + WIDTH * place);
    if (MOMENTS) scatter_moments(used, scratch + MOMENT, blocks.moment.data + WIDTH * place);
  }
}

}  // namespace

void evaluate_blocks(const Law &law, int64_t dim, int64_t first, int64_t last, bool crossing, int64_t begin,
                     int64_t end, const Blocks &blocks, const Moving &moving, double dt, bool hold, const Flow *flow,
                     double *scratch) {
  auto plain = dim == 3 ? evaluate<3, false> : evaluate<2, false>, turning = dim == 3 ? evaluate<3, true> : evaluate<2, true>;
  (has_moments(law) ? turning : plain)(law, first, last, crossing, begin, end, blocks, moving, dt, hold, flow, scratch);
}
