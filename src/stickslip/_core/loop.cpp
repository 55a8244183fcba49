// Time steps of all grains. Contacts are evaluated by rows (few grains, or bonds) or by blocks.
//
// By rows, all bodies are in the last tile. By blocks, a step first evaluates the contacts
// between bodies of different threads. Then each thread goes through its tiles. It evaluates a tile's contacts, both with
// later tiles and within the tile, and moves the tile's grains while they are in the processor's cache.
#include <math.h>
#include <string.h>

#include "bonds.h"
#include "loop.h"
#include "threads.h"

namespace {

inline int64_t ticks() {  // of a constant-rate counter of the processor, 0 where none is known
#if defined(__x86_64__)
  return int64_t(__builtin_ia32_rdtsc());
#elif defined(__aarch64__)
  int64_t count;
  __asm__ volatile("mrs %0, cntvct_el0" : "=r"(count));
  return count;
#else
  return 0;
#endif
}

struct Run {
  const Law &law;
  int64_t dim;
  const Moving &moving;
  Blocks *blocks;  // null: by rows
  const Bodies &bodies;
  const Contacts &contacts;
  const double *vectors;
  const Pace &pace;
  Frame *frame;
  Flow *flow;
  Pull *pull;
  const Bonds *bonds;
  const Writing &writing;
  bool predict;
  int64_t tiles, workers;
  double *far, *sums, *scratch;
  Pool &pool;
};

void record_break(const void *context, const Bonds &bonds, int64_t k, const double *place) {
  const Events *events = static_cast<const Events *>(context);
  const int64_t row = events->count[0]++;
  write_event(events->row + EVENT * row, FAILED, events->time, bonds.i[k], bonds.j[k], bonds.image + 3 * k, place);
}

void evaluate_by_rows(const Run &run, bool hold, double time) {
  const Moving &moving = run.moving;
  for (int64_t g = 0; g < moving.len_order; ++g) {
    const double *external = moving.external + (moving.len_external > 1 ? WIDTH * g : 0);
    const double *torque = moving.torque + (moving.len_torque > 1 ? 3 * g : 0);
    for (int k = 0; k < 3; ++k) moving.force[6 * g + k] = external[k], moving.force[6 * g + 3 + k] = torque[k];
  }
  for (int64_t k = 0; k < 9 * moving.len_virial; ++k) moving.virial[k] = 0.0;
  const double *matrix = run.flow ? run.flow->matrix : nullptr, *body = moving.body;
  Motion motion = {{body + VELOCITY, BODY}, {body + SPIN, BODY}, run.pace.dt, hold,
                   matrix ? matrix + 9 * RATE : nullptr, matrix ? matrix + 9 * INVERSE_HALF : nullptr};
  Vectors velocity = motion.velocity, spin = motion.spin;
  if (run.predict) velocity = {moving.ahead + VELOCITY_AHEAD, BODY_AHEAD}, spin = {moving.ahead + SPIN_AHEAD, BODY_AHEAD};
  Events events = {run.writing.events, run.writing.event_count, run.writing.len_events, time};
  Sweep sweep = {FREE, false, true, motion, {body, BODY}, {moving.angle, 3}, velocity, spin,
                 matrix ? matrix + 9 * RATE_AHEAD : nullptr, run.bodies, matrix ? matrix + 9 * VECTORS : run.vectors,
                 moving.force, moving.force + 3, 6, matrix ? moving.virial : nullptr,
                 run.writing.len_events ? &events : nullptr};
  sweep_contacts(run.law, run.dim, sweep, run.contacts);
  if (!run.bonds) return;
  BondSweep held = {};
  held.position = {body, BODY}, held.angle = {moving.angle, 3};
  held.velocity = {velocity.data, velocity.stride}, held.spin = {spin.data, spin.stride};
  held.vectors = sweep.vectors, held.gradient = sweep.gradient;
  held.force = sweep.force, held.torque = sweep.torque, held.stride = sweep.stride;
  held.virial = sweep.virial, held.by_body = true, held.commits = held.breaks = true;
  if (sweep.events) held.broken = record_break, held.context = &events;
  sweep_bonds(run.dim, held, *run.bonds);
}

// Contacts between bodies of different threads, then tile by tile the others, and the motion of each tile's grains.
void evaluate_by_blocks(const Run &run, const Step &step) {
  const Moving &moving = run.moving;
  const Blocks &blocks = *run.blocks;
  const int64_t *cross = blocks.cross.data, *inner = blocks.inner.data, tiles = run.tiles, workers = run.workers;
  const int64_t between = cross[tiles + 1] - cross[tiles];
  auto evaluate = [&](int64_t first, int64_t last, bool crossing, int64_t begin, int64_t end, int64_t k) {
    evaluate_blocks(run.law, run.dim, first, last, crossing, begin, end, blocks, moving, run.pace.dt, step.fresh,
                    run.flow, run.scratch + SCRATCH * k);
  };
  if (between > 0)
    run.pool.each([&](int64_t k) {
      evaluate(cross[tiles] + between * k / workers, cross[tiles] + between * (k + 1) / workers, true, 0, 0, k);
    });
  run.pool.each([&](int64_t k) {
    const int64_t since = ticks(), stop = moving.share[k + 1];
    for (int64_t t = moving.share[k]; t < stop; ++t) {
      const int64_t begin = moving.tile[t + 1], end = moving.tile[t + 2 < stop ? t + 2 : stop];  // next tile
      evaluate(cross[t], cross[t + 1], true, 0, 0, k);
      evaluate(inner[t], inner[t + 1], false, begin, end, k);
      run.far[t] = end_step(step, blocks, moving.tile[t], moving.tile[t + 1], run.sums + CHUNK * WIDTH * k);
    }
    moving.spent[8 * k] += ticks() - since;
  });
}

// Records the contacts whose modes show that they closed, opened or first reached the Coulomb limit.
void record_changes(const Run &run, const int64_t *before, int64_t slots, double time) {
  const Blocks &blocks = *run.blocks;
  const Events events = {run.writing.events, run.writing.event_count, run.writing.len_events, time};
  for (int64_t s = 0; s < slots; ++s) {
    const int64_t old = before[s], now = blocks.mode.data[s], c = blocks.row.data[s];
    if (old == now || c < 0) continue;
    const double *place = run.moving.body + BODY * blocks.i.data[s];
    if (now == OPEN || old == OPEN) record_event(&events, now == OPEN ? OPENED : CLOSED, run.contacts, c, place);
    if (now == SLIDE && old != SLIDE && old != STUCK_AGAIN)
      record_event(&events, REACHED_LIMIT, run.contacts, c, place);
  }
}

void begin_all(const Run &run, const Step &step) {
  const Moving &moving = run.moving;
  if (run.blocks)
    run.pool.each([&](int64_t k) {
      for (int64_t t = moving.share[k]; t < moving.share[k + 1]; ++t)
        run.far[t] = begin_step(step, moving.tile[t], moving.tile[t + 1]);
    });
  run.far[run.tiles] = begin_step(step, moving.tile[run.tiles], moving.len_order);
}

struct Progress {
  int64_t step;
  bool ended, fresh;
};

int32_t advance(const Run &run, Progress &at, int64_t stop, double start, double tolerance, double *residual,
                int64_t *before, int64_t slots) {
  const Writing &writing = run.writing;
  const bool watch = writing.len_events > 0, by_rows = !run.blocks;
  const auto sampling = [&] { return writing.every > 0 && at.step % writing.every == 0; };
  const auto checking = [&] { return tolerance > 0.0 && at.step % CHECK_EVERY == 0; };
  double limit = 1.0;
  while (true) {
    const double time = start + double(at.step) * run.pace.dt;
    if (!at.ended) {
      const int64_t most = by_rows ? run.contacts.count[0] + (run.bonds ? run.bonds->len_i : 0) : 2 * slots;
      if (watch && writing.event_count[0] + most > writing.len_events) return FULL;
      const bool go_on = at.step < stop && !run.flow && !sampling() && !checking() && (by_rows || !watch);
      const Step step = {run.dim, run.predict, bool(run.law.lever), has_moments(run.law), run.moving, run.pace, run.flow, at.fresh, go_on};
      if (by_rows) {
        evaluate_by_rows(run, at.fresh, time);
      } else {
        if (watch) memcpy(before, run.blocks->mode.data, sizeof(int64_t) * slots);
        evaluate_by_blocks(run, step);
      }
      run.far[run.tiles] = end_last_tile(step, run.blocks, run.pull, run.sums + CHUNK * WIDTH * run.workers);
      if (run.flow) end_cell_step(run.dim, *run.frame, *run.flow, run.pace.dt, run.pace.slow, run.moving, at.fresh);
      if (watch && !by_rows) record_changes(run, before, slots, time);
      at.ended = !go_on;
      at.fresh = false;
    }
    if (at.ended) {
      if (sampling()) {
        if (!by_rows) commit_blocks(run.blocks, &run.contacts);
        const double *vectors = run.flow ? run.flow->matrix + 9 * VECTORS : run.vectors;
        if (!write_moving_sample(run.law, run.dim, at.step / writing.every, run.moving, run.bodies, run.contacts, vectors,
                                 writing, time))
          return NO_MEMORY;
      }
      if (checking()) {
        int64_t worst;
        residual[0] = largest_unbalanced(run.moving, run.pace, run.pace.drag, run.pace.spin_drag, &worst);
        residual[1] = double(worst);
        if (run.flow) {
          const double cell = unbalanced_cell(run.dim, *run.frame, *run.flow, run.pace.drag);
          if (!(cell <= residual[0]) && !isnan(residual[0])) residual[0] = cell;
        }
        if (residual[0] <= tolerance) return CONVERGED;
      }
      if (at.step == stop) return DONE;
      if (run.flow) limit = begin_cell_step(run.frame, run.flow, run.pace.dt, run.pace.keep, run.pace.slow);
      begin_all(run, {run.dim, run.predict, bool(run.law.lever), has_moments(run.law), run.moving, run.pace, run.flow, true, true});
    }
    at.ended = false;
    ++at.step;
    if (run.pull) run.pull->clock[0] += run.pace.dt;
    for (int64_t t = 0; t <= run.tiles; ++t)
      if (run.far[t] > limit) return MOVED;
  }
}

}  // namespace

int32_t run_steps(const Law *law, int64_t dim, const Moving *moving, Blocks *blocks, const Bodies *bodies,
                  const Contacts *contacts, const double *vectors, const Pace *pace, Frame *frame, Flow *flow,
                  Pull *pull, const Bonds *bonds, const Writing *writing, double start, int64_t stop, double tolerance,
                  double *residual, int64_t *progress) {
  const int64_t tiles = moving->len_tile - 1, workers = moving->len_share - 1;
  Pool pool(workers);
  const int64_t slots = blocks ? LANES * blocks->count : 0, watched = writing->len_events ? slots : 0;
  Scratch memory;
  double *far, *sums, *scratch;
  int64_t *before;
  if (!memory.take_zeros(far, tiles + 1) || !memory.take(sums, (workers + 1) * CHUNK * WIDTH) ||
      !memory.take(scratch, workers * SCRATCH) || !memory.take(before, watched))
    return NO_MEMORY;
  const Run run = {*law, dim, *moving, blocks, *bodies, *contacts, vectors, *pace, frame, flow, pull, bonds, *writing,
                   moving->len_ahead > 0, tiles, workers, far, sums, scratch, pool};
  Progress at = {progress[0], progress[1] != 0, progress[2] != 0};
  const int32_t code = advance(run, at, stop, start, tolerance, residual, before, slots);
  progress[0] = at.step, progress[1] = at.ended, progress[2] = at.fresh;
  return code;
}
