// Many systems side by side: what each thread does. The file is compiled for this processor, where a loop goes through
// the threads, and at run time for a graphics processor; both give the same bits, because products are not contracted.
//
// Every body evaluates all its contacts, so that each contact is evaluated from both sides: with the same bits but for
// signs, since every formula is odd or even in the order of the two bodies. No sum needs atomic additions.
//
// An entry of the list of a body is a word: partner, images along the three vectors, and in its lowest bits the mode, and
// whether the contact has been at its limit. Entries are sorted.
#pragma once
#include "course.h"
#include "mechanics.h"

namespace batch {

int32_t fetch_add(int32_t *to, int32_t more);  // atomic where threads run at once

constexpr int64_t MODE = 3, REACHED = 4, FLAGS = ENTRY_FLAGS, IMAGE = ENTRY_IMAGE, PARTNER = ENTRY_PARTNER;
constexpr int64_t ROWS = 16;  // of partial sums
constexpr int64_t IMAGE_HALF = 1 << (IMAGE - 1);

inline int64_t make_key(int64_t partner, int64_t a, int64_t b, int64_t c) {
  return partner << (PARTNER - FLAGS) | (a + IMAGE_HALF) << 2 * IMAGE | (b + IMAGE_HALF) << IMAGE | (c + IMAGE_HALF);
}

inline int64_t image_of(int64_t word, int k) {
  return (word >> (FLAGS + IMAGE * (2 - k)) & (2 * IMAGE_HALF - 1)) - IMAGE_HALF;
}

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
  bool is_wall(int64_t a) const { return a >= number[SLOT_GRAINS]; }
};

inline Vec<double> at(const double *v) { return {v[0], v[1], v[2]}; }

template <int DIM>
inline Vec<double> flat(Vec<double> v) {
  return {v.x, v.y, DIM == 3 ? v.z : 0.0};
}

template <int DIM>
inline Vec<double> rolled(double radius, const double *spin, double other, const double *turn) {
  Vec<double> sum = radius * at(spin) + other * at(turn);
  return DIM == 3 ? sum : Vec<double>{0.0, 0.0, sum.z};
}

struct Touch {  // geometry of an entry
  Vec<double> r, n;
  double inverse, overlap, radius;  // of the partner
  int64_t partner;
  bool wall;
};

template <int DIM>
inline Vec<double> find_pair(const Slot &slot, const double *own, const double *other, int64_t word) {
  Vec<double> r = flat<DIM>(at(own) - at(other));
  for (int k = 0; k < 3; ++k)
    if (int64_t image = image_of(word, k)) r = r + double(image) * flat<DIM>(at(slot.batch.vectors + 9 * slot.s + 3 * k));
  return r;
}

template <int DIM>
inline Touch find_touch(const Slot &slot, int64_t a, int64_t word, int64_t now) {
  Touch out;
  out.partner = word >> PARTNER;
  const double *own = slot.point(a, now), *other = slot.point(out.partner, now);
  out.r = find_pair<DIM>(slot, own, other, word);
  out.wall = slot.is_wall(out.partner);
  out.radius = other[3];
  if (out.wall) {
    out.n = flat<DIM>(at(slot.batch.normal + 3 * slot.row(out.partner)));
    out.inverse = 0.0;
    out.overlap = own[3] - dot(out.r, out.n);
  } else {
    const double distance = root(dot(out.r, out.r));
    out.inverse = 1.0 / distance;
    out.n = out.inverse * out.r;
    out.overlap = own[3] + out.radius - distance;
  }
  return out;
}

// Writes an event of a contact as body a sees it. Apart, so that it does not take registers from the step.
__attribute__((noinline)) inline void write_event(const Batch &b, int64_t s, int64_t a, int64_t word, int64_t kind) {
  const int64_t row = fetch_add(b.happened + s, 1);
  if (row >= b.events) return;
  const Slot slot(b, s);
  const double time = slot.value[PACE_START] + double(slot.number[SLOT_STEP]) * slot.value[PACE_DT];
  double *out = b.event + EVENT * (b.events * s + row);
  out[0] = double(kind), out[1] = time, out[2] = double(a), out[3] = double(word >> PARTNER);
  for (int k = 0; k < 3; ++k) {
    out[4 + k] = double(image_of(word, k));
    out[7 + k] = slot.point(a, slot.number[SLOT_NOW])[k];
  }
}

inline void record_event(const Slot &slot, int64_t a, int64_t word, int64_t kind) {
  if (slot.batch.events) write_event(slot.batch, slot.s, a, word, kind);
}

inline void open_entry(const Slot &slot, int64_t a, int64_t *entry) {
  if ((*entry & MODE) == OPEN) return;
  record_event(slot, a, *entry, OPENED);
  *entry &= ~(MODE | REACHED);
}

// What a system does that may step.
inline int64_t run_or_wait(const Slot &slot) {  // one step and a new list fill less than half of the rows
  return 2 * int64_t(slot.batch.happened[slot.s]) > slot.batch.events ? WAITING : RUNNING;
}

struct Material {
  Parameters q;
  double r_eff, m_eff;
};

inline Material find_material(const Law &law, const Slot &slot, int64_t a, const Touch &touch) {
  const Batch &b = slot.batch;
  const int64_t i = slot.row(a), j = slot.row(touch.partner), size = law.len_table * law.len_table * law.width;
  Material out;
  out.q = {b.table + size * slot.s + (b.material[i] * law.len_table + b.material[j]) * law.width, nullptr};
  const double radius = b.point[POINT_WIDTH * i + 3], weight = b.heavy[3 * i] + b.heavy[3 * j];
  out.r_eff = !needs_radius(law) ? 1.0 : touch.wall ? radius : radius * touch.radius / (radius + touch.radius);
  out.m_eff = !needs_mass(law) ? 1.0 : weight > 0.0 ? 1.0 / weight : 0.0;
  return out;
}

struct Sum {  // force and torque
  double f[6];
};

// Whether entries e, e + step … of body a, which has `count`, may touch. Entries that surely do not are opened.
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
    const Vec<double> r = find_pair<DIM>(slot, own, other[k], word[k]);
    const bool apart = !slot.is_wall(word[k] >> PARTNER) && dot(r, r) > (1.0 + 1e-15) * (reach * reach);
    touches[k] = e + step * k < count && !apart;
    if (e + step * k < count && apart) open_entry(slot, a, entry + step * k);
  }
}

// Loads on body a of its entry e, whose memory is updated.
template <int DIM>
inline Sum evaluate_contact(const Law &law, const Slot &slot, int64_t a, int64_t e) {
  const int64_t now = slot.number[SLOT_NOW], list = slot.number[SLOT_LISTED];
  const double dt = slot.value[PACE_DT], radius = slot.point(a, now)[3], *own = slot.motion(a, now);
  int64_t *entry = slot.entry(a, list) + e;
  const int64_t word = *entry, before = word & MODE;
  const Touch touch = find_touch<DIM>(slot, a, word, now);
  if (touch.overlap <= 0.0) {
    open_entry(slot, a, entry);
    return {};
  }
  double *slip[3];
  for (int k = 0; k < 3; ++k) slip[k] = slot.slip(a, list, k) + e;
  const Material material = find_material(law, slot, a, touch);
  const Parameters q = material.q;
  const Vec<double> n = touch.n;
  const double overlap = touch.overlap, inverse = touch.inverse, *other = slot.motion(touch.partner, now);
  const Vec<double> d = dt * flat<DIM>(at(own) - at(other));
  const Vec<double> roll = dt * rolled<DIM>(radius, own + 3, touch.radius, other + 3);
  const Ratio<double> fraction = before == OPEN ? touching_fraction(n, inverse, overlap, d) : Ratio<double>{1.0, 1.0};
  Vec<double> s = {0.0, 0.0, 0.0};
  if (before != OPEN) s = {*slip[0], *slip[1], DIM == 3 ? *slip[2] : 0.0};
  const Elastic<double> spring = built_in(law, q, material.r_eff, overlap);
  const Transport<double> moved = transport_slip(law, false, n, inverse, overlap, d, roll, s);
  double fn = spring.force, damping = 0.0;
  Vec<double> v = {0.0, 0.0, 0.0};
  if (law.damping) {
    v = at_contact(n, flat<DIM>(at(own + 6) - at(other + 6)), rolled<DIM>(radius, own + 9, touch.radius, other + 9));
    const double vn = dot(v, n), factor = damping_factor(law, material.r_eff, material.m_eff, overlap, fn);
    v = v - vn * n;
    fn = with_dashpot(law, fn, factor * q[DAMPING_N], vn);
    damping = factor * q[DAMPING_T];
  }
  const double limit = coulomb_limit(q, fn, false);
  const Loads<double, bool> out = contact_loads<DIM>(law, false, FREE, false, fn, spring.stiffness, damping, limit,
                                                     overlap, radius + touch.radius, moved, fraction, before == SLIDE, v);
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

// Ends a step with half a kick (`half`) and begins the next one (`go_on`), as `move_body` in `motion.cpp`; from one
// buffer of the motion to another.
template <int DIM>
inline void move(const Slot &slot, int64_t a, const double *f, bool half, bool go_on, int64_t from, int64_t to) {
  const Batch &b = slot.batch;
  const double *value = slot.value, *x = slot.point(a, from), *was = slot.motion(a, from);
  const double kick[2] = {b.kick[2 * slot.row(a)], b.kick[2 * slot.row(a) + 1]}, dt = value[PACE_DT];
  const double keep[2] = {value[PACE_KEEP], value[PACE_KEEP_T]}, slow[2] = {value[PACE_SLOW], value[PACE_SLOW_T]};
  const uint8_t *free = b.free + 6 * slot.row(a);
  double rate[6], ahead[6], place[3] = {x[0], x[1], x[2]};
  for (int k = 0; k < 6; ++k) {
    rate[k] = was[k], ahead[k] = was[6 + k];
    if (free[k]) {
      if (half) rate[k] = (rate[k] + kick[k / 3] * f[k]) * slow[k / 3];
      if (go_on) rate[k] = keep[k / 3] * rate[k] + kick[k / 3] * f[k];
    }
    if (go_on) ahead[k] = free[k] ? slow[k / 3] * (rate[k] + kick[k / 3] * f[k]) : rate[k];
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

inline void store_force(const Slot &slot, int64_t a, const double *f) {
  for (int k = 0; k < 6; ++k) slot.batch.force[6 * slot.row(a) + k] = f[k];
}

// Ends the step of grain a, and begins the next one, with the loads of its contacts.
template <int DIM>
inline void end_step(const Slot &slot, int64_t a, const double *loads) {
  const int64_t now = slot.number[SLOT_NOW];
  const bool go_on = slot.number[SLOT_STEP] != slot.number[SLOT_NEXT];
  double f[6];
  for (int k = 0; k < 6; ++k) f[k] = slot.batch.external[6 * slot.row(a) + k] + loads[k];
  const bool single = a < slot.number[SLOT_SINGLE];
  if (!single || !go_on) store_force(slot, a, f);
  if (single) move<DIM>(slot, a, f, true, go_on, now, 1 - now);
}

// Pull of the springs on body a.
inline double spring_force(const Slot &slot, int64_t a, int k, int64_t now) {
  const Batch &b = slot.batch;
  const double *spring = b.spring + 6 * slot.row(a);
  if (!(spring[k] > 0.0)) return 0.0;
  const int64_t c = b.leads[3 * slot.row(a) + k];
  const double *knot = b.knot + b.knots * slot.s, *course = b.course + b.knots * b.courses * slot.s;
  const double ahead = c < 0 ? 0.0 : course_at(knot, b.knots, course, b.courses, c, slot.value[PACE_CLOCK]).value;
  return spring[k] * (spring[3 + k] + ahead - slot.point(a, now)[k]);
}

// Adds up the first `sums` sums of all threads, in ROWS parts; the sum of these is `reduced`.
template <class Team>
inline void reduce(const Slot &slot, const Team &team, int64_t sums) {
  double *partial = slot.batch.partial + TEAM * SUMS * slot.s;
  team.each([&](int64_t t) {
    for (int64_t k = t / ROWS; k < sums; k += TEAM / ROWS) {
      double total = 0.0;
      for (int64_t m = t % ROWS; m < TEAM; m += ROWS) total += partial[SUMS * m + k];
      partial[SUMS * (t % ROWS) + k] = total;
    }
  });
}

inline double reduced(const Slot &slot, int64_t k) {
  const double *partial = slot.batch.partial + TEAM * SUMS * slot.s;
  double total = 0.0;
  for (int64_t m = 0; m < ROWS; ++m) total += partial[SUMS * m + k];
  return total;
}

// Springs, rigid groups, walls and counters of one system, after all grains have ended their step.
template <int DIM, class Team>
inline void finish_step(const Slot &slot, const Team &team) {
  const Batch &b = slot.batch;
  int64_t *number = slot.number;
  const int64_t now = number[SLOT_NOW], single = number[SLOT_SINGLE], bodies = number[SLOT_BODIES];
  const bool go_on = number[SLOT_STEP] != number[SLOT_NEXT];
  const int64_t *members = b.members + (b.groups + 1) * slot.s, rest = b.groups ? members[b.groups] : single;
  team.each([&](int64_t t) {
    double *partial = b.partial + TEAM * SUMS * slot.s + SUMS * t;
    for (int64_t g = 0; g < b.groups; ++g) {
      double total[3] = {};
      for (int64_t a = members[g] + t; a < members[g + 1]; a += TEAM)
        for (int k = 0; k < 3; ++k) total[k] += b.force[6 * slot.row(a) + k] + spring_force(slot, a, k, now);
      for (int k = 0; k < 3; ++k) partial[3 * g + k] = total[k];
    }
  });
  reduce(slot, team, 3 * b.groups);
  team.each([&](int64_t t) {
    for (int64_t g = 0; g < b.groups; ++g) {
      const double total[3] = {reduced(slot, 3 * g), reduced(slot, 3 * g + 1), reduced(slot, 3 * g + 2)};
      for (int64_t a = members[g] + t; a < members[g + 1]; a += TEAM) {
        double *f = b.force + 6 * slot.row(a);
        for (int k = 0; k < 3; ++k) f[k] = total[k];
        move<DIM>(slot, a, f, true, go_on, now, 1 - now);
      }
    }
    for (int64_t a = rest + t; a < bodies; a += TEAM) {
      double *f = b.force + 6 * slot.row(a);
      for (int k = 0; k < 3; ++k) f[k] += spring_force(slot, a, k, now);
      move<DIM>(slot, a, f, true, go_on, now, 1 - now);
    }
  });
  team.once([&] {
    number[SLOT_NOW] = 1 - now;
    number[SLOT_STEP] += go_on;
    if (go_on) slot.value[PACE_CLOCK] += slot.value[PACE_DT];
    number[SLOT_PHASE] = !go_on ? SAMPLING : number[SLOT_BROKEN] ? BROKE : number[SLOT_MOVED_FAR] ? LISTING : run_or_wait(slot);
  });
}

// Begins the step after a sample.
template <int DIM>
inline void begin_step(const Slot &slot, int64_t a) {
  const int64_t now = slot.number[SLOT_NOW];
  move<DIM>(slot, a, slot.batch.force + 6 * slot.row(a), false, true, now, now);
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

// Sorts the grains of one system into bins.
template <class Team>
inline void sort_into_bins(const Slot &slot, const Team &team) {
  const Batch &b = slot.batch;
  int64_t *number = slot.number;
  team.once([&] {
    if (number[SLOT_PHASE] == BEGINNING) {
      number[SLOT_STEP] += 1;
      slot.value[PACE_CLOCK] += slot.value[PACE_DT];
      number[SLOT_PHASE] = number[SLOT_BROKEN] ? BROKE : number[SLOT_MOVED_FAR] ? LISTING : run_or_wait(slot);
    }
  });
  if (number[SLOT_PHASE] != LISTING) return;
  const int64_t grains = number[SLOT_GRAINS], now = number[SLOT_NOW], *bins = number + SLOT_BINS;
  const int64_t count = bins[0] * bins[1] * bins[2];
  int32_t *bound = b.bound + (b.room + 1) * slot.s, *bin = b.bin + slot.row(0), *binned = b.binned + slot.row(0);
  team.each([&](int64_t t) {
    for (int64_t k = t; k <= count; k += TEAM) bound[k] = 0;
  });
  team.each([&](int64_t t) {
    for (int64_t a = t; a < grains; a += TEAM) {
      int64_t box, at_bin = 0;
      for (int k = 0; k < 3; ++k) at_bin = at_bin * bins[k] + bin_along(slot, at(slot.point(a, now)), k, &box);
      bin[a] = int32_t(at_bin);
      fetch_add(bound + at_bin + 1, 1);
    }
    for (int64_t a = t; a < number[SLOT_BODIES]; a += TEAM)
      for (int k = 0; k < 3; ++k) b.origin[3 * slot.row(a) + k] = slot.point(a, now)[k];
  });
  // prefix sums: each thread adds up a stretch of bins, then the stretches before it
  const int64_t stretch = (count + TEAM - 1) / TEAM;
  double *sums = b.partial + TEAM * SUMS * slot.s;
  team.each([&](int64_t t) {
    int32_t total = 0;
    for (int64_t k = stretch * t; k < stretch * (t + 1) && k < count; ++k) total += bound[k + 1];
    sums[t] = total;
  });
  team.each([&](int64_t t) {
    int32_t total = 0;
    for (int64_t k = 0; k < t; ++k) total += sums[k];
    for (int64_t k = stretch * t; k < stretch * (t + 1) && k < count; ++k) bound[k + 1] = total += bound[k + 1];
  });
  team.each([&](int64_t t) {  // bodies from the last place of a bin on; their order does not matter
    for (int64_t a = t; a < grains; a += TEAM) binned[fetch_add(bound + bin[a] + 1, -1) - 1] = int32_t(a);
  });
}

// First and last place of a bin in `binned`: the last loop above has moved each bound to the begin of its bin.
struct Bin {
  int32_t first, last;
};

inline Bin bin_at(const Slot &slot, int64_t bin, int64_t bins) {
  const int32_t *bound = slot.batch.bound + (slot.batch.room + 1) * slot.s;
  return {bound[bin + 1], bin + 2 <= bins ? bound[bin + 2] : int32_t(slot.number[SLOT_GRAINS])};
}

// Keys of all bodies within reach of grain a, unsorted. Returns their number, which may be larger than there is room for,
// or −1 if one is more periodic boxes apart than a key can hold.
template <int DIM>
inline int64_t find_partners(const Slot &slot, int64_t a, int64_t *key) {
  const Batch &b = slot.batch;
  const int64_t now = slot.number[SLOT_NOW], *bins = slot.number + SLOT_BINS, count = bins[0] * bins[1] * bins[2];
  const double *own = slot.point(a, now), *vectors = b.vectors + 9 * slot.s, skin = slot.value[PACE_SKIN];
  const Vec<double> x = at(own);
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
    const Bin at_bin = bin_at(slot, bin, count);
    for (int64_t m = at_bin.first; m < at_bin.last; ++m) {
      const int64_t c = b.binned[slot.row(m)];
      const double *there = slot.point(c, now);
      int64_t image[3];
      Vec<double> r = flat<DIM>(x - at(there));
      for (int k = 0; k < 3; ++k) {
        bin_along(slot, at(there), k, other + k);
        image[k] = other[k] - box[k] - cross[k];
        if (image[k]) r = r + double(image[k]) * flat<DIM>(at(vectors + 3 * k));
      }
      if (c == a && !image[0] && !image[1] && !image[2]) continue;
      const double reach = own[3] + there[3] + skin;
      if (!(dot(r, r) < reach * reach)) continue;
      for (int k = 0; k < 3; ++k)
        if (image[k] < -IMAGE_HALF || image[k] >= IMAGE_HALF) return -1;
      if (many < b.most) key[many] = make_key(c, image[0], image[1], image[2]);
      ++many;
    }
  }
  for (int64_t w = slot.number[SLOT_GRAINS]; w < slot.number[SLOT_BODIES]; ++w) {
    const Vec<double> r = flat<DIM>(x - at(slot.point(w, now)));
    if (!(dot(r, at(b.normal + 3 * slot.row(w))) - own[3] < skin)) continue;
    if (many < b.most) key[many] = make_key(w, 0, 0, 0);
    ++many;
  }
  return many;
}

// New list of grain a, with the memory of the former.
template <int DIM>
inline void build_list(const Slot &slot, int64_t a) {
  const int64_t old = slot.number[SLOT_LISTED], list = 1 - old, before = slot.entries(a, old);
  int64_t *entry = slot.entry(a, list), *former = slot.entry(a, old), many = find_partners<DIM>(slot, a, entry);
  if (many < 0 || many > slot.batch.most) {
    slot.number[SLOT_CHANGED] = many;  // tells that a list cannot be made, or is full
    many = many < 0 ? 0 : slot.batch.most;
  }
  for (int64_t c = 1; c < many; ++c) {
    const int64_t key = entry[c];
    int64_t d = c;
    for (; d > 0 && entry[d - 1] > key; --d) entry[d] = entry[d - 1];
    entry[d] = key;
  }
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

// sums over grains for a sample, in the order in which a thread adds them; entries count half if both bodies are grains
constexpr int64_t MSD = 0, KINETIC = 1, CENTER = 2, TOUCHING = 5, SLIDING = 6, VIRIAL = 7, FABRIC = 16, FLUX = 25;
constexpr int64_t CONTACTS = 34, LOOSE_GRAINS = 35, HELD = 36, BEARING = 37;

inline void add_square(double *out, double factor, Vec<double> a, Vec<double> b) {  // factor a ⊗ b
  const double left[3] = {a.x, a.y, a.z}, right[3] = {b.x, b.y, b.z};
  for (int k = 0; k < 9; ++k) out[k] += factor * left[k / 3] * right[k % 3];
}

template <int DIM>
inline void add_grain(const Law &law, const Slot &slot, int64_t a, double *sum) {
  const Batch &b = slot.batch;
  const int64_t now = slot.number[SLOT_NOW], list = slot.number[SLOT_LISTED], row = slot.row(a);
  const double *x = slot.point(a, now), *motion = slot.motion(a, now), *heavy = b.heavy + 3 * row;
  const Vec<double> way = at(x) - at(b.reference + 3 * row), v = at(motion), w = at(motion + 3);
  sum[MSD] += dot(way, way);
  sum[KINETIC] += 0.5 * heavy[1] * dot(v, v) + 0.5 * heavy[2] * dot(w, w);
  for (int k = 0; k < 3; ++k) sum[CENTER + k] += x[k];
  add_square(sum + FLUX, heavy[1], v, v);
  for (int64_t e = 0; e < slot.entries(a, list); ++e) {
    const int64_t word = slot.entry(a, list)[e], mode = word & MODE;
    if (mode == OPEN) continue;
    const Touch touch = find_touch<DIM>(slot, a, word, now);
    const double part = touch.wall ? 1.0 : 0.5;
    sum[TOUCHING] += part;
    sum[SLIDING] += mode == SLIDE ? part : 0.0;
    sum[CONTACTS] += 1.0;
    add_square(sum + FABRIC, part, touch.n, touch.n);
    if (touch.wall) continue;
    const Material material = find_material(law, slot, a, touch);
    const Elastic<double> spring = built_in(law, material.q, material.r_eff, touch.overlap);
    const Vec<double> s = {slot.slip(a, list, 0)[e], slot.slip(a, list, 1)[e], DIM == 3 ? slot.slip(a, list, 2)[e] : 0.0};
    const double limit = coulomb_limit(material.q, spring.force, false);
    const Vec<double> f = spring.force * touch.n + tangential_force(law.smooth, spring.stiffness, limit, s);
    add_square(sum + VIRIAL, 0.5, f, touch.r);
  }
}

// Counts the contacts between bodies that are not loose, of each body (`unit` null) or of its rigid group.
template <class Team>
inline void count_contacts(const Slot &slot, const Team &team, const int32_t *unit) {
  const Batch &b = slot.batch;
  const int64_t list = slot.number[SLOT_LISTED], first = slot.row(0);
  team.each([&](int64_t t) {
    for (int64_t a = t; a < slot.number[SLOT_GRAINS]; a += TEAM)
      for (int64_t e = 0; e < slot.entries(a, list); ++e) {
        const int64_t word = slot.entry(a, list)[e], p = word >> PARTNER;
        const int64_t i = unit ? unit[first + a] : a, j = unit ? unit[first + p] : p;
        if ((word & MODE) == OPEN || i == j || b.loose[first + i] || b.loose[first + j]) continue;
        fetch_add(b.touching + first + i, 1);
        if (slot.is_wall(p)) fetch_add(b.touching + first + j, 1);
      }
  });
}

// Marks rattlers: see `measure.rattlers`.
template <class Team>
inline void mark_rattlers(const Slot &slot, const Team &team) {
  const Batch &b = slot.batch;
  const int64_t bodies = slot.number[SLOT_BODIES], first = slot.row(0);
  team.each([&](int64_t t) {
    for (int64_t a = t; a < bodies; a += TEAM) b.loose[first + a] = 0;
  });
  for (bool peeled = true; peeled;) {
    team.each([&](int64_t t) {
      if (t == 0) slot.number[SLOT_CHANGED] = 0;
      for (int64_t a = t; a < bodies; a += TEAM) b.touching[first + a] = b.supports[first + a];
    });
    count_contacts(slot, team, b.unit);
    team.each([&](int64_t t) {
      for (int64_t a = t; a < bodies; a += TEAM)
        if (b.touching[first + b.unit[first + a]] < b.least && !b.loose[first + a])
          b.loose[first + a] = 1, slot.number[SLOT_CHANGED] = 1;
    });
    peeled = slot.number[SLOT_CHANGED];
    team.each([](int64_t) {});  // all threads have read it
  }
  team.each([&](int64_t t) {
    if (t == 0) slot.number[SLOT_CHANGED] = 0;
    for (int64_t a = t; a < bodies; a += TEAM) b.touching[first + a] = 0;
  });
  count_contacts(slot, team, nullptr);
}

inline void write_row(const Slot &slot, double *row) {
  const Batch &b = slot.batch;
  const double grains = double(slot.number[SLOT_GRAINS]);
  double sum[SUMS];
  for (int64_t k = 0; k < SUMS; ++k) sum[k] = reduced(slot, k);
  const auto copy = [&](const double *from, int64_t width, double whole) {
    for (int64_t k = 0; k < width; ++k) *row++ = from[k] / whole;
  };
  *row++ = slot.value[PACE_START] + double(slot.number[SLOT_STEP]) * slot.value[PACE_DT];
  copy(sum + MSD, 2, 1.0);
  copy(sum + CENTER, 3, grains);
  copy(sum + TOUCHING, 2, 1.0);
  copy(sum + VIRIAL, 9, 1.0);
  copy(sum + FABRIC, 9, sum[TOUCHING] > 0.0 ? sum[TOUCHING] : 1.0);
  copy(sum + FLUX, 9, 1.0);
  copy(sum + CONTACTS, 1, grains);
  copy(sum + HELD, 1, sum[BEARING] > 0.0 ? sum[BEARING] : 1.0);
  copy(sum + LOOSE_GRAINS, 1, 1.0);
  copy(b.vectors + 9 * slot.s, 9, 1.0);
}

// Motion and loads of a rigid group, see `write_groups` in `core/dynamics/record.py`.
template <class Team>
inline void write_group(const Slot &slot, const Team &team, int64_t g, double *row) {
  const Batch &b = slot.batch;
  const int64_t now = slot.number[SLOT_NOW], *members = b.members + (b.groups + 1) * slot.s;
  double *partial = b.partial + TEAM * SUMS * slot.s;
  team.each([&](int64_t t) {
    double *sum = partial + SUMS * t;
    for (int k = 0; k < 10; ++k) sum[k] = 0.0;
    for (int64_t a = members[g] + t; a < members[g + 1]; a += TEAM) {
      const double mass = slot.is_wall(a) ? 1.0 : b.heavy[3 * slot.row(a) + 1];
      sum[0] += mass;
      for (int k = 0; k < 3; ++k) {
        sum[1 + k] += mass * slot.point(a, now)[k];
        sum[4 + k] += b.external[6 * slot.row(a) + k];
        sum[7 + k] += spring_force(slot, a, k, now);
      }
    }
  });
  reduce(slot, team, 10);
  team.once([&] {
    for (int k = 0; k < 3; ++k) {
      const double pull = reduced(slot, 7 + k);
      row[k] = reduced(slot, 1 + k) / reduced(slot, 0);
      row[3 + k] = slot.motion(members[g], now)[k];
      row[6 + k] = b.force[6 * slot.row(members[g]) + k] - reduced(slot, 4 + k) - pull;
      row[9 + k] = pull;
    }
  });
}

template <int DIM, class Team>
inline void write_sample(const Law &law, const Slot &slot, const Team &team) {
  const Batch &b = slot.batch;
  int64_t *number = slot.number;
  const int64_t at_row = b.samples * slot.s + number[SLOT_ROWS];
  double *partial = b.partial + TEAM * SUMS * slot.s;
  const bool due = number[SLOT_EVERY] && number[SLOT_STEP] % number[SLOT_EVERY] == 0;
  if (due) {
    for (int64_t g = 0; g < b.groups; ++g)
      if (b.members[(b.groups + 1) * slot.s + g] < b.members[(b.groups + 1) * slot.s + g + 1])
        write_group(slot, team, g, b.group + 12 * (b.groups * at_row + g));
    mark_rattlers(slot, team);
    team.each([&](int64_t t) {
      double *sum = partial + SUMS * t;
      for (int64_t k = 0; k < SUMS; ++k) sum[k] = 0.0;
      for (int64_t a = t; a < number[SLOT_GRAINS]; a += TEAM) {
        add_grain<DIM>(law, slot, a, sum);
        sum[LOOSE_GRAINS] += b.loose[slot.row(a)];
        sum[HELD] += b.touching[slot.row(a)];
        sum[BEARING] += b.touching[slot.row(a)] > 0;
      }
    });
    reduce(slot, team, SUMS);
    team.each([&](int64_t t) {
      for (int64_t a = t; a < number[SLOT_GRAINS] && a < b.tracks; a += TEAM) {
        double *row = b.track + 6 * (b.tracks * at_row + a);
        for (int k = 0; k < 3; ++k) row[k] = slot.point(a, number[SLOT_NOW])[k], row[3 + k] = b.angle[3 * slot.row(a) + k];
      }
    });
  }
  team.once([&] {
    if (due) write_row(slot, b.series + COLUMNS * at_row), number[SLOT_ROWS] += 1;
    number[SLOT_NEXT] += number[SLOT_EVERY];
    if (number[SLOT_EVERY] == 0 || number[SLOT_NEXT] > number[SLOT_STOP]) number[SLOT_NEXT] = number[SLOT_STOP];
    number[SLOT_PHASE] = number[SLOT_STEP] == number[SLOT_STOP] ? FINISHED : BEGINNING;
  });
}

}  // namespace batch
