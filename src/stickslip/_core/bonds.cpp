// build: -ffp-contract=fast
// Forces, moments and failure of bonds, and their linearisation by dual numbers; see `core/contacts/bonds.py`.
#include <math.h>

#include "bonds.h"
#include "pairs.h"

namespace {

enum Part { TENSION, SHEAR, BENDING, TWISTING };  // columns of stiffness, damping and strength

// ---- functions of squares, so that they are smooth at zero

inline Dual with_slope(Dual x, double value, double slope) { return {value, slope * x.slope}; }
inline double with_slope(double, double value, double) { return value; }
inline double value_of(double x) { return x; }
inline double value_of(Dual x) { return x.value; }

template <class T>
T sine_part(T square) {  // sin(a/2)/a for the square of an angle a
  const double s = value_of(square), a = sqrt(s);
  if (s < 1e-3)
    return with_slope(square, 0.5 - s * (1.0 / 48.0 - s * (1.0 / 3840.0 - s / 645120.0)),
                      -1.0 / 48.0 + s * (1.0 / 1920.0 - s * (1.0 / 215040.0 - s / 46448640.0)));
  const double part = sin(0.5 * a) / a;
  return with_slope(square, part, 0.5 * (0.5 * cos(0.5 * a) - part) / s);
}

template <class T>
T half_cosine(T square) {  // cos(a/2)
  return with_slope(square, cos(0.5 * sqrt(value_of(square))), -0.25 * sine_part(value_of(square)));
}

template <class T>
T arc_part(T square, bool beyond) {  // a/sin a for the square of the sine; `beyond`: a > π/2
  const double s = fmin(value_of(square), 1.0), x = sqrt(s);
  if (s < 1e-3 && !beyond)
    return with_slope(square, 1.0 + s * (1.0 / 6.0 + s * (3.0 / 40.0 + s * (5.0 / 112.0 + s * 35.0 / 1152.0))),
                      1.0 / 6.0 + s * (3.0 / 20.0 + s * (15.0 / 112.0 + s * (35.0 / 288.0 + s * 315.0 / 2816.0))));
  const double below = fmax(x, 1e-150), part = (beyond ? M_PI - asin(x) : asin(x)) / below;
  const double slope = (beyond ? -1.0 : 1.0) / fmax(sqrt(1.0 - s), 1e-150);
  return with_slope(square, part, 0.5 * (slope - part) / (below * below));
}

inline double arc(double y, double x) { return atan2(y, x); }
inline Dual arc(Dual y, Dual x) {
  const double square = x.value * x.value + y.value * y.value;
  return {atan2(y.value, x.value), (x.value * y.slope - y.value * x.slope) / square};
}

// ---- rotations

template <class T>
struct Turn {  // quaternion
  T w;
  Vec<T> v;
};

template <class T>
Turn<T> operator*(Turn<T> a, Turn<T> b) {
  return {a.w * b.w - dot(a.v, b.v), a.w * b.v + b.w * a.v + cross(a.v, b.v)};
}

template <class T>
Turn<T> turn_of(Vec<T> angle) {
  const T square = dot(angle, angle);
  return {half_cosine(square), sine_part(square) * angle};
}

template <class T>
Turn<T> inverse(Turn<T> a) {
  return {a.w, {-a.v.x, -a.v.y, -a.v.z}};
}

template <class T>
Vec<T> rotated(Turn<T> a, Vec<T> x) {
  const Vec<T> way = cross(a.v, x), twice = way + way;
  return x + a.w * twice + cross(a.v, twice);
}

template <class T>
Vec<T> constant(Vec<double> v) {
  return {T{} + v.x, T{} + v.y, T{} + v.z};
}

template <class T>
T length_of(Vec<T> v) {  // its derivative at zero counts as zero
  const T square = dot(v, v);
  return value_of(square) > 0.0 ? root(square) : T{};
}

// ---- one bond

struct Bond {
  const double *stiffness, *damping, *strength;
  double length, arm;  // at rest; fraction of r from j to the point at which the force acts
  int64_t form, fading;
  Vec<double> direction;
  Turn<double> turn;
};

Bond bond_at(const Bonds &bonds, int64_t k) {
  const double *q = bonds.turn + 4 * k;
  return {bonds.stiffness + 4 * k, bonds.damping + 4 * k, bonds.strength + 4 * k, bonds.length[k], bonds.arm[k],
          bonds.form[k], bonds.fading[k], vector_at(3, bonds.direction, k), {q[0], {q[1], q[2], q[3]}}};
}

template <class T>
struct Deformed {
  Vec<T> n, bend, twist, shear;  // unit vector from j to i; rotation vectors of i relative to j; see `load_of`
  Vec<T> direction;
  Turn<T> turn;
  T distance;
};

// The deformation of a bond whose ends are r apart and have turned by `a` (of i) and `b` (of j) since the memory was
// committed.
template <class T>
Deformed<T> deformed(const Bond &bond, Vec<T> r, Vec<T> a, Vec<T> b) {
  Deformed<T> out;
  const T one = T{} + 1.0;
  const Turn<T> turn_j = turn_of(b), turn = {T{} + bond.turn.w, constant<T>(bond.turn.v)};
  out.distance = root(dot(r, r));
  out.n = (one / out.distance) * r;
  out.direction = rotated(turn_j, constant<T>(bond.direction));
  out.turn = turn_of(a) * turn * inverse(turn_j);
  if (value_of(out.turn.w) < 0.0) out.turn = {-out.turn.w, {-out.turn.v.x, -out.turn.v.y, -out.turn.v.z}};
  const Vec<T> axis = cross(out.direction, out.n);
  const Vec<T> tilt = arc_part(dot(axis, axis), value_of(dot(out.direction, out.n)) < 0.0) * axis;
  const T along = dot(out.turn.v, out.n), w = out.turn.w, half = root(w * w + along * along);
  const Vec<T> across = out.turn.v - along * out.n;
  out.bend = (2.0 * arc_part(dot(across, across), false) / half) * (w * across - along * cross(across, out.n));
  out.twist = (2.0 * arc(along, w)) * out.n;
  out.shear = out.distance * (tilt - (1.0 - bond.arm) * out.bend);
  return out;
}

template <class T>
struct Springs {  // tension, shear force, moments of bending and twisting
  T pull;
  Vec<T> shear, bend, twist;
};

template <class T>
Springs<T> springs_of(const Bond &bond, const Deformed<T> &at) {
  const double *k = bond.stiffness;
  return {k[TENSION] * (at.distance + -bond.length), k[SHEAR] * cross(at.shear, at.n), k[BENDING] * at.bend,
          k[TWISTING] * at.twist};
}

template <class T>
T share_of(const Bond &bond, const Springs<T> &load) {
  const double *s = bond.strength;
  if (bond.form == BY_STRETCH) return (1.0 / s[TENSION]) * magnitude(load.pull);
  const T normal = (1.0 / s[TENSION]) * load.pull + (1.0 / s[BENDING]) * length_of(load.bend);
  const T tangential = (1.0 / s[SHEAR]) * length_of(load.shear) + (1.0 / s[TWISTING]) * length_of(load.twist);
  return larger(bond.form == BY_SUM ? normal + tangential : larger(normal, tangential), T{});
}

// The largest of the loads over their strengths whose sum reaches the strength.
int8_t failure_of(const Bond &bond, const Springs<double> &load) {
  const double *s = bond.strength;
  if (bond.form == BY_STRETCH) return load.pull < 0.0 ? BY_COMPRESSION : BY_TENSION;
  double part[] = {load.pull / s[TENSION], length_of(load.shear) / s[SHEAR], length_of(load.bend) / s[BENDING],
                   length_of(load.twist) / s[TWISTING]};
  if (bond.form == BY_BEAM) {
    const bool sheared = part[SHEAR] + part[TWISTING] > part[TENSION] + part[BENDING];
    part[sheared ? TENSION : SHEAR] = part[sheared ? BENDING : TWISTING] = -INFINITY;
  }
  int most = TENSION;
  for (int k = 1; k < 4; ++k)
    if (part[k] > part[most]) most = k;
  return int8_t(BY_TENSION + most);
}

template <class T>
T power_of(const Bond &bond, T share) {  // of the share, by which loads fade
  const T square = share * share, fourth = square * square;
  return bond.fading == 4 ? fourth : fourth * fourth;
}

template <class T>
T faded(const Bond &bond, T share) {
  if (!bond.fading) return T{} + 1.0;
  if (value_of(share) >= 1.0) return T{};
  return T{} + 1.0 - power_of(bond, share);
}

// Energy of the springs. Of loads that fade, it is the work that they do if all of them grow in proportion.
template <class T>
T energy_of(const Bond &bond, const Deformed<T> &at, T share) {
  const double *k = bond.stiffness, fading = double(bond.fading);
  const T stretch = at.distance + -bond.length;
  const T whole = 0.5 * (k[TENSION] * (stretch * stretch) + k[SHEAR] * dot(at.shear, at.shear) +
                         k[BENDING] * dot(at.bend, at.bend) + k[TWISTING] * dot(at.twist, at.twist));
  if (!bond.fading) return whole;
  if (value_of(share) >= 1.0) return ((fading / (fading + 2.0)) * whole) / (share * share);
  return whole * (T{} + 1.0 - (2.0 / (fading + 2.0)) * power_of(bond, share));
}

template <class T>
struct BondLoad {
  Vec<T> force, moment_i, moment_j;  // force on i; that on j is opposite
  T share;                           // of the strength
};

template <class T>
BondLoad<T> scaled(T factor, BondLoad<T> load) {
  return {factor * load.force, factor * load.moment_i, factor * load.moment_j, load.share};
}

// Elastic loads: with the shear u and the force k_s u × n on j, whose point of action is at a fraction `arm` of r from
// j.
template <class T>
BondLoad<T> load_of(const Bond &bond, const Deformed<T> &at) {
  const Springs<T> load = springs_of(bond, at);
  const Vec<T> lever = (bond.stiffness[SHEAR] * at.distance) * at.shear, moment = load.bend + load.twist;
  const T share = share_of(bond, load);
  const Vec<T> nothing = {};
  BondLoad<T> out = {nothing - load.pull * at.n - load.shear, (1.0 - bond.arm) * lever - moment,
                     bond.arm * lever + moment, share};
  return scaled(faded(bond, share), out);
}

// Loads of the dashpots; v is the velocity of i relative to j, `a` and `b` are the spins of i and j.
BondLoad<double> drag_of(const Bond &bond, const Deformed<double> &at, Vec<double> v, Vec<double> a, Vec<double> b) {
  const double *c = bond.damping, vn = dot(v, at.n);
  const Vec<double> r = at.distance * at.n, turn = a - b;
  const Vec<double> surface = v - vn * at.n - cross((1.0 - bond.arm) * a + bond.arm * b, r);
  const double twist = dot(turn, at.n);
  const Vec<double> shear = c[SHEAR] * surface, lever = cross(r, shear);
  const Vec<double> moment = (0.5 * c[BENDING] * at.distance) * (turn - twist * at.n) + (0.5 * c[TWISTING] * twist) * at.n;
  const Vec<double> nothing = {};
  return {nothing - (c[TENSION] * vn) * at.n - shear, (1.0 - bond.arm) * lever - moment, bond.arm * lever + moment, 0.0};
}

struct Ends {
  int64_t i, j;
  Vec<double> r, a, b;  // pair vector; rotations of i and j since the memory was committed
};

Ends ends_at(const Bonds &bonds, int dim, BondRows position, BondRows angle, const double *vectors, int64_t k) {
  Ends out = {bonds.i[k], bonds.j[k], {}, {}, {}};
  const double *x = position.data + position.stride * out.i, *y = position.data + position.stride * out.j;
  out.r = {x[0] - y[0], x[1] - y[1], dim == 3 ? x[2] - y[2] : 0.0};
  for (int64_t m = 0; m < 3; ++m)
    if (bonds.image[3 * k + m]) out.r = out.r + double(bonds.image[3 * k + m]) * vector_at(dim, vectors, m);
  out.a = read(angle.data + angle.stride * out.i) - vector_at(3, bonds.angle_i, k);
  out.b = read(angle.data + angle.stride * out.j) - vector_at(3, bonds.angle_j, k);
  if (dim == 2) out.a.x = out.a.y = out.b.x = out.b.y = 0.0;
  return out;
}

void commit(const Bonds &bonds, BondRows angle, const Deformed<double> &at, int64_t i, int64_t j, int64_t k) {
  const Turn<double> turn = at.turn;
  const double scale = 1.0 / root(turn.w * turn.w + dot(turn.v, turn.v));
  double *q = bonds.turn + 4 * k;
  q[0] = scale * turn.w;
  store(q + 1, scale * turn.v);
  store(bonds.direction + 3 * k, (1.0 / root(dot(at.direction, at.direction))) * at.direction);
  store(bonds.angle_i + 3 * k, read(angle.data + angle.stride * i));
  store(bonds.angle_j + 3 * k, read(angle.data + angle.stride * j));
}

void add_to(double *row, double factor, Vec<double> v) {
  row[0] += factor * v.x, row[1] += factor * v.y, row[2] += factor * v.z;
}

}  // namespace

void sweep_bonds(int64_t dim, const BondSweep &sweep, const Bonds &bonds) {
  for (int64_t k = 0; k < bonds.len_i; ++k) {
    if (!bonds.intact[k]) continue;
    const Bond bond = bond_at(bonds, k);
    const Ends ends = ends_at(bonds, int(dim), sweep.position, sweep.angle, sweep.vectors, k);
    const Deformed<double> at = deformed(bond, ends.r, ends.a, ends.b);
    BondLoad<double> load = load_of(bond, at);
    const Vec<double> elastic = load.force;
    if (sweep.share) sweep.share[k] = load.share;
    const bool turned = !is_zero(ends.a) || !is_zero(ends.b);  // else the memory keeps its bits
    if (sweep.commits && turned) commit(bonds, sweep.angle, at, ends.i, ends.j, k);
    if (sweep.breaks && load.share >= 1.0) {
      bonds.intact[k] = false;
      bonds.failed[k] = failure_of(bond, springs_of(bond, at));
      if (sweep.broken)
        sweep.broken(sweep.context, bonds, k, sweep.position.data + sweep.position.stride * ends.i);
      continue;
    }
    if (sweep.velocity.data) {
      Vec<double> v = read(sweep.velocity.data + sweep.velocity.stride * ends.i) -
                      read(sweep.velocity.data + sweep.velocity.stride * ends.j);
      if (sweep.gradient) v = v + transform(sweep.gradient, ends.r);
      if (dim == 2) v.z = 0.0;
      const Vec<double> a = read(sweep.spin.data + sweep.spin.stride * ends.i);
      const Vec<double> b = read(sweep.spin.data + sweep.spin.stride * ends.j);
      const BondLoad<double> drag = scaled(faded(bond, load.share), drag_of(bond, at, v, a, b));
      load = {load.force + drag.force, load.moment_i + drag.moment_i, load.moment_j + drag.moment_j, load.share};
    }
    add_to(sweep.force + sweep.stride * ends.i, 1.0, load.force);
    add_to(sweep.force + sweep.stride * ends.j, -1.0, load.force);
    add_to(sweep.torque + sweep.stride * ends.i, 1.0, load.moment_i);
    add_to(sweep.torque + sweep.stride * ends.j, 1.0, load.moment_j);
    if (!sweep.virial) continue;
    const Vec<double> f = sweep.by_body ? load.force : elastic;
    double *virial = sweep.virial + (sweep.by_body ? 9 * ends.i : 0);
    add_to(virial, f.x, ends.r), add_to(virial + 3, f.y, ends.r), add_to(virial + 6, f.z, ends.r);
  }
}

void evaluate_bonds(int64_t dim, const Bodies *bodies, const Bonds *bonds, const double *vectors, uint8_t commits,
                    double *share, double *force, double *torque, double *virial) {
  BondSweep sweep = {};
  sweep.position = {bodies->position, 3}, sweep.angle = {bodies->angle, 3};
  sweep.velocity = {bodies->velocity, 3}, sweep.spin = {bodies->spin, 3};
  sweep.vectors = vectors, sweep.gradient = bodies->rate;
  sweep.force = force, sweep.torque = torque, sweep.stride = 3, sweep.virial = virial;
  sweep.share = share, sweep.commits = commits;
  sweep_bonds(dim, sweep, *bonds);
}

// Deformation of a bond at one end of a motion, with derivatives along it.
static Deformed<Dual> deformed_along(const Bond &bond, const Ends &ends, Vec<double> r, Vec<double> a, Vec<double> b) {
  const auto along = [](Vec<double> v, Vec<double> way) {
    return Vec<Dual>{{v.x, way.x}, {v.y, way.y}, {v.z, way.z}};
  };
  return deformed(bond, along(ends.r, r), along(ends.a, a), along(ends.b, b));
}

void limit_bonds(int64_t dim, const Bodies *bodies, const Bonds *bonds, const double *vectors, const double *way,
                 double *load, double *slope, double *energy) {
  for (int64_t k = 0; k < bonds->len_i; ++k) {
    const Bond bond = bond_at(*bonds, k);
    const double *s = bond.strength, *d = way + 9 * k;
    const Ends ends = ends_at(*bonds, int(dim), {bodies->position, 3}, {bodies->angle, 3}, vectors, k);
    const Deformed<Dual> at = deformed_along(bond, ends, read(d), read(d + 3), read(d + 6));
    const Springs<Dual> out = springs_of(bond, at);
    const Dual parts[] = {out.pull, out.shear.x, out.shear.y, out.shear.z, out.bend.x,
                          out.bend.y, out.bend.z, out.twist.x, out.twist.y, out.twist.z};
    for (int m = 0; m < 10; ++m) {
      const double unit = s[m ? SHEAR + (m - 1) / 3 : TENSION];
      load[10 * k + m] = parts[m].value / unit, slope[10 * k + m] = parts[m].slope / unit;
    }
    const Deformed<double> here = deformed(bond, ends.r, ends.a, ends.b);
    energy[k] = energy_of(bond, here, share_of(bond, springs_of(bond, here)));
  }
}

void judge_loads(const Bonds *bonds, const double *load, double *share, int8_t *failure) {
  const double unit[] = {1.0, 1.0, 1.0, 1.0};
  for (int64_t k = 0; k < bonds->len_i; ++k) {
    Bond bond = bond_at(*bonds, k);
    bond.strength = unit;
    const double *f = load + 10 * k;
    const Springs<double> springs = {f[0], read(f + 1), read(f + 4), read(f + 7)};
    share[k] = share_of(bond, springs), failure[k] = failure_of(bond, springs);
  }
}

Vec<double> bond_vector(int dim, const Bonds &bonds, int64_t k, const Bodies &bodies, const double *vectors) {
  return ends_at(bonds, dim, {bodies.position, 3}, {bodies.angle, 3}, vectors, k).r;
}

BondEnd bond_end(int dim, const Bonds &bonds, int64_t k, const Bodies &bodies, const double *vectors, const BondWay &way) {
  const Bond bond = bond_at(bonds, k);
  const Ends ends = ends_at(bonds, dim, {bodies.position, 3}, {bodies.angle, 3}, vectors, k);
  const auto flat = [&](Vec<double> turn) { return dim == 3 ? turn : Vec<double>{0.0, 0.0, turn.z}; };
  const Vec<double> turn_i = flat(way.a), turn_j = flat(way.b);
  const Deformed<Dual> along = deformed_along(bond, ends, way.r, turn_i, turn_j);
  const Deformed<double> at = deformed(bond, ends.r, ends.a, ends.b);
  const BondLoad<double> load = load_of(bond, at);
  Vec<double> v = vector_at(dim, bodies.velocity, ends.i) - vector_at(dim, bodies.velocity, ends.j);
  if (bodies.rate) v = v + transform(bodies.rate, ends.r);
  if (dim == 2) v.z = 0.0;
  const Vec<double> a = vector_at(3, bodies.spin, ends.i), b = vector_at(3, bodies.spin, ends.j);
  const BondLoad<double> drag = scaled(faded(bond, load.share), drag_of(bond, at, v, a, b));
  BondEnd out = {};
  out.energy = energy_of(bond, at, load.share);
  out.work = dot(load.force, way.r) + dot(load.moment_i, turn_i) + dot(load.moment_j, turn_j);
  out.created = energy_of(bond, along, load_of(bond, along).share).slope + out.work;
  out.power = -(dot(drag.force, v) + dot(drag.moment_i, a) + dot(drag.moment_j, b));
  out.r = ends.r;
  out.force = load.force + drag.force;
  out.moment_i = load.moment_i + drag.moment_i, out.moment_j = load.moment_j + drag.moment_j;
  return out;
}

void linearise_bonds(int64_t dim, const Bodies *bodies, const Bonds *bonds, const double *vectors, double *force,
                     double *stiff, double *damp) {
  const int wide = dim == 3 ? 9 : 4, plane[] = {0, 1, 5, 8};  // coordinates that vary
  for (int64_t k = 0; k < bonds->len_i; ++k) {
    if (!bonds->intact[k]) continue;
    const Bond bond = bond_at(*bonds, k);
    const Ends ends = ends_at(*bonds, int(dim), {bodies->position, 3}, {bodies->angle, 3}, vectors, k);
    const Deformed<double> here = deformed(bond, ends.r, ends.a, ends.b);
    const BondLoad<double> load = load_of(bond, here);
    const double fade = faded(bond, load.share);
    store(force + 3 * k, load.force);
    if (!stiff) continue;
    for (int w = 0; w < wide; ++w) {
      const int column = dim == 3 ? w : plane[w];
      double unit[9] = {};
      unit[column] = 1.0;
      const auto moved = [&](Vec<double> v, int first) {
        return Vec<Dual>{{v.x, unit[first]}, {v.y, unit[first + 1]}, {v.z, unit[first + 2]}};
      };
      const BondLoad<Dual> out = load_of(bond, deformed(bond, moved(ends.r, 0), moved(ends.a, 3), moved(ends.b, 6)));
      const BondLoad<double> drag = drag_of(bond, here, read(unit), read(unit + 3), read(unit + 6));
      const Vec<Dual> parts[] = {out.force, out.moment_i, out.moment_j};
      const Vec<double> drags[] = {drag.force, drag.moment_i, drag.moment_j};
      for (int p = 0; p < 3; ++p) {
        const double slopes[] = {parts[p].x.slope, parts[p].y.slope, parts[p].z.slope};
        const double rates[] = {drags[p].x, drags[p].y, drags[p].z};
        for (int m = 0; m < 3; ++m) {
          const int64_t place = 81 * k + 9 * (3 * p + m) + column;
          stiff[place] = slopes[m], damp[place] = fade * rates[m];
        }
      }
    }
  }
}
