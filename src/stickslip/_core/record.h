#pragma once
#include "blocks.h"
#include "laws.h"
void write_moving_sample(const Law &law, int64_t dim, int64_t row, const Moving &moving, const Bodies &bodies, const Contacts &contacts, const double *vectors, const Writing &writing, double time);
