// Assignment of pairs to blocks, see blocks.h.
#include "blocks.h"
#include "threads.h"

namespace {

constexpr int64_t CLASSES = 8;  // of pairs: 0 if they touch, else by distance

struct Picked {  // a pair, and all that blocks need about it except its slip, so that the list is read only once
  int32_t row, bucket;
  uint32_t i, j;
  uint8_t mode, distance;  // as in blocks; class
  bool far;                // its block needs vectors
};

// Buckets hold pairs between a tile and later ones of the same thread, then pairs between threads or within the last
// tile, and finally pairs within each of the other tiles; each pair of materials has separate buckets, and so have walls.
struct Choice {
  Contacts list;
  Moving moving;
  const double *inverse_mass;
  const int64_t *material;
  const double *normal, *vectors, *across, *room;
  double gap;
  int64_t materials, bodies, grains, top, workers, kinds, buckets;  // tiles with the last one; buckets of a tile; all
  int32_t *place;    // (B,) of each body in memory
  int32_t *tile_of;  // (B,)
  int32_t *worker;   // (top,)
  int32_t *first;    // (B + 1,) first row of each body in the list, which is sorted by the first body of each pair
  int64_t *bound;    // (workers + 1,) bodies of each thread, in memory order
  int64_t *begin;    // (workers + 1,) first of the pairs picked by each thread
  int64_t *number;   // (workers,) of pairs picked
  Picked *picked;    // (C,)
  int32_t *turn;     // (C,) order in which pairs are put into blocks
  int32_t *slot;     // (C,) in blocks, or −1
  uint32_t *start;   // (workers, B + 2) loads of each body
  int64_t *filled;   // (workers, buckets) pairs of each thread and bucket, then the next slot
  int64_t *rank;     // (workers, CLASSES top + 1) for sorting
  int64_t *block;    // (buckets + 1,) first block of each bucket
};

void commit(const Blocks &blocks, const Contacts &list, int64_t part, int64_t parts) {
  for (int64_t s = blocks.count * part / parts * LANES; s < blocks.count * (part + 1) / parts * LANES; ++s) {
    const int64_t c = blocks.row.data[s], mode = blocks.mode.data[s];
    if (c < 0) continue;
    const double *slip = blocks.slip.data + 3 * (s - s % LANES) + s % LANES;
    for (int64_t m = 0; m < 3; ++m) list.slip[3 * c + m] = slip[m * LANES];
    list.mode[c] = static_cast<int8_t>(mode == STUCK_AGAIN ? STICK : mode == LOOSE ? SLIDE : mode);
    list.reached[c] = mode == SLIDE || mode == STUCK_AGAIN;
  }
}

bool prepare(Choice &s, Scratch &scratch) {
  const Moving &moving = s.moving;
  const int64_t rows = s.list.count[0];
  if (!scratch.take(s.place, s.bodies) || !scratch.take(s.tile_of, s.bodies) || !scratch.take(s.worker, s.top) ||
      !scratch.take(s.first, s.bodies + 1) || !scratch.take(s.bound, s.workers + 1) ||
      !scratch.take(s.begin, s.workers + 1) || !scratch.take(s.number, s.workers) || !scratch.take(s.picked, rows) ||
      !scratch.take(s.turn, rows) || !scratch.take(s.slot, rows) || !scratch.take(s.block, s.buckets + 1) ||
      !scratch.take_zeros(s.start, s.workers * (s.bodies + 2)) ||
      !scratch.take_zeros(s.filled, s.workers * s.buckets) ||
      !scratch.take_zeros(s.rank, s.workers * (CLASSES * s.top + 1)))
    return false;
  for (int64_t g = 0; g < s.bodies; ++g) s.place[moving.order[g]] = static_cast<int32_t>(g);
  for (int64_t t = 0; t < s.top; ++t) {
    const int64_t end = t + 1 < s.top ? moving.tile[t + 1] : s.bodies;
    for (int64_t g = moving.tile[t]; g < end; ++g) s.tile_of[g] = static_cast<int32_t>(t);
  }
  int64_t a = 0;
  for (int64_t c = 0; c < rows; ++c)
    while (a <= s.list.i[c]) s.first[a++] = static_cast<int32_t>(c);
  while (a <= s.bodies) s.first[a++] = static_cast<int32_t>(rows);
  s.worker[s.top - 1] = 0;
  s.begin[0] = 0;
  for (int64_t k = 0; k < s.workers; ++k) {
    for (int64_t t = moving.share[k]; t < moving.share[k + 1]; ++t) s.worker[t] = static_cast<int32_t>(k);
    s.bound[k] = moving.tile[moving.share[k]];
    s.bound[k + 1] = k + 1 < s.workers ? moving.tile[moving.share[k + 1]] : s.bodies;
    s.begin[k + 1] = s.begin[k];
    for (int64_t g = s.bound[k]; g < s.bound[k + 1]; ++g)
      s.begin[k + 1] += s.first[moving.order[g] + 1] - s.first[moving.order[g]];
  }
  return true;
}

// Class of an open pair, which increases with distance; `left` is the remaining part of `most`
uint8_t distance_class(double left, double most) {
  // bounded before it is converted, because without a skin `most` is zero and the quotient infinite
  const double part = (CLASSES - 1) * (left > 0.0 ? left : 0.0) / most;
  return static_cast<uint8_t>(CLASSES - 1 - static_cast<int64_t>(part < CLASSES - 2.0 ? part : CLASSES - 2.0));
}

uint8_t mode_in_blocks(int64_t mode, bool reached) {
  return static_cast<uint8_t>(mode == STICK && reached ? STUCK_AGAIN : mode == SLIDE && !reached ? LOOSE : mode);
}

// Picks all pairs that touch or may soon touch, for the first bodies of one thread
void pick_pairs(const Choice &s, int64_t part) {
  const Contacts list = s.list;
  const Moving moving = s.moving;
  const int64_t last = s.top - 1;
  const double *h = s.vectors;
  uint32_t *start = s.start + part * (s.bodies + 2);
  int64_t *held = s.filled + part * s.buckets;
  Picked *next = s.picked + s.begin[part];
  for (int64_t g = s.bound[part]; g < s.bound[part + 1]; ++g) {
    const int64_t a = moving.order[g];
    const double *x = moving.body + BODY * g;
    for (int64_t c = s.first[a]; c < s.first[a + 1]; ++c) {
      const int64_t z = list.j[c], o = s.place[z];
      const double *y = moving.body + BODY * o;
      const int16_t *image = list.image + 3 * c;
      const bool wall = z >= s.grains, moved = !wall && (image[0] | image[1] | image[2]);
      const double touch = x[RADIUS] + y[RADIUS], near = s.gap + s.room[g] + s.room[o] + touch;
      double dx = x[0] - y[0], dy = x[1] - y[1], dz = x[2] - y[2], square;
      if (wall) {
        const double *n = s.normal + 3 * (z - s.grains), height = dx * n[0] + dy * n[1] + dz * n[2];
        square = height < 0.0 ? 0.0 : height * height;
      } else {
        if (moved) {
          dx += image[0] * h[0] + image[1] * h[3] + image[2] * h[6];
          dy += image[0] * h[1] + image[1] * h[4] + image[2] * h[7];
          dz += image[0] * h[2] + image[1] * h[5] + image[2] * h[8];
        }
        square = dx * dx + dy * dy + dz * dz;
      }
      if (!(square < near * near) && list.mode[c] == OPEN) continue;
      const int64_t one = s.tile_of[g], two = s.tile_of[o], later = one < two ? two : one;
      int64_t group = one < two ? one : two;
      if (group == later && later < last)
        group += last + 1;
      else if (later < last && s.worker[group] != s.worker[later])
        group = last;
      const int64_t kind =
          s.materials == 1 ? group : (group * s.materials + s.material[a]) * s.materials + s.material[z];
      next->row = static_cast<int32_t>(c);
      next->bucket = static_cast<int32_t>(2 * kind + wall);
      next->i = static_cast<uint32_t>(g);
      next->j = static_cast<uint32_t>(o);
      next->mode = mode_in_blocks(list.mode[c], list.reached[c]);
      next->distance = next->mode ? 0 : distance_class(near * near - square, near * near - touch * touch);
      next->far = moved || wall;
      ++held[next->bucket];
      ++start[o + 2];
      ++start[g + 2];
      ++next;
    }
  }
  s.number[part] = next - (s.picked + s.begin[part]);
}

// Finds the blocks of each bucket, and the first slot of each thread in it
bool lay_out(const Choice &s, Blocks &blocks, bool by_size, bool by_mass) {
  s.block[0] = 0;
  for (int64_t k = 0; k < s.buckets; ++k) {
    int64_t slot = s.block[k] * LANES;
    for (int64_t w = 0; w < s.workers; ++w) {
      int64_t &filled = s.filled[w * s.buckets + k];
      const int64_t pairs = filled;
      filled = slot;
      slot += pairs;
    }
    s.block[k + 1] = (slot + LANES - 1) / LANES;
  }
  const int64_t count = s.block[s.buckets], slots = count * LANES;
  if (!grow(blocks.i, slots) || !grow(blocks.j, slots) || !grow(blocks.row, slots) ||
      !grow(blocks.material, 2 * count) || !grow(blocks.wall, count) || !grow(blocks.at, count) ||
      !grow(blocks.size, by_size ? slots : 0) || !grow(blocks.mass, by_mass ? slots : 0) ||
      !grow(blocks.slip, 3 * slots) || !grow(blocks.mode, slots) || !grow(blocks.place, count) ||
      !grow(blocks.cross, s.top + 1) || !grow(blocks.inner, s.top + 1))
    return false;
  for (int64_t t = 0; t <= s.top; ++t) {
    blocks.cross.data[t] = s.block[s.kinds * t];
    blocks.inner.data[t] = s.block[s.kinds * (s.top + t)];
  }
  for (int64_t b = 0; b < count; ++b) {
    blocks.at.data[b] = -1;
    blocks.material.data[2 * b] = blocks.material.data[2 * b + 1] = 0;
  }
  memset(s.slot, -1, s.list.count[0] * sizeof(int32_t));
  blocks.tiles = s.top - 1;
  return true;
}

// Sorts the pairs of one thread: those between its tiles by their last tile, after all others, and then by their class
void sort_picked(const Choice &s, int64_t part) {
  const Picked *picked = s.picked + s.begin[part], *end = picked + s.number[part];
  int64_t *first = s.rank + part * (CLASSES * s.top + 1);
  auto rank = [&s](const Picked &pair) {
    const int64_t one = s.tile_of[pair.i], two = s.tile_of[pair.j], last = one < two ? two : one;
    return pair.distance + (pair.bucket < (s.top - 1) * s.kinds ? CLASSES * last : 0);
  };
  for (const Picked *pair = picked; pair < end; ++pair) ++first[rank(*pair) + 1];
  for (int64_t t = 0; t < CLASSES * s.top; ++t) first[t + 1] += first[t];
  for (const Picked *pair = picked; pair < end; ++pair)
    s.turn[s.begin[part] + first[rank(*pair)]++] = static_cast<int32_t>(pair - picked);
}

// Writes the picked pairs of one thread to the lanes of their buckets' blocks, and marks blocks that need vectors
void fill_blocks(const Choice &s, const Blocks &blocks, bool by_size, bool by_mass, int64_t part) {
  const Picked *picked = s.picked + s.begin[part];
  const int32_t *turn = s.turn + s.begin[part];
  int64_t *filled = s.filled + part * s.buckets;
  for (int64_t k = 0; k < s.number[part]; ++k) {
    const Picked pair = picked[turn[k]];
    const bool wall = pair.bucket & 1;
    const int64_t slot = filled[pair.bucket]++, b = slot / LANES, a = s.moving.order[pair.i], z = s.moving.order[pair.j];
    blocks.i.data[slot] = pair.i;
    blocks.j.data[slot] = pair.j;
    blocks.row.data[slot] = pair.row;
    blocks.mode.data[slot] = pair.mode;
    blocks.wall.data[b] = wall;
    s.slot[pair.row] = static_cast<int32_t>(slot);
    if (s.materials > 1) {
      blocks.material.data[2 * b] = s.material[a];
      blocks.material.data[2 * b + 1] = s.material[z];
    }
    if (by_size) {
      const double one = s.moving.body[BODY * pair.i + RADIUS], two = s.moving.body[BODY * pair.j + RADIUS];
      blocks.size.data[slot] = wall ? one : one * two / (one + two);
    }
    if (by_mass) {
      const double inverse = s.inverse_mass[a] + s.inverse_mass[z];
      blocks.mass.data[slot] = inverse > 0.0 ? 1.0 / inverse : 0.0;
    }
    double *slip = blocks.slip.data + 3 * b * LANES + slot % LANES;
    for (int64_t m = 0; m < 3; ++m) slip[m * LANES] = s.list.slip[3 * pair.row + m];
    if (pair.far) blocks.at.data[b] = 0;
  }
}

// Fills unused lanes of a block with a body paired with itself; the pair's vector keeps it from touching
void pad_blocks(const Choice &s, const Blocks &blocks, bool by_size, bool by_mass) {
  for (int64_t k = 0; k < s.buckets; ++k) {
    for (int64_t slot = s.filled[(s.workers - 1) * s.buckets + k]; slot < s.block[k + 1] * LANES; ++slot) {
      const int64_t b = slot / LANES;
      blocks.at.data[b] = 0;
      blocks.i.data[slot] = blocks.j.data[slot] = static_cast<uint32_t>(blocks.wall.data[b] ? s.bodies - 1 : 0);
      blocks.row.data[slot] = -1;
      blocks.mode.data[slot] = OPEN;
      if (by_size) blocks.size.data[slot] = 1.0;
      if (by_mass) blocks.mass.data[slot] = 1.0;
      for (int64_t m = 0; m < 3; ++m) blocks.slip.data[(3 * b + m) * LANES + slot % LANES] = 0.0;
    }
  }
}

int64_t last_tile(const Choice &s, const Blocks &blocks, int64_t b, int64_t last) {
  for (int64_t slot = LANES * b; slot < LANES * (b + 1); ++slot)
    if (blocks.row.data[slot] >= 0) {
      const int64_t one = s.tile_of[blocks.i.data[slot]], two = s.tile_of[blocks.j.data[slot]];
      last = one > last ? one : last;
      last = two > last ? two : last;
    }
  return last;
}

// Assigns each block its first row of loads. Returns the number of rows, or −1 if there is no memory. Blocks of pairs
// between threads have separate rows. Tiles of a thread share rows for pairs within a tile. Rows for pairs between tiles
// are reused by another block as soon as the last of the tiles has summed them.
int64_t assign_load_rows(const Choice &s, const Blocks &blocks) {
  Scratch scratch;
  const int64_t *cross = blocks.cross.data, *inner = blocks.inner.data, *share = s.moving.share;
  int64_t rows = 0, *place = blocks.place.data, *following, *due, *given;
  if (!scratch.take(following, cross[s.top]) || !scratch.take(given, cross[s.top]) || !scratch.take(due, s.top))
    return -1;
  for (int64_t t = 0; t < s.top; ++t) due[t] = -1;
  for (int64_t b = cross[s.top - 1]; b < cross[s.top]; ++b, rows += LANES) place[b] = rows;
  for (int64_t k = 0; k < s.workers; ++k) {
    int64_t count = 0, largest = 0;
    for (int64_t t = share[k]; t < share[k + 1]; ++t) {
      for (int64_t b = cross[t]; b < cross[t + 1]; ++b) {
        place[b] = count ? given[--count] : rows;
        rows += place[b] == rows ? LANES : 0;
        const int64_t last = last_tile(s, blocks, b, t);
        following[b] = due[last];
        due[last] = b;
      }
      for (int64_t b = due[t]; b >= 0; b = following[b]) given[count++] = place[b];
      largest = inner[t + 1] - inner[t] > largest ? inner[t + 1] - inner[t] : largest;
    }
    for (int64_t t = share[k]; t < share[k + 1]; ++t)
      for (int64_t b = inner[t]; b < inner[t + 1]; ++b) place[b] = rows + (b - inner[t]) * LANES;
    rows += largest * LANES;
  }
  return rows;
}

// Replaces marks of blocks with the starts of their vectors. Returns the end of the last one
int64_t place_vectors(const Blocks &blocks, int64_t count) {
  int64_t end = 0;
  for (int64_t b = 0; b < count; ++b)
    if (blocks.at.data[b] >= 0) {
      blocks.at.data[b] = static_cast<int32_t>(end);
      end += 3 * LANES;
    }
  return end;
}

// Writes the vectors of all blocks that have them
void write_vectors(const Choice &s, const Blocks &blocks, int64_t count) {
  double far = 1.0 + s.gap;  // keeps a body from touching itself
  for (int64_t g = 0; g < s.bodies; ++g) {
    const double own = 4.0 * s.moving.body[BODY * g + RADIUS] + 1.0 + s.gap + 2.0 * s.room[g];
    far = own > far ? own : far;
  }
  for (int64_t b = 0; b < count; ++b) {
    if (blocks.at.data[b] < 0) continue;
    const bool wall = blocks.wall.data[b];
    for (int64_t l = 0; l < LANES; ++l) {
      const int64_t c = blocks.row.data[LANES * b + l];
      double *vector = blocks.vector.data + blocks.at.data[b] + l;
      for (int64_t m = 0; m < 3; ++m) {
        double value = 0.0;
        if (c < 0)
          value = wall || m ? 0.0 : far;
        else if (wall)
          value = s.normal[3 * (s.list.j[c] - s.grains) + m];
        else
          for (int64_t k = 0; k < 3; ++k) value += s.list.image[3 * c + k] * s.across[3 * k + m];
        vector[m * LANES] = value;
      }
    }
  }
}

// Sums the counts of loads over threads. Returns the number of codes
int64_t count_codes(const Choice &s, uint32_t *start) {
  int64_t codes = 0;
  for (int64_t a = 0; a < s.bodies + 2; ++a) {
    start[a] = 0;
    for (int64_t w = 0; w < s.workers; ++w) start[a] += s.start[w * (s.bodies + 2) + a];
    if (a > 1) codes += start[a] ? start[a] : 1;
  }
  return codes;
}

// Converts counts of loads to the loads that each body sums, in the order of partners. A body without loads gets the row
// `nothing`, so that it also has a first row
void write_summation_order(const Choice &s, const Blocks &blocks, int64_t nothing) {
  uint32_t *start = blocks.start.data, *code = blocks.code.data;
  const uint32_t row = ROW;
  for (int64_t g = 0; g < s.bodies; ++g) {
    const uint32_t held = start[g + 2];
    start[g + 2] = start[g + 1] + (held ? held : 1);
    if (!held) code[start[g + 1]++] = static_cast<uint32_t>(nothing) * row;
  }
  for (int64_t c = 0; c < s.list.count[0]; ++c) {
    const int64_t slot = s.slot[c];
    if (slot < 0) continue;
    const uint32_t load = static_cast<uint32_t>(blocks.place.data[slot / LANES] + slot % LANES) * row;
    // j before i, as a grain may touch its own image
    code[start[s.place[s.list.j[c]] + 1]++] = load;
    code[start[s.place[s.list.i[c]] + 1]++] = load + IS_I;
  }
  for (int64_t g = 0; g < s.bodies; ++g) code[start[g]] += IS_FIRST;
}

}  // namespace

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

void commit_blocks(const Blocks *blocks, const Contacts *contacts) { commit(*blocks, *contacts, 0, 1); }

uint8_t choose_blocks(Blocks *blocks, const Contacts *contacts, const Moving *moving, const double *inverse_mass,
                      const int64_t *material, const double *normal, int64_t walls, const double *vectors,
                      const double *across, const double *room, double gap, int64_t materials, uint8_t by_size,
                      uint8_t by_mass) {
  Scratch scratch;
  Blocks &b = *blocks;
  Choice s{};
  s.list = *contacts;
  s.moving = *moving;
  s.inverse_mass = inverse_mass;
  s.material = material;
  s.normal = normal;
  s.vectors = vectors;
  s.across = across;
  s.room = room;
  s.gap = gap;
  s.materials = materials;
  s.bodies = moving->len_order;
  s.grains = s.bodies - walls;
  s.top = moving->len_tile;
  s.workers = moving->len_share - 1;
  s.kinds = 2 * materials * materials;
  s.buckets = 2 * s.top * s.kinds;
  Pool pool(s.workers);
  pool.each(s.workers, [&](int64_t k) { commit(b, s.list, k, s.workers); });
  b.count = 0;
  if (!prepare(s, scratch)) return false;
  pool.each(s.workers, [&](int64_t k) { pick_pairs(s, k); });
  if (!lay_out(s, b, by_size, by_mass)) return false;
  pool.each(s.workers, [&](int64_t k) {
    sort_picked(s, k);
    fill_blocks(s, b, by_size, by_mass, k);
  });
  const int64_t count = s.block[s.buckets];
  pad_blocks(s, b, by_size, by_mass);
  const int64_t rows = assign_load_rows(s, b), numbers = place_vectors(b, count), frame = moving->len_virial > 0;
  if (rows < 0 || !grow(b.vector, numbers) || !grow(b.load, WIDTH * (rows + 1)) ||
      !grow(b.pair, frame * 3 * (rows + 1)) || !grow(b.start, s.bodies + 2))
    return false;
  write_vectors(s, b, count);
  memset(b.load.data + WIDTH * rows, 0, WIDTH * sizeof(double));
  if (!grow(b.code, count_codes(s, b.start.data) + PREFETCH_DISTANCE)) return false;
  write_summation_order(s, b, rows);
  b.count = count;
  return true;
}
