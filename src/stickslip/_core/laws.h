// Contact laws as scalar functions of numbers, vectors of numbers, or numbers with a derivative.
#pragma once
#include "core.h"
#include "vector.h"

// parameters that every law has, and models of damping
constexpr int64_t KN = 0, KT = 1, MU = 2, DAMPING_N = 3, DAMPING_T = 4;
constexpr int64_t VELOCITY_DAMPING = 1, MASS_DAMPING = 2, VISCOELASTIC = 3, TSUJI = 8;  // TSUJI + 1: RESTITUTION

template <class T>
struct Elastic {
  T force, stiffness;  // of the normal spring, and of the unmobilised tangential one
};

template <class T>
struct Slopes {
  T first, second;
};

// Parameters of a pair of materials, and the additional memory of a contact if the law has any.
struct Parameters {
  const double *table, *memory;
  Parameters(const double *table = nullptr, const double *memory = nullptr) : table(table), memory(memory) {}
  double operator[](int64_t k) const { return table[k]; }
};

inline const double *parameters(const Law &law, int64_t a, int64_t b) {
  return law.table + (a * law.len_table + b) * law.width;
}

inline bool has_moments(const Law &law) { return law.rolling || law.roll_at || law.twist_at; }

inline bool needs_radius(const Law &law) {
  return law.uses_radius || law.damping == VISCOELASTIC || has_moments(law);
}
// Return true if the slip of a contact changes with its overlap.
inline bool fades(const Law &law) { return law.rescaled || law.keeps_force; }
inline bool needs_mass(const Law &law) { return law.damping >= MASS_DAMPING; }

// Elastic normal force and tangential stiffness of a built-in law; overlap > 0.
template <class T>
inline Elastic<T> built_in(const Law &law, Parameters q, T r_eff, T overlap) {
  if (!law.hertz) return {q[KN] * overlap, T{} + q[KT]};
  T radius = root(law.uses_radius ? overlap * r_eff : overlap);
  return {q[KN] * overlap * radius, q[KT] * radius};
}

// Result of a function of a user-defined law at one contact.
inline Slopes<double> call(void *function, Parameters q, double r_eff, double overlap, double fn) {
  double one = 0.0, two = 0.0;
  reinterpret_cast<LawFunction>(function)(q.table, 1, &r_eff, &overlap, &fn, q.memory, &one, &two);
  return {one, two};
}

inline Elastic<double> elastic(const Law &law, Parameters q, double r_eff, double overlap) {
  if (!law.force) return built_in(law, q, r_eff, overlap);
  Slopes<double> found = call(law.force, q, r_eff, overlap, 0.0);
  return {found.first, found.second};
}

// Derivatives dF_n/dδ and dk_t/dδ.
inline Slopes<double> tangents(const Law &law, Parameters q, double r_eff, double overlap) {
  if (law.slopes) return call(law.slopes, q, r_eff, overlap, 0.0);
  Elastic<Dual> found = built_in(law, q, Dual{r_eff, 0.0}, Dual{overlap, 1.0});
  return {found.force.slope, found.stiffness.slope};
}

// Factor k_t(old)/k_t by which a slip changes if the force of its spring is kept.
template <class T>
inline T kept_force(T stiffness, T former) {
  auto both = (stiffness > 0.0) & (former > 0.0);
  return select(both, former / select(both, stiffness, T{} + 1.0), T{} + 1.0);
}

inline double kept_force(const Law &law, Parameters q, double r_eff, double stiffness, double old_overlap) {
  return law.keeps_force ? kept_force(stiffness, elastic(law, q, r_eff, old_overlap).stiffness) : 1.0;
}

// Contact radius a and da/dδ: the factor of k_t in LAMMPS laws, or √(δ R_eff).
template <class T>
inline Slopes<T> contact_radius(const Law &law, Parameters q, T r_eff, T overlap, T stiffness, T slope) {
  if (law.hertz && law.uses_radius && q[KT] > 0.0) return {stiffness / q[KT], slope / q[KT]};
  auto touches = overlap > 0.0;
  T depth = select(touches, overlap, T{} + 1.0), a = select(touches, root(depth * r_eff), T{});
  return {a, 0.5 * a / depth};
}

inline double range(const Law &law, Parameters q, double r_eff) {
  return law.range ? call(law.range, q, r_eff, 0.0, 0.0).first : 0.0;
}

// Largest gap at which a pair acts; `open`: it has not touched.
inline double reach(const Law &law, Parameters q, double r_eff, bool open) {
  return law.bonds && open ? 0.0 : range(law, q, r_eff);
}

inline double *own_memory(const Law &law, const Contacts &contacts, int64_t c) {
  return contacts.rolling + contacts.width_rolling * c + law.angular;
}

// Additional memory of contact c, that of a new contact if it is open.
inline const double *memory_at(const Law &law, const Contacts &contacts, int64_t c) {
  bool has = contacts.width_rolling == law.angular + law.len_memory;
  return law.len_memory && has && contacts.mode[c] != OPEN ? own_memory(law, contacts, c) : law.memory;
}

// Whether the additional memory of contact c differs from that of a new contact.
inline bool has_own_memory(const Law &law, const Contacts &contacts, int64_t c) {
  const double *own = own_memory(law, contacts, c);
  bool same = true;
  for (int64_t k = 0; k < law.len_memory; ++k) same &= own[k] == law.memory[k];
  return !same;
}

inline void update_memory(const Law &law, Parameters q, double r_eff, double overlap, double *own) {
  double fn = 0.0, unused;
  reinterpret_cast<LawFunction>(law.update)(q.table, 1, &r_eff, &overlap, &fn, q.memory, own, &unused);
}

// Coulomb limit of a law without a user-defined cap; `viscous_rate`: as in LAMMPS, which uses |F_n|.
template <class T>
inline T coulomb_limit(Parameters q, T fn, bool viscous_rate) {
  return q[MU] * (viscous_rate ? magnitude(fn) : larger(fn, T{}));
}

inline double cap(const Law &law, Parameters q, double r_eff, double overlap, double fn, bool viscous_rate = false) {
  if (law.cap) return call(law.cap, q, r_eff, overlap, fn).first;
  return coulomb_limit(q, fn, viscous_rate && !law.force);
}

// Derivatives of the cap with respect to F_n and to the overlap, where F_n > 0.
inline Slopes<double> cap_slopes(const Law &law, Parameters q, double r_eff, double overlap, double fn) {
  if (law.cap_slopes) return call(law.cap_slopes, q, r_eff, overlap, fn);
  return {q[MU], 0.0};
}

inline double normal_energy(const Law &law, Parameters q, double r_eff, double overlap) {
  if (law.energy) return call(law.energy, q, r_eff, overlap, 0.0).first;
  return built_in(law, q, r_eff, overlap).force * overlap / (law.hertz ? 2.5 : 2.0);
}

// Factor on the damping coefficients; `force` is that of the normal spring.
template <class T>
inline T damping_factor(const Law &law, T r_eff, T m_eff, T overlap, T force) {
  T factor = T{} + 1.0;
  if (law.damping >= TSUJI) {
    auto touches = overlap > 0.0;
    factor = root(m_eff * select(touches, larger(force, T{}), T{}) / select(touches, overlap, factor));
  }
  if (law.damping == VISCOELASTIC) factor = m_eff * root(overlap * r_eff);
  if (law.damping == MASS_DAMPING) factor = m_eff;
  return law.range ? select(overlap > 0.0, factor, T{}) : factor;  // there is no damping across a gap
}

// Factor on the tangential stiffness of a spring whose force k_t |s| is a fraction x of the Coulomb limit.
template <class T>
inline T mobilisation(T x) {
  return 1.0 + x - x * x;
}

inline double mobilisation_tangent(double x) { return 1.0 - 2.0 * x; }
