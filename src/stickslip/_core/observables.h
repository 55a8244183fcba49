// Observables of a sample, and rattlers: written once, for runs and for batches.
//
// An observable adds terms of grains and of closed contacts to sums that begin at zero, and writes its columns from
// these. The view of a system is `Sample` in `record.cpp` or in `batch.h`: `each_closed` calls its argument with bodies i
// and j of each closed contact that a thread has, and its place in a list. With `FROM_BOTH`, each grain has a list.
#pragma once
#include "pairs.h"

struct Seen : Pair {  // a closed contact
  bool slides;
  Vec<double> force;  // elastic, on i
  bool apart;  // its virial is summed separately
  double part;  // 1, or 1/2 if it is met from both of its grains
  double ends;  // grains from which it is met here
};

inline void add_square(double *out, double factor, Vec<double> a, Vec<double> b) {  // factor a ⊗ b
  const double left[3] = {a.x, a.y, a.z}, right[3] = {b.x, b.y, b.z};
  for (int k = 0; k < 9; ++k) out[k] += factor * left[k / 3] * right[k % 3];
}

template <int64_t COUNT>
struct Sums {  // which are the columns, unless an observable writes others
  static constexpr int64_t SUMS = COUNT, WIDTH = COUNT;
  template <class View>
  static void add_grain(const View &, int64_t, double *) {}
  static void add_contact(const Seen &, double *) {}
  template <class View>
  static void write(const View &, const double *sum, double *row) {
    for (int64_t k = 0; k < COUNT; ++k) row[k] = sum[k];
  }
};

struct Time : Sums<0> {
  static constexpr const char *NAME = "time";
  static constexpr int64_t WIDTH = 1;
  template <class View>
  static void write(const View &view, const double *, double *row) { *row = view.time(); }
};

struct Msd : Sums<1> {
  static constexpr const char *NAME = "msd";
  template <class View>
  static void add_grain(const View &view, int64_t a, double *sum) {
    const Vec<double> way = view.position(a) - view.reference(a);
    *sum += dot(way, way);
  }
};

struct KineticEnergy : Sums<1> {
  static constexpr const char *NAME = "kinetic_energy";
  template <class View>
  static void add_grain(const View &view, int64_t a, double *sum) {
    const Vec<double> v = view.velocity(a), w = view.spin(a);
    *sum += 0.5 * view.mass(a) * dot(v, v) + 0.5 * view.inertia(a) * dot(w, w);
  }
};

struct Center : Sums<3> {
  static constexpr const char *NAME = "center";
  template <class View>
  static void add_grain(const View &view, int64_t a, double *sum) {
    const Vec<double> x = view.position(a);
    const double entry[3] = {x.x, x.y, x.z};
    for (int k = 0; k < 3; ++k) sum[k] += entry[k] / view.divisor();
  }
  template <class View>
  static void write(const View &view, const double *sum, double *row) {
    for (int k = 0; k < 3; ++k) row[k] = sum[k] / (double(view.grains()) / view.divisor());
  }
};

struct Touching : Sums<1> {
  static constexpr const char *NAME = "touching";
  static void add_contact(const Seen &seen, double *sum) { *sum += seen.part; }
};

struct Sliding : Sums<1> {
  static constexpr const char *NAME = "sliding";
  static void add_contact(const Seen &seen, double *sum) { *sum += seen.slides ? seen.part : 0.0; }
};

struct Virial : Sums<9> {  // of contacts between grains
  static constexpr const char *NAME = "virial";
  static void add_contact(const Seen &seen, double *sum) {
    if (!seen.wall && !seen.apart) add_square(sum, seen.part, seen.force, seen.r);
  }
  template <class View>
  static void write(const View &view, const double *sum, double *row) {
    Sums<9>::write(view, sum, row);
    view.add_virial(row);
  }
};

struct Fabric : Sums<10> {  // the last one counts contacts
  static constexpr const char *NAME = "fabric";
  static constexpr int64_t WIDTH = 9;
  static void add_contact(const Seen &seen, double *sum) {
    add_square(sum, seen.part, seen.n, seen.n);
    sum[9] += seen.part;
  }
  template <class View>
  static void write(const View &, const double *sum, double *row) {
    for (int k = 0; k < 9; ++k) row[k] = sum[k] / (sum[9] > 0.0 ? sum[9] : 1.0);
  }
};

struct MomentumFlux : Sums<9> {
  static constexpr const char *NAME = "momentum_flux";
  template <class View>
  static void add_grain(const View &view, int64_t a, double *sum) {
    const Vec<double> v = view.velocity(a);
    add_square(sum, view.mass(a), v, v);
  }
};

struct Coordination : Sums<1> {
  static constexpr const char *NAME = "coordination";
  static void add_contact(const Seen &seen, double *sum) { *sum += seen.ends; }
  template <class View>
  static void write(const View &view, const double *sum, double *row) { *row = *sum / double(view.grains()); }
};

struct HeldCoordination : Sums<2> {  // contacts of grains that are not rattlers, and the number of those that have any
  static constexpr const char *NAME = "held_coordination";
  static constexpr int64_t WIDTH = 1;
  template <class View>
  static void add_grain(const View &view, int64_t a, double *sum) {
    sum[0] += double(view.held(a)), sum[1] += double(view.held(a) > 0);
  }
  template <class View>
  static void write(const View &, const double *sum, double *row) { *row = sum[0] / (sum[1] > 0.0 ? sum[1] : 1.0); }
};

struct RattlerCount : Sums<1> {
  static constexpr const char *NAME = "rattlers";
  template <class View>
  static void add_grain(const View &view, int64_t a, double *sum) { *sum += double(view.loose(a)); }
};

struct CellVectors : Sums<0> {
  static constexpr const char *NAME = "cell";
  static constexpr int64_t WIDTH = 9;
  template <class View>
  static void write(const View &view, const double *, double *row) {
    for (int k = 0; k < 9; ++k) row[k] = view.vectors()[k];
  }
};

template <class... Ones>
struct Table {
  static constexpr int64_t COUNT = sizeof...(Ones), WIDTH = (Ones::WIDTH + ...), SUMS = (Ones::SUMS + ...);
  template <class View>
  static void add_grain(const View &view, int64_t a, double *sum) {
    ((Ones::add_grain(view, a, sum), sum += Ones::SUMS), ...);
  }
  static void add_contact(const Seen &seen, double *sum) { ((Ones::add_contact(seen, sum), sum += Ones::SUMS), ...); }
  template <class View>
  static void write(const View &view, const double *sum, double *row) {
    ((Ones::write(view, sum, row), sum += Ones::SUMS, row += Ones::WIDTH), ...);
  }
};

// with the names of fields of `Record` in `core/dynamics/record.py`, which reads their widths here
using Observables = Table<Time, Msd, KineticEnergy, Center, Touching, Sliding, Virial, Fabric, MomentumFlux,
                          Coordination, HeldCoordination, RattlerCount, CellVectors>;

template <int64_t THREADS>
struct InTurn {  // a team whose threads run one after another
  static constexpr int64_t SIZE = THREADS;
  template <class Work>
  void each(const Work &work) const {
    for (int64_t t = 0; t < THREADS; ++t) work(t);
  }
  template <class Work>
  void once(const Work &work) const {
    work();
  }
};

// Counts the contacts between bodies that are not loose, of each body or, with `by_unit`, of its rigid group.
template <class View, class Team>
inline void count_held(const View &view, const Team &team, bool by_unit) {
  team.each([&](int64_t t) {
    view.each_closed(t, [&](int64_t i, int64_t j, int64_t) {
      const bool other = !View::FROM_BOTH || j >= view.grains();  // a wall has no list
      if (by_unit) i = view.unit(i), j = view.unit(j);
      if (i == j || view.loose(i) || view.loose(j)) return;
      view.count(i);
      if (other) view.count(j);
    });
  });
}

// Marks rattlers and counts the contacts of the other bodies: see `measure.rattlers`. The threads of a team share bodies.
template <class View, class Team>
inline void mark_rattlers(const View &view, const Team &team) {
  const int64_t bodies = view.bodies();
  team.each([&](int64_t t) {
    for (int64_t a = t; a < bodies; a += Team::SIZE) view.loose(a) = 0;
  });
  for (bool peeled = true; peeled;) {
    team.each([&](int64_t t) {
      if (t == 0) view.changed() = 0;
      for (int64_t a = t; a < bodies; a += Team::SIZE) view.held(a) = view.supports(a);
    });
    count_held(view, team, true);
    team.each([&](int64_t t) {
      for (int64_t a = t; a < bodies; a += Team::SIZE)
        if (view.held(view.unit(a)) < view.least() && !view.loose(a)) view.loose(a) = 1, view.changed() = 1;
    });
    peeled = view.changed();
    team.each([](int64_t) {});  // all threads have read it
  }
  team.each([&](int64_t t) {
    if (t == 0) view.changed() = 0;
    for (int64_t a = t; a < bodies; a += Team::SIZE) view.held(a) = 0;
  });
  count_held(view, team, false);
}

// Writes the columns of all observables.
template <class View, class Team>
inline void write_sample(const View &view, const Team &team, double *row) {
  mark_rattlers(view, team);
  view.add_up(team, Observables::SUMS, [&](int64_t t, double *sum) {
    for (int64_t a = t; a < view.grains(); a += Team::SIZE) Observables::add_grain(view, a, sum);
    view.each_closed(t, [&](int64_t i, int64_t j, int64_t entry) {
      Seen seen = view.seen(i, j, entry);
      seen.part = View::FROM_BOTH && !seen.wall ? 0.5 : 1.0;
      seen.ends = View::FROM_BOTH || seen.wall ? 1.0 : 2.0;
      Observables::add_contact(seen, sum);
    });
  });
  team.once([&] {
    double sum[Observables::SUMS];
    for (int64_t k = 0; k < Observables::SUMS; ++k) sum[k] = view.total(k);
    Observables::write(view, sum, row);
  });
}
