// Geometry of one contact in the list.
#pragma once
#include "blocks.h"
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

inline void store(double *row, Vec<double> v) { row[0] = v.x, row[1] = v.y, row[2] = v.z; }

inline double effective_radius(const Bodies &bodies, int64_t i, int64_t j, bool wall) {
  double a = bodies.radius[i], b = bodies.radius[j];
  return wall ? a : a * b / (a + b);
}

inline bool is_zero(Vec<double> a) { return a.x == 0.0 && a.y == 0.0 && a.z == 0.0; }

// Effective mass; bodies that do not move are infinitely heavy.
inline double effective_mass(const Bodies &bodies, int64_t i, int64_t j) {
  double inverse = bodies.inverse_mass[i] + bodies.inverse_mass[j];
  return inverse > 0.0 ? 1.0 / inverse : 0.0;
}

// Rolled length R_i angle_i + R_j angle_j; the radius of a wall is zero.
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
inline void find_overlap(Pair &pair, const Bodies &bodies, int64_t i, int64_t j) {
  const int64_t wall = j - (bodies.len_radius - bodies.len_normal);
  pair.wall = wall >= 0;
  if (pair.wall) {
    pair.n = vector_at(3, bodies.normal, wall);
    pair.inverse = 0.0;
    pair.overlap = bodies.radius[i] - dot(pair.r, pair.n);
  } else {
    const double distance = root(dot(pair.r, pair.r));
    pair.inverse = 1.0 / distance;
    pair.n = pair.inverse * pair.r;
    pair.overlap = bodies.radius[i] + bodies.radius[j] - distance;
  }
}

// Parameters, effective radius and mass of bodies i and j.
inline void find_parameters(Pair &pair, const Law &law, const Bodies &bodies, const Contacts &contacts, int64_t c) {
  const int64_t i = contacts.i[c], j = contacts.j[c];
  pair.q = {parameters(law, bodies.material[i], bodies.material[j]), memory_at(law, contacts, c)};
  pair.r_eff = needs_radius(law) ? effective_radius(bodies, i, j, pair.wall) : 1.0;
  pair.m_eff = needs_mass(law) ? effective_mass(bodies, i, j) : 1.0;
}

// Contact c of the list; `shift` (C, 3): periodic shifts cellᵀ·image, or null.
inline Pair pair_at(const Law &law, int dim, const Bodies &bodies, const Contacts &contacts, const double *shift,
                    int64_t c) {
  Pair pair;
  const int64_t i = contacts.i[c], j = contacts.j[c];
  pair.r = vector_at(dim, bodies.position, i) - vector_at(dim, bodies.position, j);
  if (shift) pair.r = pair.r + vector_at(dim, shift, c);
  find_overlap(pair, bodies, i, j);
  find_parameters(pair, law, bodies, contacts, c);
  pair.touches = pair.overlap > -reach(law, pair.q, pair.r_eff, contacts.mode[c] == OPEN);
  return pair;
}
