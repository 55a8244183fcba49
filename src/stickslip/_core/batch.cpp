// Many systems side by side on this processor: the work of a graphics processor, thread after thread. For tests.
#include <math.h>

#include "batch.h"

namespace batch {

int32_t fetch_add(int32_t *to, int32_t more) {
  *to += more;
  return *to - more;
}

int32_t exchange(int32_t *at, int32_t value) {
  const int32_t former = *at;
  *at = value;
  return former;
}

}  // namespace batch

namespace {

using Team = InTurn<TEAM>;

template <int DIM>
void step(const Law &law, const batch::Slot &slot) {
  if (slot.number[SLOT_PHASE] != RUNNING) return;
  for (int64_t a = 0; a < slot.number[SLOT_GRAINS]; ++a) {
    double total[6] = {};
    for (int64_t e = 0; e < slot.entries(a, slot.number[SLOT_LISTED]); ++e) {
      const batch::Sum more = batch::evaluate_contact<DIM>(law, slot, a, e);
      for (int k = 0; k < 6; ++k) total[k] += more.f[k];
    }
    batch::end_step<DIM>(slot, a, total);
  }
  batch::finish_step<DIM>(slot, Team());
}

template <int DIM>
void serve(const Law &law, const batch::Slot &slot) {
  const int64_t *number = slot.number;
  if (number[SLOT_PHASE] == SAMPLING) batch::end_at_sample<DIM>(law, slot, Team());
  if (number[SLOT_PHASE] == BEGINNING)
    for (int64_t a = 0; a < number[SLOT_BODIES]; ++a) batch::begin_step<DIM>(slot, a);
  batch::sort_into_bins(slot, Team());
  if (number[SLOT_PHASE] == LISTING)
    for (int64_t a = 0; a < number[SLOT_GRAINS]; ++a) batch::build_list<DIM>(slot, a);
  batch::finish_list(slot);
}

}  // namespace

void run_batch(const Law *law, const Batch *batch, int64_t steps) {
  const bool flat = batch->dim == 2;
  for (int64_t s = 0; s < batch->slots; ++s) {
    const batch::Slot slot(*batch, s);
    for (int64_t n = 0; n < steps; ++n) (flat ? step<2> : step<3>)(*law, slot);
    (flat ? serve<2> : serve<3>)(*law, slot);
  }
}
