// Loads of all bonds, for `forces` and for runs.
#pragma once
#include "core.h"
#include "vector.h"

struct BondRows {  // one per body; rows of arrays that hold more
  const double *data;
  int64_t stride;
};

struct BondSweep {
  BondRows position, angle, velocity, spin;  // the last two as dashpots use them, or null
  const double *vectors;                     // of the cell
  const double *gradient;                    // of the cell's velocity, or null
  double *force, *torque;                    // rows of `stride` numbers, to which loads are added
  int64_t stride;
  double *virial;  // to which f ⊗ r is added: of all forces in row i if it is `by_body`, else of elastic ones; or null
  bool by_body;
  double *share;         // (K,) of the strength, or null
  bool commits, breaks;  // the memory follows the rotations; bonds that reach their strength break
  void (*broken)(const void *context, const Bonds &bonds, int64_t k, const double *place);  // or null
  const void *context;
};

void sweep_bonds(int64_t dim, const BondSweep &sweep, const Bonds &bonds);

struct BondWay {
  Vec<double> r, a, b;  // changes of the pair vector and of the angles of i and j in a step
};

struct BondEnd {  // a bond at one end of a step
  double energy, work, created;  // stored; work of its elastic loads along the step; energy that they create on the way
  double power;                  // of its dashpots
  Vec<double> r, force, moment_i, moment_j;  // pair vector and loads, dashpots included; force on i
};

Vec<double> bond_vector(int dim, const Bonds &bonds, int64_t k, const Bodies &bodies, const double *vectors);
BondEnd bond_end(int dim, const Bonds &bonds, int64_t k, const Bodies &bodies, const double *vectors, const BondWay &way);
