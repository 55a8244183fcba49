// build: -ffp-contract=fast
// Leapfrog of many vectors at once, see `solve.leapfrog`.
#include <string.h>

#include "core.h"
#include "vector.h"

constexpr int BLOCK = 3, LANES_AT_ONCE = 16, PARTS = LANES_AT_ONCE / (2 * W);
typedef float Floats __attribute__((vector_size(8 * W)));

struct Row {  // LANES_AT_ONCE numbers, in registers
  Floats part[PARTS];
};

static inline Row row_at(const float *from) {
  Row row;
  memcpy(&row, from, sizeof row);
  return row;
}

static inline void add(Row &row, float factor, const Row &other) {
  for (int p = 0; p < PARTS; p++) row.part[p] += factor * other.part[p];
}

// v[row] += Σ blocks[e] q[indices[e]] over e from first to last. Sums stay in registers.
static inline void add_block_row(int64_t first, int64_t last, const uint32_t *indices, const float *blocks,
                                 const float *q, float *v) {
  Row sums[BLOCK];
  memcpy(sums, v, sizeof sums);
  for (int64_t e = first; e < last; e++) {
    const float *from = q + indices[e] * (int64_t)(BLOCK * LANES_AT_ONCE), *block = blocks + e * (BLOCK * BLOCK);
    for (int c = 0; c < BLOCK; c++) {
      Row vector = row_at(from + c * LANES_AT_ONCE);
      for (int k = 0; k < BLOCK; k++) add(sums[k], block[k * BLOCK + c], vector);
    }
  }
  memcpy(v, sums, sizeof sums);
}

// q ← q + v, and signed sums of q by bucket.
static void move(int64_t rows, const int64_t *bucket, const float *signs, float *q, const float *v, float *sums) {
  for (int64_t i = 0; i < rows; i++) {
    Row now = row_at(q + i * LANES_AT_ONCE), sum = row_at(sums + bucket[i] * LANES_AT_ONCE);
    add(now, 1.0f, row_at(v + i * LANES_AT_ONCE)), add(sum, signs[i], now);
    memcpy(q + i * LANES_AT_ONCE, &now, sizeof now), memcpy(sums + bucket[i] * LANES_AT_ONCE, &sum, sizeof sum);
  }
}

void leapfrog(int64_t n, const int64_t *indptr, const uint32_t *indices, const float *blocks, const int64_t *bucket,
              const float *signs, float *q, float *v, int64_t steps, int64_t buckets, float *record) {
  for (int64_t t = 0; t < steps; t++) {
    for (int64_t i = 0; i < n; i++) {
      add_block_row(indptr[i], indptr[i + 1], indices, blocks, q, v + i * (BLOCK * LANES_AT_ONCE));
    }
    move(BLOCK * n, bucket, signs, q, v, record + t * buckets * LANES_AT_ONCE);
  }
}
