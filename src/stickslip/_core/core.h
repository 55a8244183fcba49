// Everything that Python calls, and the arrays that it passes. `core/library.py` reads this file: one member or function
// per declaration; `len_x` is filled with len(x). Pointers may be null where a comment says so. See `core.fields` for
// shapes and ranges of the fields of a state.
#pragma once
#include <stdint.h>

#define API extern "C" __attribute__((visibility("default")))

// ---- state

struct Bodies {
  double *position;  // (B, 3)
  double *angle;
  double *velocity;
  double *spin;
  double *radius;  // (B,) zero for walls
  int64_t *material;
  double *inverse_mass;
  double *normal;  // (W, 3)
  double *rate;    // (3, 3) velocity gradient of the cell
  int64_t len_radius;
  int64_t len_normal;
};

struct Contacts {
  int32_t *i;
  int32_t *j;
  int16_t *image;  // (C, 3)
  int64_t *key;    // empty if the list has none
  double *slip;    // (C, 3)
  int8_t *mode;
  double *pair;  // (C, 3), or empty
  double *roll;
  uint8_t *reached;
  double *origin;  // (B, 3)
  int64_t *count;  // (1,)
  double *rolling;  // (C, 7) or null
  int64_t len_i;
  int64_t len_key;
  int64_t len_pair;
};

// ---- a run

constexpr int64_t LANES = 64;  // pairs in a block
// columns of a body: position and radius; velocity and half a time step over mass; spin and half a time step over
// inertia. Then columns of predicted values: velocity; spin
constexpr int64_t RADIUS = 3, VELOCITY = 4, KICK = 7, SPIN = 8, KICK_T = 11, BODY = 12;
constexpr int64_t VELOCITY_AHEAD = 0, SPIN_AHEAD = 4, BODY_AHEAD = 8;

// Bodies in memory order: tiles of neighbouring grains, then the last tile: rigid groups, bodies on springs, and walls
struct Moving {
  int64_t *order;    // (B,) number of each body in the state
  double *body;      // (B, BODY)
  double *angle;     // (B, 3)
  double *ahead;     // (B, BODY_AHEAD) velocity and spin predicted at the full step, for dashpots; else empty
  double *force;     // (B, 6) written where a step ends without beginning the next
  uint8_t *free;     // (B, 6)
  uint8_t *whole;    // (B,) all components that exist in this dimension are free
  double *external;  // (B, 8) external forces and zeros, or (1, 8) zeros
  double *torque;    // (B, 3), or (1, 3) zeros
  double *virial;    // (B, 9) Σ f ⊗ r over contacts in which a body is i, written with a frame; else empty
  double *origin;    // (B, 4) positions when blocks were chosen, and 1/d², d the displacement limit
  int64_t *tile;     // (T + 1,) bounds of the tiles; the last tile follows
  int64_t *member;   // bodies in rigid groups, group after group
  int64_t *members;  // (G + 1,) bounds of the groups
  int64_t *share;    // (threads + 1,) bounds of the tiles of each thread
  int64_t *spent;    // (threads, 8) first column: ticks that each thread spent on its tiles
  int64_t len_order;
  int64_t len_ahead;
  int64_t len_external;
  int64_t len_torque;
  int64_t len_virial;
  int64_t len_tile;
  int64_t len_members;
  int64_t len_share;
};

struct Blocks;  // see blocks.h

API Blocks *new_blocks(void);
API void free_blocks(Blocks *blocks);

// ---- contact laws

// A function of a user's law for n contacts of one pair of materials, see `laws.user`
typedef void (*LawFunction)(const double *q, int64_t n, const double *r_eff, const double *overlap, const double *fn,
                            double *one, double *two);

struct Law {
  int64_t hertz;        // F_n grows as overlap^(3/2), else linearly
  int64_t uses_radius;  // stiffnesses contain √R_eff, or a user's function takes R_eff
  int64_t rescaled;     // a decreasing overlap shortens the slip
  int64_t smooth;       // smoothed Coulomb limit
  int64_t damping;      // 0, or VELOCITY, MASS, VISCOELASTIC
  int64_t tension;      // dashpots may make a contact pull
  int64_t rate;         // slip update as in LAMMPS
  int64_t len_table;    // materials
  int64_t width;        // parameters
  double *table;        // (materials, materials, width)
  void *force;          // of a user's law, else null: F_n and k_t
  void *cap;            // largest tangential force, null: μ max(F_n, 0)
  void *slopes;         // dF_n/dδ and dk_t/dδ
  void *cap_slopes;     // d(cap)/dF_n and d(cap)/dδ
  void *energy;         // of the normal spring
  void *range;          // largest gap, null: 0
  void *rolling;        // k_r and dk_r/dδ, null: no rolling resistance
  void *rolling_cap;    // largest moment
  void *rolling_slopes;  // d(rolling cap)/dF_n and d(rolling cap)/dδ
};

// ---- rate-and-state friction

// A surface and the spring that pulls it, see `friction.slider`; stiffness and damping are over the normal stress
struct Slider {
  double a;
  double b;
  double b2;  // of a second state
  double mu0;
  double cut;  // V0 over the cut-off velocities of the direct effect and of the evolution effect
  double cut2;
  double dc;
  double dc2;
  double v0;
  double alpha;
  double stiffness;
  double damping;
  int64_t form;       // see `friction.laws`
  int64_t evolution;  // see `friction.laws`
};

// Legs of constant velocity of the load point, and of constant normal stress
struct Legs {
  double *duration;
  double *velocity;
  double *normal;
  int64_t len_duration;
};

struct Fault {
  int64_t form;
  int64_t evolution;
  double mu0;
  double cut;
  double cut2;
  double v0;
  double damping;
  double plate_rate;
  double cell;
  double *cells;  // (7, N) a, b, D_c, normal stress, initial stress, b2, D_c2
  int64_t number;
  int64_t states;
  double *weights;  // (K, K) of the stages of a step in each later one, and in the step
  double *five;     // (K + 1,) weights of the stages in errors of order 5 and 3
  double *three;
  int64_t len_weights;
};

// A step of a fault of S states
struct FaultStep {
  double *y;       // (1 + S, N) unknowns at its start
  double *trial;   // (1 + S, N) unknowns of the present stage
  double *w;       // (N,) ln(V/V0) of the stage before, replaced by that of the present one
  double *stages;  // (K + 1, 1 + S, N) rates of the unknowns
  double *powers;  // (K + 1, 3) of loading, friction and radiation
  double length;
};

// Friction (N,), its slopes (N, 3) and curvatures (N, 6) from w, s and s2 (N, 3); results may be null
API void friction_of_rows(int64_t form, int64_t count, const double *logs, const double *surfaces, int64_t many,
                          double *mu, double *slopes, double *curvatures);
// s at the ends of pieces of constant slip velocity
API void state_history(int64_t evolution, double s, int64_t count, const double *duration, const double *velocity,
                       double v0, double dc, double *out);
// Time derivatives of w, s and s2 (3,), and their Jacobian (3, 3)
API void slider_rates(const Slider *slider, const double *logs, double velocity, double normal, double *out,
                      double *jacobian);
// w, s and s2 at ascending times (N, 3); returns a code, see `friction.slider`
API int64_t slider_history(const Slider *slider, const Legs *legs, const double *start, const double *times,
                           int64_t count, double tolerance, double *out, double *reached);
// Rates of the unknowns and powers; false if a velocity cannot be found
API uint8_t fault_rates(const Fault *fault, const double *transferred, const double *y, double *w, double *out,
                        double *power);
// Unknowns of a stage from the rates of the stages before
API void fault_trial(const Fault *fault, const FaultStep *step, int64_t stage);
// Rates of a stage, and unknowns of the next one; false if a velocity cannot be found
API uint8_t fault_stage(const Fault *fault, const FaultStep *step, int64_t stage, const double *transferred);
// Root mean square of the estimated errors of u/D_c and of each s in a step
API double fault_error(const Fault *fault, const FaultStep *step);

// ---- the library itself

API int32_t core_processor_level(void);  // best level of this processor
