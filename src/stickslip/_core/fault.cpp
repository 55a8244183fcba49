// Rates of a fault with rate-and-state friction, and the stages of an embedded Runge–Kutta step.
//
// The unknowns of each cell are its slip in excess of plate motion, u = δ − V_p t, and s = ln(V0 θ/D_c) of each of its
// one or two states, plus the shift by which changes of the normal stress have decreased it. The slip velocity
// V = V0 e^w follows from the balance of stress and friction, τ₀ + τ(u) = σ μ(w, s, s2) + η V.
#include "rate_state.h"

namespace {

constexpr int64_t TOGETHER = 64;  // cells or unknowns that fit into the fastest memory; loops over these have no branches
constexpr double CLOSE = 1e-8;    // step of w after which Newton's method has converged to round-off

struct Cells {
  const double *a, *b, *dc, *normal, *initial, *b2, *dc2, *shift;
};

inline Cells cells(const Fault &f) {
  const double *row[8];
  for (int k = 0; k < 8; ++k) row[k] = f.cells + k * f.number;
  return {row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7]};
}

// Solves slope w + η V0 e^w = rest for w by Newton's method from guesses; false if that does not converge.
bool balance(int64_t count, const double *slope, const double *rest, double damping, double *w) {
  int64_t moves[TOGETHER];
  for (int64_t i = 0; i < count; ++i) moves[i] = 1;
  for (int k = 0; k < MOST_ITERATIONS; ++k) {
    int64_t moving = 0;
    for (int64_t i = 0; i < count; ++i) {
      double push = damping * exponential(w[i]);
      double step = (slope[i] * w[i] + push - rest[i]) / (slope[i] + push);
      step = step > 5.0 ? 5.0 : step < -5.0 ? -5.0 : step;
      w[i] = moves[i] ? w[i] - step : w[i];
      moves[i] = moves[i] && !(fabs(step) < CLOSE);
      moving += moves[i];
    }
    if (!moving) return true;
  }
  return false;
}

template <class Form>
bool velocities(const Fault &f, const Cells &c, int64_t start, int64_t count, const double *stress, const double *s,
                const double *s2, double *w) {
  double slope[TOGETHER], rest[TOGETHER], guess[TOGETHER];
  for (int64_t i = 0; i < count; ++i) {
    int64_t k = start + i;
    guess[i] = w[i];
    slope[i] = c.normal[k] * c.a[k];
    rest[i] = stress[i] - c.normal[k] * (f.mu0 + c.b[k] * s[i] + c.b2[k] * s2[i]);
  }
  bool found = balance(count, slope, rest, f.damping * f.v0, w);
  auto surface = [&](int64_t k) { return Surface{c.a[k], c.b[k], c.b2[k], f.mu0, f.cut, f.cut2}; };
  int64_t others = !found;
  for (int64_t i = 0; i < count; ++i) others += !Form::linear(surface(start + i), {w[i], s[i], s2[i]});
  for (int64_t i = 0; i < (others ? count : 0); ++i) {
    int64_t k = start + i;
    if (found && Form::linear(surface(k), {w[i], s[i], s2[i]})) continue;
    w[i] = log_velocity<Form>(surface(k), {guess[i], s[i], s2[i]}, stress[i], c.normal[k], f.damping * f.v0);
    if (!isfinite(w[i])) return false;
  }
  return true;
}

template <class Form, class Evolution>
bool rates(const Fault &f, const double *image, const double *y, double *w, double *out, double *power) {
  Cells c = cells(f);
  int64_t n = f.number;
  double *transferred = out;  // until the rates are known
  fault_stress(f.transfer, y, transferred);
  double loading = 0.0, rubbed = 0.0, radiated = 0.0;
  for (int64_t start = 0; start < n; start += TOGETHER) {
    int64_t count = n - start < TOGETHER ? n - start : TOGETHER;
    double stress[TOGETHER], v[TOGETHER], s[2][TOGETHER] = {};
    for (int64_t i = 0; i < count; ++i) stress[i] = c.initial[start + i] + transferred[start + i];
    if (image)
      for (int64_t i = 0; i < count; ++i) stress[i] += image[start + i];
    for (int64_t j = 0; j < f.states; ++j)
      for (int64_t i = 0; i < count; ++i) s[j][i] = y[(1 + j) * n + start + i] - c.shift[start + i];
    if (!velocities<Form>(f, c, start, count, stress, s[0], s[1], w + start)) return false;
    for (int64_t i = 0; i < count; ++i) {
      v[i] = f.v0 * exponential(w[start + i]);
      out[start + i] = v[i] - f.plate_rate;
    }
    for (int64_t j = 0; j < f.states; ++j) {
      const double *dc = j ? c.dc2 : c.dc;
      for (int64_t i = 0; i < count; ++i) {
        int64_t k = start + i;
        out[(1 + j) * n + k] =
            Evolution::template rate<exponential>(v[i] / f.v0, w[k], s[j][i], f.v0 / dc[k]);
      }
    }
    for (int64_t i = 0; i < count; ++i) {
      loading += stress[i];
      radiated += v[i] * v[i];
      rubbed += (stress[i] - f.damping * v[i]) * v[i];
    }
  }
  power[0] = f.plate_rate * f.cell * loading;
  power[1] = f.cell * rubbed;
  power[2] = f.damping * f.cell * radiated;
  return true;
}

}  // namespace

uint8_t fault_rates(const Fault *fault, const double *image, const double *y, double *w, double *out, double *power) {
  return with_laws(fault->form, fault->evolution, [&](auto form, auto law) {
    return rates<decltype(form), decltype(law)>(*fault, image, y, w, out, power);
  });
}

void fault_trial(const Fault *fault, const FaultStep *step, int64_t stage) {
  int64_t size = (1 + fault->states) * fault->number;
  const double *weights = fault->weights + (stage - 1) * fault->len_weights;
  for (int64_t start = 0; start < size; start += TOGETHER) {
    int64_t count = size - start < TOGETHER ? size - start : TOGETHER;
    double sum[TOGETHER] = {};
    for (int64_t j = 0; j < stage; ++j) {
      if (weights[j] == 0.0) continue;
      const double *rate = step->stages + j * size + start;
      for (int64_t i = 0; i < count; ++i) sum[i] += weights[j] * rate[i];
    }
    for (int64_t i = 0; i < count; ++i) step->trial[start + i] = step->y[start + i] + step->length * sum[i];
  }
}

uint8_t fault_stages(const Fault *fault, const FaultStep *step, int64_t first, int64_t last) {
  for (int64_t stage = first; stage <= last; ++stage) {
    double *out = step->stages + stage * (1 + fault->states) * fault->number;
    if (!fault_rates(fault, step->image, step->trial, step->w, out, step->powers + 3 * stage)) return false;
    if (stage < fault->len_weights) fault_trial(fault, step, stage + 1);
  }
  return true;
}

double fault_error(const Fault *fault, const FaultStep *step) {
  int64_t n = fault->number, size = (1 + fault->states) * n;
  const double *dc = fault->cells + 2 * n;
  double sum_five = 0.0, sum_three = 0.0;
  for (int64_t start = 0; start < size; start += TOGETHER) {
    int64_t count = size - start < TOGETHER ? size - start : TOGETHER;
    double five[TOGETHER] = {}, three[TOGETHER] = {};
    for (int64_t j = 0; j <= fault->len_weights; ++j) {
      if (fault->five[j] == 0.0 && fault->three[j] == 0.0) continue;
      const double *rate = step->stages + j * size + start;
      for (int64_t i = 0; i < count; ++i) {
        five[i] += fault->five[j] * rate[i];
        three[i] += fault->three[j] * rate[i];
      }
    }
    for (int64_t i = 0; i < count; ++i) {
      double scale = start + i < n ? dc[start + i] : 1.0;
      sum_five += (five[i] / scale) * (five[i] / scale);
      sum_three += (three[i] / scale) * (three[i] / scale);
    }
  }
  if (sum_five == 0.0) return 0.0;
  return fabs(step->length) * sum_five / sqrt((sum_five + 0.01 * sum_three) * (double)size);
}
