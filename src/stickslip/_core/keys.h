// Keys of pairs: (i, j, image) in one integer with the same order.
#pragma once
#include "core.h"

constexpr int64_t BODY_BITS = 21, IMAGE_BITS = ENTRY_IMAGE, IMAGE_OFFSET = 1 << (IMAGE_BITS - 1);  // see `core.fields`

inline int64_t pack_key(int64_t i, int64_t j, int64_t a, int64_t b, int64_t c) {
  constexpr int64_t BODIES = 1 << BODY_BITS, IMAGES = 1 << IMAGE_BITS;
  return (((i * BODIES + j) * IMAGES + a + IMAGE_OFFSET) * IMAGES + b + IMAGE_OFFSET) * IMAGES + c + IMAGE_OFFSET;
}

inline int64_t image_of(int64_t key, int k) {  // along vector k
  return (key >> IMAGE_BITS * (2 - k) & (2 * IMAGE_OFFSET - 1)) - IMAGE_OFFSET;
}

inline void insert_in_order(int64_t *key, int64_t count) {  // sorts a few keys
  for (int64_t c = 1; c < count; ++c) {
    const int64_t one = key[c];
    int64_t d = c;
    for (; d > 0 && key[d - 1] > one; --d) key[d] = key[d - 1];
    key[d] = one;
  }
}

struct Pairs {
  int64_t *key;
  int64_t *row;  // (N + 1,) first row of each grain
  int64_t grains, threads;
  bool too_far;
};
