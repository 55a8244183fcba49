// Values of a time profile, linear between knots and constant beyond them.
#pragma once
#include "core.h"

struct CoursePoint {
  int64_t knot;  // the last one before the time, −1: none
  double value;
};

// Value of column c of `course` (K, courses) at a time.
inline CoursePoint course_at(const double *knots, int64_t len_knots, const double *course, int64_t courses, int64_t c,
                             double time) {
  int64_t k = 0, last = len_knots - 1;
  if (time <= knots[0]) return {-1, course[c]};
  if (time >= knots[last]) return {last, course[last * courses + c]};
  for (int64_t end = last; end - k > 1;) {
    int64_t middle = k + (end - k) / 2;
    (knots[middle] <= time ? k : end) = middle;
  }
  double part = (time - knots[k]) / (knots[k + 1] - knots[k]), value = course[k * courses + c];
  return {k, value + part * (course[(k + 1) * courses + c] - value)};
}
