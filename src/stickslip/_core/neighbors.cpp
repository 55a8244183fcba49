// Neighbour search: the keys of all pairs within range, sorted, and the rows of a list from them.
//
// Grains of similar radius share a cell list in fractional coordinates. Its bins follow the cell's vectors. Sheared
// cells and boxes narrower than the range of a grain therefore need no special case: an image is simply a bin some
// number of boxes away. For pairs of two sizes, the search starts from the grains of the size for which fewer bins must
// be read: one
// large grain reads the bins of the small ones around it, and does not widen them.
#include "keys.h"
#include "memory.h"
#include "threads.h"
#include <math.h>
#include <new>
#ifdef __AVX512F__
#include <immintrin.h>
#endif

namespace {

// ---- bins

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
 public:
  Bins(const Grid &grid, const double *x, const double *radius, int64_t n, double skin)
      : grid(grid), x(x), radius(radius), n(n), skin(skin) {}

  bool sort_grains(Scratch &scratch) {  // false if memory runs out
    if (!take_arrays(scratch)) return false;
    wrap_positions();
    assign_sizes();
    return sort_into_bins(scratch);
  }

 protected:
  int64_t bin_along(const Size &one, double f, int64_t k) const {
    return static_cast<int64_t>(bounded((f - one.low[k]) * one.scale[k], 0.0, one.number[k] - 1.0));
  }

  const Grid &grid;
  const double *x, *radius;
  const int64_t n;
  const double skin;
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
  bool take_arrays(Scratch &scratch);
  void wrap_positions();
  void assign_sizes();
  void lay_out_bins(Size &one) const;
  bool sort_into_bins(Scratch &scratch);
};

inline bool Bins::take_arrays(Scratch &scratch) {
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
      if (!(fabs(f) < 1e9)) f = 0.0;  // NaN never touches, in any bin
      if (grid.periodic[k]) {
        const double whole = floor(f);
        box[3 * a + k] = static_cast<int32_t>(whole);
        f -= whole;
      }
      fraction[3 * a + k] = f;
    }
}

// Sizes of grains, largest first: each begins with the largest remaining radius.
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

inline bool Bins::sort_into_bins(Scratch &scratch) {
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

// ---- search

constexpr int64_t COLUMNS = int64_t{1} << 32, BOXES = int64_t{1} << 48;  // units of a hit, whose last part is an entry
constexpr int64_t MOST_BOXES = 1 << 14;  // along one axis within the range of a grain

inline bool is_far(int64_t image) { return image >= IMAGE_OFFSET || image <= -IMAGE_OFFSET; }

inline int64_t floor_divide(int64_t a, int64_t b) { return a >= 0 && a < b ? 0 : a / b - (a % b < 0); }

inline int64_t floor_to_int(double a) { return static_cast<int64_t>(floor(a)); }

struct Column {  // of bins near a grain
  int64_t first;  // bin
  int64_t across[2];  // boxes crossed along the first and third axis
  double shift[3];
};

struct Range {  // of entries
  int64_t from, to;
};

struct Window {  // of bins near a grain; beyond those of the box are those of its images
  int64_t low[3], high[3];
  int64_t home[3];  // bin of the grain

  bool has_same_columns(const Window &other) const {
    bool same = true;
    for (int64_t k = 0; k < 3; k += 2)
      same &= low[k] == other.low[k] && high[k] == other.high[k] && home[k] == other.home[k];
    return same;
  }
};

template <class T>
struct Growing {  // array that keeps its contents as it grows
  T *data = nullptr;
  int64_t room = 0;
  ~Growing() { free(data); }

  bool reserve(int64_t need) {
    if (need <= room) return true;
    int64_t more = need + need / 2;
    void *moved = realloc(data, more * sizeof(T));
    if (!moved) return false;
    data = static_cast<T *>(moved);
    room = more;
    return true;
  }
};

class Search : Bins {  // for the pairs of a part of the grains, by one thread
 public:
  Search(const Bins &bins, const double *normal, int64_t walls, int32_t *many, int64_t part, int64_t parts)
      : Bins(bins), normal(normal), walls(walls), many(many), part(part), parts(parts) {}

  void run();
  void write_keys(int64_t *out, const int64_t *row);

  bool too_far = false, complete = false;  // not complete if memory runs out

 private:
  void find_window(const Size &to, int64_t e, const int64_t *wide, Window &out);
  double cost(const Size &from, const Size &to) const;
  bool find_columns(const Size &to, const Window &window, bool own);
  int64_t scan(Range range, const double *s, double near, int64_t code, int64_t hits) const;
  bool scan_columns(const Size &to, int64_t e, const Window &window, bool own, int64_t &hits);
  bool search(const Size &from, const Size &to, bool own);
  bool add_pairs(int64_t e, int64_t hits);
  bool add_walls();

  const double *normal;
  const int64_t walls;
  int32_t *const many;  // (N,) pairs in which a grain is the first; then the end of their free rows
  const int64_t part, parts;
  int64_t columns = 0, keys = 0;
  Growing<Column> column;  // near a grain
  Growing<Range> range;    // in each of these
  Growing<int64_t> hit;    // entries near a grain
  Growing<int64_t> key;    // of the pairs
};

void Search::run() {
  if (!key.reserve(6 * n / parts)) return;
  for (int64_t k = 0; k < sizes; ++k)
    for (int64_t l = 0; l <= k && !too_far; ++l) {
      const bool swap = cost(size[l], size[k]) < cost(size[k], size[l]);
      if (!search(size[swap ? l : k], size[swap ? k : l], k == l)) return;
    }
  complete = add_walls();
}

// Bins within range of an entry. Its columns are those within range of any grain of its column if `wide` says how many.
inline void Search::find_window(const Size &to, int64_t e, const int64_t *wide, Window &out) {
  for (int64_t k = 0; k < 3; ++k) {
    const int64_t most = grid.periodic[k] ? MOST_BOXES * to.number[k] : 0, home = bin_along(to, fraction_at[k][e], k);
    double middle = (fraction_at[k][e] - to.low[k]) * to.scale[k];
    double half = (rim[e] + to.most + skin) * to.dense[k] + 1e-6;  // more than the error of coordinates
    if (wide && k != 1) middle = home, half = wide[k];
    too_far |= most && !(half < most);
    out.low[k] = floor_to_int(bounded(middle - half, -1.0 * most, to.number[k] - 1.0));
    out.high[k] = floor_to_int(bounded(middle + half, 0.0, to.number[k] - 1.0 + most));
    out.home[k] = wide ? home : 0;
  }
}

// Number of columns to be searched for pairs of a size with another one.
double Search::cost(const Size &from, const Size &to) const {
  double found = static_cast<double>(from.grains);
  for (int64_t k = 0; k < 3; k += 2) found *= 2.0 * (from.most + to.most + skin) * to.dense[k] + 1.0;
  return found;
}

// Columns of bins in a window, the boxes crossed, and the shifts of positions. With `own`, only that of the grain,
// as the first one, and those after it, so each pair of columns is found once.
bool Search::find_columns(const Size &to, const Window &window, bool own) {
  const double need = (window.high[0] - window.low[0] + 1.0) * (window.high[2] - window.low[2] + 1.0);
  columns = 0;
  too_far |= need >= BOXES / COLUMNS;
  if (too_far) return true;
  if (!column.reserve(static_cast<int64_t>(need)) || !range.reserve(static_cast<int64_t>(need))) return false;
  for (int64_t t = own ? window.home[2] : window.low[2]; t <= window.high[2]; ++t)
    for (int64_t u = own && t == window.home[2] ? window.home[0] : window.low[0]; u <= window.high[0]; ++u) {
      const int64_t i = floor_divide(u, to.number[0]), k = floor_divide(t, to.number[2]);
      Column &one = column.data[columns++];
      one.first = to.first + (u - i * to.number[0]) * to.stride[0] + (t - k * to.number[2]) * to.stride[2];
      one.across[0] = i;
      one.across[1] = k;
      for (int64_t m = 0; m < 3; ++m) one.shift[m] = i * grid.vectors[m] + k * grid.vectors[6 + m];
    }
  return true;
}

// Writes the entries of a range that are near a point to `hit`, and returns the end of the hits. All are written but
// few are counted, which is cheaper than an unpredictable branch.
inline int64_t Search::scan(Range range, const double *s, double near, int64_t code, int64_t hits) const {
  int64_t *out = hit.data;
  const double *px = at[0], *py = at[1], *pz = at[2], *pr = rim;
#ifdef __AVX512F__
  const __m512d sx = _mm512_set1_pd(s[0]), sy = _mm512_set1_pd(s[1]), sz = _mm512_set1_pd(s[2]);
  const __m512d all = _mm512_set1_pd(near);
  const __m512i step = _mm512_set_epi64(7, 6, 5, 4, 3, 2, 1, 0);
  for (int64_t f = range.from; f < range.to; f += 8) {
    const __m512d dx = sx - _mm512_loadu_pd(px + f), dy = sy - _mm512_loadu_pd(py + f);
    const __m512d dz = sz - _mm512_loadu_pd(pz + f), reach = all + _mm512_loadu_pd(pr + f);
    const __mmask8 within = _bzhi_u32(255, smaller(range.to - f, int64_t{8}));
    const __mmask8 close = _mm512_mask_cmp_pd_mask(within, dx * dx + dy * dy + dz * dz, reach * reach, _CMP_LT_OQ);
    _mm512_storeu_si512(out + hits, _mm512_maskz_compress_epi64(close, _mm512_set1_epi64(code + f) + step));
    hits += __builtin_popcount(close);
  }
#else
  for (int64_t f = range.from; f < range.to; ++f) {
    const double dx = s[0] - px[f], dy = s[1] - py[f], dz = s[2] - pz[f], reach = near + pr[f];
    out[hits] = code + f;
    hits += dx * dx + dy * dy + dz * dz < reach * reach;
  }
#endif
  return hits;
}

// Entries near one, in the part of each column that is in the window. False if memory runs out.
inline bool Search::scan_columns(const Size &to, int64_t e, const Window &window, bool own, int64_t &hits) {
  const int64_t last_box = floor_divide(window.high[1], to.number[1]);
  hits = 0;
  for (int64_t over = floor_divide(window.low[1], to.number[1]); over <= last_box; ++over) {
    const int64_t low = larger(window.low[1] - over * to.number[1], int64_t{0});
    const int64_t high = smaller(window.high[1] - over * to.number[1], to.number[1] - 1) + 1;
    int64_t need = hits + PAD;
    for (int64_t c = 0; c < columns; ++c) {
      range.data[c] = {start[column.data[c].first + low], start[column.data[c].first + high]};
      need += range.data[c].to - range.data[c].from;
    }
    if (own && over <= 0) range.data[0].from = over < 0 ? range.data[0].to : e + 1;
    if (!hit.reserve(need)) return false;
    double s[3], p[3];
    for (int64_t m = 0; m < 3; ++m) s[m] = at[m][e] - over * grid.vectors[3 + m];
    for (int64_t c = 0; c < columns; ++c) {
      for (int64_t m = 0; m < 3; ++m) p[m] = s[m] - column.data[c].shift[m];
      hits = scan(range.data[c], p, rim[e] + skin, over * BOXES + c * COLUMNS, hits);
    }
  }
  return true;
}

// Adds the pairs of an entry with the bodies that were hit; returns false if there is not enough memory.
inline bool Search::add_pairs(int64_t e, int64_t hits) {
  if (!key.reserve(keys + hits)) return false;
  const int64_t a = member[e];
  for (int64_t h = 0; h < hits; ++h) {
    const int64_t code = hit.data[h], f = code & (COLUMNS - 1), over = code >> 48, b = member[f];
    const Column &one = column.data[code >> 32 & (BOXES / COLUMNS - 1)];
    const int64_t i = box_at[3 * f] - box_at[3 * e] - one.across[0], j = box_at[3 * f + 1] - box_at[3 * e + 1] - over;
    const int64_t k = box_at[3 * f + 2] - box_at[3 * e + 2] - one.across[1];
    too_far |= is_far(i) | is_far(j) | is_far(k);
    const int64_t forward = pack_key(a, b, i, j, k), backward = pack_key(b, a, -i, -j, -k);
    // a grain and its own image: that which comes first among the images
    key.data[keys++] = a < b || (a == b && forward > backward) ? forward : backward;
    ++many[smaller(a, b)];
  }
  return true;
}

// Pairs of grains with walls. False if memory runs out.
bool Search::add_walls() {
  const int64_t last = walls > 0 ? n * (part + 1) / parts : 0;
  for (int64_t a = n * part / parts; a < last; ++a) {
    if (!key.reserve(keys + walls)) return false;
    for (int64_t b = 0; b < walls; ++b) {
      double gap = -radius[a] - skin;
      for (int64_t k = 0; k < 3; ++k) gap += (x[3 * a + k] - x[3 * (n + b) + k]) * normal[3 * b + k];
      key.data[keys] = pack_key(a, n + b, 0, 0, 0);
      keys += gap < 0.0;
      many[a] += gap < 0.0;
    }
  }
  return true;
}

// Pairs of grains of a size with those of another or of the same size. False if memory runs out.
bool Search::search(const Size &from, const Size &to, bool own) {
  const int64_t entry = start[from.first] + from.grains * part / parts;
  const int64_t end = start[from.first] + from.grains * (part + 1) / parts;
  int64_t wide[3], hits;
  Window window, known = {};
  columns = 0;
  for (int64_t k = 0; k < 3; ++k) wide[k] = floor_to_int(bounded(ceil((2 * to.most + skin) * to.dense[k]), 0.0, 1e9));
  for (int64_t e = entry; e < end; ++e) {
    find_window(to, e, own ? wide : nullptr, window);
    if (!columns || !window.has_same_columns(known)) {
      if (!find_columns(to, window, own)) return false;
      known = window;
    }
    if (too_far) return true;
    if (!scan_columns(to, e, window, own, hits) || !add_pairs(e, hits)) return false;
  }
  return true;
}

int order(const void *a, const void *b) {
  const int64_t x = *static_cast<const int64_t *>(a), y = *static_cast<const int64_t *>(b);
  return (x > y) - (x < y);
}

// Sorts keys, which are few except for grains much larger than their neighbours.
void sort_keys(int64_t *key, int64_t count) {
  if (count > 64) return qsort(key, count, sizeof(int64_t), order);
  insert_in_order(key, count);
}

void Search::write_keys(int64_t *out, const int64_t *row) {
  for (int64_t c = 0; c < keys; ++c) {
    const int64_t a = key.data[c] >> (BODY_BITS + 3 * IMAGE_BITS);
    out[row[a] + --many[a]] = key.data[c];
  }
}

// Finds the pairs of all parts. False if memory runs out.
bool find_all(Pairs &pairs, Search *search, int32_t *many, Pool &pool) {
  const int64_t n = pairs.grains, parts = pool.parts;
  pool.each([&](int64_t k) { search[k].run(); });
  for (int64_t k = 0; k < parts; ++k) {
    if (!search[k].complete && !search[k].too_far) return false;
    pairs.too_far |= search[k].too_far;
  }
  if (pairs.too_far) return true;
  pairs.row[0] = 0;
  for (int64_t a = 0; a < n; ++a) {
    int32_t rows = 0;
    for (int64_t k = 0; k < parts; ++k) rows = many[k * n + a] += rows;
    pairs.row[a + 1] = pairs.row[a] + rows;
  }
  pairs.key = static_cast<int64_t *>(malloc((pairs.row[n] + 1) * sizeof(int64_t)));
  if (!pairs.key) return false;
  pool.each([&](int64_t k) { search[k].write_keys(pairs.key, pairs.row); });
  pool.each([&](int64_t k) {
    const int64_t last = n * (k + 1) / parts;
    for (int64_t a = n * k / parts; a < last; ++a)
      sort_keys(pairs.key + pairs.row[a], pairs.row[a + 1] - pairs.row[a]);
  });
  return true;
}

}  // namespace

Pairs *find_pairs(const Grid *grid, const double *x, const double *radius, const double *normal, int64_t bodies,
                  int64_t walls, double skin, int64_t threads) {
  const int64_t n = bodies - walls;
  Pool pool(threads);
  Scratch scratch;
  Search *search;
  int32_t *many;
  Bins bins(*grid, x, radius, n, skin);
  Pairs *pairs = static_cast<Pairs *>(calloc(1, sizeof(Pairs)));
  if (!pairs) return nullptr;
  pairs->grains = n;
  pairs->threads = threads;
  pairs->row = static_cast<int64_t *>(malloc((n + 1) * sizeof(int64_t)));
  bool found = pairs->row && scratch.take(search, threads) && scratch.take_zeros(many, threads * n) &&
               bins.sort_grains(scratch);
  if (found) {
    for (int64_t k = 0; k < threads; ++k) new (search + k) Search(bins, normal, walls, many + k * n, k, threads);
    found = find_all(*pairs, search, many, pool);
    for (int64_t k = 0; k < threads; ++k) search[k].~Search();
  }
  if (found) return pairs;
  free_pairs(pairs);
  return nullptr;
}

// ---- list, with the memory of the former one

int64_t count_pairs(const Pairs *pairs) { return pairs->too_far ? -1 : pairs->row[pairs->grains]; }

void free_pairs(Pairs *pairs) {
  free(pairs->key);
  free(pairs->row);
  free(pairs);
}

namespace {

// Row of a key in a list, or −1.
int64_t find_row(const Pairs &pairs, int64_t grain, int64_t key) {
  if (grain >= pairs.grains) return -1;
  int64_t low = pairs.row[grain], high = pairs.row[grain + 1];
  while (low < high) {
    const int64_t middle = (low + high) / 2;
    if (pairs.key[middle] < key)
      low = middle + 1;
    else
      high = middle;
  }
  return low < pairs.row[grain + 1] && pairs.key[low] == key ? low : -1;
}

void copy(double *to, int64_t row, const double *from, int64_t old_row, int64_t width) {
  memcpy(to + row * width, from + old_row * width, width * sizeof(double));
}

// Copies the memory of the contacts in some rows that are in both lists: of closed ones, and of rolling and laws also
// of open ones.
void copy_memory(const Pairs &pairs, const Contacts &old, const Contacts &list, int64_t first, int64_t last) {
  const bool anchors = old.len_pair > 0 && list.len_pair > 0;
  const bool rolls = old.width_rolling && old.width_rolling == list.width_rolling;
  for (int64_t c = first; c < last; ++c) {
    if (old.mode[c] == OPEN && !rolls) continue;
    const int16_t *image = old.image + 3 * c;
    const int64_t row = find_row(pairs, old.i[c], pack_key(old.i[c], old.j[c], image[0], image[1], image[2]));
    if (row < 0) continue;
    if (rolls) copy(list.rolling, row, old.rolling, c, list.width_rolling);
    if (old.mode[c] == OPEN) continue;
    list.mode[row] = old.mode[c];
    list.reached[row] = old.reached[c];
    copy(list.slip, row, old.slip, c, 3);
    if (!anchors) continue;
    copy(list.pair, row, old.pair, c, 3);
    copy(list.roll, row, old.roll, c, 3);
  }
}

}  // namespace

void fill_list(const Pairs *pairs, const Contacts *old, const Contacts *list) {
  constexpr int64_t BODY = (1 << BODY_BITS) - 1;
  const int64_t count = pairs->row[pairs->grains], parts = pairs->threads, former = old->count[0];
  Pool pool(parts);
  pool.each([&](int64_t k) {
    const int64_t last = count * (k + 1) / parts;
    for (int64_t c = count * k / parts; c < last; ++c) {
      const int64_t key = pairs->key[c];
      if (list->len_key > 0) list->key[c] = key;
      list->i[c] = static_cast<int32_t>(key >> (BODY_BITS + 3 * IMAGE_BITS));
      list->j[c] = static_cast<int32_t>(key >> 3 * IMAGE_BITS & BODY);
      for (int m = 0; m < 3; ++m) list->image[3 * c + m] = static_cast<int16_t>(image_of(key, m));
    }
    copy_memory(*pairs, *old, *list, former * k / parts, former * (k + 1) / parts);
  });
}

double largest_displacement(const double *x, const double *origin, int64_t bodies) {
  double most = 0.0;
  for (int64_t a = 0; a < bodies; ++a) {
    const double dx = x[3 * a] - origin[3 * a], dy = x[3 * a + 1] - origin[3 * a + 1];
    const double dz = x[3 * a + 2] - origin[3 * a + 2], square = dx * dx + dy * dy + dz * dz;
    if (!(square <= most)) most = square < INFINITY ? square : INFINITY;
  }
  return sqrt(most);
}
