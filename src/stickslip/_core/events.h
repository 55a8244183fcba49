// Events of contacts during a run.
#pragma once
#include "blocks.h"
#include "rows.h"

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
  double *row = events->row + EVENT * k;
  row[0] = double(kind), row[1] = events->time, row[2] = contacts.i[c], row[3] = contacts.j[c];
  for (int m = 0; m < 3; ++m) row[4 + m] = contacts.image[3 * c + m], row[7 + m] = place[m];
}
