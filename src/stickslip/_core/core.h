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

// ---- neighbours

struct Grid {  // of the cell, for the pair search; the unit matrix if nothing is periodic
  double *vectors;    // (3, 3)
  double *inverse;    // (3, 3)
  double *height;     // (3,) distance between opposite faces
  uint8_t *periodic;  // (3,)
};

struct Pairs;  // keys of all pairs within range

// Pairs closer than `skin`; x are the positions of all bodies, walls last. Null if there is no memory
API Pairs *find_pairs(const Grid *grid, const double *x, const double *radius, const double *normal, int64_t bodies,
                      int64_t walls, double skin);
API int64_t count_pairs(const Pairs *pairs);  // −1 if a pair is more boxes apart than a key can hold
// Fills a list, whose memory is zero, and copies the memory of pairs that are also in the old list
API void fill_list(const Pairs *pairs, const Contacts *old, const Contacts *list);
API void free_pairs(Pairs *pairs);
// Largest displacement of a body; infinite if a position is not a number
API double largest_displacement(const double *x, const double *origin, int64_t bodies);
// Periodic shift of every pair, (C, 3)
API void shifts(const int16_t *image, const double *vectors, int64_t count, double *out);

// ---- the library itself

API int32_t core_processor_level(void);  // best level of this processor
