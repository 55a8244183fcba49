// Grains sorted into bins, for the neighbour search.
//
// Grains of similar radius share a cell list in fractional coordinates. Its bins follow the cell's vectors. Sheared
// cells and boxes narrower than the range of a grain therefore need no special case: an image is simply a bin that lies
// some number of boxes away.
#pragma once
#include "core.h"
#include "memory.h"
#include <math.h>

namespace {

constexpr int64_t PAD = 8;  // entries that may be read beyond the last one
constexpr int64_t MOST_SIZES = 16;
constexpr double SPREAD = 3.0;  // largest ratio of radii within a size
constexpr double FEW = 0.5;     // a size with fewer grains, relative to the next larger one, is merged with that
constexpr int64_t BINS_PER_REACH[] = {1, 3, 1};  // columns along the second axis have shorter bins

template <class T>
inline T smaller(T a, T b) {
  return a < b ? a : b;
}

template <class T>
inline T larger(T a, T b) {
  return a < b ? b : a;
}

template <class T>
inline T bounded(T value, T low, T high) {
  return value < low ? low : smaller(value, high);
}

// Grains of similar radius, and their bins: columns along the second axis, because in two dimensions there is only one
// bin along the third
struct Size {
  double most;  // radius
  int64_t grains;
  double low[3], high[3];  // range of fractional coordinates
  double scale[3];         // bins per fractional coordinate
  double dense[3];         // bins per length; zero if no other bin along this axis need be searched
  int64_t number[3];       // bins along each axis
  int64_t stride[3];
  int64_t first;  // bin
};

class Bins {
 protected:
  Bins(const Grid &grid, const double *x, const double *radius, int64_t n, double skin)
      : grid(grid), x(x), radius(radius), n(n), skin(skin) {}

  bool sort_grains() {  // false if there is no memory
    if (!take_arrays()) return false;
    wrap_positions();
    assign_sizes();
    return sort_into_bins();
  }

  int64_t bin_along(const Size &one, double f, int64_t k) const {
    return static_cast<int64_t>(bounded((f - one.low[k]) * one.scale[k], 0.0, one.number[k] - 1.0));
  }

  const Grid &grid;
  const double *x, *radius;
  const int64_t n;
  const double skin;
  Scratch scratch;
  // of grains
  double *fraction;  // (N, 3) coordinates in box 0
  int32_t *box;      // (N, 3)
  uint8_t *size_of;
  int32_t *place;  // bin
  // of grains sorted into bins
  int32_t *member;
  double *at[3], *rim;  // position in box 0, and radius
  double *fraction_at[3];
  int32_t *box_at;  // (N, 3)
  int32_t *start;   // (bins + 1,)
  Size size[MOST_SIZES];
  int64_t sizes = 0;

 private:
  bool take_arrays();
  void wrap_positions();
  void assign_sizes();
  void lay_out_bins(Size &one) const;
  bool sort_into_bins();
};

inline bool Bins::take_arrays() {
  bool found = scratch.take(fraction, 3 * n) && scratch.take_zeros(box, 3 * n) && scratch.take_zeros(size_of, n) &&
               scratch.take(place, n) && scratch.take(member, n) && scratch.take(rim, n + PAD) &&
               scratch.take(box_at, 3 * n);
  for (int64_t k = 0; k < 3; ++k) found = found && scratch.take(at[k], n + PAD) && scratch.take(fraction_at[k], n);
  return found;
}

// Fractional coordinates of grains in box 0, and the boxes in which they lie.
inline void Bins::wrap_positions() {
  for (int64_t a = 0; a < n; ++a)
    for (int64_t k = 0; k < 3; ++k) {
      double f = x[3 * a] * grid.inverse[k] + x[3 * a + 1] * grid.inverse[3 + k] + x[3 * a + 2] * grid.inverse[6 + k];
      if (!(fabs(f) < 1e9)) f = 0.0;  // NaN touches nothing, whatever its bin
      if (grid.periodic[k]) {
        const double whole = floor(f);
        box[3 * a + k] = static_cast<int32_t>(whole);
        f -= whole;
      }
      fraction[3 * a + k] = f;
    }
}

// Sizes of grains, largest first: each begins with the largest radius that is left.
inline void Bins::assign_sizes() {
  double most = 0.0;
  for (int64_t a = 0; a < n; ++a) most = larger(most, radius[a]);
  for (int64_t left = n; left > 0; ++sizes) {
    Size &one = size[sizes];
    const double least = sizes < MOST_SIZES - 1 ? most / SPREAD : 0.0;
    one.most = most;
    double next = 0.0;
    int64_t grains = 0;
    for (int64_t a = 0; a < n; ++a)
      if (radius[a] <= most) {
        const bool within = radius[a] > least;
        size_of[a] = within ? sizes : size_of[a];
        grains += within;
        next = within ? next : larger(next, radius[a]);
      }
    one.grains = grains;
    left -= grains;
    most = next;
    if (sizes > 0 && grains < FEW * size[sizes - 1].grains) {
      for (int64_t a = 0; a < n; ++a) size_of[a] -= size_of[a] == sizes;
      size[--sizes].grains += grains;
    }
  }
}

// Bins along each axis. One that is as long as the range of a grain is enough where a column is crossed.
inline void Bins::lay_out_bins(Size &one) const {
  const double reach = 2 * one.most + skin;
  double span[3];
  int64_t limit = 8 * one.grains + static_cast<int64_t>(ceil(cbrt(4.0 * one.grains))) + 1;
  for (int64_t k = 0; k < 3; ++k) {
    span[k] = (one.high[k] - one.low[k]) * grid.height[k];
    one.number[k] = static_cast<int64_t>(bounded(span[k] / reach * BINS_PER_REACH[k], 1.0, 1e6));
  }
  for (;;) {
    int64_t k = one.number[1] > one.number[0], all = one.number[0] * one.number[1] * one.number[2];
    k = one.number[2] > one.number[k] ? 2 : k;
    if (all <= limit) break;
    one.number[k] = (one.number[k] + 1) / 2;
  }
  for (int64_t k = 0; k < 3; ++k) {
    const bool divided = span[k] > 0.0 && (grid.periodic[k] || one.number[k] > 1);  // else it may be 0 or tiny
    one.scale[k] = divided ? one.number[k] / (one.high[k] - one.low[k]) : 0.0;
    one.dense[k] = divided ? one.number[k] / span[k] : 0.0;
  }
  one.stride[0] = one.number[1];
  one.stride[1] = 1;
  one.stride[2] = one.number[0] * one.number[1];
}

inline bool Bins::sort_into_bins() {
  for (int64_t s = 0; s < sizes; ++s)
    for (int64_t k = 0; k < 3; ++k) {
      size[s].low[k] = grid.periodic[k] ? 0.0 : INFINITY;
      size[s].high[k] = grid.periodic[k] ? 1.0 : -INFINITY;
    }
  for (int64_t a = 0; a < n; ++a)
    for (int64_t k = 0; k < 3; ++k) {
      Size &one = size[size_of[a]];
      one.low[k] = smaller(one.low[k], fraction[3 * a + k]);
      one.high[k] = larger(one.high[k], fraction[3 * a + k]);
    }
  int64_t bins = 0;
  for (int64_t s = 0; s < sizes; ++s) {
    lay_out_bins(size[s]);
    size[s].first = bins;
    bins += size[s].number[0] * size[s].number[1] * size[s].number[2];
  }
  // the start of each bin is counted two entries ahead and moves back as it is filled
  if (!scratch.take_zeros(start, bins + 2)) return false;
  for (int64_t a = 0; a < n; ++a) {
    const Size &one = size[size_of[a]];
    int64_t bin = one.first;
    for (int64_t k = 0; k < 3; ++k) bin += bin_along(one, fraction[3 * a + k], k) * one.stride[k];
    place[a] = static_cast<int32_t>(bin);
    ++start[bin + 2];
  }
  for (int64_t b = 0; b < bins; ++b) start[b + 2] += start[b + 1];
  for (int64_t a = 0; a < n; ++a) {
    const int64_t e = start[place[a] + 1]++;
    member[e] = static_cast<int32_t>(a);
    rim[e] = radius[a];
    for (int64_t m = 0; m < 3; ++m) {
      double value = x[3 * a + m];
      for (int64_t k = 0; k < 3; ++k) value -= box[3 * a + k] * grid.vectors[3 * k + m];
      at[m][e] = value;
      fraction_at[m][e] = fraction[3 * a + m];
      box_at[3 * e + m] = box[3 * a + m];
    }
  }
  for (int64_t e = n; e < n + PAD; ++e) rim[e] = at[0][e] = at[1][e] = at[2][e] = 0.0;
  return true;
}

}  // namespace
