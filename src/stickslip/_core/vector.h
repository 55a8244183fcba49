// Vectors of numbers as wide as the processor's registers, and functions that take a number or such a vector.
#pragma once
#include "core.h"
#ifdef __CUDACC__
inline double root(double x) { return sqrt(x); }
#else
#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

#if defined(__AVX512F__)
constexpr int W = 8;
#elif defined(__AVX__)
constexpr int W = 4;
#else
constexpr int W = 2;
#endif

typedef double Real __attribute__((vector_size(8 * W)));  // W numbers
typedef int64_t Mask __attribute__((vector_size(8 * W)));  // −1 where true, 0 where false; also W integers

inline Real load(const double *from) {
  Real value;
  __builtin_memcpy(&value, from, sizeof value);
  return value;
}

inline Mask load(const int64_t *from) {
  Mask value;
  __builtin_memcpy(&value, from, sizeof value);
  return value;
}

inline void store(double *to, Real value) { __builtin_memcpy(to, &value, sizeof value); }
inline void store(int64_t *to, Mask value) { __builtin_memcpy(to, &value, sizeof value); }

inline double root(double x) { return __builtin_sqrt(x); }

inline Real root(Real x) {
#if defined(__AVX512F__)
  return (Real)_mm512_maskz_sqrt_pd(0xff, (__m512d)x);
#elif defined(__AVX__)
  return (Real)_mm256_sqrt_pd((__m256d)x);
#elif defined(__x86_64__)
  return (Real)_mm_sqrt_pd((__m128d)x);
#elif defined(__aarch64__)
  return (Real)vsqrtq_f64((float64x2_t)x);
#else
  return Real{__builtin_sqrt(x[0]), __builtin_sqrt(x[1])};
#endif
}

inline Real select(Mask which, Real a, Real b) { return which ? a : b; }
inline Mask select(Mask which, Mask a, Mask b) { return which ? a : b; }
inline Mask negate(Mask which) { return ~which; }

inline bool any(Mask which) {
#if defined(__AVX512F__)
  return _mm512_movepi64_mask((__m512i)which) != 0;
#elif defined(__AVX__)
  return _mm256_movemask_pd((__m256d)which) != 0;
#else
  return (which[0] | which[1]) != 0;
#endif
}
#endif

inline double select(bool which, double a, double b) { return which ? a : b; }
inline bool negate(bool which) { return !which; }
inline bool any(bool which) { return which; }

template <class T>
inline T larger(T a, T b) {
  return select(a > b, a, b);
}

template <class T>
inline T smaller(T a, T b) {
  return select(a < b, a, b);
}

template <class T>
inline T magnitude(T a) {
  return select(a < T{}, -a, a);
}

// Number with its derivative
struct Dual {
  double value, slope;
  Dual(double value = 0.0, double slope = 0.0) : value(value), slope(slope) {}
};

inline Dual operator+(Dual a, Dual b) { return {a.value + b.value, a.slope + b.slope}; }
inline Dual operator*(Dual a, Dual b) { return {a.value * b.value, a.slope * b.value + a.value * b.slope}; }
inline Dual operator*(double a, Dual b) { return {a * b.value, a * b.slope}; }
inline Dual operator+(Dual a, double b) { return {a.value + b, a.slope}; }
inline Dual operator-(Dual a) { return {-a.value, -a.slope}; }
inline Dual operator-(Dual a, Dual b) { return a + -b; }
inline Dual operator/(Dual a, Dual b) {
  double value = a.value / b.value;
  return {value, (a.slope - value * b.slope) / b.value};
}
inline bool operator<(Dual a, Dual b) { return a.value < b.value; }
inline bool operator>(Dual a, Dual b) { return a.value > b.value; }
inline Dual select(bool which, Dual a, Dual b) { return which ? a : b; }

inline Dual root(Dual a) {
  double value = root(a.value);
  return {value, 0.5 * a.slope / value};
}

template <class T>
struct Vec {
  T x, y, z;
};

template <class T>
inline Vec<T> operator+(Vec<T> a, Vec<T> b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}

template <class T>
inline Vec<T> operator-(Vec<T> a, Vec<T> b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}

template <class S, class T>
inline Vec<T> operator*(S factor, Vec<T> a) {
  return {factor * a.x, factor * a.y, factor * a.z};
}

template <class T>
inline T dot(Vec<T> a, Vec<T> b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

template <class T>
inline Vec<T> cross(Vec<T> a, Vec<T> b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

template <class M, class T>
inline Vec<T> select(M which, Vec<T> a, Vec<T> b) {
  return {select(which, a.x, b.x), select(which, a.y, b.y), select(which, a.z, b.z)};
}

// Product of a matrix (3, 3) and a vector.
template <class T>
inline Vec<T> transform(const double *m, Vec<T> a) {
  return {m[0] * a.x + m[1] * a.y + m[2] * a.z, m[3] * a.x + m[4] * a.y + m[5] * a.z,
          m[6] * a.x + m[7] * a.y + m[8] * a.z};
}
