// Parts of the loop over time steps: contacts by rows and by blocks, motion of bodies, of the cell and by springs,
// samples, events.
#pragma once
#include "blocks.h"
#include "course.h"
#include "pairs.h"

// ---- events of contacts

struct Events {
  double *row;     // (…, EVENT)
  int64_t *count;  // rows beyond the capacity are counted but not stored
  int64_t capacity;
  double time;
};

inline void record_event(const Events *events, int64_t kind, const Contacts &contacts, int64_t c, const double *place) {
  if (!events) return;
  const int64_t k = events->count[0]++;
  if (k >= events->capacity) return;
  write_event(events->row + EVENT * k, kind, events->time, contacts.i[c], contacts.j[c],
              contacts.image + 3 * c, place);
}

// ---- contacts row by row of the list: for `forces`, and for runs of few grains or with bonds

struct Vectors {  // one per body; rows of arrays that hold more
  const double *data;
  int64_t stride;
};

struct Motion {  // of bodies during a step of a run
  Vectors velocity, spin;  // at the half step
  double dt;
  bool hold;               // the memory is kept
  const double *gradient;  // of the cell's velocity, and (1 + ½ dt L)⁻¹; or null
  const double *back;
};

struct Sweep {
  int64_t memory;         // see core.h
  bool given;             // with GIVEN
  bool stepping;          // during a run; else contacts have moved from their committed `pair` and `roll`, which are updated
  Motion motion;          // during a run
  Vectors position, angle, velocity, spin;  // the last two as dashpots use them
  const double *gradient;                   // of the cell's velocity, as dashpots use it; or null
  const Bodies &bodies;                     // radius, material, inverse mass, normals of walls
  const double *vectors;                    // of the cell
  double *force, *torque;                   // rows of `stride` numbers, to which loads are added
  int64_t stride;
  double *virial;  // (B, 9) to which f ⊗ r is added at body i; or null
  Events *events;  // or null
};

// Adds the loads of all contacts and updates their memory in place.
void sweep_contacts(const Law &law, int64_t dim, const Sweep &sweep, const Contacts &contacts);

// ---- contacts by blocks

// Planes in the scratch memory of a block: pair vector, relative velocity, Σ R ω, sum of radii; with dashpots predicted
// velocity and Σ R ω; for a user-defined law overlap, range, elastic force, stiffness, force with its dashpot, cap,
// rolling stiffness and cap, stiffness before the step, and unused results; with moments ω_i − ω_j, and as predicted
constexpr int64_t PAIR = 0, MOTION = 3 * LANES, ROLL = 6 * LANES, RADII = 9 * LANES, MOTION_AHEAD = 10 * LANES;
constexpr int64_t ROLL_AHEAD = 13 * LANES, OVERLAP = 16 * LANES, EDGE = 17 * LANES, ELASTIC = 18 * LANES;
constexpr int64_t STIFFNESS = 19 * LANES, TOTAL = 20 * LANES, LIMIT = 21 * LANES, ROLL_STIFFNESS = 22 * LANES;
constexpr int64_t ROLL_CAP = 23 * LANES, ROTATION = 24 * LANES, ROTATION_AHEAD = 27 * LANES, FORMER = 30 * LANES;
constexpr int64_t UNUSED = 31 * LANES, SCRATCH = 32 * LANES;

// Loads and memory of the blocks `first` to `last`. With `hold`, the memory is kept. Data are prefetched meanwhile. If
// the blocks are `crossing`, their bodies are scattered and are prefetched one block ahead. Otherwise the bodies
// `begin` to `end`, which come next, are prefetched.
void evaluate_blocks(const Law &law, int64_t dim, int64_t first, int64_t last, bool crossing, int64_t begin,
                     int64_t end, const Blocks &blocks, const Moving &moving, double dt, bool hold, const Flow *flow,
                     double *scratch);

// ---- motion: sums of contact loads, half kicks and drift. Compiled without contraction and without fast math, so
// stopping after a step for a record does not change a single bit of the trajectory

constexpr int64_t CHUNK = 64;  // bodies whose forces are summed together

// One step of velocity Verlet for a range of bodies
struct Step {
  int64_t dim;
  bool predict;  // velocities at the full step for dashpots
  bool lever;    // lever arms are shorter than R by the seventh number of a row of loads
  bool turns;    // contacts have moments
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

void end_cell_step(int64_t dim, Frame &frame, Flow &flow, double dt, double slow, const Moving &moving, bool fresh);

// Largest force or drag force on a free component of the cell, divided by ℓ [force]; NaN if one is NaN.
double unbalanced_cell(int64_t dim, const Frame &frame, const Flow &flow, double drag);

// Add the forces of springs to those on the bodies of the last tile, which begins at body `first`.
void add_springs(const Pull &pull, int64_t first, const Moving &moving);

// ---- samples, see `core/dynamics/record.py`

bool write_moving_sample(const Law &law, int64_t dim, int64_t k, const Moving &moving, const Bodies &bodies,
                         const Contacts &contacts, const double *vectors, const Writing &writing, double time);
