#include "cell.h"

#include <math.h>

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
      double ahead = 0.0;
      if (c >= 0) ahead = course_at(pull.knots, pull.len_knots, pull.course, pull.courses, c, pull.clock[0]).value;
      moving.force[6 * g + k] += pull.stiffness[at] * (pull.anchor[at] + ahead - moving.body[g * BODY + k]);
    }
}
