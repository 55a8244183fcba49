// build: -ffp-contract=fast -fno-signed-zeros -ffinite-math-only
#include "evaluate.h"
#include "mechanics.h"
#include "transpose.h"

namespace {

constexpr double SQUARE_MARGIN = 1.0 + 1e-9;  // on squared distances beyond which nothing can touch, despite rounding

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

// Evaluates the functions of a user's law for all lanes.
template <int DIM>
void evaluate_user_law(const Block &block, double *scratch) {
  const Law &law = block.law;
  for (int64_t l = 0; l < block.used; l += W) store(scratch + OVERLAP + l, geometry<DIM>(block, l).overlap);
  double unused[LANES];
  const double *size = block.size ? block.size : unused;
  if (!block.size)
    for (double &value : unused) value = 1.0;
  reinterpret_cast<LawFunction>(law.force)(block.q, block.used, size, scratch + OVERLAP, scratch + OVERLAP,
                                           nullptr, scratch + ELASTIC, scratch + STIFFNESS);
  if (!law.cap) return;
  for (int64_t l = 0; l < block.used; l += W)
    store(scratch + TOTAL + l, normal_force<DIM>(block, geometry<DIM>(block, l), l).total);
  double second[LANES];
  reinterpret_cast<LawFunction>(law.cap)(block.q, block.used, size, scratch + OVERLAP, scratch + TOTAL, nullptr,
                                         scratch + LIMIT, second);
}

// Forces and memory of one block. Lanes that do not touch get zeros.
template <int DIM>
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
    if (!rate) {
      Ratio<Real> touched = touching_fraction(at.n, at.inverse, at.overlap - at.edge, d);
      fraction = {select(open, touched.part, fraction.part), select(open, touched.whole, fraction.whole)};
    }
    Transport<Real> moved = transport_slip(law, rate, at.n, at.inverse, at.overlap, d, roll, s);
    if (hold) moved.slip = s, moved.increment = {Real{}, Real{}, Real{}};
    Real limit = law.cap ? select(at.touches, load(scratch + LIMIT + l), Real{})
                         : coulomb_limit(block.q, normal.total, rate && law.damping && !law.force);
    Mask slid = (before == SLIDE) | (before == LOOSE);
    Loads<Real, Mask> out =
        contact_loads<DIM>(law, rate, FREE, held, normal.total, normal.stiffness, normal.factor * block.q[DAMPING_T],
                           limit, at.overlap, at.reach, moved, fraction, slid, normal.velocity);
    Vec<Real> none = {Real{}, Real{}, Real{}}, t = out.tangential, force = out.normal * at.n + t;
    Vec<Real> slip = select(at.touches, out.slip, none), turn = cross(t, at.n);
    store(slips + l, slip.x), store(slips + LANES + l, slip.y);
    if (DIM == 3) store(slips + 2 * LANES + l, slip.z);
    Mask reached = (before == SLIDE) | (before == STUCK_AGAIN), zero = {};
    Mask sliding = select(reached | (limit > 0.0), zero + SLIDE, zero + LOOSE);
    Mask after = select(out.slides, sliding, select(reached, zero + STUCK_AGAIN, zero + STICK));
    if (hold) after = select(open, after, before);
    store(modes + l, select(at.touches, after, zero + OPEN));
    store(scratch + l, force.x), store(scratch + LANES + l, force.y), store(scratch + 5 * LANES + l, turn.z);
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

template <int DIM>
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
                   blocks.mode.data + LANES * b, predict, used};
    if (law.range) {
      double unused[LANES];
      reinterpret_cast<LawFunction>(law.range)(q, used, block.size ? block.size : unused, unused, unused,
                                               nullptr, scratch + EDGE, unused);
    }
    const int64_t place = blocks.place.data[b];
    if (is_idle<DIM>(block, blocks.mode.data + LANES * b)) {
      __builtin_memset(blocks.load.data + WIDTH * place, 0, sizeof(double) * WIDTH * used);
      if (flow) __builtin_memset(blocks.pair.data + 3 * place, 0, sizeof(double) * 3 * used);
      continue;
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
    if (law.force) evaluate_user_law<DIM>(block, scratch);
    evaluate_block<DIM>(block, blocks, b, dt, hold, scratch);
    scatter_loads(law.lever, used, scratch, blocks.load.data + WIDTH * place);
  }
}

}  // namespace

void evaluate_blocks(const Law &law, int64_t dim, int64_t first, int64_t last, bool crossing, int64_t begin,
                     int64_t end, const Blocks &blocks, const Moving &moving, double dt, bool hold, const Flow *flow,
                     double *scratch) {
  auto own = dim == 3 ? evaluate<3> : evaluate<2>;
  own(law, first, last, crossing, begin, end, blocks, moving, dt, hold, flow, scratch);
}
