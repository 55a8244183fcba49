// Rates of a fault with rate-and-state friction, and the pieces of an embedded Runge–Kutta step.
//
// The unknowns of each cell are its slip in excess of plate motion, u = δ − V_p t, and s = ln(V0 θ/D_c) of each of its
// one or two states, plus the shift by which changes of the normal stress have decreased it. The slip velocity V = V0 e^w follows from the balance of stress and friction,
// τ₀ + τ(u) = σ μ(w, s, s2) + η V.
#include "rate_state.h"

namespace {

struct Cells {
  const double *a, *b, *dc, *normal, *initial, *b2, *dc2, *shift;
};

inline Cells cells(const Fault &f) {
  const double *row[8];
  for (int k = 0; k < 8; ++k) row[k] = f.cells + k * f.number;
  return {row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7]};
}

template <class Form, class Evolution>
bool rates(const Fault &f, const double *transferred, const double *y, double *w, double *out, double *power) {
  Cells c = cells(f);
  int64_t n = f.number;
  bool two = f.states > 1;
  double loading = 0.0, rubbed = 0.0, radiated = 0.0;
  for (int64_t i = 0; i < n; ++i) {
    double stress = c.initial[i] + transferred[i];
    Surface q = {c.a[i], c.b[i], c.b2[i], f.mu0, f.cut, f.cut2};
    Logs x = {w[i], y[n + i] - c.shift[i], two ? y[2 * n + i] - c.shift[i] : 0.0};
    x.w = log_velocity<Form>(q, x, stress, c.normal[i], f.damping * f.v0);
    if (!isfinite(x.w)) return false;
    w[i] = x.w;
    double v = f.v0 * exp(x.w);
    out[i] = v - f.plate_rate;
    out[n + i] = Evolution::rate(v / f.v0, x.w, x.s, f.v0 / c.dc[i]);
    if (two) out[2 * n + i] = Evolution::rate(v / f.v0, x.w, x.s2, f.v0 / c.dc2[i]);
    loading += stress;
    radiated += v * v;
    rubbed += (stress - f.damping * v) * v;
  }
  power[0] = f.plate_rate * f.cell * loading;
  power[1] = f.cell * rubbed;
  power[2] = f.damping * f.cell * radiated;
  return true;
}

}  // namespace

uint8_t fault_rates(const Fault *fault, const double *transferred, const double *y, double *w, double *out,
                    double *power) {
  return with_laws(fault->form, fault->evolution, [&](auto form, auto law) {
    return rates<decltype(form), decltype(law)>(*fault, transferred, y, w, out, power);
  });
}

void fault_trial(const Fault *fault, const FaultStep *step, int64_t stage) {
  int64_t size = (1 + fault->states) * fault->number;
  const double *weights = fault->weights + (stage - 1) * fault->len_weights;
  memcpy(step->trial, step->y, size * sizeof(double));
  for (int64_t j = 0; j < stage; ++j) {
    if (weights[j] == 0.0) continue;
    double factor = step->length * weights[j];
    const double *rate = step->stages + j * size;
    for (int64_t i = 0; i < size; ++i) step->trial[i] += factor * rate[i];
  }
}

uint8_t fault_stage(const Fault *fault, const FaultStep *step, int64_t stage, const double *transferred) {
  double *out = step->stages + stage * (1 + fault->states) * fault->number;
  if (!fault_rates(fault, transferred, step->trial, step->w, out, step->powers + 3 * stage)) return false;
  if (stage < fault->len_weights) fault_trial(fault, step, stage + 1);
  return true;
}

double fault_error(const Fault *fault, const FaultStep *step) {
  int64_t n = fault->number, rows = 1 + fault->states;
  const double *dc = fault->cells + 2 * n;
  double sum_five = 0.0, sum_three = 0.0;
  for (int64_t k = 0; k < rows * n; ++k) {
    double five = 0.0, three = 0.0, scale = k < n ? dc[k] : 1.0;
    for (int64_t j = 0; j <= fault->len_weights; ++j) {
      if (fault->five[j] == 0.0 && fault->three[j] == 0.0) continue;
      five += fault->five[j] * step->stages[j * rows * n + k];
      three += fault->three[j] * step->stages[j * rows * n + k];
    }
    sum_five += (five / scale) * (five / scale);
    sum_three += (three / scale) * (three / scale);
  }
  if (sum_five == 0.0) return 0.0;
  return fabs(step->length) * sum_five / sqrt((sum_five + 0.01 * sum_three) * (double)rows * (double)n);
}
