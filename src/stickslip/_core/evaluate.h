// Evaluation of contacts by blocks and by rows, called by the loop over time steps.
#pragma once
#include "blocks.h"
#include "cell.h"
#include "laws.h"

// Planes in the scratch memory of a block: pair vector, relative velocity, Σ R ω, sum of radii; with dashpots predicted
// velocity and Σ R ω; for a user's law overlap, range, elastic force, stiffness, force with its dashpot, and cap
constexpr int64_t PAIR = 0, MOTION = 3 * LANES, ROLL = 6 * LANES, RADII = 9 * LANES, MOTION_AHEAD = 10 * LANES;
constexpr int64_t ROLL_AHEAD = 13 * LANES, OVERLAP = 16 * LANES, EDGE = 17 * LANES, ELASTIC = 18 * LANES;
constexpr int64_t STIFFNESS = 19 * LANES, TOTAL = 20 * LANES, LIMIT = 21 * LANES, SCRATCH = 22 * LANES;

// Loads and memory of the blocks `first` to `last`. With `hold`, the memory is kept. Data are prefetched meanwhile. If
// the blocks are `crossing`, their bodies may be anywhere and are prefetched one block ahead. Otherwise the bodies
// `begin` to `end`, which come next, are prefetched.
void evaluate_blocks(const Law &law, int64_t dim, int64_t first, int64_t last, bool crossing, int64_t begin,
                     int64_t end, const Blocks &blocks, const Moving &moving, double dt, bool hold, const Flow *flow,
                     double *scratch);
