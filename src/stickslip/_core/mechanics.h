// Geometry and mechanics of one contact, or of a vector of contacts, for all laws.
//
// The normal n points from j to i, the slip is that of i relative to j. In two dimensions (DIM = 2) z components are
// literal zeros that the compiler removes.
#pragma once
#include "laws.h"

constexpr double MIN_WEIGHT = 0.6;  // of an increment (see `turning_weight`); above 1/2, so that a slip can reverse
// Round-off of a slip and of its limit, in units of R_i + R_j: a sliding contact slides until its slip is shorter than
// the limit by more. Positions far from the origin, other orders of arithmetic and solver tolerances cause smaller
// differences.
constexpr double ROUND_OFF = 1e-11;
// Fraction of the limit by which the slip of a sliding contact may fall short at rest, due to dashpots.
constexpr double AT_LIMIT = 1e-3;
constexpr double NORMAL_PART = 1e-12;  // round-off of the normal part of a slip, over its length
constexpr double NO_LIMIT = 1e150;  // its square is finite

template <class T>
struct Ratio {
  T part, whole;
};

// Displacement of the surface of i relative to that of j, dr + n × d(roll); the same formula holds for velocities.
// Source: doi:10.48550/arXiv.1908.11724, Eq 2 and supplement Eq 7.
template <class T>
inline Vec<T> at_contact(Vec<T> n, Vec<T> d, Vec<T> roll) {
  return d + cross(n, roll);
}

// Normal halfway through a displacement dr that ends at n, scaled so that n·m = 1: m = n − P dr/(2|r|); `inverse` is
// 1/|r|, zero at walls.
template <class T>
inline Vec<T> mid_normal(Vec<T> n, T inverse, Vec<T> d) {
  T half = 0.5 * inverse;
  return n - half * (d - dot(n, d) * n);
}

// Vector w projected along the mid-step normal m onto the plane of contact: w − (n·w) m. It rotates a slip from the
// plane before the step to that after it, to third order in the angle.
template <class T>
inline Vec<T> onto_plane(Vec<T> n, Vec<T> m, Vec<T> w) {
  return w - dot(w, n) * m;
}

// Whether a memory is one that was committed; those of files may not be tangential.
inline bool is_tangential(Vec<double> n, Vec<double> s) {
  const double along = dot(n, s);
  return along * along <= NORMAL_PART * NORMAL_PART * dot(s, s);
}

template <class T>
inline Vec<T> slip_increment(Vec<T> n, Vec<T> m, Vec<T> d, Vec<T> roll) {
  return onto_plane(n, m, at_contact(m, d, roll));
}

// Overlap increment of a displacement dr that ends at n: |r − dr| − |r|, exactly zero if dr = 0.
template <class T>
inline T overlap_increment(Vec<T> n, T inverse, Vec<T> d) {
  T twice = inverse * dot(d, d) - 2.0 * dot(n, d);
  return twice / (1.0 + root(larger(1.0 + inverse * twice, T{})));
}

// Half the overlap halfway through a displacement dr that ends at n: the reduction of lever arms R − δ/2 from R.
template <class T>
inline T mid_shortening(Vec<T> n, T inverse, T overlap, Vec<T> d) {
  return 0.5 * (overlap - 0.5 * overlap_increment(n, inverse, d));
}

// Fraction of a step during which a closing contact touched; `depth` is the overlap at the end. During the step, the
// overlap grew by |P dr|²/(2|r|) − n·dr, to third order in dr.
template <class T>
inline Ratio<T> touching_fraction(Vec<T> n, T inverse, T depth, Vec<T> d) {
  T along = dot(n, d), gained = 0.5 * inverse * (dot(d, d) - along * along) - along, one = T{} + 1.0;
  auto part = gained > depth;
  return {select(part, depth, one), select(part, gained, one)};
}

// Ratio of contact radii √(δ/δ_old) where the overlap has decreased, else 1.
template <class T>
inline T contact_radius_ratio(T overlap, T gained) {
  T one = T{} + 1.0;
  auto falls = (gained < 0.0) & (overlap > 0.0);
  return select(falls, root(select(falls, overlap, one) / select(falls, overlap - gained, one)), one);
}

template <class T>
struct Transport {
  Vec<T> slip;       // rotated with the contact and shortened by the law
  Vec<T> increment;  // of the slip
  Vec<T> mid;        // mid-step normal
  T fade;            // factor by which the law changed the slip
};

// Slip s after a displacement d and a rotation d(roll), which end at the normal n. A law may shorten it as k_t changes,
// by the factor `kept`.
template <class T>
inline Transport<T> transport_slip(const Law &law, bool rate, Vec<T> n, T inverse, T overlap, Vec<T> d, Vec<T> roll,
                                   Vec<T> s, T kept = T{} + 1.0) {
  Vec<T> m = rate ? n : mid_normal(n, inverse, d), o = onto_plane(n, m, s);
  Vec<T> increment = slip_increment(n, m, d, roll);
  T fade = T{} + 1.0;
  if (fades(law)) {
    if (rate) {  // as LAMMPS `granular` rotates its memory
      T square = dot(o, o);
      o = root(dot(s, s) / select(square > 0.0, square, fade)) * o;
    }
    fade = law.rescaled ? kept * contact_radius_ratio(overlap, overlap_increment(n, inverse, d)) : kept;
    o = fade * o;
    if (!rate) increment = (0.5 * (1.0 + fade)) * increment;
  }
  return {o, increment, m, fade};
}

// Factor κ of the increment d such that a + κ d has the direction to which the slip a of a sliding contact turns.
//
// A slip of length R turns towards d by dψ = −sin ψ |d|/R, and its final direction is that of a + κ d with
// κ = 1 + a·d/(2R²) + (a² − R²)/(4R²) to second order. The last term uses the mean of R before and after. A slip that
// was shortened by a factor f turns as if it had not been shortened: with d multiplied by (1 + f)/2, κ is 2f/(1 + f)
// times its value for a/f.
// Source: Krieg and Krieg, doi:10.1115/1.3454568, for the exact rotation.
template <class T>
inline Ratio<T> turning_weight(bool fades, T stiffness, T limit, Vec<T> a, Vec<T> d, T fade) {
  T scale = stiffness * stiffness, square = limit * limit;
  Vec<T> b = fades ? (1.0 / fade) * a : a;
  T change = scale * (b.x * (b.x + 2.0 * d.x) + b.y * (b.y + 2.0 * d.y) + b.z * (b.z + 2.0 * d.z));
  // the bound lets a contact sheared in the opposite direction reverse, although κ is derived for small steps
  T part = larger(0.75 * square + 0.25 * change, MIN_WEIGHT * square);
  return {fades ? 2.0 * fade / (1.0 + fade) * part : part, square};
}

template <class T, class M>
struct Truncated {
  Vec<T> slip;
  M slides;
};

// Whether a spring that was sliding still slides: `square` is that of its force, and `slack` the force of round-off.
template <class T>
inline auto still_slides(T square, T limit, T slack) {
  T least = larger(limit - slack, T{});
  return square > least * least;
}

// Whether the memory of a spring that has not moved since it was committed agrees with the law, and is kept to the last
// bit. If not, it belongs to another law. `pull` is its force; `loose`: it slides if its limit is zero.
inline bool agrees(int64_t memory, bool slid, double pull, double limit, double slack, bool loose = true) {
  if (limit == 0.0) return pull == 0.0 && slid == loose;
  if (memory == HELD) return !slid || magnitude(pull - limit) <= slack;
  return pull <= limit + slack && (!slid || (pull > 0.0 && pull >= smaller((1.0 - AT_LIMIT) * limit, limit - slack)));
}

// Whether the memory of such a spring is kept while a dashpot acts, so that its limit differs from that at the commit.
inline bool is_kept_in_motion(bool slid, double pull, double limit) { return !slid || pull > 0.0 || limit == 0.0; }

// Slip a + d part/whole truncated at the Coulomb limit, and whether the contact slides. With HELD memory it keeps its
// mode.
//
// `a` is the previous slip, rotated with the contact and shortened by `fade`, d the increment. In three dimensions the
// slip of a contact that keeps sliding turns (not with `rate`); see `turning_weight`. The slip of a contact that starts
// to slide is truncated along a + d part/whole. One division serves all cases, because a vector division takes as long
// as ten multiplications.
template <int DIM, class T, class M>
inline Truncated<T, M> return_mapping(bool fades, bool rate, int64_t memory, T stiffness, T limit, T slack, Vec<T> a,
                                      Vec<T> d, Ratio<T> fraction, M slid, T fade) {
  T part = fraction.part, whole = fraction.whole;
  Vec<T> b = whole * a + part * d;
  T scale = stiffness * stiffness, bound = whole * limit, pull = scale * dot(b, b);
  // without slip there is no sliding direction to hold: such contacts slid under a law without friction
  M over = memory == HELD ? M(slid & ((a.x != 0.0) | (a.y != 0.0) | (a.z != 0.0))) : M(pull > bound * bound);
  M cut = (limit == 0.0) | over, slides = memory == HELD ? cut : M(cut | (slid & still_slides(pull, limit, slack)));
  if (!any(cut | (whole != 1.0))) return {b, slides};  // the same bits, sooner
  if (DIM == 3 && !rate) {
    Ratio<T> weight = turning_weight(fades, stiffness, limit, a, d, fade);
    M turns = cut & slid & (limit > 0.0);
    part = select(turns, weight.part, part);
    whole = select(turns, weight.whole, whole);
    b = whole * a + part * d;
    pull = scale * dot(b, b);
  }
  T below = select(cut, root(pull), whole), one = T{} + 1.0;
  T factor = select(below > 0.0, select(cut, limit, one) / below, T{});
  return {factor * b, slides};
}

// Tangential force −k_t (mobilisation) s on i due to the slip.
template <class T>
inline Vec<T> tangential_force(bool smooth, T stiffness, T limit, Vec<T> s) {
  T factor = -stiffness;
  if (smooth) {
    auto holds = limit > 0.0;
    T x = stiffness * root(dot(s, s)) / select(holds, limit, T{} + 1.0);
    factor = select(holds, factor * mobilisation(x), T{});
  }
  return factor * s;
}

// Tangential force with its dashpot, truncated at the Coulomb limit.
template <class T>
inline Vec<T> with_tangential_dashpot(Vec<T> t, T damping, T limit, Vec<T> v) {
  t = t - damping * v;
  T square = dot(t, t), one = T{} + 1.0;
  auto over = square > limit * limit;
  if (!any(over)) return t;  // the same bits, sooner
  return select(over, limit / root(select(over, square, one)), one) * t;
}

template <class T, class M>
struct Loads {
  T normal;
  Vec<T> tangential, slip;
  T limit;
  M slides;
};

// Tangential force and slip if spring and dashpot together are truncated at the Coulomb limit, as in LAMMPS:
// s ← f (s + c v_t/k_t) − c v_t/k_t, F_t ← f F_t, f = limit/|F_t|.
template <class T, class M>
inline Loads<T, M> truncate_as_lammps(T fn, T stiffness, T damping, T limit, T slack, Vec<T> s, Vec<T> v, M hold,
                                      M slid) {
  Vec<T> t = (-stiffness) * s - damping * v;
  T square = dot(t, t), one = T{} + 1.0;
  M cut = square > limit * limit, slides = (cut | (slid & still_slides(square, limit, slack))) & negate(hold);
  if (!any(cut)) return {fn, t, s, limit, slides};  // the same bits, sooner
  T share = select(cut, limit / root(select(cut, square, one)), one);
  // a contact that slides without ever having been sheared transmits no tangential force
  T grip = select(negate(cut) | (dot(s, s) > 0.0), share, T{});
  auto soft = stiffness > 0.0;
  T stretch = select(soft, damping / select(soft, stiffness, one), T{});
  s = select(cut & negate(hold), s + (share - 1.0) * (s + stretch * v), s);
  return {fn, grip * t, s, limit, slides};
}

// Normal force with its dashpot, clipped if the law has no tension. Attraction by a user-defined law itself is allowed.
template <class T>
inline T with_dashpot(const Law &law, T elastic, T damping, T vn) {
  T fn = elastic - damping * vn;
  return law.tension ? fn : larger(fn, law.force ? smaller(elastic, T{}) : T{});
}

// Tangential part of a contact's loads: springs, dashpots, Coulomb limit, from its transported slip and the increment.
// `slid`: the contact was sliding before; `hold`: the slip is kept; `reach`: R_i + R_j; `v`: tangential velocity of the
// surface of i relative to that of j.
template <int DIM, class T, class M>
inline Loads<T, M> contact_loads(const Law &law, bool rate, int64_t memory, M hold, T fn, T stiffness, T damping,
                                 T limit, T overlap, T reach, const Transport<T> &moved, Ratio<T> fraction, M slid,
                                 Vec<T> v) {
  Loads<T, M> out;
  const T slack = ROUND_OFF * reach * stiffness;
  if (law.damping && rate) {
    out = truncate_as_lammps(fn, stiffness, damping, limit, slack, moved.slip + moved.increment, v, hold, slid);
  } else {
    Truncated<T, M> found = return_mapping<DIM>(fades(law), rate, memory, stiffness, limit, slack, moved.slip,
                                                moved.increment, fraction, slid, moved.fade);
    Vec<T> slip = select(hold, moved.slip, found.slip), t = tangential_force(law.smooth, stiffness, limit, slip);
    const T most = memory == HELD ? select(found.slides, limit, T{} + NO_LIMIT) : limit;
    if (law.damping) t = with_tangential_dashpot(t, damping, most, v);
    out = {fn, t, slip, limit, found.slides};
  }
  // a pair without friction across a gap does not touch: it does not slide either
  if (law.range) out.slides = out.slides & ((limit > 0.0) | (overlap > 0.0));
  return out;
}
