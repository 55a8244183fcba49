// Neighbour list: its rows from the keys of all pairs, with the memory of the former list.
#include "keys.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

int64_t count_pairs(const Pairs *pairs) { return pairs->too_far ? -1 : pairs->row[pairs->grains]; }

void free_pairs(Pairs *pairs) {
  free(pairs->key);
  free(pairs->row);
  free(pairs);
}

namespace {

constexpr int64_t OPEN = 0;

// Row of a key in a list, or −1.
int64_t find_row(const Pairs &pairs, int64_t grain, int64_t key) {
  if (grain >= pairs.grains) return -1;
  int64_t low = pairs.row[grain], high = pairs.row[grain + 1];
  while (low < high) {
    const int64_t middle = (low + high) / 2;
    if (pairs.key[middle] < key)
      low = middle + 1;
    else
      high = middle;
  }
  return low < pairs.row[grain + 1] && pairs.key[low] == key ? low : -1;
}

void copy(double *to, int64_t row, const double *from, int64_t old_row, int64_t width) {
  memcpy(to + row * width, from + old_row * width, width * sizeof(double));
}

// Copies the memory of every closed contact that is in both lists, and that of rolling and of laws also of open ones.
void copy_memory(const Pairs &pairs, const Contacts &old, const Contacts &list) {
  const bool anchors = old.len_pair > 0 && list.len_pair > 0;
  const bool rolls = old.width_rolling && old.width_rolling == list.width_rolling;
  for (int64_t c = 0; c < old.count[0]; ++c) {
    if (old.mode[c] == OPEN && !rolls) continue;
    const int16_t *image = old.image + 3 * c;
    const int64_t row = find_row(pairs, old.i[c], pack_key(old.i[c], old.j[c], image[0], image[1], image[2]));
    if (row < 0) continue;
    if (rolls) copy(list.rolling, row, old.rolling, c, list.width_rolling);
    if (old.mode[c] == OPEN) continue;
    list.mode[row] = old.mode[c];
    list.reached[row] = old.reached[c];
    copy(list.slip, row, old.slip, c, 3);
    if (!anchors) continue;
    copy(list.pair, row, old.pair, c, 3);
    copy(list.roll, row, old.roll, c, 3);
  }
}

}  // namespace

void fill_list(const Pairs *pairs, const Contacts *old, const Contacts *list) {
  constexpr int64_t LOW = (1 << IMAGE_BITS) - 1, BODY = (1 << BODY_BITS) - 1;
  const int64_t count = pairs->row[pairs->grains];
  if (list->len_key > 0) memcpy(list->key, pairs->key, count * sizeof(int64_t));
  for (int64_t c = 0; c < count; ++c) {
    const int64_t key = pairs->key[c];
    list->i[c] = static_cast<int32_t>(key >> (BODY_BITS + 3 * IMAGE_BITS));
    list->j[c] = static_cast<int32_t>(key >> 3 * IMAGE_BITS & BODY);
    for (int64_t m = 0; m < 3; ++m)
      list->image[3 * c + m] = static_cast<int16_t>((key >> (2 - m) * IMAGE_BITS & LOW) - IMAGE_OFFSET);
  }
  copy_memory(*pairs, *old, *list);
}

double largest_displacement(const double *x, const double *origin, int64_t bodies) {
  double most = 0.0;
  for (int64_t a = 0; a < bodies; ++a) {
    const double dx = x[3 * a] - origin[3 * a], dy = x[3 * a + 1] - origin[3 * a + 1];
    const double dz = x[3 * a + 2] - origin[3 * a + 2], square = dx * dx + dy * dy + dz * dz;
    if (!(square <= most)) most = square < INFINITY ? square : INFINITY;
  }
  return sqrt(most);
}
