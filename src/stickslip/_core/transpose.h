// Transposition between rows of bodies and planes of lanes, four at a time; compilers move one number at a time instead,
// which takes longer than evaluating the contact law.
#pragma once
#include "evaluate.h"

typedef double Four __attribute__((vector_size(32)));
typedef int64_t Four64 __attribute__((vector_size(32)));

#if defined(__clang__)
#define SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define SHUFFLE(a, b, ...) __builtin_shuffle(a, b, Four64{__VA_ARGS__})
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

inline void transpose(Four rows[4]) {
  Four low = SHUFFLE(rows[0], rows[1], 0, 4, 2, 6), high = SHUFFLE(rows[0], rows[1], 1, 5, 3, 7);
  Four low_two = SHUFFLE(rows[2], rows[3], 0, 4, 2, 6), high_two = SHUFFLE(rows[2], rows[3], 1, 5, 3, 7);
  rows[0] = SHUFFLE(low, low_two, 0, 1, 4, 5);
  rows[1] = SHUFFLE(high, high_two, 0, 1, 4, 5);
  rows[2] = SHUFFLE(low, low_two, 2, 3, 6, 7);
  rows[3] = SHUFFLE(high, high_two, 2, 3, 6, 7);
}

// x_i − x_j and R_i + R_j of the pairs of a block.
template <int DIM>
inline void gather_positions(int64_t used, const uint32_t *i, const uint32_t *j, const double *body, double *scratch) {
  const Four sign = {1.0, 1.0, 1.0, -1.0};
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
