// Contacts evaluated one after another, row by row of the list: for `forces`, for runs of few grains, and for laws with
// rolling resistance or a memory of their own.
#pragma once
#include "core.h"
#include "laws.h"

struct Events;  // see events.h

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
