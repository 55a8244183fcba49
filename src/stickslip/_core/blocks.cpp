// Memory of blocks, see blocks.h.
#include "blocks.h"

Blocks *new_blocks(void) { return static_cast<Blocks *>(calloc(1, sizeof(Blocks))); }

void clear_blocks(Blocks *blocks) {
  Blocks &b = *blocks;
  release_all(b.i, b.j, b.row, b.material, b.wall, b.at, b.vector, b.size, b.mass, b.slip, b.mode, b.place, b.cross,
              b.inner, b.load, b.pair, b.start, b.code);
  b = Blocks{};
}

void free_blocks(Blocks *blocks) {
  clear_blocks(blocks);
  free(blocks);
}

void commit_part(const Blocks &blocks, const Contacts &list, int64_t part, int64_t parts) {
  const int64_t end = blocks.count * (part + 1) / parts * LANES, ahead = 16;
  for (int64_t s = blocks.count * part / parts * LANES; s < end; ++s) {
    const int64_t c = blocks.row.data[s], mode = blocks.mode.data[s];
    const int64_t next = s + ahead < end ? blocks.row.data[s + ahead] : -1;
    if (next >= 0) __builtin_prefetch(list.slip + 3 * next, 1);
    if (c < 0) continue;
    const double *slip = blocks.slip.data + 3 * (s - s % LANES) + s % LANES;
    for (int64_t m = 0; m < 3; ++m) list.slip[3 * c + m] = slip[m * LANES];
    list.mode[c] = static_cast<int8_t>(mode == STUCK_AGAIN ? STICK : mode == LOOSE ? SLIDE : mode);
    list.reached[c] = mode == SLIDE || mode == STUCK_AGAIN;
  }
}

void commit_blocks(const Blocks *blocks, const Contacts *contacts) { commit_part(*blocks, *contacts, 0, 1); }
