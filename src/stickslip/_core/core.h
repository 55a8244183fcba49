// All functions called from Python, and their arrays. `core/library.py` reads this file: one member or function
// per declaration; `len_x` is filled with len(x), and `width_x` with the number of its columns. Pointers may be null if
// a comment states it. See `core.fields` for shapes and ranges of the fields of a state.
#pragma once
#ifdef __CUDACC_RTC__  // compiled at run time, without system headers
typedef signed char int8_t;
typedef unsigned char uint8_t;
typedef short int16_t;
typedef int int32_t;
typedef unsigned int uint32_t;
typedef long long int64_t;
#define API extern "C"
#else
#include <stdint.h>
#define API extern "C" __attribute__((visibility("default")))
#endif

// ---- state

// modes of contacts. Within blocks also STUCK_AGAIN: sticks but has been at the Coulomb limit since it closed; and LOOSE:
// slides because its limit is zero, and has not been at a limit
constexpr int64_t OPEN = 0, STICK = 1, SLIDE = 2, STUCK_AGAIN = 3, LOOSE = 4;
// Treatment of the memory in an evaluation. FREE: transport it, but keep it bit for bit if nothing has moved since it
// was committed; HELD: the same with every contact in its mode; FROZEN: as FREE, even if it is not the memory of this
// law
constexpr int64_t FROZEN = 0, HELD = 1, FREE = 2;
constexpr int64_t GIVEN = 4;  // added to HELD or FREE: the memory was not committed in motion but imported

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

// first columns of `Contacts.rolling` (see `core/contacts/rolling.py`): ψ; angle_i − angle_j; whether ψ is at its cap; with
// twisting the twist, and whether it is at its cap
constexpr int64_t ANCHOR = 3, AT_CAP = 6, TWIST = 7, TWIST_AT_CAP = 8;

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
  double *rolling;  // (C, columns) or null: rolling memory, then additional memory of the law
  int64_t width_rolling;
  int64_t len_i;
  int64_t len_key;
  int64_t len_pair;
};

// forms of strength, see `core/contacts/bonds.py`
constexpr int64_t BY_STRETCH = 0, BY_SUM = 1, BY_BEAM = 2;
// loads that break a bond; 0: none did, or unknown
constexpr int64_t BY_TENSION = 1, BY_SHEAR = 2, BY_BENDING = 3, BY_TWISTING = 4, BY_COMPRESSION = 5;

struct Bonds {  // columns of four: tension, shear, bending, twisting
  int32_t *i;
  int32_t *j;
  int16_t *image;  // (K, 3)
  uint8_t *intact;
  double *length;
  double *arm;
  double *direction;  // (K, 3)
  double *turn;       // (K, 4)
  double *angle_i;    // (K, 3)
  double *angle_j;    // (K, 3)
  double *stiffness;  // (K, 4)
  double *damping;    // (K, 4)
  double *strength;   // (K, 4)
  int8_t *form;
  int8_t *fading;
  int8_t *failed;  // by which load, see above
  int64_t len_i;
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

// Time step, drag factors and drags, for translations and for rotations
struct Pace {
  double dt;
  double keep;  // 1 − ν dt/2
  double slow;  // 1/(1 + ν dt/2)
  double keep_t;
  double slow_t;
  double drag;
  double spin_drag;
};

constexpr int64_t CHECK_EVERY = 200;  // steps between checks for NaN and, with a tolerance, for rest
constexpr int32_t DONE = 0, CONVERGED = 1, NOT_FINITE = 2, FULL = 3, MOVED = 4, RUNAWAY = 5, NO_MEMORY = 6;

constexpr int64_t MOST_THREADS = 256;

struct Blocks;  // see blocks.h
struct Law;

API Blocks *new_blocks(void);  // null if memory runs out
API void free_blocks(Blocks *blocks);
API void clear_blocks(Blocks *blocks);  // frees memory and leaves no block
API void commit_blocks(const Blocks *blocks, const Contacts *contacts);  // writes slips and modes back to the list
// Commits the old blocks, then chooses blocks for all pairs that may touch within the displacement limits `room` (B,).
// `across` maps an image to the shift of the pair vector: the cell's vectors, or the unit matrix if there is a frame.
// Returns false, without any block, if memory runs out.
API uint8_t choose_blocks(Blocks *blocks, const Law *law, const Contacts *contacts, const Moving *moving,
                          const double *inverse_mass, const int64_t *material, const double *normal, int64_t walls,
                          const double *vectors, const double *across, const double *room, double gap);

// Morton keys (n,) of points (3, n) in cells of `size`; coordinates must not be negative
API void morton_keys(const double *x, int64_t n, double size, int64_t *key);
API void speeds(const Moving *moving, double *out);  // (2,) largest and root-mean-square speed
// Limit of each body until blocks are chosen again: `base` + `span` times its speed, within bounds
API void displacement_limits(const Moving *moving, double base, double span, double least, double most, double *room);
// Reduces `room` so that no body moves further than `most` from its `origin`, which is in the state's order. Returns
// false if this takes more than half of any body's limit.
API uint8_t limit_displacements(const Moving *moving, const double *origin, double most, double *room);
// Copies bodies from the state's order; `kick` and `kick_t` are half a time step over mass and over inertia
API void gather_bodies(const Moving *moving, const Bodies *bodies, const double *kick, const double *kick_t);
API void scatter_bodies(const Moving *moving, const Bodies *bodies);  // copies bodies back to the state's order
// Writes the pair vectors and angles of touching contacts, unless the outputs are null. Returns true if they are those
// of the committed memory. `angular`: as in `Law`
API uint8_t store_reference(const Contacts *contacts, const double *position, const double *angle,
                            const double *radius, const double *vectors, int64_t angular, double *pair, double *roll);
API int64_t find_not_finite(const Moving *moving);  // first body with a non-finite coordinate or angle, or −1
API int64_t find_runaway(const Moving *moving, double dt);  // first that moves more than its radius in a step, or −1

// ---- contact laws

// A function of a user-defined law for n contacts of one pair of materials (see `laws.user`). If the law has additional
// memory, n is one, and `memory` is that of the contact
typedef void (*LawFunction)(const double *q, int64_t n, const double *r_eff, const double *overlap, const double *fn,
                            const double *memory, double *one, double *two);

// Functions of built-in laws with additional parameters, by position after the laws in `laws.h`: force, cap, slopes,
// cap slopes, energy, range and update; null if the law has none
API void *law_function(int64_t law, int64_t member);

struct Law {
  int64_t hertz;        // F_n grows as overlap^(3/2), else linearly
  int64_t uses_radius;  // stiffnesses contain √R_eff, or a user-defined function depends on R_eff
  int64_t rescaled;     // a decreasing overlap shortens the slip
  int64_t keeps_force;  // the memory is the force of the tangential spring: slips change as k_t does
  int64_t smooth;       // smoothed Coulomb limit
  int64_t damping;      // 0, or VELOCITY, MASS, VISCOELASTIC, or for a restitution TSUJI, RESTITUTION
  int64_t tension;      // dashpots may make a contact pull
  int64_t rate;         // slip update as in LAMMPS
  int64_t lever;        // lever arms of grains on grains are R − δ/2, not R
  int64_t len_table;    // materials
  int64_t width;        // parameters
  double *table;        // (materials, materials, width)
  void *force;          // of a user-defined law, else null: F_n and k_t
  void *cap;            // largest tangential force, null: μ max(F_n, 0)
  void *slopes;         // dF_n/dδ and dk_t/dδ
  void *cap_slopes;     // d(cap)/dF_n and d(cap)/dδ
  void *energy;         // of the normal spring
  void *range;          // largest gap, null: 0
  int64_t bonds;        // gaps are bridged only after the two have touched
  void *rolling;        // k_r and dk_r/dδ, null: no rolling resistance
  void *rolling_cap;    // largest moment
  void *rolling_slopes;  // d(rolling cap)/dF_n and d(rolling cap)/dδ
  int64_t roll_at;       // column of k_roll, before mu_roll and gamma_roll, or 0: none
  int64_t roll_viscous;  // the rolling dashpot grows with F_n, and there is no cap
  int64_t twist_at;      // column of k_twist, before mu_twist and gamma_twist, or 0: none
  int64_t twist_scaled;  // these are multiples, see `TwistScale`
  int64_t angular;       // first columns of `Contacts.rolling`, for moments and lever arms
  void *update;          // additional memory at a given overlap
  double *memory;        // of a contact that closes
  int64_t len_memory;
};

// ---- neighbours

struct Grid {  // of the cell, for the pair search; the unit matrix if nothing is periodic
  double *vectors;    // (3, 3)
  double *inverse;    // (3, 3)
  double *height;     // (3,) distance between opposite faces
  uint8_t *periodic;  // (3,)
};

struct Pairs;  // keys of all pairs within range

// Pairs closer than `skin`; x are the positions of all bodies, walls last. Null if memory runs out
API Pairs *find_pairs(const Grid *grid, const double *x, const double *radius, const double *normal, int64_t bodies,
                      int64_t walls, double skin, int64_t threads);
API int64_t count_pairs(const Pairs *pairs);  // −1 if a pair is more boxes apart than a key can hold
// Fills a list, whose memory is zero, and copies the memory of pairs that are also in the old list
API void fill_list(const Pairs *pairs, const Contacts *old, const Contacts *list);
API void free_pairs(Pairs *pairs);
// Largest displacement of a body; infinite if a position is not a number
API double largest_displacement(const double *x, const double *origin, int64_t bodies);

// ---- motion of the cell, and springs

// rows of Flow.matrix, see `core/dynamics/cell_motion.py`
constexpr int64_t VECTORS = 0, RATE = 1, RATE_AHEAD = 2, STRETCH = 3, TURN = 4, INVERSE_HALF = 5, SINCE = 6, PULL = 7;

struct Flow {
  double *matrix;    // (8, 3, 3)
  double *factor;    // (2, courses + 1) of courses, mean over the step and at its end; the last is 1, for none
  double *rate;      // (B, 6) of bodies, in the order of memory
  int64_t *follows;  // (B, 6)
  int64_t courses;
};

struct Frame {
  uint8_t *free;       // (3, 3)
  double *given;       // (3, 3) rates of components that are not free
  int64_t *follows;    // (3, 3) course, or the last column: constant
  double *wanted;      // (3, 3) stress
  double mass;
  double *knots;
  double *course;      // (K, courses)
  double *area;        // (K, courses) integral of `course` from the first knot
  int64_t *place;      // (N,) position of each grain in memory
  double *grain_mass;  // (N,)
  double *clock;       // (1,) time, accumulated step by step
  double *reach;       // (1,) distance within which pairs were selected
  double widest;       // largest sum of two radii
  int64_t courses;
  int64_t len_knots;
  int64_t len_place;
};

struct Pull {  // springs on the bodies of the last tile
  double *stiffness;  // (L, 3)
  double *anchor;     // (L, 3)
  int64_t *leads;     // (L, 3) column of `course`, −1: none
  double *knots;
  double *course;     // (K, courses)
  double *clock;      // (1,) time, accumulated step by step
  int64_t courses;
  int64_t len_stiffness;
  int64_t len_knots;
};

// Begins a step: rates, matrices and the cell at its end. Returns the square of the allowed displacement, or −1 if there
// is none left. `keep` and `slow` are the drag factors of translations.
API double begin_cell_step(Frame *frame, Flow *flow, double dt, double keep, double slow);

// ---- samples and events

constexpr int64_t CLOSED = 0, OPENED = 1, REACHED_LIMIT = 2, FAILED = 3;  // kinds of events; the last one of bonds
constexpr int64_t EVENT = 10;  // columns: kind, time, i, j, image, position of i

struct Writing {  // see `RecordBuffers` in `core/dynamics/record.py`
  int64_t every;
  double *reference;  // (N, 3)
  double *mass;       // (N,)
  double *inertia;    // (N,)
  int64_t *unit;      // (B,)
  int64_t *supports;  // (B,)
  int64_t *probes;    // (P,)
  double *series;     // (T, columns of all observables)
  double *tracks;     // (T, P, 6)
  double *events;     // (E, EVENT)
  int64_t *event_count;  // (1,)
  int64_t len_probes;
  int64_t len_events;
};

API const char *observable_name(int64_t k);  // null after the last
API int64_t observable_width(int64_t k);     // columns

// periodic shifts cellᵀ·image (count, 3)
API void find_shifts(const int16_t *image, int64_t count, const double *vectors, double *shift);

// ---- energy ledger

struct LedgerStep {  // see `core/dynamics/ledger.py`
  Law *law;
  int64_t dim;
  Bodies *old;
  Bodies *now;
  Contacts *before;
  Contacts *after;
  double *shift_old;  // (C, 3) periodic shifts of the contacts of `after` before the step
  double *shift_now;
  double *way;      // (B, 3) displacements, without the flow
  double *strain;   // (3, 3) dt L
  uint8_t *free;    // (B, 6)
  double *mass;     // (B,)
  double *inertia;  // (B,)
  double *force;    // (B, 3) external forces, and springs
  double *torque;   // (B, 3)
  double drag;
  double spin_drag;
  double dt;
  uint8_t first;  // there is no step, only stored energies
  Bonds *bonds_old;  // null without bonds; their memory is that of each end
  Bonds *bonds_now;
  double *vectors_old;  // (3, 3) of the cell
  double *vectors_now;
  double *row;    // (11,) written in place
  double *shares;  // (C, 2) or null: dissipated by friction and by the dashpots of each contact of `after`
};

// add one step to a row
API void add_ledger_step(const LedgerStep *step);

// ---- many systems side by side, see `batch.h`

constexpr int64_t TEAM = 256;  // threads of a system, where a block has it alone
constexpr int64_t MOST_ENTRIES = 256;  // of a body in its list
constexpr int64_t POINT_WIDTH = 4, MOTION_WIDTH = 12;  // columns: position and radius; velocity, spin, and both predicted
// columns of `Batch.number`: task for which the system waits; valid buffers of the motion and of the list; step, and
// those at which it is sampled next and ends; samples that have been written; bodies; grains; grains that neither
// belong to a group nor hang on a spring, which come first; whether a body has moved too far for the list; the first
// faulty body
constexpr int64_t SLOT_PHASE = 0, SLOT_NOW = 1, SLOT_LISTED = 2, SLOT_STEP = 3, SLOT_NEXT = 4, SLOT_STOP = 5;
constexpr int64_t SLOT_EVERY = 6, SLOT_ROWS = 7, SLOT_BODIES = 8, SLOT_GRAINS = 9, SLOT_SINGLE = 10, SLOT_MOVED_FAR = 11;
constexpr int64_t SLOT_BROKEN = 12, SLOT_CHANGED = 13, SLOT_BINS = 14, SLOT_NUMBERS = 17;
constexpr int64_t RUNNING = 0, SAMPLING = 1, BEGINNING = 2, LISTING = 3, FINISHED = 4, BROKE = 5, CROWDED = 6, APART = 7;
constexpr int64_t WAITING = 8;  // for room for events: the caller removes these, and the system continues
// columns of `Batch.value`: members of `Pace`; skin; time of the start, and that of the positions; lower bounds and
// spacings of bins, in parts of the cell
constexpr int64_t PACE_DT = 0, PACE_KEEP = 1, PACE_SLOW = 2, PACE_KEEP_T = 3, PACE_SLOW_T = 4, PACE_SKIN = 5;
constexpr int64_t PACE_START = 6, PACE_CLOCK = 7, PACE_LOWEST = 8, PACE_DENSITY = 11, PACE_VALUES = 14;
// bits of a word in a list: flags, image along each vector, and the first bit of the partner
constexpr int64_t ENTRY_FLAGS = 3, ENTRY_IMAGE = 7, ENTRY_PARTNER = 24;
constexpr int64_t SUMS = 64;  // room for the sums of all observables, of which one has three for a vector

struct Batch {  // S slots with room for R bodies, each with one system or none
  int64_t slots;
  int64_t room;      // R, a multiple of 32
  int64_t most;      // M, the largest number of entries of a body
  int64_t dim;
  int64_t groups;    // G, the largest number of rigid groups
  int64_t knots;     // K
  int64_t courses;   // C
  int64_t samples;   // T, rows of `series`
  int64_t least;     // smallest number of contacts of a grain that is not a rattler
  int64_t events;    // E, rows of `event`; 0: none are recorded
  int64_t tracks;    // P, bodies of each sample: R or none
  int64_t *number;   // (S, SLOT_NUMBERS)
  double *value;     // (S, PACE_VALUES)
  double *vectors;   // (S, 3, 3)
  double *inverse;   // (S, 3, 3)
  int64_t *periodic;  // (S, 3)
  double *table;     // (S, materials, materials, width)
  double *point;     // (2, S, R, POINT_WIDTH)
  double *motion;    // (2, S, R, MOTION_WIDTH)
  double *angle;     // (S, R, 3)
  double *origin;    // (S, R, 3) positions when the list was built
  double *force;     // (S, R, 6) of the last step, where it ended without beginning the next
  double *external;  // (S, R, 6)
  double *kick;      // (S, R, 2)
  double *heavy;     // (S, R, 3) inverse mass, mass and inertia
  double *normal;    // (S, R, 3) of walls
  double *reference;  // (S, R, 3)
  uint8_t *free;     // (S, R, 6)
  int32_t *material;  // (S, R)
  int32_t *unit;     // (S, R)
  int32_t *supports;  // (S, R)
  int32_t *loose;    // (S, R)
  int32_t *touching;  // (S, R)
  int64_t *members;  // (S, G + 1) bounds of the groups
  double *spring;    // (S, R, 6) stiffness and anchor
  int64_t *leads;    // (S, R, 3)
  double *knot;      // (S, K)
  double *course;    // (S, K, C)
  int64_t *entry;    // (2, S, R, M) see `batch.h`
  double *slip;      // (2, 3, S, R, M)
  int32_t *entries;  // (2, S, R) number of entries of each body
  int32_t *head;     // (S, R) first grain of each bin, −1: none
  int32_t *next;     // (S, R) grain after each in its bin
  int32_t *arrived;  // (S,) blocks that have taken the step
  double *partial;   // (S, TEAM, SUMS)
  double *series;    // (S, T, columns of all observables)
  double *group;     // (S, T, G, 4, 3) see `RecordBuffers.groups`
  double *track;     // (S, T, P, 6) positions and angles
  double *event;     // (S, E, EVENT) as in `Writing`, of each contact from both sides
  int32_t *happened;  // (S,) events that have been recorded
};

// Advances all RUNNING systems by `steps` steps, then samples, begins steps and builds lists where due
API void run_batch(const Law *law, const Batch *batch, int64_t steps);

// ---- evaluation

// Steps up to the end of step `stop`, or until a body has moved too far for the list or the blocks. `blocks` is null by
// rows. `progress` (3,): step; whether it has ended and forces are stored, else positions are those of the step, but
// forces are not known yet; whether velocities are also those of the step, and memory is not transported. `residual`
// (2,): largest unbalanced force at the last check, and its body.
API int32_t run_steps(const Law *law, int64_t dim, const Moving *moving, Blocks *blocks, const Bodies *bodies,
                      const Contacts *contacts, const double *vectors, const Pace *pace, Frame *frame, Flow *flow,
                      Pull *pull, const Bonds *bonds, const Writing *writing, double start, int64_t stop,
                      double tolerance, double *residual, int64_t *progress);

// Loads of all contacts, added to (B, 3) forces and torques; their memory is updated in place.
API void evaluate_contacts(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts,
                           const double *vectors, int64_t memory, double *force, double *torque);

// ---- values of a law at given overlaps

struct LawValues {
  int64_t *a;  // (n,) materials
  int64_t *b;
  double *overlap;
  double *r_eff;
  double *m_eff;
  double *fn;     // normal force with its dashpot
  double *memory;  // (n, len_memory) of contacts, null: as they close
  double *force;  // results (n,), null where not needed: of the normal spring
  double *stiffness;
  double *energy;
  double *slopes;      // (n, 2) as in `Law`, and so are `cap_slopes`
  double *cap;
  double *cap_slopes;
  double *range;
  double *damping;  // factor on the damping coefficients
  int64_t len_a;
};

API void law_values(const Law *law, const LawValues *at);  // evaluates a law, see `laws.compiled`

// ---- linearisation, time step and quench. `shift` (C, 3): periodic shifts of all pairs

// See `contacts.jacobian` for the members
struct Linearisation {
  double *normal;
  double *inverse;
  double *before;
  double *way;
  double *turn;
  double *slip;
  double *closed;
  double *remembers;
  double *slides;
  double *weighted;
  double *force_n;
  double *slope_n;
  double *secant;
  double *along;
  double *by_overlap;
  double *by_force;
  double *damping_n;
  double *damping_t;
  double *stiffness_t;
  double *slope_t;
  double *limit;
  double *mu;
  double *fade;
  double *half;  // half the overlap, and halfway since the memory was committed
  double *half_mid;
  double *together;  // (C, 3)
  double *fading;
};

// See `contacts.rolling`
struct MomentLinearisation {
  double *before;
  double *way;
  double *secant;
  double *along;
  double *by_overlap;
  double *by_force;
  double *reach;
  double *reach_by_overlap;
  double *reach_by_force;
  double *weighted;
  double *damping;
  double *slides;
  double *twisting;
  double *twisting_along;
  double *twisting_damping;
  double *twisting_by_force;
  double *twisting_by_overlap;
};

// linearisation of all contacts, at rest
API void linearise(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts, const double *shift,
                   int64_t memory, const Linearisation *out);
// linearisation of the rolling moments of all contacts
API void linearise_moments(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts,
                           const double *shift, int64_t memory, const MomentLinearisation *out);
// largest sum of 2 k_r/I over the contacts of a body; `total` (B,) zeros
API double rolling_bound(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts,
                         const double *shift, const double *inverse_inertia, double *total);
// add Σ f ⊗ r over all touching pairs of grains whose memory is committed to `out` (3, 3)
API void add_virial(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts, const double *shift,
                    double *out);
// energy of all normal springs
API double elastic_energy(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts,
                          const double *shift);
// upper bound on ω²; `cell` (3, 3): 1/(M ℓ²) of its free components; `total` (B, 2) zeros
API double frequency_bound(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts,
                           const double *shift, const double *inverse_inertia, const double *cell, double *total);
// largest ω² by power iteration from x (B, 6); scratch: `y` (B, 6), `springs` (C, 6)
API double largest_squared_frequency(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts,
                                     const double *shift, const double *inverse_inertia, const double *cell,
                                     int64_t rounds, double *x, double *y, double *springs);
// steps of FIRE until the forces balance or a coordinate has changed by `reach`; returns their number. `velocity` (B, 3)
// and `pace` (5,) are continued from the last call; scratch: `force` (B, 3), `stiffness` (B,)
API int64_t descend(const Law *law, int64_t dim, const Bodies *bodies, const Contacts *contacts, const double *shift,
                    double reach, double *velocity, double *force, double *stiffness, double *pace, double tolerance,
                    int64_t steps);
// see `solve.probes`: n rows of blocks, q and v (3 n, 16), `record` (steps, buckets, 16). Unless `previous` (3 n, 16),
// which holds v of one step ago, is null, v gains the damper blocks times `now` v + `before` previous; `drawn` (3 n, 16)
// is scratch. Unless null, `filtered` (3 n, 16) gains `weights` (steps, 16) times q of the vectors `lane` (16,)
API void leapfrog(int64_t n, const int64_t *indptr, const uint32_t *indices, const float *blocks,
                  const int64_t *damper_indptr, const uint32_t *damper_indices, const float *damper_blocks,
                  double now, double before, const int64_t *bucket, const float *signs, float *q, float *v,
                  float *previous, float *drawn, int64_t steps, int64_t buckets, float *record, const int64_t *lane,
                  const float *weights, float *filtered);

// see `solve.linear`: front[places, places] += part (m, m), both column by column, of numbers of `width` parts (real or
// complex); the front has `rows` rows
API void extend_add(int64_t m, int64_t width, const int64_t *places, const double *part, int64_t rows, double *front);

// Loads of intact bonds are added to `force` and `torque` (B, 3) and, unless it is null, to `virial` (3, 3). Loads over
// strengths (K,) are written unless that is null. `commits`: the memory is updated to the present rotations
API void evaluate_bonds(int64_t dim, const Bodies *bodies, const Bonds *bonds, const double *vectors, uint8_t commits,
                        double *share, double *force, double *torque, double *virial);
// Of all bonds as if they were intact: loads over their strengths (tension, then vectors of shear, bending and twisting),
// (K, 10), their derivatives along `way` (K, 9), changes of pair vector and angles of i and j; and energy (K,)
API void limit_bonds(int64_t dim, const Bodies *bodies, const Bonds *bonds, const double *vectors, const double *way,
                     double *load, double *slope, double *energy);
// Share of the strength (K,) under such loads (K, 10), and the load that breaks each bond if all grow in proportion
API void judge_loads(const Bonds *bonds, const double *load, double *share, int8_t *failure);
// Elastic forces on i (K, 3) and, unless null, derivatives (K, 9, 9) of force on i, moment on i and moment on j with
// respect to pair vector and angles of i and j, and to their rates
API void linearise_bonds(int64_t dim, const Bodies *bodies, const Bonds *bonds, const double *vectors, double *force,
                         double *stiff, double *damp);

// ---- rate-and-state friction

// A surface and the spring that pulls it (see `friction.laws`); stiffness and damping are over the normal stress
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

// Stress due to slip of N cells: Σ_j (K_|i−j| + H_{i+j}) slip_j, by Fourier transforms of length L = rows × columns ≥ N,
// powers of two, of z_j = slip_j e^{iπj/(2L)}, in which the part carried past the ends becomes imaginary
struct Transfer {
  int64_t number;     // N
  int64_t rows;
  int64_t columns;
  double *phases;     // (2, N) cosine and sine of πj/(2L)
  double *roots;      // (2, M) of −2πj/M, with M the greater of rows and columns
  double *turns;      // (2, rows, columns) between the transforms along columns and rows
  double *symbol;     // (L,) transform of K, in the order in which the transforms leave it
  double *reflected;  // (2, L) transform of H, real and imaginary part, or null
  double *work;       // (4, L)
};

struct Fault {
  Transfer *transfer;
  int64_t form;
  int64_t evolution;
  double mu0;
  double cut;
  double cut2;
  double v0;
  double damping;
  double plate_rate;
  double cell;
  double *cells;  // (8, N) a, b, D_c, normal stress, initial stress, b2, D_c2, shift of s
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
  double *image;   // (N,) stress that a surface adds, or null
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
// Logarithms at ascending times (N, 3) from those at the start, and from durations, velocities and normal stresses of
// legs (3, L); returns a code, see `friction.laws`
API int64_t slider_history(const Slider *slider, double w, double s, double s2, const double *legs, int64_t many,
                           const double *times, int64_t count, double tolerance, double *out, double *reached);
// Shear stress due to slip (N,)
API void fault_stress(const Transfer *transfer, const double *slip, double *stress);
// Rates of the unknowns and powers; false if a velocity cannot be found
API uint8_t fault_rates(const Fault *fault, const double *image, const double *y, double *w, double *out, double *power);
// Stages from the first to the last one; false if a velocity cannot be found
API uint8_t fault_stages(const Fault *fault, const FaultStep *step, int64_t first, int64_t last);
// Unknowns of a stage from the rates of the previous stages
API void fault_trial(const Fault *fault, const FaultStep *step, int64_t stage);
// Root mean square of the estimated errors of u/D_c and of each s in a step
API double fault_error(const Fault *fault, const FaultStep *step);

// ---- the library itself

API int32_t core_processor_level(void);  // best level of this processor
