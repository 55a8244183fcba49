#include "loop.h"
#include "observables.h"

namespace {

struct Sample {
  static constexpr bool FROM_BOTH = false;
  const Law &law;
  int dim;
  const Bodies &body;
  const Contacts &contacts;
  const double *shift;  // (C, 3)
  const double *cell;
  const Writing &writing;
  double now;
  bool friction;
  int64_t *is_loose, *contact_count;  // (B,)
  mutable int64_t peeled;
  mutable double sum[Observables::SUMS];

  double time() const { return now; }
  const double *vectors() const { return cell; }
  int64_t bodies() const { return body.len_radius; }
  int64_t grains() const { return body.len_radius - body.len_normal; }
  double divisor() const { return double(grains()); }  // of each term of a mean, which a batch divides as a sum
  Vec<double> position(int64_t a) const { return read(body.position + 3 * a); }
  Vec<double> velocity(int64_t a) const { return read(body.velocity + 3 * a); }
  Vec<double> spin(int64_t a) const { return read(body.spin + 3 * a); }
  Vec<double> reference(int64_t a) const { return read(writing.reference + 3 * a); }
  double mass(int64_t a) const { return writing.mass[a]; }
  double inertia(int64_t a) const { return writing.inertia[a]; }
  int64_t unit(int64_t a) const { return writing.unit[a]; }
  int64_t supports(int64_t a) const { return writing.supports[a]; }
  int64_t least() const { return friction ? 2 : dim + 1; }
  int64_t &loose(int64_t a) const { return is_loose[a]; }
  int64_t &held(int64_t a) const { return contact_count[a]; }
  int64_t &changed() const { return peeled; }
  void count(int64_t a) const { ++contact_count[a]; }
  // with the same last bits as in `linear.cpp`
  void add_virial(double *row) const { ::add_virial(&law, dim, &body, &contacts, shift, row); }

  double total(int64_t k) const { return sum[k]; }
  template <class Team, class Add>
  void add_up(const Team &, int64_t count, const Add &add) const {
    for (int64_t k = 0; k < count; ++k) sum[k] = 0.0;
    add(0, sum);
  }
  template <class Act>
  void each_closed(int64_t, const Act &act) const {
    for (int64_t c = 0; c < contacts.count[0]; ++c)
      if (contacts.mode[c] != OPEN) act(contacts.i[c], contacts.j[c], c);
  }
  Seen seen(int64_t, int64_t, int64_t c) const {
    const Pair pair = pair_at(law, dim, body, contacts, shift, c);
    return {pair, contacts.mode[c] == SLIDE, elastic_force(law, contacts, pair, c), true, 1.0, 1.0};
  }
};

bool has_friction(const Law &law) {
  for (int64_t k = 0; k < law.len_table * law.len_table; ++k)
    if (law.table[k * law.width + MU] > 0.0) return true;
  return false;
}

bool sample(const Law &law, int64_t dim, int64_t k, const Bodies &bodies, const Contacts &contacts,
            const double *vectors, const Writing &writing, double time) {
  Scratch scratch;
  double *shift;
  int64_t *loose, *held;
  if (!scratch.take(shift, 3 * contacts.count[0]) || !scratch.take(loose, bodies.len_radius) ||
      !scratch.take(held, bodies.len_radius))
    return false;
  find_shifts(contacts.image, contacts.count[0], vectors, shift);
  const Sample s = {law, int(dim), bodies, contacts, shift, vectors, writing, time, has_friction(law), loose, held, 0, {}};
  write_sample(s, InTurn<1>(), writing.series + Observables::WIDTH * k);
  double *track = writing.tracks + 6 * writing.len_probes * k;
  for (int64_t a = 0; a < writing.len_probes; ++a, track += 6) {
    memcpy(track, bodies.position + 3 * writing.probes[a], 3 * sizeof(double));
    memcpy(track + 3, bodies.angle + 3 * writing.probes[a], 3 * sizeof(double));
  }
  return true;
}

struct Column {
  const char *name;
  int64_t width;
};

template <class... Ones>
Column column(Table<Ones...>, int64_t k) {
  constexpr Column all[] = {{Ones::NAME, Ones::WIDTH}...};
  return k < int64_t(sizeof...(Ones)) ? all[k] : Column{nullptr, 0};
}

}  // namespace

void find_shifts(const int16_t *image, int64_t count, const double *vectors, double *shift) {
  for (int64_t c = 0; c < count; ++c, image += 3)
    for (int m = 0; m < 3; ++m)
      shift[3 * c + m] = image[0] * vectors[m] + image[1] * vectors[3 + m] + image[2] * vectors[6 + m];
}

const char *observable_name(int64_t k) { return column(Observables(), k).name; }
int64_t observable_width(int64_t k) { return column(Observables(), k).width; }

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
