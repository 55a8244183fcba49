// Rules of motion of runs and batches: time profiles, springs, half kicks.
#pragma once
#include "core.h"

struct CoursePoint {
  int64_t knot;  // the last one before the time, −1: none
  double value;
};

// Value of column c of `course` (K, courses) at a time, linear between knots and constant beyond them.
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

// Pull of a spring to an anchor that follows column c of `course`; −1: none.
inline double spring_force(double stiffness, double anchor, double place, const double *knots, int64_t len_knots,
                           const double *course, int64_t courses, int64_t c, double time) {
  const double ahead = c < 0 ? 0.0 : course_at(knots, len_knots, course, courses, c, time).value;
  return stiffness * (anchor + ahead - place);
}

// Rate after half a kick with implicit drag that ends a step (`half`), and one with explicit drag that begins the next
// (`go_on`); `push`: load times half a time step over the mass.
inline double kicked(double rate, double push, double keep, double slow, bool half, bool go_on) {
  if (half) rate = (rate + push) * slow;
  if (go_on) rate = keep * rate + push;
  return rate;
}

// Rate predicted at the end of the step that begins with `rate`.
inline double predicted(double rate, double push, double slow) { return slow * (rate + push); }
