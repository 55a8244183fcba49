// Neighbour search: the keys of all pairs within range, sorted.
//
// Grains of similar radius share a cell list, see `bins.h`. Pairs of two sizes are sought by the grains of that size
// for which fewer bins must be read: one large grain reads the bins of the small ones around it, and does not widen
// them.
#include "bins.h"
#include "keys.h"
#include <math.h>
#ifdef __AVX512F__
#include <immintrin.h>
#endif

namespace {

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

class Search : Bins {
 public:
  Search(const Grid &grid, const double *x, const double *radius, const double *normal, int64_t bodies, int64_t walls,
         double skin)
      : Bins(grid, x, radius, bodies - walls, skin), normal(normal), walls(walls) {}

  bool run();  // false if there is no memory
  bool write_keys(int64_t *&key, int64_t *row);  // sorted, and the first row of each grain

  bool too_far = false;

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
  int64_t *many;  // pairs in which a grain is the first
  int64_t columns = 0, keys = 0;
  Growing<Column> column;  // near a grain
  Growing<Range> range;    // in each of these
  Growing<int64_t> hit;    // entries near a grain
  Growing<int64_t> key;    // of all pairs
};

bool Search::run() {
  if (!sort_grains() || !scratch.take_zeros(many, n) || !key.reserve(6 * n)) return false;
  for (int64_t k = 0; k < sizes; ++k)
    for (int64_t l = 0; l <= k && !too_far; ++l) {
      const bool swap = cost(size[l], size[k]) < cost(size[k], size[l]);
      if (!search(size[swap ? l : k], size[swap ? k : l], k == l)) return false;
    }
  return add_walls();
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
// as the first one, and those after it, so that each pair of columns is found once.
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

// Writes the entries of a range that are near a point to `hit`, and returns the end of the hits. All are written and
// few are counted, which is cheaper than a branch that cannot be predicted.
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

// Entries near one, in the part of each column that is in the window. False if there is no memory.
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

// Pairs of an entry with those that were hit. False if there is no memory.
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

// Pairs of all grains with walls. False if there is no memory.
bool Search::add_walls() {
  for (int64_t a = 0; a < n && walls > 0; ++a) {
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

// Pairs of all grains of a size with those of another or of the same size. False if there is no memory.
bool Search::search(const Size &from, const Size &to, bool own) {
  const int64_t entry = start[from.first];
  int64_t wide[3], hits;
  Window window, known = {};
  columns = 0;
  for (int64_t k = 0; k < 3; ++k) wide[k] = floor_to_int(bounded(ceil((2 * to.most + skin) * to.dense[k]), 0.0, 1e9));
  for (int64_t e = entry; e < entry + from.grains; ++e) {
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
  for (int64_t c = 1; c < count; ++c) {
    const int64_t one = key[c];
    int64_t d = c;
    for (; d > 0 && key[d - 1] > one; --d) key[d] = key[d - 1];
    key[d] = one;
  }
}

bool Search::write_keys(int64_t *&out, int64_t *row) {
  row[0] = 0;
  for (int64_t a = 0; a < n; ++a) row[a + 1] = row[a] + many[a];
  out = static_cast<int64_t *>(malloc((keys + 1) * sizeof(int64_t)));
  if (!out) return false;
  for (int64_t c = 0; c < keys; ++c) {
    const int64_t a = key.data[c] >> (BODY_BITS + 3 * IMAGE_BITS);
    out[row[a] + --many[a]] = key.data[c];
  }
  for (int64_t a = 0; a < n; ++a) sort_keys(out + row[a], row[a + 1] - row[a]);
  return true;
}

}  // namespace

Pairs *find_pairs(const Grid *grid, const double *x, const double *radius, const double *normal, int64_t bodies,
                  int64_t walls, double skin) {
  Search search(*grid, x, radius, normal, bodies, walls, skin);
  const int64_t n = bodies - walls;
  Pairs *pairs = static_cast<Pairs *>(calloc(1, sizeof(Pairs)));
  if (!pairs) return nullptr;
  pairs->grains = n;
  pairs->row = static_cast<int64_t *>(malloc((n + 1) * sizeof(int64_t)));
  if (pairs->row && search.run()) {
    pairs->too_far = search.too_far;
    if (search.too_far || search.write_keys(pairs->key, pairs->row)) return pairs;
  }
  free_pairs(pairs);
  return nullptr;
}
