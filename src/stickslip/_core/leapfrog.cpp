// build: -ffp-contract=fast
// Leapfrog of many vectors at once (see `solve.probes`), and sums of fronts (see `solve.linear`).
#include <string.h>

#include "core.h"
#include "vector.h"

constexpr int64_t BLOCK = 3, VECTORS_AT_ONCE = 16;
typedef float Floats __attribute__((vector_size(8 * W)));
constexpr int64_t WIDE = 2 * W;  // numbers in a register

static inline Floats load(const float *from) {
  Floats value;
  memcpy(&value, from, sizeof value);
  return value;
}

static inline void store(float *to, Floats value) { memcpy(to, &value, sizeof value); }

// v += Σ blocks[e] q[indices[e]] over e from first to last, for a register of vectors. Sums stay in registers.
static inline void add_block_row(int64_t first, int64_t last, const uint32_t *indices, const float *blocks,
                                 const float *q, float *v) {
  constexpr int64_t ROW = VECTORS_AT_ONCE;
  Floats a = load(v), b = load(v + ROW), c = load(v + 2 * ROW);
  for (int64_t e = first; e < last; e++) {
    const float *from = q + indices[e] * BLOCK * ROW, *m = blocks + e * BLOCK * BLOCK;
    Floats x = load(from), y = load(from + ROW), z = load(from + 2 * ROW);
    a += m[0] * x, b += m[3] * x, c += m[6] * x;
    a += m[1] * y, b += m[4] * y, c += m[7] * y;
    a += m[2] * z, b += m[5] * z, c += m[8] * z;
  }
  store(v, a), store(v + ROW, b), store(v + 2 * ROW, c);
}

// q ← q + v, and signed sums of q by bucket.
static void move(int64_t rows, const int64_t *bucket, const float *signs, float *q, const float *v, float *sums) {
  for (int64_t i = 0; i < rows; i++) {
    for (int64_t k = 0; k < VECTORS_AT_ONCE; k += WIDE) {
      float *here = q + i * VECTORS_AT_ONCE + k, *sum = sums + bucket[i] * VECTORS_AT_ONCE + k;
      Floats now = load(here) + load(v + i * VECTORS_AT_ONCE + k);
      store(here, now), store(sum, load(sum) + signs[i] * now);
    }
  }
}

// Adds weights · q to the filtered sums; row i takes the vector lane[i] of q for each sum.
static void filter(int64_t rows, const int64_t *lane, const float *weights, const float *q, float *filtered) {
  for (int64_t i = 0; i < rows; i++) {
    const float *from = q + i * VECTORS_AT_ONCE;
    float *sum = filtered + i * VECTORS_AT_ONCE;
    for (int64_t k = 0; k < VECTORS_AT_ONCE; k++) sum[k] += weights[k] * from[lane[k]];
  }
}

void leapfrog(int64_t n, const int64_t *indptr, const uint32_t *indices, const float *blocks,
              const int64_t *damper_indptr, const uint32_t *damper_indices, const float *damper_blocks,
              double now, double before, const int64_t *bucket, const float *signs, float *q, float *v,
              float *previous, float *drawn, int64_t steps, int64_t buckets, float *record, const int64_t *lane,
              const float *weights, float *filtered) {
  for (int64_t t = 0; t < steps; t++) {
    for (int64_t i = 0; previous && i < BLOCK * n * VECTORS_AT_ONCE; i++) {
      drawn[i] = float(now) * v[i] + float(before) * previous[i];
      previous[i] = v[i];
    }
    for (int64_t i = 0; i < n; i++) {
      for (int64_t k = 0; k < VECTORS_AT_ONCE; k += WIDE) {
        float *to = v + i * BLOCK * VECTORS_AT_ONCE + k;
        add_block_row(indptr[i], indptr[i + 1], indices, blocks, q + k, to);
        if (previous) {
          add_block_row(damper_indptr[i], damper_indptr[i + 1], damper_indices, damper_blocks, drawn + k, to);
        }
      }
    }
    move(BLOCK * n, bucket, signs, q, v, record + t * buckets * VECTORS_AT_ONCE);
    if (filtered) filter(BLOCK * n, lane, weights + t * VECTORS_AT_ONCE, q, filtered);
  }
}

void extend_add(int64_t m, int64_t width, const int64_t *places, const double *part, int64_t rows, double *front) {
  for (int64_t k = 0; k < m; k++) {
    double *column = front + places[k] * rows * width;
    const double *from = part + k * m * width;
    for (int64_t i = 0; i < m; i++) {
      for (int64_t c = 0; c < width; c++) column[places[i] * width + c] += from[i * width + c];
    }
  }
}
