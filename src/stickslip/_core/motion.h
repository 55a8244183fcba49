// Motion of bodies: sums of contact loads, half kicks and drift. Compiled without contraction and without fast math, so
// that stopping after a step for a record does not change a single bit of the trajectory.
#pragma once
#include "blocks.h"
#include "cell.h"

constexpr int64_t CHUNK = 64;  // bodies whose forces are summed together

// One step of velocity Verlet for a range of bodies
struct Step {
  int64_t dim;
  bool predict;  // velocities at the full step for dashpots
  bool lever;    // lever arms are shorter than R by the seventh number of a row of loads
  const Moving &moving;
  const Pace &pace;
  const Flow *flow;
  bool fresh;  // velocities are those of the full step already
  bool go_on;  // begin the next step at once
};

// Each of the following returns the largest squared displacement since blocks were chosen, over the allowed one; NaN
// counts as largest. `total` has room for CHUNK rows of loads.
double end_step(const Step &step, const Blocks &blocks, int64_t first, int64_t last, double *total);
double end_last_tile(const Step &step, const Blocks *blocks, const Pull *pull, double *total);
double begin_step(const Step &step, int64_t first, int64_t last);

// Largest force, torque/R or drag force on the free components of moving bodies, and the body; NaN counts as largest.
double largest_unbalanced(const Moving &moving, const Pace &pace, double drag, double spin_drag, int64_t *worst);
