// Geometry of one contact, in the list of a state or in that of a batch.
//
// A view of bodies gives the functions `radius_of`, `inverse_mass_of`, `is_wall`, `normal_of` and `parameters_of`. The
// one of a state is `Bodies`, that of a system in a batch is `batch::Slot`.
#pragma once
#include "mechanics.h"

struct Pair {
  Vec<double> r, n;      // pair vector, and normal from j to i
  double inverse;        // 1/|r|, zero at walls, whose normal does not rotate
  double overlap;
  double r_eff, m_eff;   // 1 where the law does not use them
  Parameters q;
  bool wall, touches;    // within the range of the law
};

// Rows of (B, 3) arrays; z is zero in two dimensions.
inline Vec<double> vector_at(int dim, const double *rows, int64_t a) {
  return {rows[3 * a], rows[3 * a + 1], dim == 3 ? rows[3 * a + 2] : 0.0};
}

inline Vec<double> read(const double *v) { return {v[0], v[1], v[2]}; }

template <int DIM>
inline Vec<double> flat(Vec<double> v) {
  return {v.x, v.y, DIM == 3 ? v.z : 0.0};
}

// Rolled length R_i a_i + R_j a_j of angles or spins; the radius of a wall is zero.
template <int DIM>
inline Vec<double> rolled(double radius_i, Vec<double> a, double radius_j, Vec<double> b) {
  const Vec<double> sum = radius_i * a + radius_j * b;
  return DIM == 3 ? sum : Vec<double>{0.0, 0.0, sum.z};
}

inline void store(double *row, Vec<double> v) { row[0] = v.x, row[1] = v.y, row[2] = v.z; }

inline double radius_of(const Bodies &bodies, int64_t a) { return bodies.radius[a]; }
inline double inverse_mass_of(const Bodies &bodies, int64_t a) { return bodies.inverse_mass[a]; }
inline bool is_wall(const Bodies &bodies, int64_t a) { return a >= bodies.len_radius - bodies.len_normal; }
inline Vec<double> normal_of(const Bodies &bodies, int64_t wall) {
  return vector_at(3, bodies.normal, wall - (bodies.len_radius - bodies.len_normal));
}
inline const double *parameters_of(const Law &law, const Bodies &bodies, int64_t i, int64_t j) {
  return parameters(law, bodies.material[i], bodies.material[j]);
}

template <class View>
inline double effective_radius(const View &view, int64_t i, int64_t j, bool wall) {
  const double a = radius_of(view, i), b = radius_of(view, j);
  return wall ? a : a * b / (a + b);
}

inline bool is_zero(Vec<double> a) { return a.x == 0.0 && a.y == 0.0 && a.z == 0.0; }

// Effective mass; bodies that do not move are infinitely heavy.
template <class View>
inline double effective_mass(const View &view, int64_t i, int64_t j) {
  const double inverse = inverse_mass_of(view, i) + inverse_mass_of(view, j);
  return inverse > 0.0 ? 1.0 / inverse : 0.0;
}

// Rolled length of the angles or spins of bodies i and j.
inline Vec<double> surface_rotation(int dim, const Bodies &bodies, const double *angle, int64_t i, int64_t j) {
  Vec<double> sum = bodies.radius[i] * vector_at(3, angle, i) + bodies.radius[j] * vector_at(3, angle, j);
  return dim == 3 ? sum : Vec<double>{0.0, 0.0, sum.z};
}

// Relative rotation angle_i − angle_j.
inline Vec<double> relative_angle(int dim, const double *angle, int64_t i, int64_t j) {
  Vec<double> difference = vector_at(3, angle, i) - vector_at(3, angle, j);
  return dim == 3 ? difference : Vec<double>{0.0, 0.0, difference.z};
}

// Change of angle_i + angle_j, from those of R_i angle_i + R_j angle_j and of angle_i − angle_j.
inline Vec<double> turned_together(const double *radius, int64_t i, int64_t j, Vec<double> rolled, Vec<double> apart) {
  const double whole = radius[i] + radius[j];
  return (2.0 / whole) * rolled + ((radius[j] - radius[i]) / whole) * apart;
}

// Normal, overlap and 1/|r| of bodies i and j from their pair vector.
template <class View>
inline void find_overlap(Pair &pair, const View &view, int64_t i, int64_t j) {
  pair.wall = is_wall(view, j);
  if (pair.wall) {
    pair.n = normal_of(view, j);
    pair.inverse = 0.0;
    pair.overlap = radius_of(view, i) - dot(pair.r, pair.n);
  } else {
    const double distance = root(dot(pair.r, pair.r));
    pair.inverse = 1.0 / distance;
    pair.n = pair.inverse * pair.r;
    pair.overlap = radius_of(view, i) + radius_of(view, j) - distance;
  }
}

// Parameters, effective radius and mass of bodies i and j; `memory`: additional memory of the contact, or null.
template <class View>
inline void find_parameters(Pair &pair, const Law &law, const View &view, int64_t i, int64_t j, const double *memory) {
  pair.q = {parameters_of(law, view, i, j), memory};
  pair.r_eff = needs_radius(law) ? effective_radius(view, i, j, pair.wall) : 1.0;
  pair.m_eff = needs_mass(law) ? effective_mass(view, i, j) : 1.0;
}

// Contact c of the list; `shift` (C, 3): periodic shifts cellᵀ·image, or null.
inline Pair pair_at(const Law &law, int dim, const Bodies &bodies, const Contacts &contacts, const double *shift,
                    int64_t c) {
  Pair pair;
  const int64_t i = contacts.i[c], j = contacts.j[c];
  pair.r = vector_at(dim, bodies.position, i) - vector_at(dim, bodies.position, j);
  if (shift) pair.r = pair.r + vector_at(dim, shift, c);
  find_overlap(pair, bodies, i, j);
  find_parameters(pair, law, bodies, i, j, memory_at(law, contacts, c));
  pair.touches = pair.overlap > -reach(law, pair.q, pair.r_eff, contacts.mode[c] == OPEN);
  return pair;
}

// Elastic force on i of contact c of the list, which touches and whose memory is committed.
inline Vec<double> elastic_force(const Law &law, const Contacts &contacts, const Pair &pair, int64_t c) {
  Elastic<double> spring = elastic(law, pair.q, pair.r_eff, pair.overlap);
  double limit = cap(law, pair.q, pair.r_eff, pair.overlap, spring.force);
  Vec<double> slip = vector_at(3, contacts.slip, c);
  return spring.force * pair.n + tangential_force(law.smooth, spring.stiffness, limit, slip);
}

// A row of events: columns as in `core.h`.
template <class Image>
inline void write_event(double *row, int64_t kind, double time, int64_t i, int64_t j, const Image *image,
                        const double *place) {
  row[0] = double(kind), row[1] = time, row[2] = double(i), row[3] = double(j);
  for (int k = 0; k < 3; ++k) row[4 + k] = double(image[k]), row[7 + k] = place[k];
}
