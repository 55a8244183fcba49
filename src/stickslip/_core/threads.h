// A pool of threads that lasts for one call from Python. Threads wait by spinning, since a region takes microseconds.
#pragma once
#include "core.h"
#include <pthread.h>
#include <sched.h>

constexpr int SPINS = 4000;  // before a waiting thread offers its processor to others

inline void relax(int &spins) {
  if (++spins < SPINS) {
#if defined(__x86_64__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __asm__ volatile("yield");
#endif
    return;
  }
  sched_yield();
}

class Pool {
 public:
  explicit Pool(int64_t workers) : workers(workers < MOST_THREADS ? workers : MOST_THREADS) {
    for (int64_t k = 1; k < this->workers; ++k) {
      member[k].pool = this;
      member[k].number = k;
      if (pthread_create(&member[k].thread, nullptr, work, &member[k])) this->workers = k;
    }
    started = this->workers;
  }

  ~Pool() {
    run(nullptr, nullptr);
    for (int64_t k = 1; k < started; ++k) {
      pthread_join(member[k].thread, nullptr);
    }
  }

  Pool(const Pool &) = delete;
  Pool &operator=(const Pool &) = delete;

  // Calls body(k) for every part k below `parts`, part k on thread k modulo the number of threads, and waits for all.
  template <class Body>
  void each(int64_t parts, const Body &body) {
    struct Job {
      const Body *body;
      int64_t parts, step;
    } job{&body, parts, workers};
    auto task = [](void *given, int64_t k) {
      Job *own = static_cast<Job *>(given);
      for (int64_t part = k; part < own->parts; part += own->step) (*own->body)(part);
    };
    if (workers == 1 || parts == 1)
      for (int64_t part = 0; part < parts; ++part) body(part);
    else
      run(task, &job);
  }

  int64_t workers;

 private:
  typedef void (*Task)(void *, int64_t);
  struct Member {
    Pool *pool;
    int64_t number;
    pthread_t thread;
  };

  void run(Task next, void *given) {
    task = next;
    context = given;
    __atomic_store_n(&left, started - 1, __ATOMIC_RELAXED);
    __atomic_add_fetch(&epoch, 1, __ATOMIC_RELEASE);
    if (!next) return;
    next(given, 0);
    for (int spins = 0; __atomic_load_n(&left, __ATOMIC_ACQUIRE) > 0;) relax(spins);
  }

  static void *work(void *given) {
    Member *own = static_cast<Member *>(given);
    Pool *pool = own->pool;
    for (int64_t seen = 0;;) {
      for (int spins = 0; __atomic_load_n(&pool->epoch, __ATOMIC_ACQUIRE) == seen;) relax(spins);
      ++seen;
      if (!pool->task) return 0;
      pool->task(pool->context, own->number);
      __atomic_sub_fetch(&pool->left, 1, __ATOMIC_RELEASE);
    }
  }

  Task task = nullptr;
  void *context = nullptr;
  int64_t started = 1;
  alignas(64) int64_t epoch = 0;
  alignas(64) int64_t left = 0;
  Member member[MOST_THREADS];
};
