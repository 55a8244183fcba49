// Motion of the deforming cell, time profiles, and springs whose load points move; see `core/dynamics/cell_motion.py`.
//
// Compiled without fast math: courses and cells of a continued run are bitwise identical.
#pragma once
#include "course.h"

// End a step: sum the stress in order of grain number, and accelerate the cell.
void end_cell_step(int64_t dim, Frame &frame, Flow &flow, double dt, double slow, const Moving &moving, bool fresh);

// Largest force or drag force on a free component of the cell, divided by ℓ [force]; NaN if one is NaN.
double unbalanced_cell(int64_t dim, const Frame &frame, const Flow &flow, double drag);

// Add the forces of springs to those on the bodies of the last tile, which begins at body `first`.
void add_springs(const Pull &pull, int64_t first, const Moving &moving);
