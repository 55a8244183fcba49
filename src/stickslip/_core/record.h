// Samples of a run, see `core/dynamics/record.py`.
#pragma once
#include "core.h"

// Writes row k of the observables and of the tracks during a run; `bodies` holds what does not move. Returns false,
// without a sample, if there is no memory.
bool write_moving_sample(const Law &law, int64_t dim, int64_t k, const Moving &moving, const Bodies &bodies,
                         const Contacts &contacts, const double *vectors, const Writing &writing, double time);
