// build: -fno-tree-slp-vectorize
// Integration of a slider with rate-and-state friction on a spring.
//
// The unknowns are logarithms, because velocity and state vary over many orders of magnitude during a hold.
// Extrapolation of the linearly implicit Euler method (P. Deuflhard, SIAM Rev. 27, 505 (1985), doi:10.1137/1027140)
// needs no table of coefficients, adapts its order, and solves its systems by elimination, since the states are coupled
// through w alone. A step ends at every requested time, so nothing is interpolated.
//
// The flag keeps GCC from packing w and s into vectors, which lengthens the chain of dependent operations.
#include "rate_state.h"

namespace {

constexpr int64_t DONE = 0, RUNAWAY = 1, STEPS_SPENT = 2;
constexpr int ORDERS = 10;  // largest number of columns of the extrapolation
constexpr double FASTEST = 200.0;  // ln(V/V0) above which slip has run away: quasi-static slip does so in finite time
constexpr int64_t MOST_STEPS = 200000;  // between two requested times
constexpr double FARTHEST = 5.0;  // largest change of a logarithm in a part of a step

struct Jacobian {
  double ww, ws, ws2, sw, ss, ss2, s2w, s2s, s2s2;  // rows are derivatives of w', s' and s2'
};

inline double smaller(double a, double b) { return b < a ? b : a; }
inline double larger(double a, double b) { return b > a ? b : a; }

inline Surface surface(const Slider &q) { return {q.a, q.b, q.b2, q.mu0, q.cut, q.cut2}; }

// Time derivatives of w, s and s2; the last is 0 if b2 = 0. The balance of forces n μ + ηV = k(x_lp − x),
// differentiated, is (n ∂μ/∂w + ηV) w' = k(V_lp − V) − n (∂μ/∂s s' + ∂μ/∂s2 s2').
template <class Form, class Evolution>
Logs rates(const Slider &q, const Logs &x, double velocity, double normal) {
  double e = exp(x.w);
  Logs m = Form::slopes(surface(q), x);
  double s = Evolution::rate(e, x.w, x.s, q.v0 / q.dc), s2 = 0.0;
  if (q.b2 != 0.0) s2 = Evolution::rate(e, x.w, x.s2, q.v0 / q.dc2);
  double inertia = normal * m.w + q.damping * q.v0 * e;
  return {(q.stiffness * (velocity - q.v0 * e) - normal * (m.s * s + m.s2 * s2)) / inertia, s, s2};
}

template <class Form, class Evolution>
Jacobian derivatives(const Slider &q, const Logs &x, double velocity, double normal) {
  double e = q.v0 * exp(x.w);
  Logs m = Form::slopes(surface(q), x), d = rates<Form, Evolution>(q, x, velocity, normal);
  Curvatures c = Form::curvatures(surface(q), x);
  StateSlopes one = Evolution::slopes(x.w, x.s, q.v0 / q.dc), two = {0.0, 0.0};
  if (q.b2 != 0.0) two = Evolution::slopes(x.w, x.s2, q.v0 / q.dc2);
  double inertia = normal * m.w + q.damping * e;
  double states = c.ws * d.s + m.s * one.w + c.ws2 * d.s2 + m.s2 * two.w;
  double ww = (-q.stiffness * e - normal * states - d.w * (normal * c.ww + q.damping * e)) / inertia;
  double ws = -normal * (c.ss * d.s + m.s * one.s + c.ss2 * d.s2 + d.w * c.ws) / inertia;
  double ws2 = -normal * (c.ss2 * d.s + c.s2s2 * d.s2 + m.s2 * two.s + d.w * c.ws2) / inertia;
  return {ww, ws, ws2, one.w, one.s, 0.0, two.w, 0.0, two.s};
}

// Takes one step of length h, if it meets the tolerance; returns the number of columns used, else 0.
template <class Form, class Evolution>
int extrapolate(const Slider &q, Logs &start, double h, double velocity, double normal, double tolerance) {
  Jacobian j = derivatives<Form, Evolution>(q, start, velocity, normal);
  bool two = q.b2 != 0.0;
  Logs table[ORDERS];
  for (int column = 0; column < ORDERS; ++column) {
    double d = h / (column + 1);
    double over_s = 1.0 / (1.0 - d * j.ss), over_s2 = 1.0 / (1.0 - d * j.s2s2);
    double by_s = d * j.ws * over_s, by_s2 = d * j.ws2 * over_s2;
    double over_w = 1.0 / (1.0 - d * j.ww - d * (by_s * j.sw + by_s2 * j.s2w));
    Logs x = start;
    for (int k = 0; k <= column; ++k) {
      Logs rate = rates<Form, Evolution>(q, x, velocity, normal);
      double w = (d * (rate.w + by_s * rate.s + by_s2 * rate.s2)) * over_w, s = d * (rate.s + j.sw * w) * over_s;
      x.w += w;
      x.s += s;
      if (!(fabs(w) < FARTHEST && fabs(s) < FARTHEST)) return 0;
      if (!two) continue;
      double s2 = d * (rate.s2 + j.s2w * w) * over_s2;
      x.s2 += s2;
      if (!(fabs(s2) < FARTHEST)) return 0;
    }
    double gap = 0.0;
    for (int m = 0; m < column; ++m) {  // Aitken and Neville: the table holds the row before and becomes this one
      double share = (column - m) / (m + 1.0);
      Logs next = {x.w + (x.w - table[m].w) * share, x.s + (x.s - table[m].s) * share, x.s2};
      gap = larger(fabs(next.w - x.w), fabs(next.s - x.s));
      if (two) {
        next.s2 = x.s2 + (x.s2 - table[m].s2) * share;
        gap = larger(gap, fabs(next.s2 - x.s2));
      }
      table[m] = x;
      x = next;
    }
    table[column] = x;
    if (column >= 2 && gap <= tolerance) {
      start = x;
      return column + 1;
    }
  }
  return 0;
}

// Logarithms after a jump of the normal stress: θ → θ (new/old)^(−α/(b + b2)) for each state (Linker and Dieterich
// 1992, doi:10.1029/92JB00017), at constant spring force n μ + ηV.
template <class Form>
Logs after_normal_jump(const Slider &q, Logs x, double before, double after) {
  double eta = q.damping * q.v0, force = before * Form::friction(surface(q), x).value + eta * exp(x.w);
  double shift = (q.b + q.b2 > 0.0 ? q.alpha / (q.b + q.b2) : 0.0) * log(after / before);
  x.s -= shift;
  x.s2 -= shift;
  x.w = (force / after - q.mu0 - q.b * x.s - q.b2 * x.s2) / q.a;
  if (eta > 0.0) x.w = smaller(x.w, log(larger(fabs(force), eta) / eta));
  x.w = log_velocity<Form>(surface(q), x, force, after, eta);
  return x;
}

struct Leg {
  double duration, velocity, normal;
};

// Integrates over a span in steps of which the first has length h; returns a code and updates x, h and the time t
// reached, which counts from the last stop, since steps during fast slip may be below the resolution of the whole time.
template <class Form, class Evolution>
int64_t integrate_span(const Slider &q, Logs &x, const Leg &leg, double span, double tolerance, double &h, double &t) {
  t = 0.0;
  for (int64_t steps = 1; t < span; ++steps) {
    double d = smaller(h, span - t);
    int columns = extrapolate<Form, Evolution>(q, x, d, leg.velocity, leg.normal, tolerance);
    if (columns == 0) {
      h = 0.25 * d;
      if (h < 1e-15 * (t + span * 1e-9) || steps > MOST_STEPS) return h < 1e-12 * span ? RUNAWAY : STEPS_SPENT;
      continue;
    }
    t = d == span - t ? span : t + d;
    if (x.w > FASTEST) return RUNAWAY;
    if (columns < 5 || (columns < 7 && d < h))
      h = larger(h, d * 2.0);
    else if (columns < 7)
      h = d * 1.3;
    else if (columns > 8)
      h = 0.7 * d;
  }
  return DONE;
}

// Writes x at all times; at the end of a leg, the values are those before the next leg begins.
template <class Form, class Evolution>
int64_t integrate(const Slider &q, Logs x, const double *legs, int64_t many, const double *times, int64_t count,
                  double tolerance, double *out, double *reached) {
  double began = 0.0, before = legs[2 * many];
  int64_t k = 0;
  while (k < count && times[k] <= 0.0) put(out + 3 * k++, x);
  for (int64_t number = 0; number < many; ++number) {
    Leg leg = {legs[number], legs[many + number], legs[2 * many + number]};
    if (leg.normal != before) x = after_normal_jump<Form>(q, x, before, leg.normal);
    before = leg.normal;
    double ends = began + leg.duration, stop = 0.0, t;
    double h = smaller(leg.duration, 0.1 * q.dc / (q.v0 * exp(x.w) + fabs(leg.velocity)));
    for (bool asked = true; asked;) {
      asked = k < count && (times[k] <= ends || number == many - 1);
      double target = asked ? times[k] - began : leg.duration;
      int64_t code = integrate_span<Form, Evolution>(q, x, leg, target - stop, tolerance, h, t);
      *reached = began + stop + t;
      if (code != DONE) return code;
      stop = target;
      if (asked) put(out + 3 * k++, x);
    }
    *reached = began = ends;
    if (k == count) break;
  }
  return DONE;
}

}  // namespace

int64_t slider_history(const Slider *slider, double w, double s, double s2, const double *legs, int64_t many,
                       const double *times, int64_t count, double tolerance, double *out, double *reached) {
  return with_laws(slider->form, slider->evolution, [&](auto form, auto law) {
    return integrate<decltype(form), decltype(law)>(*slider, {w, s, s2}, legs, many, times, count, tolerance, out,
                                                    reached);
  });
}

void slider_rates(const Slider *slider, const double *logs, double velocity, double normal, double *out,
                  double *jacobian) {
  Logs x = take<Logs>(logs);
  with_laws(slider->form, slider->evolution, [&](auto form, auto law) {
    put(out, rates<decltype(form), decltype(law)>(*slider, x, velocity, normal));
    put(jacobian, derivatives<decltype(form), decltype(law)>(*slider, x, velocity, normal));
  });
}

void state_history(int64_t evolution, double s, int64_t count, const double *duration, const double *velocity,
                   double v0, double dc, double *out) {
  with(Evolutions{}, evolution, [&](auto law) {
    for (int64_t k = 0; k < count; ++k) out[k] = s = law.later(s, velocity[k], duration[k], v0, dc);
  });
}

void friction_of_rows(int64_t form, int64_t count, const double *logs, const double *surfaces, int64_t many, double *mu,
                      double *slopes, double *curvatures) {
  with(Forms{}, form, [&](auto chosen) {
    for (int64_t k = 0; k < count; ++k) {
      Logs x = take<Logs>(logs + 3 * k);
      Surface q = take<Surface>(surfaces + (many > 1 ? 6 * k : 0));
      if (mu) mu[k] = chosen.friction(q, x).value;
      if (slopes) put(slopes + 3 * k, chosen.slopes(q, x));
      if (curvatures) put(curvatures + 6 * k, chosen.curvatures(q, x));
    }
  });
}
