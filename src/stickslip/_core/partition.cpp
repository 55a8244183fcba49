// Assignment of pairs to blocks (see blocks.h); memory of blocks; copies of bodies and contacts between the state and memory
// order; displacement limits of the blocks.
#include <math.h>

#include "blocks.h"
#include "laws.h"
#include "threads.h"

namespace {

constexpr int64_t CLASSES = 8;  // classes of pairs: 0 if they touch, else by distance
constexpr int64_t AHEAD = 16;   // distance of prefetches, in bodies or pairs

struct Turn {
  int32_t pair, bucket;
};

struct Picked {  // a pair, with all data for blocks except its slip, so that the list is read only once
  int32_t row, bucket, rank;
  uint32_t i, j;
  uint8_t mode;  // as in blocks
  bool far;      // its block needs vectors
};

// Buckets hold pairs between a tile and later ones of the same thread or the last one, then pairs between threads or
// within the last tile, and finally pairs within each of the other tiles. Each pair of materials has separate buckets,
// and so have walls.
struct Choice {
  Blocks &blocks;
  const Law &law;
  const Contacts list;
  const Moving moving;
  const double *const inverse_mass;
  const int64_t *const material;
  const double *const normal, *const vectors, *const across, *const room;
  const double gap;
  const int64_t materials, bodies, grains;
  const int64_t top;      // tiles, the last one included
  const int64_t workers;  // threads
  const int64_t kinds;    // buckets of a tile
  const int64_t buckets;
  int32_t *place = nullptr;    // (B,) of each body in memory
  int32_t *tile_of = nullptr;  // (B,)
  int32_t *worker = nullptr;   // (top,) thread of each tile
  int32_t *first = nullptr;    // (B + 1,) first row of each body in the list, which is sorted by first bodies
  int64_t *bound = nullptr;    // (workers + 1,) bounds of the bodies of each thread, in memory order
  int64_t *begin = nullptr;    // (workers + 1,) bounds of the pairs of each thread in `picked`, not necessarily filled
  int64_t *number = nullptr;   // (workers,) of picked pairs
  Picked *picked = nullptr;    // (C,)
  int64_t *rank = nullptr;     // (workers, CLASSES top + 1) pairs of each rank, then the next place
  Turn *turn = nullptr;        // (C,) picked pairs in the order of their ranks
  int64_t *filled = nullptr;   // (workers, buckets) pairs of each bucket, then the next slot
  int64_t *block = nullptr;    // (buckets + 1,) first block of each bucket
  int32_t *slot = nullptr;     // (C,) place in blocks, or −1
  uint32_t *start = nullptr;   // (workers, B) loads of each body from a part of the list, then the next place
  double *far = nullptr;       // (workers,) distance that no pair can bridge
};

template <class T>
T larger(T a, T b) {
  return b > a ? b : a;
}

bool take_memory(Choice &s, Scratch &scratch) {
  const int64_t rows = s.list.count[0];
  return scratch.take(s.place, s.bodies) && scratch.take(s.tile_of, s.bodies) && scratch.take(s.worker, s.top) &&
         scratch.take(s.first, s.bodies + 1) && scratch.take(s.bound, s.workers + 1) &&
         scratch.take(s.begin, s.workers + 1) && scratch.take(s.number, s.workers) && scratch.take(s.picked, rows) &&
         scratch.take_zeros(s.rank, s.workers * (CLASSES * s.top + 1)) && scratch.take(s.turn, rows) &&
         scratch.take_zeros(s.filled, s.workers * s.buckets) && scratch.take(s.block, s.buckets + 1) &&
         scratch.take(s.slot, rows) && scratch.take_zeros(s.start, s.workers * s.bodies) &&
         scratch.take(s.far, s.workers);
}

// Finds the places, tiles, threads and rows of all bodies
void index_bodies(const Choice &s) {
  const int64_t *order = s.moving.order, *tile = s.moving.tile, *share = s.moving.share, rows = s.list.count[0];
  for (int64_t g = 0; g < s.bodies; ++g) s.place[order[g]] = static_cast<int32_t>(g);
  for (int64_t t = 0; t < s.top; ++t)
    for (int64_t g = tile[t]; g < (t + 1 < s.top ? tile[t + 1] : s.bodies); ++g) s.tile_of[g] = static_cast<int32_t>(t);
  int64_t a = 0;
  for (int64_t c = 0; c < rows; ++c)
    while (a <= s.list.i[c]) s.first[a++] = static_cast<int32_t>(c);
  while (a <= s.bodies) s.first[a++] = static_cast<int32_t>(rows);
  s.worker[s.top - 1] = 0;
  s.begin[0] = s.bound[0] = 0;
  for (int64_t k = 0; k < s.workers; ++k) {
    for (int64_t t = share[k]; t < share[k + 1]; ++t) s.worker[t] = static_cast<int32_t>(k);
    s.bound[k + 1] = k + 1 < s.workers ? tile[share[k + 1]] : s.bodies;
    s.begin[k + 1] = s.begin[k];
    for (int64_t g = s.bound[k]; g < s.bound[k + 1]; ++g) s.begin[k + 1] += s.first[order[g] + 1] - s.first[order[g]];
  }
}

// Squared distance of the bodies at places g and h, or of body g from a wall; none behind it
double square_of_distance(const Choice &s, int64_t c, int64_t wall, int64_t g, int64_t h) {
  const double *x = s.moving.body + BODY * g, *y = s.moving.body + BODY * h, *v = s.vectors;
  double dx = x[0] - y[0], dy = x[1] - y[1], dz = x[2] - y[2];
  if (wall >= 0) {
    const double *n = s.normal + 3 * wall, height = dx * n[0] + dy * n[1] + dz * n[2];
    return height < 0.0 ? 0.0 : height * height;
  }
  const int16_t *image = s.list.image + 3 * c;
  if (image[0] | image[1] | image[2]) {
    dx += image[0] * v[0] + image[1] * v[3] + image[2] * v[6];
    dy += image[0] * v[1] + image[1] * v[4] + image[2] * v[7];
    dz += image[0] * v[2] + image[1] * v[5] + image[2] * v[8];
  }
  return dx * dx + dy * dy + dz * dz;
}

// Class of an open pair, which increases with distance; `left` is the remaining part of `most`
int32_t distance_class(double left, double most) {
  // bounded before it is converted, because without a skin `most` is zero and the quotient infinite
  const double part = (CLASSES - 1) * (left > 0.0 ? left : 0.0) / most;
  return static_cast<int32_t>(CLASSES - 1) - static_cast<int32_t>(part < CLASSES - 2.0 ? part : CLASSES - 2.0);
}

// Picks all pairs that touch or may soon touch and whose first body is one of a thread's. Pairs between tiles of the
// thread are ranked by their last tile, and then, like all others, by their class.
void pick_pairs(const Choice s, int64_t part) {
  const int64_t last = s.top - 1;
  int64_t *held = s.filled + part * s.buckets, *ranked = s.rank + part * (CLASSES * s.top + 1);
  Picked *next = s.picked + s.begin[part];
  double far = 1.0 + s.gap;
  for (int64_t g = s.bound[part]; g < s.bound[part + 1]; ++g) {
    const int64_t a = s.moving.order[g];
    const double radius = s.moving.body[BODY * g + RADIUS], beyond = 4.0 * radius + 1.0 + s.gap + 2.0 * s.room[g];
    far = larger(far, beyond);
    const int64_t row = s.first[s.moving.order[g + AHEAD < s.bodies ? g + AHEAD : g]];
    __builtin_prefetch(s.list.j + row);
    __builtin_prefetch(s.list.image + 3 * row);
    __builtin_prefetch(s.list.mode + row);
    __builtin_prefetch(s.list.reached + row);
    for (int64_t c = s.first[a]; c < s.first[a + 1]; ++c) {
      const int64_t z = s.list.j[c], h = s.place[z];
      const int8_t mode = s.list.mode[c];
      const bool wall = z >= s.grains, reached = s.list.reached[c];
      const double touch = radius + s.moving.body[BODY * h + RADIUS], near = s.gap + s.room[g] + s.room[h] + touch;
      const double square = square_of_distance(s, c, wall ? z - s.grains : -1, g, h);
      if (!(square < near * near) && mode == OPEN) continue;
      const int64_t later = larger(s.tile_of[g], s.tile_of[h]), sooner = s.tile_of[g] + s.tile_of[h] - later;
      const bool within = sooner == later && later < last, shared = later < last && s.worker[sooner] != s.worker[later];
      const int64_t group = within ? sooner + s.top : shared ? last : sooner;
      const int64_t kind = s.materials == 1 ? 0 : s.material[a] * s.materials + s.material[z];
      next->row = static_cast<int32_t>(c);
      next->bucket = static_cast<int32_t>(s.kinds * group + 2 * kind + wall);
      next->i = static_cast<uint32_t>(g);
      next->j = static_cast<uint32_t>(h);
      next->mode = static_cast<uint8_t>(mode == STICK && reached ? STUCK_AGAIN : mode);
      if (mode == SLIDE && !reached) next->mode = LOOSE;
      next->rank = next->mode ? 0 : distance_class(near * near - square, near * near - touch * touch);
      if (group < last) next->rank += static_cast<int32_t>(CLASSES * later);
      next->far = wall || s.list.image[3 * c] || s.list.image[3 * c + 1] || s.list.image[3 * c + 2];
      ++held[next->bucket];
      ++ranked[next->rank + 1];
      ++next;
    }
  }
  s.number[part] = next - (s.picked + s.begin[part]);
  s.far[part] = far;
}

// Finds the blocks of each bucket and the first slot of each thread in it
void lay_out(const Choice &s) {
  s.block[0] = 0;
  for (int64_t k = 0; k < s.buckets; ++k) {
    int64_t slot = s.block[k] * LANES;
    for (int64_t w = 0; w < s.workers; ++w) {
      const int64_t pairs = s.filled[w * s.buckets + k];
      s.filled[w * s.buckets + k] = slot;
      slot += pairs;
    }
    s.block[k + 1] = (slot + LANES - 1) / LANES;
  }
}

bool grow_blocks(const Choice &s, int64_t count) {
  Blocks &b = s.blocks;
  const int64_t slots = count * LANES;
  return grow(b.i, slots) && grow(b.j, slots) && grow(b.row, slots) && grow(b.material, 2 * count) &&
         grow(b.used, count) && grow(b.wall, count) && grow(b.at, count) && grow(b.size, needs_radius(s.law) ? slots : 0) &&
         grow(b.mass, needs_mass(s.law) ? slots : 0) && grow(b.slip, 3 * slots) &&
         grow(b.turn, b.turns ? TURNS * slots : 0) && grow(b.memory, b.own * slots) && grow(b.mode, slots) &&
         grow(b.place, count) && grow(b.cross, s.top + 1) && grow(b.inner, s.top + 1) && grow(b.start, s.bodies + 1);
}

// Sorts the pairs of one thread by rank, and writes their numbers to their slots in `row`
void sort_picked(const Choice &s, int64_t part) {
  int64_t *first = s.rank + part * (CLASSES * s.top + 1), *filled = s.filled + part * s.buckets;
  const int64_t begin = s.begin[part], end = begin + s.number[part];
  first[0] = begin;
  for (int64_t t = 0; t < CLASSES * s.top; ++t) first[t + 1] += first[t];
  for (int64_t p = begin; p < end; ++p)
    s.turn[first[s.picked[p].rank]++] = {static_cast<int32_t>(p), s.picked[p].bucket};
  for (int64_t k = begin; k < end; ++k) s.blocks.row.data[filled[s.turn[k].bucket]++] = s.turn[k].pair;
}

// Writes the picked pairs of a block to its lanes. Other lanes hold a body paired with itself; the vector of that pair
// keeps it from touching.
void fill_block(const Choice &s, int64_t b) {
  const Blocks &blocks = s.blocks;
  int32_t *row = blocks.row.data + LANES * b;
  const Picked one = s.picked[row[0]];
  const bool wall = one.bucket & 1;
  const uint32_t any = wall ? static_cast<uint32_t>(s.bodies - 1) : one.i;  // no other thread moves it
  bool far = false;
  int32_t used = 0;
  for (int32_t l = 0; l < LANES; ++l) {
    const int64_t slot = LANES * b + l, next = l + AHEAD < LANES ? row[l + AHEAD] : -1;
    if (next >= 0) __builtin_prefetch(s.list.slip + 3 * s.picked[next].row);
    const bool real = row[l] >= 0;
    const Picked pair = real ? s.picked[row[l]] : Picked{-1, 0, 0, any, any, OPEN, true};
    row[l] = pair.row;
    blocks.i.data[slot] = pair.i;
    blocks.j.data[slot] = pair.j;
    blocks.mode.data[slot] = pair.mode;
    far |= pair.far;
    if (real) used = (l / MOST_LANES + 1) * MOST_LANES;
    if (real) s.slot[pair.row] = static_cast<int32_t>(slot);
    if (needs_radius(s.law)) {
      const double r = s.moving.body[BODY * pair.i + RADIUS], other = s.moving.body[BODY * pair.j + RADIUS];
      blocks.size.data[slot] = !real ? 1.0 : wall ? r : r * other / (r + other);
    }
    if (needs_mass(s.law)) {
      const double inverse = s.inverse_mass[s.moving.order[pair.i]] + s.inverse_mass[s.moving.order[pair.j]];
      blocks.mass.data[slot] = !real ? 1.0 : inverse > 0.0 ? 1.0 / inverse : 0.0;
    }
    for (int64_t m = 0; m < 3; ++m)
      blocks.slip.data[(3 * b + m) * LANES + l] = real ? s.list.slip[3 * pair.row + m] : 0.0;
    const bool closed = real && pair.mode != OPEN;
    const double *own = closed ? s.list.rolling + s.list.width_rolling * pair.row : nullptr;
    for (int64_t m = 0; m < blocks.own; ++m)
      blocks.memory.data[blocks.own * slot + m] = closed ? own[blocks.at_own + m] : s.law.memory[m];
    if (blocks.turns) {
      double *turn = blocks.turn.data + TURNS * LANES * b + l;
      const bool twists = blocks.turns > TWIST;
      for (int64_t m = 0; m < 3; ++m) turn[m * LANES] = closed ? own[m] : 0.0;
      turn[CAPPED * LANES] = closed ? own[AT_CAP] : 0.0;
      turn[TWISTED * LANES] = closed && twists ? own[TWIST] : 0.0;
      turn[TWIST_CAPPED * LANES] = closed && twists ? own[TWIST_AT_CAP] : 0.0;
    }
  }
  blocks.used.data[b] = used;
  blocks.wall.data[b] = wall;
  blocks.at.data[b] = far ? 0 : -1;
  blocks.material.data[2 * b] = s.materials > 1 ? s.material[s.moving.order[one.i]] : 0;
  blocks.material.data[2 * b + 1] = s.materials > 1 ? s.material[s.moving.order[one.j]] : 0;
}

// Assigns each block its first row of loads. Returns the number of rows, or −1 if memory runs out. Blocks of pairs
// between threads have separate rows. Tiles of a thread share rows for pairs within a tile. Rows for pairs between
// tiles are reused by another block as soon as the last of the tiles has summed them.
int64_t assign_load_rows(const Choice &s) {
  const int64_t *cross = s.blocks.cross.data, *inner = s.blocks.inner.data, *share = s.moving.share;
  int64_t rows = 0, *place = s.blocks.place.data, *following, *due, *given;
  Scratch scratch;
  if (!scratch.take(following, cross[s.top]) || !scratch.take(given, cross[s.top]) || !scratch.take(due, s.top))
    return -1;
  for (int64_t t = 0; t < s.top; ++t) due[t] = -1;
  for (int64_t b = cross[s.top - 1]; b < cross[s.top]; ++b, rows += LANES) place[b] = rows;
  for (int64_t k = 0; k < s.workers; ++k) {
    int64_t count = 0, most = 0;
    for (int64_t t = share[k]; t < share[k + 1]; ++t) {
      for (int64_t b = cross[t]; b < cross[t + 1]; ++b) {
        place[b] = count ? given[--count] : rows;
        rows = larger(rows, place[b] + LANES);
        int32_t last = 0;
        for (int64_t slot = LANES * b; slot < LANES * (b + 1) && s.blocks.row.data[slot] >= 0; ++slot)
          last = larger(last, larger(s.tile_of[s.blocks.i.data[slot]], s.tile_of[s.blocks.j.data[slot]]));
        following[b] = due[last];
        due[last] = b;
      }
      for (int64_t b = due[t]; b >= 0; b = following[b]) given[count++] = place[b];
      most = larger(most, inner[t + 1] - inner[t]);
    }
    for (int64_t t = share[k]; t < share[k + 1]; ++t)
      for (int64_t b = inner[t]; b < inner[t + 1]; ++b) place[b] = rows + (b - inner[t]) * LANES;
    rows += most * LANES;
  }
  return rows;
}

// Replaces marks of blocks with the starts of their vectors. Returns the end of the last one
int64_t place_vectors(const Choice &s) {
  int64_t end = 0;
  for (int64_t b = 0; b < s.block[s.buckets]; ++b)
    if (s.blocks.at.data[b] >= 0) {
      s.blocks.at.data[b] = static_cast<int32_t>(end);
      end += 3 * LANES;
    }
  return end;
}

// Writes the vectors of a block, if it has them
void write_vectors(const Choice &s, double far, int64_t b) {
  if (s.blocks.at.data[b] < 0) return;
  const bool wall = s.blocks.wall.data[b];
  for (int64_t l = 0; l < LANES; ++l) {
    const int64_t c = s.blocks.row.data[LANES * b + l];
    for (int64_t m = 0; m < 3; ++m) {
      double value = 0.0;
      if (c < 0)
        value = wall || m ? 0.0 : far;
      else if (wall)
        value = s.normal[3 * (s.list.j[c] - s.grains) + m];
      else
        for (int64_t k = 0; k < 3; ++k) value += s.list.image[3 * c + k] * s.across[3 * k + m];
      s.blocks.vector.data[s.blocks.at.data[b] + m * LANES + l] = value;
    }
  }
}

// Calls use(c, slot) for all pairs in blocks from a part of the list
template <class Use>
void each_pair(const Choice &s, int64_t part, const Use &use) {
  const int64_t rows = s.list.count[0];
  for (int64_t c = rows * part / s.workers; c < rows * (part + 1) / s.workers; ++c)
    if (s.slot[c] >= 0) use(c, s.slot[c]);
}

void count_loads(const Choice &s, int64_t part) {
  uint32_t *start = s.start + part * s.bodies;
  each_pair(s, part, [&](int64_t c, int64_t) {
    ++start[s.place[s.list.i[c]]];
    ++start[s.place[s.list.j[c]]];
  });
}

// Converts counts to places in `code`. A body without loads gets the row `nothing`, so it also has a first row
void place_loads(const Choice &s, int64_t nothing) {
  uint32_t next = 0, *bound = s.blocks.start.data;
  for (int64_t g = 0; g < s.bodies; ++g) {
    bound[g] = next;
    for (int64_t w = 0; w < s.workers; ++w) {
      const uint32_t held = s.start[w * s.bodies + g];
      s.start[w * s.bodies + g] = next;
      next += held;
    }
    if (next == bound[g]) s.blocks.code.data[next++] = static_cast<uint32_t>(nothing) * ROW;
  }
  bound[s.bodies] = next;
}

// Writes the loads that each body sums, in the order of partners
void write_summation_order(const Choice &s, int64_t part) {
  uint32_t *start = s.start + part * s.bodies, *code = s.blocks.code.data;
  each_pair(s, part, [&](int64_t c, int64_t slot) {
    const uint32_t load = static_cast<uint32_t>(s.blocks.place.data[slot / LANES] + slot % LANES) * ROW;
    code[start[s.place[s.list.j[c]]]++] = load;  // before the next line, as a grain may touch its own image
    code[start[s.place[s.list.i[c]]]++] = load + IS_I;
  });
}

// Calls use(b) for part of the blocks
template <class Use>
void each_block(const Choice &s, int64_t part, const Use &use) {
  const int64_t count = s.block[s.buckets];
  for (int64_t b = count * part / s.workers; b < count * (part + 1) / s.workers; ++b) use(b);
}

// Fills the blocks with the picked pairs. Returns false if memory runs out
bool fill_blocks(const Choice &s, Pool &pool) {
  const Blocks &b = s.blocks;
  if (!grow_blocks(s, s.block[s.buckets])) return false;
  for (int64_t t = 0; t <= s.top; ++t) {
    b.cross.data[t] = s.block[s.kinds * t];
    b.inner.data[t] = s.block[s.kinds * (s.top + t)];
  }
  for (int64_t slot = 0; slot < LANES * s.block[s.buckets]; ++slot) b.row.data[slot] = -1;
  for (int64_t c = 0; c < s.list.count[0]; ++c) s.slot[c] = -1;
  pool.each([&](int64_t k) { sort_picked(s, k); });
  pool.each([&](int64_t k) { each_block(s, k, [&](int64_t at) { fill_block(s, at); }); });
  return true;
}

// Completes the blocks with rows of loads, vectors and the order of summation. Returns false if memory runs out
bool complete_blocks(const Choice &s, Pool &pool) {
  Blocks &b = s.blocks;
  const int64_t rows = assign_load_rows(s), with_frame = s.moving.len_virial > 0;
  const int64_t codes = 2 * LANES * s.block[s.buckets] + s.bodies + PREFETCH_DISTANCE;
  double far = 0.0;
  for (int64_t k = 0; k < s.workers; ++k) far = larger(far, s.far[k]);
  if (rows < 0 || !grow(b.vector, place_vectors(s)) || !grow(b.load, WIDTH * (rows + 1)) ||
      !grow(b.moment, b.turns ? WIDTH * (rows + 1) : 0) || !grow(b.pair, with_frame * 3 * (rows + 1)) || !grow(b.code, codes))
    return false;
  memset(b.load.data + WIDTH * rows, 0, WIDTH * sizeof(double));
  if (b.turns) memset(b.moment.data + WIDTH * rows, 0, WIDTH * sizeof(double));
  pool.each([&](int64_t k) { count_loads(s, k); });
  place_loads(s, rows);
  pool.each([&](int64_t k) {
    each_block(s, k, [&](int64_t at) { write_vectors(s, far, at); });
    write_summation_order(s, k);
  });
  for (int64_t g = 0; g < s.bodies; ++g) b.code.data[b.start.data[g]] += IS_FIRST;
  return true;
}

}  // namespace

uint8_t choose_blocks(Blocks *blocks, const Law *law, const Contacts *contacts, const Moving *moving,
                      const double *inverse_mass, const int64_t *material, const double *normal, int64_t walls,
                      const double *vectors, const double *across, const double *room, double gap) {
  const int64_t bodies = moving->len_order, top = moving->len_tile, workers = moving->len_share - 1;
  const int64_t materials = law->len_table, kinds = 2 * materials * materials;
  Choice s{*blocks, *law, *contacts, *moving, inverse_mass, material, normal, vectors, across, room, gap,
           materials, bodies, bodies - walls, top, workers, kinds, 2 * top * kinds};
  Pool pool(workers);
  pool.each([&](int64_t k) { commit_part(*blocks, *contacts, k, workers); });
  blocks->count = 0;
  blocks->tiles = top - 1;
  blocks->turns = has_moments(*law) ? law->angular : 0;
  blocks->own = law->len_memory, blocks->at_own = law->angular;
  Scratch scratch;
  if (!take_memory(s, scratch)) return false;
  index_bodies(s);
  pool.each([&](int64_t k) { pick_pairs(s, k); });
  lay_out(s);
  if (!fill_blocks(s, pool) || !complete_blocks(s, pool)) return false;
  blocks->count = s.block[s.buckets];
  return true;
}

// ---- memory of blocks, and of bodies in memory order

namespace {

double square_of(const double *v) { return v[0] * v[0] + v[1] * v[1] + v[2] * v[2]; }

bool is_finite(const double *v) {
  const double zero = (v[0] - v[0]) + (v[1] - v[1]) + (v[2] - v[2]);
  return zero == 0.0;
}

}  // namespace

Blocks *new_blocks(void) { return static_cast<Blocks *>(calloc(1, sizeof(Blocks))); }

void clear_blocks(Blocks *blocks) {
  Blocks &b = *blocks;
  release_all(b.i, b.j, b.row, b.material, b.used, b.wall, b.at, b.vector, b.size, b.mass, b.slip, b.turn, b.memory,
              b.mode, b.place, b.cross, b.inner, b.load, b.moment, b.pair, b.start, b.code);
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
    double *own = list.rolling + list.width_rolling * c;
    for (int64_t m = 0; m < blocks.own && mode != OPEN; ++m)
      own[blocks.at_own + m] = blocks.memory.data[blocks.own * s + m];
    if (!blocks.turns) continue;
    const double *turn = blocks.turn.data + TURNS * (s - s % LANES) + s % LANES;
    for (int64_t m = 0; m < 3; ++m) own[m] = turn[m * LANES];
    own[AT_CAP] = turn[CAPPED * LANES];
    if (blocks.turns > TWIST) own[TWIST] = turn[TWISTED * LANES], own[TWIST_AT_CAP] = turn[TWIST_CAPPED * LANES];
  }
}

void commit_blocks(const Blocks *blocks, const Contacts *contacts) { commit_part(*blocks, *contacts, 0, 1); }

void morton_keys(const double *x, int64_t n, double size, int64_t *key) {
  for (int64_t a = 0; a < n; ++a) {
    key[a] = 0;
    for (int64_t k = 0; k < 3; ++k) {
      const int64_t cell = static_cast<int64_t>(x[k * n + a] / size);
      for (int64_t bit = 0; bit < 20; ++bit) key[a] |= ((cell >> bit) & 1) << (3 * bit + k);
    }
  }
}

void speeds(const Moving *moving, double *out) {
  double most = 0.0, total = 0.0;
  const int64_t bodies = moving->len_order;
  for (int64_t g = 0; g < bodies; ++g) {
    const double square = square_of(moving->body + BODY * g + VELOCITY);
    most = square > most ? square : most;
    total += square;
  }
  out[0] = sqrt(most);
  out[1] = sqrt(total / (bodies ? bodies : 1));
}

void displacement_limits(const Moving *moving, double base, double span, double least, double most, double *room) {
  for (int64_t g = 0; g < moving->len_order; ++g) {
    const double limit = base + span * sqrt(square_of(moving->body + BODY * g + VELOCITY));
    room[g] = limit < least ? least : limit;
    room[g] = room[g] > most ? most : room[g];
  }
}

uint8_t limit_displacements(const Moving *moving, const double *origin, double most, double *room) {
  for (int64_t g = 0; g < moving->len_order; ++g) {
    const double *x = moving->body + BODY * g, *from = origin + 3 * moving->order[g];
    const double moved[3] = {x[0] - from[0], x[1] - from[1], x[2] - from[2]};
    const double left = most - sqrt(square_of(moved));
    if (!(left >= 0.5 * room[g])) return false;
    room[g] = left < room[g] ? left : room[g];
  }
  return true;
}

void gather_bodies(const Moving *moving, const Bodies *bodies, const double *kick, const double *kick_t) {
  for (int64_t g = 0; g < moving->len_order; ++g) {
    const int64_t a = moving->order[g];
    double *row = moving->body + BODY * g, *ahead = moving->ahead + (moving->len_ahead ? BODY_AHEAD * g : 0);
    for (int64_t k = 0; k < 3; ++k) {
      row[k] = bodies->position[3 * a + k];
      row[VELOCITY + k] = bodies->velocity[3 * a + k];
      row[SPIN + k] = bodies->spin[3 * a + k];
      moving->angle[3 * g + k] = bodies->angle[3 * a + k];
    }
    row[RADIUS] = bodies->radius[a];
    row[KICK] = kick[a];
    row[KICK_T] = kick_t[a];
    if (!moving->len_ahead) continue;
    for (int64_t k = 0; k < 3; ++k) {
      ahead[VELOCITY_AHEAD + k] = row[VELOCITY + k];
      ahead[SPIN_AHEAD + k] = row[SPIN + k];
    }
    ahead[VELOCITY_AHEAD + 3] = ahead[SPIN_AHEAD + 3] = 0.0;
  }
}

void scatter_bodies(const Moving *moving, const Bodies *bodies) {
  for (int64_t g = 0; g < moving->len_order; ++g) {
    const int64_t a = moving->order[g];
    const double *row = moving->body + BODY * g;
    for (int64_t k = 0; k < 3; ++k) {
      bodies->position[3 * a + k] = row[k];
      bodies->velocity[3 * a + k] = row[VELOCITY + k];
      bodies->spin[3 * a + k] = row[SPIN + k];
      bodies->angle[3 * a + k] = moving->angle[3 * g + k];
    }
  }
}

void pair_vector(const Contacts &contacts, int64_t c, const double *position, const double *vectors, double *out) {
  const double *i = position + 3 * contacts.i[c], *j = position + 3 * contacts.j[c];
  const int16_t *image = contacts.image + 3 * c;
  for (int64_t m = 0; m < 3; ++m)
    out[m] = i[m] - j[m] + (image[0] * vectors[m] + image[1] * vectors[3 + m] + image[2] * vectors[6 + m]);
}

void rolled_length(const double *radius, const double *angle, int64_t i, int64_t j, double *out) {
  for (int64_t m = 0; m < 3; ++m) out[m] = radius[i] * angle[3 * i + m] + radius[j] * angle[3 * j + m];
}

uint8_t store_reference(const Contacts *contacts, const double *position, const double *angle, const double *radius,
                        const double *vectors, int64_t angular, double *pair, double *roll) {
  bool rested = true;
  for (int64_t c = 0; c < contacts->count[0] && (pair || rested); ++c) {
    if (!contacts->mode[c]) continue;
    const int64_t i = contacts->i[c], j = contacts->j[c];
    double r[3], turned[3];
    pair_vector(*contacts, c, position, vectors, r);
    rolled_length(radius, angle, i, j, turned);
    for (int64_t m = 0; m < 3; ++m) {
      rested &= r[m] == contacts->pair[3 * c + m] && turned[m] == contacts->roll[3 * c + m];
      double *anchor = angular ? contacts->rolling + contacts->width_rolling * c + ANCHOR + m : nullptr;
      const double apart = angle[3 * i + m] - angle[3 * j + m];
      rested &= !anchor || *anchor == apart;
      if (!pair) continue;
      pair[3 * c + m] = r[m];
      roll[3 * c + m] = turned[m];
      if (anchor) *anchor = apart;
    }
  }
  return rested;
}

int64_t find_not_finite(const Moving *moving) {
  for (int64_t g = 0; g < moving->len_order; ++g)
    if (!is_finite(moving->body + BODY * g) || !is_finite(moving->angle + 3 * g)) return g;
  return -1;
}

int64_t find_runaway(const Moving *moving, double dt) {
  for (int64_t g = 0; g < moving->len_order; ++g) {
    const double *row = moving->body + BODY * g, radius = row[RADIUS];
    if (radius > 0.0 && !(square_of(row + VELOCITY) * dt * dt <= radius * radius)) return g;
  }
  return -1;
}
