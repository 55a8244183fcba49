// Stress due to slip, by fast Fourier transforms.
//
// A number j = c + columns × r of L = rows × columns stands in row r and column c. Columns are transformed, multiplied by
// the roots that both directions share, and transposed, so that all loops run along contiguous numbers. Frequencies stay
// in the order of reversed bits, in which the product with the symbol is taken.
#include <string.h>
#include "core.h"

namespace {

struct Table {
  double *re, *im;
  Table at(int64_t k) const { return {re + k, im + k}; }
};

// Sum and difference of two rows; the difference is multiplied by a root.
inline void split(Table a, Table b, int64_t columns, double cosine, double sine) {
  double *__restrict re = a.re, *__restrict im = a.im, *__restrict far_re = b.re, *__restrict far_im = b.im;
  for (int64_t c = 0; c < columns; ++c) {
    double x = re[c] - far_re[c], y = im[c] - far_im[c];
    re[c] += far_re[c];
    im[c] += far_im[c];
    far_re[c] = x * cosine - y * sine;
    far_im[c] = x * sine + y * cosine;
  }
}

// Inverse of `split`, except for a factor of 2.
inline void merge(Table a, Table b, int64_t columns, double cosine, double sine) {
  double *__restrict re = a.re, *__restrict im = a.im, *__restrict far_re = b.re, *__restrict far_im = b.im;
  for (int64_t c = 0; c < columns; ++c) {
    double x = far_re[c] * cosine + far_im[c] * sine, y = far_im[c] * cosine - far_re[c] * sine;
    far_re[c] = re[c] - x;
    far_im[c] = im[c] - y;
    re[c] += x;
    im[c] += y;
  }
}

// Transform of each column, or its inverse times the number of rows.
template <bool INVERSE>
void transform(const Transfer &t, Table a, int64_t rows, int64_t columns) {
  int64_t most = t.rows > t.columns ? t.rows : t.columns;
  const double *cosine = t.roots, *sine = t.roots + most;
  for (int64_t done = 1; done < rows; done *= 2) {
    int64_t half = INVERSE ? done : rows / (2 * done), stride = most / (2 * half);
    for (int64_t start = 0; start < rows; start += 2 * half)
      for (int64_t j = 0; j < half; ++j) {
        Table near = a.at((start + j) * columns), far = near.at(half * columns);
        (INVERSE ? merge : split)(near, far, columns, cosine[j * stride], sine[j * stride]);
      }
  }
}

// Transposes a table (rows, columns), and multiplies it by the roots of its positions, before or after.
template <bool INVERSE>
void transpose(const Transfer &t, Table from, Table to) {
  int64_t length = t.rows * t.columns;
  const double *cosine = t.turns, *sine = t.turns + length;
  for (int64_t r = 0; r < t.rows; ++r)
    for (int64_t c = 0; c < t.columns; ++c) {
      int64_t k = r * t.columns + c, turned = c * t.rows + r;
      if constexpr (INVERSE) {
        to.re[k] = from.re[turned] * cosine[k] + from.im[turned] * sine[k];
        to.im[k] = from.im[turned] * cosine[k] - from.re[turned] * sine[k];
      } else {
        to.re[turned] = from.re[k] * cosine[k] - from.im[k] * sine[k];
        to.im[turned] = from.re[k] * sine[k] + from.im[k] * cosine[k];
      }
    }
}

void multiply(const Transfer &t, Table a) {
  int64_t length = t.rows * t.columns;
  const double *symbol = t.symbol;
  if (!t.reflected) {
    for (int64_t k = 0; k < length; ++k) {
      a.re[k] *= symbol[k];
      a.im[k] *= symbol[k];
    }
    return;
  }
  const double *re = t.reflected, *im = t.reflected + length;
  for (int64_t k = 0; k < length; ++k) {
    double x = a.re[k], y = a.im[k];
    a.re[k] = symbol[k] * x + re[k] * x + im[k] * y;
    a.im[k] = symbol[k] * y + im[k] * x - re[k] * y;
  }
}

}  // namespace

void fault_stress(const Transfer *transfer, const double *slip, double *stress) {
  const Transfer &t = *transfer;
  int64_t n = t.number, length = t.rows * t.columns;
  const double *cosine = t.phases, *sine = t.phases + n;
  Table a = {t.work, t.work + length}, b = {t.work + 2 * length, t.work + 3 * length};
  for (int64_t j = 0; j < n; ++j) {
    a.re[j] = slip[j] * cosine[j];
    a.im[j] = slip[j] * sine[j];
  }
  memset(a.re + n, 0, (length - n) * sizeof(double));
  memset(a.im + n, 0, (length - n) * sizeof(double));
  transform<false>(t, a, t.rows, t.columns);
  transpose<false>(t, a, b);
  transform<false>(t, b, t.columns, t.rows);
  multiply(t, b);
  transform<true>(t, b, t.columns, t.rows);
  transpose<true>(t, b, a);
  transform<true>(t, a, t.rows, t.columns);
  for (int64_t j = 0; j < n; ++j) stress[j] = a.re[j] * cosine[j] + a.im[j] * sine[j];
}
