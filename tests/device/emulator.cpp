// Runs the kernels of `batch.cu` on this processor: the threads of a block are fibers, which take turns at barriers.
#include <math.h>
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <ucontext.h>

#include <algorithm>
#include <utility>

using std::max;
using std::min;

#define __global__
#define __device__
#define __constant__
#define __noinline__ __attribute__((noinline))
#define __shared__ static
#define __launch_bounds__(...)

static struct { int x; } threadIdx, blockIdx, blockDim;

namespace fibers {

constexpr int MOST = 256, WARP = 32, STACK = 1 << 18;
enum Waiting { NOTHING, WARP_BARRIER, BLOCK_BARRIER, END };
ucontext_t fiber[MOST];
jmp_buf host, place[MOST];  // unlike swapcontext, they make no system calls
Waiting waiting[MOST];
char *stack[MOST];
long said[2][MOST];  // by each thread at its last two warp barriers
int turn[MOST];
void (*kernel)();

void wait_at(Waiting barrier) {
  const int me = threadIdx.x;
  waiting[me] = barrier;
  if (!_setjmp(place[me])) _longjmp(host, 1);
}

void body() {
  for (;;) kernel(), wait_at(END);
}

void resume(int me) {
  threadIdx.x = me;
  if (_setjmp(host)) return;
  if (stack[me]) _longjmp(place[me], 1);
  stack[me] = static_cast<char *>(malloc(STACK));
  getcontext(&fiber[me]);
  fiber[me].uc_stack.ss_sp = stack[me], fiber[me].uc_stack.ss_size = STACK, fiber[me].uc_link = nullptr;
  makecontext(&fiber[me], body, 0);
  setcontext(&fiber[me]);
}

// What all threads of the warp say here.
const long *exchange(long value) {
  const int me = threadIdx.x, now = turn[me] ^= 1;
  said[now][me] = value;
  wait_at(WARP_BARRIER);
  return said[now] + me / WARP * WARP;
}

bool release(int first, int last, Waiting barrier) {
  bool any = false;
  for (int t = first; t < last; ++t) {
    if (waiting[t] != barrier && waiting[t] != END) return false;
    any = any || waiting[t] == barrier;
  }
  for (int t = first; any && t < last; ++t)
    if (waiting[t] == barrier) waiting[t] = NOTHING;
  return any;
}

void run_block(int threads) {
  for (int t = 0; t < threads; ++t) waiting[t] = NOTHING, turn[t] = 0;
  for (bool going = true; going;) {
    for (int t = 0; t < threads; ++t)
      if (waiting[t] == NOTHING) resume(t);
    going = false;
    for (int w = 0; w < threads; w += WARP) going = release(w, min(w + WARP, threads), WARP_BARRIER) || going;
    going = going || release(0, threads, BLOCK_BARRIER);
  }
  for (int t = 0; t < threads; ++t)
    if (waiting[t] != END) fprintf(stderr, "threads wait for each other\n"), abort();
}

}  // namespace fibers

static void __syncthreads() { fibers::wait_at(fibers::BLOCK_BARRIER); }
static void __threadfence() {}
static int __popc(unsigned x) { return __builtin_popcount(x); }

static unsigned __ballot_sync(unsigned, bool value) {
  const long *all = fibers::exchange(value);
  unsigned bits = 0;
  for (int k = 0; k < fibers::WARP; ++k) bits |= unsigned(all[k]) << k;
  return bits;
}

static int __shfl_xor_sync(unsigned, int value, int lanes) {
  const long *all = fibers::exchange(value);
  return int(all[threadIdx.x % fibers::WARP ^ lanes]);
}

static int __shfl_up_sync(unsigned, int value, int lanes) {
  const long *all = fibers::exchange(value);
  const int lane = threadIdx.x % fibers::WARP;
  return int(all[lane < lanes ? lane : lane - lanes]);
}

static int atomicAdd(int *to, int more) { return (*to += more) - more; }
static int atomicExch(int *at, int value) { return std::exchange(*at, value); }

#include "batch.cu"

extern "C" void take(const void *batch, const void *parameters) {
  memcpy(&systems, batch, sizeof systems);
  memcpy(&law, parameters, sizeof law);
}

extern "C" void launch(const char *name, int blocks, int threads) {
  const struct { const char *name; void (*kernel)(); } known[] = {
      {"step_2", step_2}, {"step_3", step_3}, {"sample_2", sample_2}, {"sample_3", sample_3}, {"begin_2", begin_2},
      {"begin_3", begin_3}, {"sort", sort}, {"list_2", list_2}, {"list_3", list_3}, {"resume", resume}};
  fibers::kernel = nullptr;
  for (const auto &one : known)
    if (!strcmp(one.name, name)) fibers::kernel = one.kernel;
  if (!fibers::kernel) fprintf(stderr, "there is no kernel %s\n", name), abort();
  blockDim.x = threads;
  for (int k = blocks - 1; k >= 0; --k) blockIdx.x = k, fibers::run_block(threads);  // backwards: no order is promised
}
