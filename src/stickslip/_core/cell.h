// Motion of the deforming cell, time profiles, and springs whose load points move; see `core/dynamics/cell_motion.py`.
//
// Compiled without fast math: courses and cells of a continued run are bitwise identical.
#pragma once
#include "core.h"

struct CoursePoint {
  int64_t knot;  // last knot before the time, −1 if there is none
  double value;
};

// Value of column c of a time profile (len_knots, courses) at a time.
CoursePoint course_at(const double *knots, int64_t len_knots, const double *course, int64_t courses, int64_t c,
                      double time);

// End a step: sum the stress in order of grain number, and accelerate the cell.
void end_cell_step(int64_t dim, Frame &frame, Flow &flow, double dt, double slow, const Moving &moving, bool fresh);

// Largest force or drag force on a free component of the cell, divided by ℓ [force]; NaN if one is NaN.
double unbalanced_cell(int64_t dim, const Frame &frame, const Flow &flow, double drag);

// Add the forces of springs to those on the bodies of the last tile, which begins at body `first`.
void add_springs(const Pull &pull, int64_t first, const Moving &moving);
