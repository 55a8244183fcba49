// Pairs in blocks of LANES, see `core/dynamics/driver.py` for how they are chosen and used.
//
// Grains are divided into equal-sized tiles of neighbours, and follow a space-filling curve within each tile. A block
// contains contacts of one pair of materials, either within one tile, or between a tile and later ones (`cross`), or
// with walls. Contacts are evaluated block by block. Each body then sums the loads of its contacts in the order of its
// partners' numbers. The orientation of a pair and the order of summation depend only on the numbers of the grains in
// the state, and every contact goes through the same vector instructions. Trajectories are therefore bitwise
// independent of the number of threads and of the memory order.
#pragma once
#include "core.h"
#include "memory.h"

// planes of the memory of rotations of a block: ψ; whether it is at its cap; the twist; whether it is at its cap
constexpr int64_t CAPPED = 3, TWISTED = 4, TWIST_CAPPED = 5, TURNS = 6;
constexpr int64_t WIDTH = 8;  // numbers in a row of loads: three of a force, three of a torque, zero or δ/2, zero
// the code of a row of loads that a body sums is ROW times its number, plus flags. IS_I: the body is i of that pair, so
// that the force keeps its sign; IS_FIRST: this is the first row of the body
constexpr uint32_t IS_FIRST = 1, IS_I = 2, ROW = 64;
constexpr int32_t MOST_LANES = 8;  // in a vector, at any level
constexpr int64_t PREFETCH_DISTANCE = 16;  // rows; `code` is that much longer than needed

struct Blocks {  // zero-initialised; T tiles, K blocks
  int64_t count;  // K
  Buffer<uint32_t> i, j;      // (K LANES,) in memory order
  Buffer<int32_t> row;        // (K LANES,) row in the list of contacts, −1 for padding
  Buffer<int64_t> material;   // (K, 2)
  Buffer<int32_t> used;       // (K,) lanes with pairs, rounded up to whole vectors
  Buffer<uint8_t> wall;       // (K,) all pairs of the block are with walls
  Buffer<int32_t> at;         // (K,) start of a block's vectors, −1: no pair is with a wall or across a boundary
  Buffer<double> vector;      // (V 3 LANES,) periodic shift (with a frame: the image), or the wall's normal
  Buffer<double> size;        // (K LANES,) R_eff, if the law uses it
  Buffer<double> mass;        // (K LANES,) m_eff, if the law uses it
  Buffer<double> slip;        // (K 3 LANES,)
  Buffer<double> turn;        // (K TURNS LANES,) if the law has moments
  Buffer<double> memory;      // (K LANES, own) additional memory of contacts, that of a new one if they are open
  Buffer<int64_t> mode;       // (K LANES,) as wide as the other numbers
  Buffer<int64_t> place;      // (K,) first row of a block's loads
  Buffer<int64_t> cross;      // (T + 2,) bounds of the blocks between a tile and later ones; then those between threads
  Buffer<int64_t> inner;      // (T + 2,) bounds of the blocks within each tile
  Buffer<double> load;        // (L, WIDTH) force on i and −n × F_t, aligned to cache lines
  Buffer<double> moment;      // (L, WIDTH) moment on i in place of −n × F_t and zeros, if the law has moments
  Buffer<double> pair;        // (L, 3) with a frame, the pair vectors
  Buffer<uint32_t> start;     // (B + 1,) bounds of each body's part of `code`
  Buffer<uint32_t> code;      // rows of `load` in the order of summation
  int64_t tiles;              // T
  int64_t turns;              // columns of rotations in the list, or 0: the law has no moments
  int64_t own, at_own;        // numbers of additional memory, and their first column in the list
};

// Pair vector (3,) of contact c, and rolled length R_i angle_i + R_j angle_j (3,) of two bodies, as they are committed:
// with the same bits on every processor, so memory shows whether a body has moved
void pair_vector(const Contacts &contacts, int64_t c, const double *position, const double *vectors, double *out);
void rolled_length(const double *radius, const double *angle, int64_t i, int64_t j, double *out);

// Writes part of the blocks back to the list
void commit_part(const Blocks &blocks, const Contacts &list, int64_t part, int64_t parts);
