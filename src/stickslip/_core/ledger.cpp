// One step of the energy ledger (see `core/dynamics/ledger.py`).
#include <math.h>

#include "blocks.h"
#include "bonds.h"
#include "pairs.h"
#include "rolling.h"

enum Column {  // of a row
  KINETIC, NORMAL, TANGENTIAL, EXTERNAL, COULOMB, ROLLING, VISCOUS, DRAG, NONPOTENTIAL, BONDED, BROKEN
};

struct End {  // a contact at one end of a step
  Pair pair;
  double depth;               // overlap plus range
  double normal;              // elastic normal force
  double stored, energy;      // of the normal and of the tangential spring
  double given[2], slope[2];  // k_t and Coulomb limit, and derivatives of `energy` with respect to them
  double friction;            // tangential force without its dashpot
  double power;               // of the dashpots
  double created;             // by a slip update whose lever arms are not those of the torques, per time
  double shorter;             // lever arms are R less this
  double roll, twist;         // stiffnesses of moments
  Vec<double> moment;         // on i
  Vec<double> force, turn;    // on i, and torque/R
};

struct Kept {  // memory of a contact before and after a step, zero where it does not touch
  Vec<double> old, now;
  bool known, closed;  // whether it touched
};

static double length(Vec<double> v) { return root(dot(v, v)); }

// Components of v that are free, or those that are not.
static Vec<double> only(const uint8_t *free, bool wanted, Vec<double> v) {
  return {free[0] == wanted ? v.x : 0.0, free[1] == wanted ? v.y : 0.0, free[2] == wanted ? v.z : 0.0};
}

static Vec<double> surface_velocity(int dim, const Bodies &bodies, const Pair &pair, int64_t i, int64_t j) {
  Vec<double> v = vector_at(dim, bodies.velocity, i) - vector_at(dim, bodies.velocity, j);
  return at_contact(pair.n, v + transform(bodies.rate, pair.r), surface_rotation(dim, bodies, bodies.spin, i, j));
}

static Vec<double> sum_of_rotations(int dim, const double *angle, int64_t i, int64_t j) {
  Vec<double> sum = vector_at(3, angle, i) + vector_at(3, angle, j);
  return dim == 3 ? sum : Vec<double>{0.0, 0.0, sum.z};
}

// Energy of the tangential spring, and its derivatives.
static void store_energy(const Law &law, Vec<double> slip, End &end) {
  double stiffness = end.given[0], limit = end.given[1], square = dot(slip, slip);
  end.energy = 0.5 * stiffness * square;
  end.slope[0] = 0.5 * square;
  if (!law.smooth || !(limit > 0.0)) return;
  double x = stiffness * root(square) / limit;  // ∫ k s (1 + x − x²) ds, x = k s/limit
  end.energy = stiffness * square * (0.5 + x / 3.0 - x * x / 4.0);
  end.slope[0] = square * (0.5 + x / 3.0 - x * x / 4.0 + x * (1.0 / 3.0 - x / 2.0));
  end.slope[1] = -stiffness * square * x * (1.0 / 3.0 - x / 2.0) / limit;
}

// Moments with rotation memory `row`, or without if null, and the power of their dashpots; w is ω_i − ω_j.
static void add_moments(const Law &law, double overlap, double fn, TwistScale<double> scale, const double *row, Vec<double> w,
                        End &end) {
  const Pair &pair = end.pair;
  Resistance<double> roll = rolling_resistance(law, pair.q, pair.r_eff, overlap, fn, end.given[1]);
  Resistance<double> twist = twisting_resistance(law, pair.q, end.given[1], scale);
  end.roll = roll.stiffness, end.twist = twist.stiffness;
  const double along = dot(w, pair.n), turned = row && law.twist_at ? row[TWIST] : 0.0;
  const Vec<double> psi = row ? vector_at(3, row, 0) : Vec<double>{}, across = w - along * pair.n;
  const Vec<double> load = rolling_load(law, roll, psi, across);
  const double pull = twisting_load(twist, turned, along);
  end.moment = load + pull * pair.n;
  end.power -= dot(load + roll.stiffness * psi, across) + (pull + twist.stiffness * turned) * along;
}

// Contact c of the list `after` the step, at one end of the step, with the contact's additional memory there, and that
// of
// rotations.
static End evaluate(const LedgerStep &step, bool at_end, int64_t c, Kept kept, const double *memory,
                    const double *rotations) {
  const Law &law = *step.law;
  const Bodies &bodies = at_end ? *step.now : *step.old;
  const Vec<double> slip = at_end ? kept.now : kept.old;
  int dim = static_cast<int>(step.dim);
  End end = {};
  Pair &pair = end.pair = pair_at(law, dim, bodies, *step.after, at_end ? step.shift_now : step.shift_old, c);
  if (law.bonds) pair.touches = at_end ? kept.closed : kept.known;
  pair.q.memory = memory;
  const Parameters q = pair.q;
  const double edge = reach(law, q, pair.r_eff, !kept.known), overlap = pair.touches ? pair.overlap : 0.0 - edge;
  Elastic<double> spring = elastic(law, q, pair.r_eff, overlap);
  end.depth = pair.overlap + edge;
  end.given[0] = spring.stiffness;
  if (!pair.touches) return end;
  double fn = end.normal = spring.force, vn = 0.0, factor = 0.0;
  const int64_t i = step.after->i[c], j = step.after->j[c];
  Vec<double> v = {}, less = {};  // the latter: of the surface velocity with shorter lever arms
  if (law.lever && !pair.wall) {
    end.shorter = 0.5 * overlap;
    less = end.shorter * cross(pair.n, sum_of_rotations(dim, bodies.spin, i, j));
  }
  if (law.damping) {
    v = surface_velocity(dim, bodies, pair, i, j);
    if (!law.rate) v = v - less;
    vn = dot(v, pair.n);
    v = v - vn * pair.n;
    factor = damping_factor(law, pair.r_eff, pair.m_eff, overlap, spring.force);
    fn = with_dashpot(law, spring.force, factor * q[DAMPING_N], vn);
  }
  double limit = end.given[1] = cap(law, q, pair.r_eff, overlap, fn, law.rate && law.damping);
  Vec<double> t = tangential_force(law.smooth, spring.stiffness, limit, slip), whole = t;
  if (law.damping) whole = with_tangential_dashpot(t, factor * q[DAMPING_T], limit, v);
  end.stored = normal_energy(law, q, pair.r_eff, overlap);
  store_energy(law, slip, end);
  end.friction = length(t);
  end.power = (spring.force - fn) * vn - dot(whole - t, v);
  if (law.rate) end.created = -dot(whole, less);
  const TwistScale<double> scale =
      twist_scale(law, q, pair.r_eff, overlap, spring.stiffness, 0.0, factor * q[DAMPING_T]);
  if (has_moments(law)) add_moments(law, overlap, fn, scale, rotations, relative_angle(dim, bodies.spin, i, j), end);
  end.force = fn * pair.n + whole;
  end.turn = -1.0 * cross(pair.n, whole);
  return end;
}

// Work of the loads f in a motion d of body a: of its free components from `first`, or of those that are not.
static double work(const LedgerStep &step, bool free, int64_t a, int first, Vec<double> f, Vec<double> d) {
  return dot(f, only(step.free + 6 * a + first, free, d));
}

static Vec<double> rotation(const LedgerStep &step, int64_t a) {
  return vector_at(3, step.now->angle, a) - vector_at(3, step.old->angle, a);
}

// Add a step of rolling and twisting; `fraction` is that of the step during which the contact touched.
static void add_rotations(const LedgerStep &step, int64_t c, Kept psi, double twist[2], const End &old, const End &now,
                          Vec<double> mid, double fraction) {
  int dim = static_cast<int>(step.dim);
  int64_t i = step.after->i[c], j = step.after->j[c];
  double k1 = now.roll, size1 = dot(psi.now, psi.now);
  step.row[TANGENTIAL] += 0.5 * (k1 * size1 + now.twist * twist[1] * twist[1]);
  if (step.first) return;
  double k0 = old.roll, size0 = dot(psi.old, psi.old);
  step.row[NONPOTENTIAL] += 0.25 * (size1 + size0) * (k1 - k0);
  step.row[NONPOTENTIAL] += 0.25 * (twist[1] * twist[1] + twist[0] * twist[0]) * (now.twist - old.twist);
  Vec<double> turned = relative_angle(dim, step.now->angle, i, j) - relative_angle(dim, step.old->angle, i, j);
  if (psi.known || psi.closed) {
    double slid = length(onto_plane(now.pair.n, mid, psi.old + fraction * turned) - psi.now);
    step.row[ROLLING] += 0.5 * (k1 * root(size1) + k0 * root(size0)) * slid;
    double twisted = fabs(twist[0] + fraction * dot(mid, turned) - twist[1]);
    step.row[ROLLING] += 0.5 * (now.twist * fabs(twist[1]) + old.twist * fabs(twist[0])) * twisted;
  }
  Vec<double> moment = 0.5 * (now.moment + old.moment);
  step.row[EXTERNAL] -= work(step, false, i, 3, moment, rotation(step, i));
  step.row[EXTERNAL] += work(step, false, j, 3, moment, rotation(step, j));
}

// Distance slid; `fade` is the factor by which the law shortened the slip.
static double slid_distance(const LedgerStep &step, int64_t c, Kept slip, const End &now, Vec<double> d,
                            Vec<double> mid, double fraction, double fade) {
  int dim = static_cast<int>(step.dim);
  int64_t i = step.after->i[c], j = step.after->j[c];
  double half = step.law->rate ? 1.0 : 0.5 * (1.0 + fade);
  Vec<double> roll = surface_rotation(dim, *step.now, step.now->angle, i, j) -
                     surface_rotation(dim, *step.old, step.old->angle, i, j);
  if (step.law->lever && !step.law->rate && !now.pair.wall)
    roll = roll - mid_shortening(now.pair.n, now.pair.inverse, now.pair.overlap, d) *
                      (sum_of_rotations(dim, step.now->angle, i, j) - sum_of_rotations(dim, step.old->angle, i, j));
  Vec<double> increment = half * slip_increment(now.pair.n, mid, d, roll);
  double slid = length(fade * onto_plane(now.pair.n, mid, slip.old) + fraction * increment - slip.now);
  if (step.law->rescaled && !step.law->keeps_force && !slip.closed) return 0.0;
  return slid / half;  // the slid distance was shortened like the slip
}

// Energy created by a tangential spring whose stiffness or limit changed, or whose slip was rescaled.
static double nonpotential(const Law &law, Kept slip, const End &old, const End &now, double fade) {
  double sum = 0.0;
  if (fades(law)) {
    sum += 0.5 * (now.friction * length(slip.now) + old.friction * length(slip.old)) * log(fade);
    if (law.rescaled && !law.keeps_force && slip.known && !slip.closed)  // the slip has vanished: replaces the terms that follow
      sum += 0.5 * (old.given[0] * old.slope[0] + old.given[1] * old.slope[1]) - old.energy;
  }
  for (int k = 0; k < 2; ++k) sum += 0.5 * (now.slope[k] + old.slope[k]) * (now.given[k] - old.given[k]);
  return sum;
}

// Energy created as a bond forms or breaks, or as the additional memory of a contact changes: energy stored less the
// work done.
static double hysteresis(const Law &law, Kept slip, const End &old, const End &now) {
  bool changes = slip.known != slip.closed;
  for (int64_t k = 0; k < law.len_memory; ++k) changes |= old.pair.q.memory[k] != now.pair.q.memory[k];
  if (!changes || !(law.bonds || law.len_memory)) return 0.0;
  return now.stored - old.stored - 0.5 * (now.normal + old.normal) * (now.pair.overlap - old.pair.overlap);
}

// Work of the contact on the cell and on imposed motions, up to the sign.
static double imposed_work(const LedgerStep &step, int64_t c, const End &old, const End &now) {
  int64_t i = step.after->i[c], j = step.after->j[c];
  Vec<double> force = now.force + old.force, turn = now.turn + old.turn;
  Vec<double> less = now.shorter * now.turn + old.shorter * old.turn;
  double sum = dot(now.force, transform(step.strain, now.pair.r)) + dot(old.force, transform(step.strain, old.pair.r));
  sum += work(step, false, i, 0, force, vector_at(3, step.way, i));
  sum -= work(step, false, j, 0, force, vector_at(3, step.way, j));
  sum += work(step, false, i, 3, step.now->radius[i] * turn - less, rotation(step, i));
  sum += work(step, false, j, 3, step.now->radius[j] * turn - less, rotation(step, j));
  return 0.5 * sum;
}

static Kept kept(const LedgerStep &step, double *const memory[2], int64_t width, int64_t m, int64_t c) {
  Kept out = {{}, {}, m >= 0, step.after->mode[c] != OPEN};
  if (out.known) out.old = {memory[0][width * m], memory[0][width * m + 1], memory[0][width * m + 2]};
  if (out.closed) out.now = {memory[1][width * c], memory[1][width * c + 1], memory[1][width * c + 2]};
  return out;
}

// Add contact c, which is row m of the list before the step, or −1 if it did not touch.
static void add_contact(const LedgerStep &step, int64_t m, int64_t c) {
  const Law &law = *step.law;
  double *slips[2] = {step.before->slip, step.after->slip}, *rolls[2] = {step.before->rolling, step.after->rolling};
  Kept slip = kept(step, slips, 3, m, c);
  const int64_t width = step.after->width_rolling;
  const double *row1 = law.angular && slip.closed ? rolls[1] + width * c : nullptr;
  const double *row0 = law.angular && m >= 0 ? rolls[0] + width * m : nullptr;
  End now = evaluate(step, true, c, slip, memory_at(law, *step.after, c), row1);
  End old = step.first ? End{}
                       : evaluate(step, false, c, slip, m < 0 ? law.memory : memory_at(law, *step.before, m), row0);
  // LAMMPS counts the whole step of a contact that closes or opens
  bool whole = law.rate || slip.known == slip.closed || now.depth == old.depth;
  double fraction = whole ? 1.0 : larger(now.depth, old.depth) / fabs(now.depth - old.depth);
  Vec<double> d = now.pair.r - old.pair.r, mid = mid_normal(now.pair.n, law.rate ? 0.0 : now.pair.inverse, d);
  step.row[NORMAL] += now.stored;
  step.row[TANGENTIAL] += now.energy;
  if (has_moments(law)) {
    double twist[2] = {law.twist_at && row0 ? row0[TWIST] : 0.0, law.twist_at && row1 ? row1[TWIST] : 0.0};
    add_rotations(step, c, kept(step, rolls, width, m, c), twist, old, now, mid, fraction);
  }
  if (step.first) return;
  bool stays = slip.known && slip.closed, touched = slip.known || slip.closed;
  double fade = law.rescaled && stays ? contact_radius_ratio(now.depth, now.depth - old.depth) : 1.0;
  if (law.keeps_force && stays && now.given[0] > 0.0 && old.given[0] > 0.0) fade *= old.given[0] / now.given[0];
  step.row[NONPOTENTIAL] += nonpotential(law, slip, old, now, fade) + hysteresis(law, slip, old, now);
  step.row[NONPOTENTIAL] += 0.5 * step.dt * (now.created + old.created);
  step.row[VISCOUS] += 0.5 * step.dt * (now.power + old.power);
  step.row[EXTERNAL] -= imposed_work(step, c, old, now);
  if (touched)
    step.row[COULOMB] +=
        0.5 * (now.friction + old.friction) * slid_distance(step, c, slip, now, d, mid, fraction, fade);
}

// Work of a bond on the cell and on imposed motions, up to the sign.
static double imposed_work(const LedgerStep &step, const BondEnd &end, int64_t i, int64_t j) {
  return dot(end.force, transform(step.strain, end.r)) + work(step, false, i, 0, end.force, vector_at(3, step.way, i)) -
         work(step, false, j, 0, end.force, vector_at(3, step.way, j)) +
         work(step, false, i, 3, end.moment_i, rotation(step, i)) + work(step, false, j, 3, end.moment_j, rotation(step, j));
}

static void add_bond(const LedgerStep &step, int64_t k) {
  const Bonds &before = *step.bonds_old, &after = *step.bonds_now;
  const bool held = before.intact[k], holds = after.intact[k];
  if (!held) return;
  const int dim = static_cast<int>(step.dim);
  const int64_t i = before.i[k], j = before.j[k];
  BondWay way = {bond_vector(dim, after, k, *step.now, step.vectors_now), rotation(step, i), rotation(step, j)};
  way.r = way.r - bond_vector(dim, before, k, *step.old, step.vectors_old);
  const BondEnd now = holds ? bond_end(dim, after, k, *step.now, step.vectors_now, way) : BondEnd{};
  step.row[BONDED] += now.energy;
  if (step.first) return;
  const BondEnd old = bond_end(dim, before, k, *step.old, step.vectors_old, way);
  step.row[VISCOUS] += 0.5 * step.dt * (now.power + old.power);
  step.row[EXTERNAL] -= 0.5 * (imposed_work(step, old, i, j) + imposed_work(step, now, i, j));
  if (holds) step.row[NONPOTENTIAL] += 0.5 * (now.created + old.created);
  else step.row[BROKEN] += old.energy - 0.5 * old.work;  // its loads act during half of the step
}

static void add_body(const LedgerStep &step, int64_t a) {
  double mass = step.mass[a], inertia = step.inertia[a], half = 0.5 * step.dt;
  Vec<double> v = vector_at(3, step.now->velocity, a), w = vector_at(3, step.now->spin, a);
  step.row[KINETIC] += 0.5 * mass * dot(v, v) + 0.5 * inertia * dot(w, w);
  if (step.first) return;
  Vec<double> v0 = vector_at(3, step.old->velocity, a), w0 = vector_at(3, step.old->spin, a);
  step.row[EXTERNAL] -= 0.5 * mass * (dot(v, transform(step.strain, v)) + dot(v0, transform(step.strain, v0)));
  step.row[EXTERNAL] += work(step, true, a, 0, vector_at(3, step.force, a), vector_at(3, step.way, a));
  step.row[EXTERNAL] += work(step, true, a, 3, vector_at(3, step.torque, a), rotation(step, a));
  step.row[DRAG] += half * step.drag * mass * (work(step, true, a, 0, v, v) + work(step, true, a, 0, v0, v0));
  step.row[DRAG] += half * step.spin_drag * inertia * (work(step, true, a, 3, w, w) + work(step, true, a, 3, w0, w0));
}

void add_ledger_step(const LedgerStep *step) {
  const Contacts &before = *step->before, &after = *step->after;
  for (int64_t a = 0; a < step->old->len_radius; ++a) add_body(*step, a);
  int64_t m = 0, count = before.count[0];
  for (int64_t c = 0; c < after.count[0]; ++c) {
    while (m < count && before.key[m] < after.key[c]) ++m;
    bool known = m < count && before.key[m] == after.key[c] && before.mode[m] != OPEN;
    const double friction = step->row[COULOMB] + step->row[ROLLING], viscous = step->row[VISCOUS];
    add_contact(*step, known ? m : -1, c);
    if (!step->shares) continue;
    step->shares[2 * c] = step->row[COULOMB] + step->row[ROLLING] - friction;
    step->shares[2 * c + 1] = step->row[VISCOUS] - viscous;
  }
  for (int64_t k = 0; step->bonds_old && k < step->bonds_old->len_i; ++k) add_bond(*step, k);
}
