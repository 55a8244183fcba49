// Many systems side by side: the work of each thread. The file is compiled for this processor, with a loop over the
// threads, and at run time for a graphics processor; both give the same bits, because products are not contracted.
//
// Every body evaluates all its contacts, so each contact is evaluated from both sides, with the same bits except
// for signs, since every formula is odd or even in the order of the two bodies. No sum needs atomic additions.
//
// An entry of the list of a body is a word: partner, images along the three vectors, and in its lowest bits the mode, and
// whether the contact has been at its limit. Entries are sorted.
#pragma once
#include "course.h"
#include "keys.h"
#include "observables.h"

namespace batch {

int32_t fetch_add(int32_t *to, int32_t more);  // atomic if threads run concurrently, like the next one
int32_t exchange(int32_t *at, int32_t value);  // returns the previous value

constexpr int64_t MODE = 3, REACHED = 4, FLAGS = ENTRY_FLAGS, PARTNER = ENTRY_PARTNER;
constexpr int64_t ROWS = 16;  // of partial sums

struct Slot {
  const Batch &batch;
  int64_t s;
  int64_t *number;
  double *value;
  Slot(const Batch &given, int64_t slot)
      : batch(given), s(slot), number(given.number + SLOT_NUMBERS * slot), value(given.value + PACE_VALUES * slot) {}
  int64_t row(int64_t a) const { return batch.room * s + a; }
  int64_t half() const { return batch.slots * batch.room; }
  double *point(int64_t a, int64_t now) const { return batch.point + POINT_WIDTH * (half() * now + row(a)); }
  double *motion(int64_t a, int64_t now) const { return batch.motion + MOTION_WIDTH * (half() * now + row(a)); }
  int64_t *entry(int64_t a, int64_t list) const { return batch.entry + batch.most * (half() * list + row(a)); }
  double *slip(int64_t a, int64_t list, int k) const { return batch.slip + batch.most * (half() * (3 * list + k) + row(a)); }
  int32_t &entries(int64_t a, int64_t list) const { return batch.entries[half() * list + row(a)]; }
  const double *here(int64_t a) const { return point(a, number[SLOT_NOW]); }
  bool goes_on() const { return number[SLOT_STEP] != number[SLOT_NEXT]; }  // to the next step, without a sample

  // Sums of `count` numbers, at most SUMS: `add` adds those of thread t to zeros. They are left in ROWS parts for `total`.
  template <class Team, class Add>
  void add_up(const Team &team, int64_t count, const Add &add) const {
    double *partial = batch.partial + TEAM * SUMS * s;
    team.each([&](int64_t t) {
      for (int64_t k = 0; k < count; ++k) partial[SUMS * t + k] = 0.0;
      add(t, partial + SUMS * t);
    });
    team.each([&](int64_t t) {
      for (int64_t k = t / ROWS; k < count; k += TEAM / ROWS) {
        double sum = 0.0;
        for (int64_t m = t % ROWS; m < TEAM; m += ROWS) sum += partial[SUMS * m + k];
        partial[SUMS * (t % ROWS) + k] = sum;
      }
    });
  }
  double total(int64_t k) const {
    double sum = 0.0;
    for (int64_t m = 0; m < ROWS; ++m) sum += batch.partial[SUMS * (TEAM * s + m) + k];
    return sum;
  }

  // the view of `observables.h`
  double time() const { return value[PACE_START] + double(number[SLOT_STEP]) * value[PACE_DT]; }
  const double *vectors() const { return batch.vectors + 9 * s; }
  int64_t bodies() const { return number[SLOT_BODIES]; }
  int64_t grains() const { return number[SLOT_GRAINS]; }
  double divisor() const { return 1.0; }
  Vec<double> position(int64_t a) const { return read(here(a)); }
  Vec<double> velocity(int64_t a) const { return read(motion(a, number[SLOT_NOW])); }
  Vec<double> spin(int64_t a) const { return read(motion(a, number[SLOT_NOW]) + 3); }
  Vec<double> reference(int64_t a) const { return read(batch.reference + 3 * row(a)); }
  double mass(int64_t a) const { return batch.heavy[3 * row(a) + 1]; }
  double inertia(int64_t a) const { return batch.heavy[3 * row(a) + 2]; }
  int64_t unit(int64_t a) const { return batch.unit[row(a)]; }
  int64_t supports(int64_t a) const { return batch.supports[row(a)]; }
  int64_t least() const { return batch.least; }
  int32_t &loose(int64_t a) const { return batch.loose[row(a)]; }
  int32_t &held(int64_t a) const { return batch.touching[row(a)]; }
  int64_t &changed() const { return number[SLOT_CHANGED]; }
  void count(int64_t a) const { fetch_add(&held(a), 1); }
  void add_virial(double *) const {}
};

// the view of `pairs.h`
inline double radius_of(const Slot &slot, int64_t a) { return slot.here(a)[3]; }
inline double inverse_mass_of(const Slot &slot, int64_t a) { return slot.batch.heavy[3 * slot.row(a)]; }
inline bool is_wall(const Slot &slot, int64_t a) { return a >= slot.number[SLOT_GRAINS]; }
inline Vec<double> normal_of(const Slot &slot, int64_t a) { return read(slot.batch.normal + 3 * slot.row(a)); }
inline const double *parameters_of(const Law &law, const Slot &slot, int64_t i, int64_t j) {
  const Batch &b = slot.batch;
  return b.table + law.len_table * law.len_table * law.width * slot.s +
         (b.material[slot.row(i)] * law.len_table + b.material[slot.row(j)]) * law.width;
}

// Pair vector of two bodies from their positions.
template <int DIM>
inline Vec<double> pair_vector(const Slot &slot, const double *own, const double *other, int64_t word) {
  Vec<double> r = flat<DIM>(read(own) - read(other));
  for (int k = 0; k < 3; ++k)
    if (const int64_t image = image_of(word >> FLAGS, k)) r = r + double(image) * flat<DIM>(read(slot.vectors() + 3 * k));
  return r;
}

// Geometry of an entry of body a.
template <int DIM>
inline Pair pair_of(const Slot &slot, int64_t a, int64_t word) {
  Pair pair;
  const int64_t partner = word >> PARTNER;
  pair.r = pair_vector<DIM>(slot, slot.here(a), slot.here(partner), word);
  find_overlap(pair, slot, a, partner);
  pair.n = flat<DIM>(pair.n);
  return pair;
}

// Writes an event of a contact from the side of body a. A separate function, so that it does not use registers of the
// step.
__attribute__((noinline)) inline void store_event(const Batch &b, int64_t s, int64_t a, int64_t word, int64_t kind) {
  const int64_t row = fetch_add(b.happened + s, 1);
  if (row >= b.events) return;
  const Slot slot(b, s);
  const int64_t key = word >> FLAGS, image[3] = {image_of(key, 0), image_of(key, 1), image_of(key, 2)};
  write_event(b.event + EVENT * (b.events * s + row), kind, slot.time(), a, word >> PARTNER, image, slot.here(a));
}

inline void record_event(const Slot &slot, int64_t a, int64_t word, int64_t kind) {
  if (slot.batch.events) store_event(slot.batch, slot.s, a, word, kind);
}

inline void open_entry(const Slot &slot, int64_t a, int64_t *entry) {
  if ((*entry & MODE) == OPEN) return;
  record_event(slot, a, *entry, OPENED);
  *entry &= ~(MODE | REACHED);
}

// State of a system that may step.
inline int64_t run_or_wait(const Slot &slot) {  // one step and a new list fill less than half of the rows
  return 2 * int64_t(slot.batch.happened[slot.s]) > slot.batch.events ? WAITING : RUNNING;
}

// Counts the step that all bodies have begun.
inline void count_step(const Slot &slot) {
  int64_t *number = slot.number;
  number[SLOT_STEP] += 1;
  slot.value[PACE_CLOCK] += slot.value[PACE_DT];
  number[SLOT_PHASE] = number[SLOT_BROKEN] ? BROKE : number[SLOT_MOVED_FAR] ? LISTING : run_or_wait(slot);
}

struct Sum {  // force and torque
  double f[6];
};

// Whether entries e, e + step … of body a, which has `count`, may touch. Entries that cannot touch are opened.
template <int DIM, int N>
inline void may_touch(const Slot &slot, int64_t a, int64_t e, int64_t step, int64_t count, bool *touches) {
  const int64_t now = slot.number[SLOT_NOW], list = slot.number[SLOT_LISTED];
  const double *own = slot.point(a, now);
  int64_t *entry = slot.entry(a, list) + e, word[N];
  double other[N][4];
  for (int k = 0; k < N; ++k) word[k] = e + step * k < count ? entry[step * k] : 0;
  for (int k = 0; k < N; ++k)  // all loads first, as they take long
    for (int m = 0; m < 4; ++m) other[k][m] = slot.point(word[k] >> PARTNER, now)[m];
  for (int k = 0; k < N; ++k) {
    const double reach = own[3] + other[k][3];
    const Vec<double> r = pair_vector<DIM>(slot, own, other[k], word[k]);
    const bool apart = !is_wall(slot, word[k] >> PARTNER) && dot(r, r) > (1.0 + 1e-15) * (reach * reach);
    touches[k] = e + step * k < count && !apart;
    if (e + step * k < count && apart) open_entry(slot, a, entry + step * k);
  }
}

// Loads on body a of its entry e, whose memory is updated: the parts of `sweep_row` in `rows.cpp` needed on a device.
// Not one function, because compilers then fuse other products in rows, which changes last bits in two dimensions.
template <int DIM>
inline Sum evaluate_contact(const Law &law, const Slot &slot, int64_t a, int64_t e) {
  const int64_t now = slot.number[SLOT_NOW], list = slot.number[SLOT_LISTED];
  const double dt = slot.value[PACE_DT], *own = slot.motion(a, now);
  int64_t *entry = slot.entry(a, list) + e;
  const int64_t word = *entry, before = word & MODE, partner = word >> PARTNER;
  Pair pair = pair_of<DIM>(slot, a, word);
  if (pair.overlap <= 0.0) {
    open_entry(slot, a, entry);
    return {};
  }
  double *slip[3];
  for (int k = 0; k < 3; ++k) slip[k] = slot.slip(a, list, k) + e;
  find_parameters(pair, law, slot, a, partner, nullptr);
  const Parameters q = pair.q;
  const Vec<double> n = pair.n;
  const double overlap = pair.overlap, inverse = pair.inverse, *other = slot.motion(partner, now);
  const double radius = radius_of(slot, a), radius_other = radius_of(slot, partner);
  const Vec<double> d = dt * flat<DIM>(read(own) - read(other));
  const Vec<double> roll = dt * rolled<DIM>(radius, read(own + 3), radius_other, read(other + 3));
  const Ratio<double> fraction = before == OPEN ? touching_fraction(n, inverse, overlap, d) : Ratio<double>{1.0, 1.0};
  Vec<double> s = {0.0, 0.0, 0.0};
  if (before != OPEN) s = {*slip[0], *slip[1], DIM == 3 ? *slip[2] : 0.0};
  const Elastic<double> spring = built_in(law, q, pair.r_eff, overlap);
  const Transport<double> moved = transport_slip(law, false, n, inverse, overlap, d, roll, s);
  double fn = spring.force, damping = 0.0;
  Vec<double> v = {0.0, 0.0, 0.0};
  if (law.damping) {
    v = at_contact(n, flat<DIM>(read(own + 6) - read(other + 6)),
                   rolled<DIM>(radius, read(own + 9), radius_other, read(other + 9)));
    const double vn = dot(v, n), factor = damping_factor(law, pair.r_eff, pair.m_eff, overlap, fn);
    v = v - vn * n;
    fn = with_dashpot(law, fn, factor * q[DAMPING_N], vn);
    damping = factor * q[DAMPING_T];
  }
  const double limit = coulomb_limit(q, fn, false);
  const Loads<double, bool> out = contact_loads<DIM>(law, false, FREE, false, fn, spring.stiffness, damping, limit,
                                                     overlap, radius + radius_other, moved, fraction, before == SLIDE, v);
  *slip[0] = out.slip.x, *slip[1] = out.slip.y;
  if (DIM == 3) *slip[2] = out.slip.z;
  const int64_t mode = out.slides ? SLIDE : STICK, reached = out.slides && limit > 0.0 ? REACHED : word & REACHED;
  const int64_t after = (word & ~(MODE | REACHED)) | mode | reached;
  if (after != word) *entry = after;
  if (before == OPEN) record_event(slot, a, word, CLOSED);
  if (reached && !(word & REACHED)) record_event(slot, a, word, REACHED_LIMIT);
  const Vec<double> f = fn * n + out.tangential, turn = radius * cross(out.tangential, n);
  return {{f.x, f.y, f.z, turn.x, turn.y, turn.z}};
}

// Ends a step with half a kick (`half`), from one buffer of the motion to the other, and begins the next one unless a
// sample is due, as `move_body` in `motion.cpp`.
template <int DIM>
inline void move(const Slot &slot, int64_t a, const double *f, bool half) {
  const Batch &b = slot.batch;
  const int64_t from = slot.number[SLOT_NOW], to = half ? 1 - from : from;
  const bool go_on = slot.goes_on();
  const double *value = slot.value, *x = slot.point(a, from), *was = slot.motion(a, from);
  const double kick[2] = {b.kick[2 * slot.row(a)], b.kick[2 * slot.row(a) + 1]}, dt = value[PACE_DT];
  const double keep[2] = {value[PACE_KEEP], value[PACE_KEEP_T]}, slow[2] = {value[PACE_SLOW], value[PACE_SLOW_T]};
  const uint8_t *free = b.free + 6 * slot.row(a);
  double rate[6], ahead[6], place[3] = {x[0], x[1], x[2]};
  for (int k = 0; k < 6; ++k) {
    rate[k] = was[k], ahead[k] = was[6 + k];
    const double push = kick[k / 3] * f[k];
    if (free[k]) rate[k] = kicked(rate[k], push, keep[k / 3], slow[k / 3], half, go_on);
    if (go_on) ahead[k] = free[k] ? predicted(rate[k], push, slow[k / 3]) : rate[k];
  }
  if (go_on) {
    double square = 0.0, speed = 0.0;
    const double *origin = b.origin + 3 * slot.row(a), radius = x[3], most = 0.5 * value[PACE_SKIN];
    for (int k = 0; k < DIM; ++k) {
      place[k] = x[k] + dt * rate[k];
      square += (place[k] - origin[k]) * (place[k] - origin[k]);
      speed += rate[k] * rate[k];
    }
    for (int k = 0; k < 3; ++k) b.angle[3 * slot.row(a) + k] += dt * rate[3 + k];
    if (!(square <= most * most)) slot.number[SLOT_MOVED_FAR] = 1;
    if (radius > 0.0 && !(speed * dt * dt <= radius * radius)) slot.number[SLOT_BROKEN] = a + 1;
  }
  double *point = slot.point(a, to), *motion = slot.motion(a, to);
  for (int k = 0; k < 3; ++k) point[k] = place[k];
  point[3] = x[3];
  for (int k = 0; k < 6; ++k) motion[k] = rate[k], motion[6 + k] = ahead[k];
}

// Ends the step of grain a, and begins the next one, with the loads of its contacts.
template <int DIM>
inline void end_step(const Slot &slot, int64_t a, const double *loads) {
  const bool single = a < slot.number[SLOT_SINGLE], store = !single || !slot.goes_on();
  double f[6];
  for (int k = 0; k < 6; ++k) {
    f[k] = slot.batch.external[6 * slot.row(a) + k] + loads[k];
    if (store) slot.batch.force[6 * slot.row(a) + k] = f[k];
  }
  if (single) move<DIM>(slot, a, f, true);
}

// Pull of the springs on body a.
inline double pull_of(const Slot &slot, int64_t a, int k) {
  const Batch &b = slot.batch;
  const double *spring = b.spring + 6 * slot.row(a);
  if (!(spring[k] > 0.0)) return 0.0;
  return spring_force(spring[k], spring[3 + k], slot.here(a)[k], b.knot + b.knots * slot.s, b.knots,
                      b.course + b.knots * b.courses * slot.s, b.courses, b.leads[3 * slot.row(a) + k],
                      slot.value[PACE_CLOCK]);
}

// Springs, rigid groups, walls and counters of one system, after all grains have ended their step.
template <int DIM, class Team>
inline void finish_step(const Slot &slot, const Team &team) {
  const Batch &b = slot.batch;
  int64_t *number = slot.number;
  const int64_t *members = b.members + (b.groups + 1) * slot.s;
  const bool go_on = slot.goes_on();
  slot.add_up(team, 3 * b.groups, [&](int64_t t, double *sum) {
    for (int64_t g = 0; g < b.groups; ++g)
      for (int64_t a = members[g] + t; a < members[g + 1]; a += TEAM)
        for (int k = 0; k < 3; ++k) sum[3 * g + k] += b.force[6 * slot.row(a) + k] + pull_of(slot, a, k);
  });
  team.each([&](int64_t t) {
    int64_t g = 0;
    for (int64_t a = number[SLOT_SINGLE] + t; a < number[SLOT_BODIES]; a += TEAM) {
      double *f = b.force + 6 * slot.row(a);
      while (g < b.groups && a >= members[g + 1]) ++g;
      for (int k = 0; k < 3; ++k) f[k] = g < b.groups ? slot.total(3 * g + k) : f[k] + pull_of(slot, a, k);
      move<DIM>(slot, a, f, true);
    }
  });
  team.once([&] {
    number[SLOT_NOW] = 1 - number[SLOT_NOW];
    if (go_on) count_step(slot);
    else number[SLOT_PHASE] = SAMPLING;
  });
}

// Begins the step after a sample.
template <int DIM>
inline void begin_step(const Slot &slot, int64_t a) {
  move<DIM>(slot, a, slot.batch.force + 6 * slot.row(a), false);
}

// ---- lists

// Number of the bin of a body along one vector; `box`: the periodic box in which it is.
inline int64_t bin_along(const Slot &slot, Vec<double> x, int k, int64_t *box) {
  const double *inverse = slot.batch.inverse + 9 * slot.s;
  const double part = x.x * inverse[k] + x.y * inverse[3 + k] + x.z * inverse[6 + k];
  const int64_t bins = slot.number[SLOT_BINS + k];
  const bool periodic = slot.batch.periodic[3 * slot.s + k];
  const double whole = periodic ? floor(part) : 0.0;
  *box = int64_t(whole);
  const double place = floor((part - whole - slot.value[PACE_LOWEST + k]) * slot.value[PACE_DENSITY + k]);
  return place <= 0.0 ? 0 : place >= double(bins - 1) ? bins - 1 : int64_t(place);
}

// Sorts the grains of one system into bins, of which each is a chain.
template <class Team>
inline void sort_into_bins(const Slot &slot, const Team &team) {
  const Batch &b = slot.batch;
  int64_t *number = slot.number;
  team.once([&] {
    if (number[SLOT_PHASE] == BEGINNING) count_step(slot);
  });
  if (number[SLOT_PHASE] != LISTING) return;
  const int64_t *bins = number + SLOT_BINS;
  team.each([&](int64_t t) {
    for (int64_t k = t; k < bins[0] * bins[1] * bins[2]; k += TEAM) b.head[slot.row(k)] = -1;
  });
  team.each([&](int64_t t) {
    for (int64_t a = t; a < number[SLOT_GRAINS]; a += TEAM) {
      int64_t box, bin = 0;
      for (int k = 0; k < 3; ++k) bin = bin * bins[k] + bin_along(slot, slot.position(a), k, &box);
      b.next[slot.row(a)] = exchange(b.head + slot.row(bin), int32_t(a));  // the order in a bin does not matter
    }
    for (int64_t a = t; a < number[SLOT_BODIES]; a += TEAM)
      for (int k = 0; k < 3; ++k) b.origin[3 * slot.row(a) + k] = slot.here(a)[k];
  });
}

// Keys of all bodies within reach of grain a, unsorted. Returns their number, which may exceed the room, or −1 if one
// is more periodic boxes apart than a key can store.
template <int DIM>
inline int64_t find_partners(const Slot &slot, int64_t a, int64_t *key) {
  const Batch &b = slot.batch;
  const int64_t now = slot.number[SLOT_NOW], *bins = slot.number + SLOT_BINS;
  const double *own = slot.point(a, now), *vectors = b.vectors + 9 * slot.s, skin = slot.value[PACE_SKIN];
  const Vec<double> x = read(own);
  int64_t many = 0, box[3], home[3], other[3];
  for (int k = 0; k < 3; ++k) home[k] = bin_along(slot, x, k, box + k);
  for (int64_t near = 0; near < 27; ++near) {
    const int64_t step[3] = {near / 9 - 1, near / 3 % 3 - 1, near % 3 - 1};
    int64_t cross[3], bin = 0;
    bool exists = true;
    for (int k = 0; k < 3; ++k) {
      int64_t place = home[k] + step[k];
      cross[k] = place < 0 ? -1 : place >= bins[k] ? 1 : 0;
      exists = exists && (!cross[k] || b.periodic[3 * slot.s + k]);
      bin = bin * bins[k] + place - cross[k] * bins[k];
    }
    if (!exists) continue;
    for (int64_t c = b.head[slot.row(bin)]; c >= 0; c = b.next[slot.row(c)]) {
      const double *there = slot.point(c, now);
      int64_t image[3];
      Vec<double> r = flat<DIM>(x - read(there));
      for (int k = 0; k < 3; ++k) {
        bin_along(slot, read(there), k, other + k);
        image[k] = other[k] - box[k] - cross[k];
        if (image[k]) r = r + double(image[k]) * flat<DIM>(read(vectors + 3 * k));
      }
      if (c == a && !image[0] && !image[1] && !image[2]) continue;
      const double reach = own[3] + there[3] + skin;
      if (!(dot(r, r) < reach * reach)) continue;
      for (int k = 0; k < 3; ++k)
        if (image[k] < -IMAGE_OFFSET || image[k] >= IMAGE_OFFSET) return -1;
      if (many < b.most) key[many] = pack_key(0, c, image[0], image[1], image[2]);
      ++many;
    }
  }
  for (int64_t w = slot.number[SLOT_GRAINS]; w < slot.number[SLOT_BODIES]; ++w) {
    const Vec<double> r = flat<DIM>(x - slot.position(w));
    if (!(dot(r, normal_of(slot, w)) - own[3] < skin)) continue;
    if (many < b.most) key[many] = pack_key(0, w, 0, 0, 0);
    ++many;
  }
  return many;
}

// New list of grain a, with the memory of the previous one.
template <int DIM>
inline void build_list(const Slot &slot, int64_t a) {
  const int64_t old = slot.number[SLOT_LISTED], list = 1 - old, before = slot.entries(a, old);
  int64_t *entry = slot.entry(a, list), *former = slot.entry(a, old), many = find_partners<DIM>(slot, a, entry);
  if (many < 0 || many > slot.batch.most) {
    slot.number[SLOT_CHANGED] = many;  // reports that a list cannot be made, or is full
    many = many < 0 ? 0 : slot.batch.most;
  }
  insert_in_order(entry, many);
  int64_t e = 0;
  for (int64_t c = 0; c < many; ++c) {
    const int64_t key = entry[c];
    for (; e < before && former[e] >> FLAGS < key; ++e) open_entry(slot, a, former + e);
    entry[c] = key << FLAGS;
    if (e == before || former[e] >> FLAGS != key) continue;
    if ((former[e] & MODE) != OPEN) {
      entry[c] = former[e];
      for (int k = 0; k < 3; ++k) slot.slip(a, list, k)[c] = slot.slip(a, old, k)[e];
    }
    ++e;
  }
  for (; e < before; ++e) open_entry(slot, a, former + e);
  slot.entries(a, list) = int32_t(many);
}

inline void finish_list(const Slot &slot) {
  int64_t *number = slot.number;
  if (number[SLOT_PHASE] != LISTING) return;
  number[SLOT_LISTED] = 1 - number[SLOT_LISTED];
  number[SLOT_MOVED_FAR] = 0;
  number[SLOT_PHASE] = number[SLOT_CHANGED] ? (number[SLOT_CHANGED] < 0 ? APART : CROWDED) : run_or_wait(slot);
}

// ---- samples

static_assert(Observables::SUMS <= SUMS, "more sums than there is room for");

template <int DIM>
struct Sample : Slot {  // the rest of the view of `observables.h`
  static constexpr bool FROM_BOTH = true;
  const Law &law;
  Sample(const Law &law, const Slot &slot) : Slot(slot), law(law) {}

  template <class Act>
  void each_closed(int64_t t, const Act &act) const {
    for (int64_t a = t; a < grains(); a += TEAM)
      for (int64_t e = 0; e < entries(a, number[SLOT_LISTED]); ++e) {
        const int64_t word = entry(a, number[SLOT_LISTED])[e];
        if ((word & MODE) != OPEN) act(a, word >> PARTNER, e);
      }
  }
  Seen seen(int64_t a, int64_t partner, int64_t e) const {
    const int64_t list = number[SLOT_LISTED], word = entry(a, list)[e];
    Seen out = {pair_of<DIM>(*this, a, word), (word & MODE) == SLIDE, {}, false, 1.0, 1.0};
    find_parameters(out, law, *this, a, partner, nullptr);
    const Elastic<double> spring = built_in(law, out.q, out.r_eff, out.overlap);
    const Vec<double> s = flat<DIM>({slip(a, list, 0)[e], slip(a, list, 1)[e], slip(a, list, 2)[e]});
    const double limit = coulomb_limit(out.q, spring.force, false);
    out.force = spring.force * out.n + tangential_force(law.smooth, spring.stiffness, limit, s);
    return out;
  }
};

// Motion and loads of a rigid group (see `write_groups` in `core/dynamics/record.py`).
template <class Team>
inline void write_group(const Slot &slot, const Team &team, const int64_t *members, double *row) {
  const Batch &b = slot.batch;
  slot.add_up(team, 10, [&](int64_t t, double *sum) {
    for (int64_t a = members[0] + t; a < members[1]; a += TEAM) {
      sum[0] += slot.mass(a);
      for (int k = 0; k < 3; ++k) {
        sum[1 + k] += slot.mass(a) * slot.here(a)[k];
        sum[4 + k] += b.external[6 * slot.row(a) + k];
        sum[7 + k] += pull_of(slot, a, k);
      }
    }
  });
  team.once([&] {
    for (int k = 0; k < 3; ++k) {
      const double pull = slot.total(7 + k);
      row[k] = slot.total(1 + k) / slot.total(0);
      row[3 + k] = slot.motion(members[0], slot.number[SLOT_NOW])[k];
      row[6 + k] = b.force[6 * slot.row(members[0]) + k] - slot.total(4 + k) - pull;
      row[9 + k] = pull;
    }
  });
}

template <int DIM, class Team>
inline void end_at_sample(const Law &law, const Slot &slot, const Team &team) {
  const Batch &b = slot.batch;
  int64_t *number = slot.number;
  const int64_t at_row = b.samples * slot.s + number[SLOT_ROWS], *members = b.members + (b.groups + 1) * slot.s;
  const bool due = number[SLOT_EVERY] && number[SLOT_STEP] % number[SLOT_EVERY] == 0;
  if (due) {
    for (int64_t g = 0; g < b.groups; ++g)
      if (members[g] < members[g + 1]) write_group(slot, team, members + g, b.group + 12 * (b.groups * at_row + g));
    write_sample(Sample<DIM>(law, slot), team, b.series + Observables::WIDTH * at_row);
    team.each([&](int64_t t) {
      for (int64_t a = t; a < number[SLOT_GRAINS] && a < b.tracks; a += TEAM) {
        double *row = b.track + 6 * (b.tracks * at_row + a);
        for (int k = 0; k < 3; ++k) row[k] = slot.here(a)[k], row[3 + k] = b.angle[3 * slot.row(a) + k];
      }
    });
  }
  team.once([&] {
    number[SLOT_ROWS] += due;
    number[SLOT_NEXT] += number[SLOT_EVERY];
    if (number[SLOT_EVERY] == 0 || number[SLOT_NEXT] > number[SLOT_STOP]) number[SLOT_NEXT] = number[SLOT_STOP];
    number[SLOT_PHASE] = number[SLOT_STEP] == number[SLOT_STOP] ? FINISHED : BEGINNING;
  });
}

}  // namespace batch
