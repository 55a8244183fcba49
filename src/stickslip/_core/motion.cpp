#include "loop.h"

#include <math.h>

namespace {

constexpr double NOT_FINITE_SQUARE = 1e300;  // returned for NaN

// Sums of loads for a range of bodies, one entry of `code` after another. There is no branch on the first row of a body,
// because it is unpredictable.
template <bool LEVER, bool TURNS>
struct Stream {
  const Blocks &blocks;
  const double *bodies;
  const double *external;
  bool loaded;  // `external` has a row for each body
  double *total;
  int64_t body, origin;
  Real sums[WIDTH / W];  // not one vector of WIDTH numbers: compilers keep wider ones than registers in memory

  void add(uint32_t word) {
    alignas(64) static const double signs[2][8] = {{-1, -1, -1, 1, 1, 1, 1, 1}, {1, 1, 1, 1, 1, 1, 1, 1}};
    alignas(64) static const double forces[8] = {1, 1, 1, 0, 0, 0, 0, 0}, torques[8] = {0, 0, 0, 1, 1, 1, 0, 0};
    alignas(64) static const int64_t kept[2][8] = {{-1, -1, -1, -1, -1, -1, -1, -1}, {}};
    const double *row = reinterpret_cast<const double *>(reinterpret_cast<const char *>(blocks.load.data) + (word & ~(ROW - 1)));
    const double *moments = TURNS ? blocks.moment.data + (row - blocks.load.data) : nullptr;
    const double *sign = signs[(word & IS_I) / IS_I];
    const int64_t *mask = kept[word & IS_FIRST];
    body += word & IS_FIRST;
    const double arm = LEVER ? bodies[BODY * body + RADIUS] - row[6] : 1.0;
    for (int k = 0; k < WIDTH; k += W) {
      Mask before = (Mask)sums[k / W] & load(mask + k);
      if (loaded) before |= (Mask)load(external + WIDTH * body + k) & ~load(mask + k);
      sums[k / W] = (Real)before + (LEVER ? load(row + k) * (load(forces + k) + arm * load(torques + k)) : load(row + k)) * load(sign + k);
      if (TURNS) sums[k / W] += sign[0] * load(moments + k);
      store(total + WIDTH * (body - origin) + k, sums[k / W]);
    }
  }
};

// Sums rows for each body, beginning with the external load, in the order of `code`. The two halves of the bodies are
// interleaved, because each addition waits for the previous one.
template <bool LEVER, bool TURNS, bool LOADED, bool FAR>
void sum_rows(const Moving &moving, const Blocks &blocks, int64_t first, int64_t last, double *total) {
  const uint32_t *start = blocks.start.data, *code = blocks.code.data;
  const int64_t middle = (first + last) / 2, begin = start[first], half = start[middle], end = start[last];
  Stream<LEVER, TURNS> one{blocks, moving.body, moving.external, LOADED, total, first - 1, first, {}};
  Stream<LEVER, TURNS> two{blocks, moving.body, moving.external, LOADED, total, middle - 1, first, {}};
  const int64_t both = half - begin < end - half ? half - begin : end - half;
  auto fetch = [&](int64_t e) {
    if (FAR)
      __builtin_prefetch(reinterpret_cast<const char *>(blocks.load.data) + (code[e + PREFETCH_DISTANCE] & ~(ROW - 1)));
  };
  for (int64_t k = 0; k < both; ++k) {
    fetch(begin + k);
    one.add(code[begin + k]);
    fetch(half + k);
    two.add(code[half + k]);
  }
  for (int64_t e = begin + both; e < half; ++e) fetch(e), one.add(code[e]);
  for (int64_t e = half + both; e < end; ++e) fetch(e), two.add(code[e]);
}

// Sums f ⊗ r over the contacts in which a body is i.
void sum_virial(const Moving &moving, const Blocks &blocks, int64_t first, int64_t last) {
  int64_t g = first - 1;
  for (int64_t e = blocks.start.data[first]; e < int64_t(blocks.start.data[last]); ++e) {
    uint32_t word = blocks.code.data[e];
    if (word & IS_FIRST) {
      ++g;
      for (int k = 0; k < 9; ++k) moving.virial[9 * g + k] = 0.0;
    }
    if (word & IS_I)
      for (int k = 0; k < 3; ++k)
        for (int m = 0; m < 3; ++m)
          moving.virial[9 * g + 3 * k + m] += blocks.load.data[WIDTH * (word / ROW) + k] * blocks.pair.data[3 * (word / ROW) + m];
  }
}

template <bool LEVER, bool TURNS>
auto choose_sum(bool loaded, bool far) {
  return loaded ? (far ? sum_rows<LEVER, TURNS, true, true> : sum_rows<LEVER, TURNS, true, false>)
                : (far ? sum_rows<LEVER, TURNS, false, true> : sum_rows<LEVER, TURNS, false, false>);
}

// External loads and those of all contacts, for at most CHUNK bodies.
void sum_loads(const Step &step, const Blocks &blocks, int64_t first, int64_t last, double *total) {
  const Moving &moving = step.moving;
  const bool far = moving.len_tile > 2;  // with one tile, all data are near
  const bool loaded = moving.len_external > 1;
  const bool arms = step.lever || step.turns;  // torques are sums of terms of which not all are proportional to R
  auto sum = step.turns ? choose_sum<true, true>(loaded, far)
             : arms     ? choose_sum<true, false>(loaded, far)
                        : choose_sum<false, false>(loaded, far);
  sum(moving, blocks, first, last, total);
  if (step.flow) sum_virial(moving, blocks, first, last);
  for (int64_t g = first; g < last; ++g) {
    const double *torque = moving.torque + (moving.len_torque > 1 ? 3 * g : 0);
    const double radius = arms ? 1.0 : moving.body[BODY * g + RADIUS];
    for (int k = 0; k < 3; ++k) total[WIDTH * (g - first) + 3 + k] = torque[k] + radius * total[WIDTH * (g - first) + 3 + k];
  }
}

void store_forces(const Moving &moving, const double *total, int64_t first, int64_t last) {
  for (int64_t g = first; g < last; ++g)
    for (int k = 0; k < 6; ++k) moving.force[6 * g + k] = total[WIDTH * (g - first) + k];
}

struct Transform {
  const double *m;
  void operator()(double *v) const {
    const double x = v[0], y = v[1], z = v[2];
    for (int k = 0; k < 3; ++k) v[k] = m[3 * k] * x + m[3 * k + 1] * y + m[3 * k + 2] * z;
  }
};

// Ends a step with half a kick (implicit drag), and begins the next with half a kick (explicit drag) and the drift.
template <int DIM>
inline double move_body(const Step &step, int64_t g, const double *f) {
  const Moving &moving = step.moving;
  const Pace &pace = step.pace;
  const Flow *flow = step.flow;
  const bool half = !step.fresh, go_on = step.go_on, whole = moving.whole[g];
  double *body = moving.body + BODY * g;
  const uint8_t *free = moving.free + 6 * g;
  const double kick[2] = {body[KICK], body[KICK_T]}, keep[2] = {pace.keep, pace.keep_t};
  const double slow[2] = {pace.slow, pace.slow_t};
  double rate[6];  // velocity and spin
  for (int k = 0; k < 3; ++k) rate[k] = body[VELOCITY + k], rate[3 + k] = body[SPIN + k];
  constexpr bool exists[6] = {true, true, DIM == 3, DIM == 3, DIM == 3, true};
  auto turn = [&] {  // half a step of the term −L v
    double v[3] = {rate[0], rate[1], rate[2]};
    Transform{flow->matrix + 9 * TURN}(v);
    for (int k = 0; k < 3; ++k)
      if (free[k]) rate[k] = v[k];
  };
  auto imposed = [&](int when, int k) {  // mean over the step (0) or at its end (1)
    return flow->rate[6 * g + k] * flow->factor[when * (flow->courses + 1) + flow->follows[6 * g + k]];
  };
  if (flow && half) turn();
  for (int k = 0; k < 6; ++k)
    if (exists[k] && (whole || free[k]))
      rate[k] = kicked(rate[k], kick[k / 3] * f[k], keep[k / 3], slow[k / 3], half, go_on);
  if (flow && go_on) turn();
  if (flow && !whole && (half || go_on))
    for (int k = 0; k < 6; ++k)
      if (!free[k]) rate[k] = imposed(!go_on, k);
  if (half || go_on)
    for (int k = 0; k < 3; ++k) {
      if (exists[k]) body[VELOCITY + k] = rate[k];
      if (exists[3 + k]) body[SPIN + k] = rate[3 + k];
    }
  if (!go_on) return 0.0;
  const double dt = pace.dt;
  double to[3];
  if (flow) {
    for (int k = 0; k < 3; ++k) to[k] = body[k] + 0.5 * dt * rate[k];
    Transform{flow->matrix + 9 * STRETCH}(to);
    for (int k = 0; k < 3; ++k) to[k] += 0.5 * dt * rate[k];
  } else {
    for (int k = 0; k < 3; ++k) to[k] = body[k] + dt * rate[k];
  }
  double square = 0.0, *origin = moving.origin + 4 * g;
  if (flow) Transform{flow->matrix + 9 * STRETCH}(origin);
  for (int k = 0; k < DIM; ++k) {
    const double moved = to[k] - origin[k];
    square += moved * moved;
    body[k] = to[k];
  }
  for (int k = 0; k < 3; ++k)
    if (exists[3 + k]) moving.angle[3 * g + k] += dt * rate[3 + k];
  if (step.predict) {
    double *ahead = moving.ahead + BODY_AHEAD * g;
    if (flow) turn();
    for (int k = 0; k < 6; ++k) {
      if (!exists[k]) continue;
      double value = whole || free[k] ? predicted(rate[k], kick[k / 3] * f[k], slow[k / 3]) : rate[k];
      if (flow && !whole && !free[k]) value = imposed(1, k);
      ahead[k < 3 ? VELOCITY_AHEAD + k : SPIN_AHEAD + k - 3] = value;
    }
  }
  square *= origin[3];
  return square < NOT_FINITE_SQUARE ? square : NOT_FINITE_SQUARE;
}

// Loads of bodies `first` to `last` are rows of `stride` numbers.
template <int DIM>
double move_all(const Step &step, int64_t first, int64_t last, const double *load, int64_t stride) {
  double far = 0.0;
  for (int64_t g = first; g < last; ++g) {
    const double square = move_body<DIM>(step, g, load + stride * (g - first));
    far = far < square ? square : far;
  }
  return far;
}

double move_bodies(const Step &step, int64_t first, int64_t last, const double *load, int64_t stride) {
  return (step.dim == 3 ? move_all<3> : move_all<2>)(step, first, last, load, stride);
}

// The force on each member of a group becomes the sum over its members, in the order of their numbers.
void sum_over_groups(const Moving &moving) {
  for (int64_t g = 0; g + 1 < moving.len_members; ++g)
    for (int k = 0; k < 3; ++k) {
      double total = 0.0;
      for (int64_t e = moving.members[g]; e < moving.members[g + 1]; ++e) total += moving.force[6 * moving.member[e] + k];
      for (int64_t e = moving.members[g]; e < moving.members[g + 1]; ++e) moving.force[6 * moving.member[e] + k] = total;
    }
}

}  // namespace

double end_step(const Step &step, const Blocks &blocks, int64_t first, int64_t last, double *total) {
  double far = 0.0;
  for (int64_t begin = first; begin < last; begin += CHUNK) {
    const int64_t end = begin + CHUNK < last ? begin + CHUNK : last;
    sum_loads(step, blocks, begin, end, total);
    const double square = move_bodies(step, begin, end, total, WIDTH);
    far = far < square ? square : far;
    if (!step.go_on) store_forces(step.moving, total, begin, end);
  }
  return far;
}

double end_last_tile(const Step &step, const Blocks *blocks, const Pull *pull, double *total) {
  const Moving &moving = step.moving;
  const int64_t first = moving.tile[moving.len_tile - 1], last = moving.len_order;
  if (blocks)
    for (int64_t begin = first; begin < last; begin += CHUNK) {
      const int64_t end = begin + CHUNK < last ? begin + CHUNK : last;
      sum_loads(step, *blocks, begin, end, total);
      store_forces(moving, total, begin, end);
    }
  if (pull) add_springs(*pull, first, moving);
  sum_over_groups(moving);
  return move_bodies(step, first, last, moving.force + 6 * first, 6);
}

double begin_step(const Step &step, int64_t first, int64_t last) {
  return move_bodies(step, first, last, step.moving.force + 6 * first, 6);
}

double largest_unbalanced(const Moving &moving, const Pace &pace, double drag, double spin_drag, int64_t *worst) {
  double most = 0.0;
  *worst = -1;
  for (int64_t g = 0; g < moving.len_order; ++g)
    for (int k = 0; k < 6; ++k) {
      const double *body = moving.body + BODY * g, kick = body[k < 3 ? KICK : KICK_T];
      if (!moving.free[6 * g + k] || !(kick > 0.0)) continue;
      const double force = moving.force[6 * g + k], rate = body[k < 3 ? VELOCITY + k : SPIN + k - 3];
      const double resisted = (k < 3 ? drag : spin_drag) * fabs(rate) * 0.5 * pace.dt / kick;
      double size = fabs(force) > resisted ? fabs(force) : resisted;
      size = (size + 0.0 * force * rate) / (k < 3 ? 1.0 : body[RADIUS]);
      if (!isfinite(size)) {
        *worst = moving.order[g];
        return NAN;
      }
      if (size > most) most = size, *worst = moving.order[g];
    }
  return most;
}

// ---- the cell and springs

typedef double Matrix[3][3];

static Matrix *matrices(const Flow &flow) { return reinterpret_cast<Matrix *>(flow.matrix); }

struct Integral {
  double value, area;
};

// Value of a time profile at a time, and its integral from the first knot.
static Integral course_and_integral(const Frame &frame, int64_t c, double time) {
  CoursePoint at = course_at(frame.knots, frame.len_knots, frame.course, frame.courses, c, time);
  if (at.knot < 0) return {at.value, (time - frame.knots[0]) * at.value};
  int64_t entry = at.knot * frame.courses + c;
  return {at.value, frame.area[entry] + 0.5 * (time - frame.knots[at.knot]) * (frame.course[entry] + at.value)};
}

static void invert(const Matrix m, Matrix out) {
  for (int a = 0; a < 3; ++a) {
    int b = (a + 1) % 3, c = (a + 2) % 3;
    for (int k = 0; k < 3; ++k) {
      int q = (k + 1) % 3, r = (k + 2) % 3;
      out[k][a] = m[b][q] * m[c][r] - m[b][r] * m[c][q];
    }
  }
  double determinant = m[0][0] * out[0][0] + m[0][1] * out[1][0] + m[0][2] * out[2][0];
  for (int a = 0; a < 3; ++a)
    for (int k = 0; k < 3; ++k) out[k][a] /= determinant;
}

static void multiply(const Matrix a, const Matrix b, Matrix out) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
}

// 1 + factor m
static void one_plus(double factor, const Matrix m, Matrix out) {
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) out[a][b] = (a == b) + factor * m[a][b];
}

static void set_courses(Frame &frame, Flow &flow, double dt) {
  double time = frame.clock[0], *mean = flow.factor, *end = flow.factor + flow.courses + 1;
  frame.clock[0] = time + dt;
  for (int64_t c = 0; c < frame.courses; ++c) {
    Integral before = course_and_integral(frame, c, time), after = course_and_integral(frame, c, frame.clock[0]);
    end[c] = after.value;
    mean[c] = (after.area - before.area) / dt;
  }
}

static void set_rates(const Frame &frame, Flow &flow, double half, double keep, double slow) {
  Matrix *m = matrices(flow);
  double *mean = flow.factor, *end = flow.factor + flow.courses + 1;
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) {
      int k = 3 * a + b;
      if (frame.free[k]) {
        m[RATE][a][b] = keep * m[RATE][a][b] + half * m[PULL][a][b];
        m[RATE_AHEAD][a][b] = slow * (m[RATE][a][b] + half * m[PULL][a][b]);
      } else {
        m[RATE][a][b] = frame.given[k] * mean[frame.follows[k]];
        m[RATE_AHEAD][a][b] = frame.given[k] * end[frame.follows[k]];
      }
    }
}

double begin_cell_step(Frame *frame, Flow *flow, double dt, double keep, double slow) {
  double half = 0.5 * dt, square = 0.0;
  Matrix *m = matrices(*flow), one, other;
  set_courses(*frame, *flow, dt);
  set_rates(*frame, *flow, half, keep, slow);
  one_plus(-half, m[RATE], one);
  invert(one, other);
  one_plus(half, m[RATE], one);
  multiply(other, one, m[STRETCH]);
  invert(one, m[INVERSE_HALF]);
  one_plus(0.5 * half, m[RATE], one);
  invert(one, other);
  one_plus(-0.5 * half, m[RATE], one);
  multiply(other, one, m[TURN]);
  multiply(m[STRETCH], m[SINCE], one);
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) {
      double *h = m[VECTORS][a], *row = m[STRETCH][b], strain = one[a][b] - (a == b);
      m[SINCE][a][b] = one[a][b];
      square += strain * strain;
      other[a][b] = h[0] * row[0] + h[1] * row[1] + h[2] * row[2];
    }
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b) m[VECTORS][a][b] = other[a][b];
  // a pair further apart than s + reach stays apart while the deformation uses no more than the remaining reach
  double left = frame->reach[0] - sqrt(square) * (frame->widest + frame->reach[0]);
  // −1 triggers a new choice of blocks even if all grains are at rest in the flow
  return left > 0.0 ? (0.5 * left) * (0.5 * left) : -1.0;
}

// Volume of a cell, or its area in two dimensions.
static double volume(int64_t dim, const Matrix h) {
  double space = h[0][0] * h[1][1] - h[0][1] * h[1][0];
  if (dim == 3) {
    space = space * h[2][2] + h[0][2] * (h[1][0] * h[2][1] - h[1][1] * h[2][0]);
    space += h[1][2] * (h[0][1] * h[2][0] - h[0][0] * h[2][1]);
  }
  return fabs(space);
}

void end_cell_step(int64_t dim, Frame &frame, Flow &flow, double dt, double slow, const Moving &moving, bool fresh) {
  Matrix *m = matrices(flow);
  double total[9] = {}, space = volume(dim, m[VECTORS]), *end = flow.factor + flow.courses + 1;
  for (int64_t a = 0; a < frame.len_place; ++a) {
    const double *v = moving.body + frame.place[a] * BODY + VELOCITY, *virial = moving.virial + frame.place[a] * 9;
    for (int k = 0; k < 3; ++k)
      for (int q = 0; q < 3; ++q) total[3 * k + q] += virial[3 * k + q] + frame.grain_mass[a] * v[k] * v[q];
  }
  double inertia = frame.mass * (dim == 2 ? space : pow(space, 2.0 / 3.0));
  for (int k = 0; k < 9; ++k) {
    double &rate = m[RATE][k / 3][k % 3], &pull = m[PULL][k / 3][k % 3];
    if (frame.free[k]) {
      pull = (total[k] - space * frame.wanted[k]) / inertia;
      if (!fresh) rate = (rate + 0.5 * dt * pull) * slow;
    } else if (!fresh) {
      rate = frame.given[k] * end[frame.follows[k]];
    }
  }
}

double unbalanced_cell(int64_t dim, const Frame &frame, const Flow &flow, double drag) {
  Matrix *m = matrices(flow);
  double most = 0.0;
  for (int k = 0; k < 9; ++k)
    if (frame.free[k]) {
      double rate = m[RATE][k / 3][k % 3], pull = m[PULL][k / 3][k % 3], force = fabs(pull), slowed = drag * fabs(rate);
      double size = (force >= slowed ? force : slowed) + 0.0 * pull * rate;
      most = size <= most ? most : size;
    }
  return frame.mass * pow(volume(dim, m[VECTORS]), 1.0 / dim) * most;
}

void add_springs(const Pull &pull, int64_t first, const Moving &moving) {
  for (int64_t s = 0; s < pull.len_stiffness; ++s)
    for (int k = 0; k < 3; ++k) {
      int64_t at = 3 * s + k, c = pull.leads[at], g = first + s;
      if (!(pull.stiffness[at] > 0.0)) continue;
      moving.force[6 * g + k] += spring_force(pull.stiffness[at], pull.anchor[at], moving.body[g * BODY + k], pull.knots,
                                              pull.len_knots, pull.course, pull.courses, c, pull.clock[0]);
    }
}
