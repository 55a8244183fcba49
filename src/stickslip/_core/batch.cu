// Many systems side by side on a graphics processor; compiled at run time (see `core/dynamics/device.py`).
#include "batch.h"

extern "C" {
__constant__ Batch systems;
__constant__ Law law;
}

namespace batch {
__device__ int32_t fetch_add(int32_t *to, int32_t more) { return atomicAdd(to, more); }
__device__ int32_t exchange(int32_t *at, int32_t value) { return atomicExch(at, value); }
}  // namespace batch

namespace {

struct Team {
  static constexpr int64_t SIZE = TEAM;
  template <class Work>
  __device__ void each(const Work &work) const {
    for (int64_t t = threadIdx.x; t < TEAM; t += blockDim.x) work(t);
    __syncthreads();
  }
  template <class Work>
  __device__ void once(const Work &work) const {
    if (threadIdx.x == 0) work();
    __syncthreads();
  }
};

struct Place {  // body of a thread
  int64_t slot, body;
  __device__ Place() {
    const int64_t row = int64_t(blockIdx.x) * blockDim.x + threadIdx.x;
    slot = row / systems.room, body = row % systems.room;
  }
};

constexpr int TILE = 32, CREW = 128, PARTS = CREW / TILE, AHEAD = 3;  // bodies of a block, its threads,
// those of a body at first, and entries that each of these looks at together

template <int DIM>
__device__ __noinline__ void finish(const batch::Slot &slot) {  // apart, so that it does not take registers from the step
  batch::finish_step<DIM>(slot, Team());
}

// One block first finds the entries that may touch, then evaluates these, one per thread, adds up the loads of each body
// in the order of its list, and moves the bodies.
template <int DIM>
__device__ void step() {
  __shared__ uint8_t queue[TILE][MOST_ENTRIES];  // entries that may touch
  __shared__ double load[6][CREW], total[TILE][6];
  __shared__ int32_t first[TILE + 1];
  const int64_t row = int64_t(blockIdx.x) * TILE;
  const batch::Slot slot(systems, row / systems.room);
  if (slot.number[SLOT_PHASE] != RUNNING) return;
  const int64_t begin = row % systems.room, grains = slot.number[SLOT_GRAINS], list = slot.number[SLOT_LISTED];
  if (begin >= grains) return;
  const int t = threadIdx.x, mine = t / PARTS, part = t % PARTS;
  const int count = begin + mine < grains ? slot.entries(begin + mine, list) : 0;
  int longest = count;  // of the warp
  for (int k = 16; k > 0; k /= 2) longest = max(longest, __shfl_xor_sync(0xffffffffu, longest, k));
  int many = 0;
  for (int from = 0; from < longest; from += AHEAD * PARTS) {
    bool touches[AHEAD];
    batch::may_touch<DIM, AHEAD>(slot, begin + mine, from + part, PARTS, count, touches);
    for (int k = 0; k < AHEAD; ++k) {
      const unsigned all = __ballot_sync(0xffffffffu, touches[k]) >> (t % 32 - part) & ((1u << PARTS) - 1);
      if (touches[k]) queue[mine][many + __popc(all & ((1u << part) - 1))] = uint8_t(from + PARTS * k + part);
      many += __popc(all);
    }
  }
  if (part == 0) first[mine + 1] = many;
  for (int k = t; k < 6 * TILE; k += CREW) total[k / 6][k % 6] = 0.0;
  __syncthreads();
  if (t < TILE) {
    int sum = first[t + 1];
    for (int k = 1; k < TILE; k *= 2) {
      const int before = __shfl_up_sync(0xffffffffu, sum, k);
      if (t >= k) sum += before;
    }
    first[t + 1] = sum;
    if (t == 0) first[0] = 0;
  }
  __syncthreads();
  for (int from = 0; from < first[TILE]; from += CREW) {
    const int to = min(from + CREW, first[TILE]), q = from + t;
    if (q < to) {
      int body = 0;
      for (int k = TILE / 2; k > 0; k /= 2)
        if (first[body + k] <= q) body += k;
      const batch::Sum more =
          batch::evaluate_contact<DIM>(law, slot, begin + body, queue[body][q - first[body]]);
      for (int k = 0; k < 6; ++k) load[k][t] = more.f[k];
    }
    __syncthreads();
    for (int m = t; m < 6 * TILE; m += CREW) {
      const int body = m / 6, k = m % 6, end = min(first[body + 1], to);
      double sum = total[body][k];
      for (int e = max(first[body], from); e < end; ++e) sum += load[k][e - from];
      total[body][k] = sum;
    }
    __syncthreads();
  }
  if (t < TILE && begin + t < grains) batch::end_step<DIM>(slot, begin + t, total[t]);
  // the last block of a system to come here ends the step
  __shared__ bool last;
  __threadfence();
  __syncthreads();
  if (t == 0) {
    int32_t *arrived = systems.arrived + slot.s;
    const int32_t blocks = int32_t((grains + TILE - 1) / TILE);
    last = atomicAdd(arrived, 1) == blocks - 1;
    if (last) *arrived = 0;
  }
  __syncthreads();
  if (!last) return;
  __threadfence();
  finish<DIM>(slot);
}

template <int DIM>
__device__ void sample() {
  const batch::Slot slot(systems, blockIdx.x);
  if (slot.number[SLOT_PHASE] == SAMPLING) batch::end_at_sample<DIM>(law, slot, Team());
}

template <int DIM>
__device__ void begin() {
  const Place at;
  if (at.slot >= systems.slots) return;
  const batch::Slot slot(systems, at.slot);
  if (slot.number[SLOT_PHASE] == BEGINNING && at.body < slot.number[SLOT_BODIES]) batch::begin_step<DIM>(slot, at.body);
}

template <int DIM>
__device__ void list() {
  const Place at;
  if (at.slot >= systems.slots) return;
  const batch::Slot slot(systems, at.slot);
  if (slot.number[SLOT_PHASE] == LISTING && at.body < slot.number[SLOT_GRAINS]) batch::build_list<DIM>(slot, at.body);
}

}  // namespace

extern "C" {
__global__ void __launch_bounds__(CREW, 6) step_2() { step<2>(); }
__global__ void __launch_bounds__(CREW, 6) step_3() { step<3>(); }
__global__ void __launch_bounds__(TEAM, 2) sample_2() { sample<2>(); }
__global__ void __launch_bounds__(TEAM, 2) sample_3() { sample<3>(); }
__global__ void begin_2() { begin<2>(); }
__global__ void begin_3() { begin<3>(); }
__global__ void sort() { batch::sort_into_bins(batch::Slot(systems, blockIdx.x), Team()); }
__global__ void list_2() { list<2>(); }
__global__ void list_3() { list<3>(); }
__global__ void resume() {
  const int64_t slot = int64_t(blockIdx.x) * blockDim.x + threadIdx.x;
  if (slot < systems.slots) batch::finish_list(batch::Slot(systems, slot));
}
}
