#include "record.h"

#include "blocks.h"
#include "memory.h"
#include "pairs.h"

namespace {

struct Rattlers {
  int64_t number, held, bearing;  // of rattlers, of contacts of the other grains, and of those that have any
};

struct Sample {
  const Law &law;
  int dim;
  const Bodies &bodies;
  const Contacts &contacts;
  const double *shift;  // (C, 3)
  const double *vectors;
  const Writing &writing;
  double time;
  int64_t grains;
  Rattlers rattlers;

  bool closed(int64_t c) const { return contacts.mode[c] != OPEN; }
  int64_t rows() const { return contacts.count[0]; }
};

void add_square(double *out, double factor, Vec<double> a) {  // factor a ⊗ a
  const double entry[3] = {a.x, a.y, a.z};
  for (int k = 0; k < 9; ++k) out[k] += factor * entry[k / 3] * entry[k % 3];
}

void displacement(const Sample &s, double *out) {
  for (int64_t a = 0; a < s.grains; ++a) {
    const Vec<double> way = vector_at(3, s.bodies.position, a) - vector_at(3, s.writing.reference, a);
    *out += dot(way, way);
  }
}

void kinetic_energy(const Sample &s, double *out) {
  for (int64_t a = 0; a < s.grains; ++a) {
    const Vec<double> v = vector_at(3, s.bodies.velocity, a), w = vector_at(3, s.bodies.spin, a);
    *out += 0.5 * s.writing.mass[a] * dot(v, v) + 0.5 * s.writing.inertia[a] * dot(w, w);
  }
}

void center(const Sample &s, double *out) {
  for (int64_t k = 0; k < 3 * s.grains; ++k) out[k % 3] += s.bodies.position[k] / double(s.grains);
}

void virial(const Sample &s, double *out) { add_virial(&s.law, s.dim, &s.bodies, &s.contacts, s.shift, out); }

void fabric(const Sample &s, double *out) {
  int64_t closed = 0;
  for (int64_t c = 0; c < s.rows(); ++c)
    if (s.closed(c)) {
      const Vec<double> n = pair_at(s.law, s.dim, s.bodies, s.contacts, s.shift, c).n;
      add_square(out, 1.0, n);
      ++closed;
    }
  for (int k = 0; k < 9; ++k) out[k] /= closed ? double(closed) : 1.0;
}

void momentum_flux(const Sample &s, double *out) {
  for (int64_t a = 0; a < s.grains; ++a) {
    const Vec<double> v = vector_at(3, s.bodies.velocity, a);
    add_square(out, s.writing.mass[a], v);
  }
}

void coordination(const Sample &s, double *out) {
  for (int64_t c = 0; c < s.rows(); ++c)
    if (s.closed(c)) *out += s.contacts.j[c] < s.grains ? 2.0 : 1.0;
  *out /= double(s.grains);
}

struct Observable {
  const char *name;
  int64_t width;
  void (*add)(const Sample &, double *);  // to zeros
};

// in the order of `OBSERVABLES` in `core/dynamics/record.py`
constexpr Observable TABLE[] = {
    {"time", 1, [](const Sample &s, double *out) { *out = s.time; }},
    {"msd", 1, displacement},
    {"kinetic_energy", 1, kinetic_energy},
    {"center", 3, center},
    {"touching", 1, [](const Sample &s, double *out) { for (int64_t c = 0; c < s.rows(); ++c) *out += s.closed(c); }},
    {"sliding", 1,
     [](const Sample &s, double *out) { for (int64_t c = 0; c < s.rows(); ++c) *out += s.contacts.mode[c] == SLIDE; }},
    {"virial", 9, virial},
    {"fabric", 9, fabric},
    {"momentum_flux", 9, momentum_flux},
    {"coordination", 1, coordination},
    {"held_coordination", 1,
     [](const Sample &s, double *out) {
       *out = double(s.rattlers.held) / (s.rattlers.bearing ? double(s.rattlers.bearing) : 1.0);
     }},
    {"rattlers", 1, [](const Sample &s, double *out) { *out = double(s.rattlers.number); }},
    {"cell", 9, [](const Sample &s, double *out) { memcpy(out, s.vectors, 9 * sizeof(double)); }},
};
constexpr int64_t COUNT = sizeof TABLE / sizeof *TABLE;

constexpr int64_t columns() {
  int64_t sum = 0;
  for (const Observable &one : TABLE) sum += one.width;
  return sum;
}

bool has_friction(const Law &law) {
  for (int64_t k = 0; k < law.len_table * law.len_table; ++k)
    if (law.table[k * law.width + MU] > 0.0) return true;
  return false;
}

// Adds the contacts between bodies that are not loose to the number of each body, or of its rigid group.
void count_contacts(const Sample &s, const int64_t *unit, const bool *loose, int64_t *number) {
  for (int64_t c = 0; c < s.rows(); ++c) {
    int64_t i = s.contacts.i[c], j = s.contacts.j[c];
    if (unit) i = unit[i], j = unit[j];
    if (!s.closed(c) || i == j || loose[i] || loose[j]) continue;
    ++number[i];
    ++number[j];
  }
}

// See `measure.rattlers`. `loose` and `number` hold one entry per body.
Rattlers count_rattlers(const Sample &s, bool *loose, int64_t *number) {
  const int64_t bodies = s.bodies.len_radius, least = has_friction(s.law) ? 2 : s.dim + 1, *unit = s.writing.unit;
  memset(loose, 0, bodies * sizeof *loose);
  for (bool peeled = true; peeled;) {
    peeled = false;
    memcpy(number, s.writing.supports, bodies * sizeof *number);
    count_contacts(s, unit, loose, number);
    for (int64_t a = 0; a < bodies; ++a)
      if (number[unit[a]] < least && !loose[a]) loose[a] = peeled = true;
  }
  memset(number, 0, bodies * sizeof *number);
  count_contacts(s, nullptr, loose, number);
  Rattlers found = {};
  for (int64_t a = 0; a < s.grains; ++a) {
    found.number += loose[a];
    found.held += number[a];
    found.bearing += number[a] > 0;
  }
  return found;
}

bool sample(const Law &law, int64_t dim, int64_t k, const Bodies &bodies, const Contacts &contacts,
            const double *vectors, const Writing &writing, double time) {
  Scratch scratch;
  double *shift;
  bool *loose;
  int64_t *number;
  if (!scratch.take(shift, 3 * contacts.count[0]) || !scratch.take(loose, bodies.len_radius) ||
      !scratch.take(number, bodies.len_radius))
    return false;
  find_shifts(contacts.image, contacts.count[0], vectors, shift);
  const int64_t grains = bodies.len_radius - bodies.len_normal;
  Sample s = {law, int(dim), bodies, contacts, shift, vectors, writing, time, grains, {}};
  s.rattlers = count_rattlers(s, loose, number);
  double *row = writing.series + columns() * k, *track = writing.tracks + 6 * writing.len_probes * k;
  memset(row, 0, columns() * sizeof *row);
  for (const Observable &one : TABLE) {
    one.add(s, row);
    row += one.width;
  }
  for (int64_t a = 0; a < writing.len_probes; ++a, track += 6) {
    memcpy(track, bodies.position + 3 * writing.probes[a], 3 * sizeof(double));
    memcpy(track + 3, bodies.angle + 3 * writing.probes[a], 3 * sizeof(double));
  }
  return true;
}

}  // namespace

void find_shifts(const int16_t *image, int64_t count, const double *vectors, double *shift) {
  for (int64_t c = 0; c < count; ++c, image += 3)
    for (int m = 0; m < 3; ++m)
      shift[3 * c + m] = image[0] * vectors[m] + image[1] * vectors[3 + m] + image[2] * vectors[6 + m];
}

const char *observable_name(int64_t k) { return k < COUNT ? TABLE[k].name : nullptr; }
int64_t observable_width(int64_t k) { return k < COUNT ? TABLE[k].width : 0; }

bool write_moving_sample(const Law &law, int64_t dim, int64_t k, const Moving &moving, const Bodies &bodies,
                         const Contacts &contacts, const double *vectors, const Writing &writing, double time) {
  Scratch scratch;
  Bodies here = bodies;
  const int64_t size = 3 * moving.len_order;
  if (!scratch.take(here.position, size) || !scratch.take(here.velocity, size) || !scratch.take(here.spin, size) ||
      !scratch.take(here.angle, size))
    return false;
  scatter_bodies(&moving, &here);
  return sample(law, dim, k, here, contacts, vectors, writing, time);
}
