// Threads of the process. A call takes a team of them and gives it back, so threads are started once. A thread
// that waits spins briefly and then sleeps. Parts of the work that no other thread has begun are done by the caller.
#pragma once
#include "core.h"
#include <pthread.h>
#include <time.h>
#ifndef _WIN32
#include <signal.h>
#include <unistd.h>
#endif

constexpr int SPINS = 4000;    // before a waiting thread sleeps: about 0.1 ms, longer than most waits in a step
constexpr int64_t TEAMS = 32;  // calls that may have threads at the same time

// After this time [ns] a team is compared with its caller alone: on a busy machine, it may wait for cores more than it
// gains. Then the caller works alone for as long, and each time longer, up to MOST_ALONE.
constexpr int64_t JUDGED = 100'000'000, MOST_ALONE = 4 * JUDGED;

inline int64_t nanoseconds() {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1'000'000'000 + now.tv_nsec;
}

struct alignas(64) Signal {  // a number for which one thread waits
  int64_t value = 0;
  bool asleep = false;
  pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
  pthread_cond_t changed = PTHREAD_COND_INITIALIZER;

  int64_t now() const { return __atomic_load_n(&value, __ATOMIC_SEQ_CST); }

  void set(int64_t to) { __atomic_store_n(&value, to, __ATOMIC_SEQ_CST); }

  void wake() {  // after a change
    if (!__atomic_load_n(&asleep, __ATOMIC_SEQ_CST)) return;
    pthread_mutex_lock(&mutex);
    pthread_cond_signal(&changed);
    pthread_mutex_unlock(&mutex);
  }

  template <class Ready>
  void wait(const Ready &ready) {
    for (int spins = 0; spins < SPINS; ++spins) {
      if (ready(now())) return;
#if defined(__x86_64__)
      __builtin_ia32_pause();
#elif defined(__aarch64__)
      __asm__ volatile("yield");
#endif
    }
    pthread_mutex_lock(&mutex);
    __atomic_store_n(&asleep, true, __ATOMIC_SEQ_CST);
    while (!ready(now())) pthread_cond_wait(&changed, &mutex);
    __atomic_store_n(&asleep, false, __ATOMIC_SEQ_CST);
    pthread_mutex_unlock(&mutex);
  }
};

class Team {
 public:
  typedef void (*Task)(const void *, int64_t);

  // Returns false if another call has this team. A child of a fork has none of the threads.
  bool take() {
    if (__atomic_exchange_n(&taken, true, __ATOMIC_ACQUIRE)) return false;
#ifndef _WIN32
    if (owner != getpid()) {
      owner = getpid(), started = 0, left = {};
      for (Member &one : member) one.order = {};
    }
#endif
    return true;
  }

  void give_back() { __atomic_store_n(&taken, false, __ATOMIC_RELEASE); }

  void grow(int64_t parts) {
    if (started >= parts - 1) return;
#ifndef _WIN32
    constexpr int FAULTS[] = {SIGSEGV, SIGBUS, SIGFPE, SIGILL};
    sigset_t all, former;  // other signals are for threads of Python
    sigfillset(&all);
    for (const int fault : FAULTS) sigdelset(&all, fault);
    pthread_sigmask(SIG_BLOCK, &all, &former);
#endif
    for (pthread_t thread; started < parts - 1; ++started) {
      Member &one = member[started + 1];
      one.team = this, one.number = started + 1, one.seen = one.order.now();
      if (pthread_create(&thread, nullptr, serve, &one)) break;
      pthread_detach(thread);
    }
#ifndef _WIN32
    pthread_sigmask(SIG_SETMASK, &former, nullptr);
#endif
  }

  void run(int64_t parts, Task next, const void *given) {
    const int64_t since = nanoseconds();
    if (since < alone_until) {
      for (int64_t k = 0; k < parts; ++k) next(given, k);
      return;
    }
    task = next, context = given;
    left.set(parts);
    ++round;
    for (int64_t k = 1; k < parts && k <= started; ++k) {
      member[k].order.set(round * (MOST_THREADS + 1) + parts);
      member[k].order.wake();
    }
    const int64_t begun = nanoseconds(), own = work(0, round, parts), worked = nanoseconds() - begun;
    left.wait([](int64_t parts_left) { return parts_left == 0; });
    judge(since, nanoseconds(), own ? worked * parts / own : 0);
  }

 private:
  struct Member {
    Signal order;         // round and number of parts
    int64_t claimed = 0;  // round in which the part with this number was last begun
    int64_t seen = 0, number = 0;
    Team *team = nullptr;
  };

  // Does the parts of a round that no other thread has begun, its own first. A thread that comes late finds none, and
  // then must not read the task, which may be that of a later round.
  int64_t work(int64_t number, int64_t in_round, int64_t parts) {
    int64_t done = 0;
    for (int64_t k = 0; k < parts; ++k) {
      const int64_t part = (number + k) % parts;
      int64_t last = __atomic_load_n(&member[part].claimed, __ATOMIC_SEQ_CST);
      if (last >= in_round || !__atomic_compare_exchange_n(&member[part].claimed, &last, in_round, false,
                                                           __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST))
        continue;
      task(context, part);
      ++done;
      if (__atomic_sub_fetch(&left.value, 1, __ATOMIC_SEQ_CST) == 0) left.wake();
    }
    return done;
  }

  void judge(int64_t since, int64_t now, int64_t by_one) {
    spent += now - since;
    gain += by_one - (now - since);
    if (spent < JUDGED) return;
    pause = gain >= 0 ? 0 : 2 * pause + JUDGED < MOST_ALONE ? 2 * pause + JUDGED : MOST_ALONE;
    alone_until = now + pause;
    spent = gain = 0;
  }

  static void *serve(void *given) {
    Member *own = static_cast<Member *>(given);
    for (;;) {
      own->order.wait([=](int64_t order) { return order != own->seen; });
      own->seen = own->order.now();
      own->team->work(own->number, own->seen / (MOST_THREADS + 1), own->seen % (MOST_THREADS + 1));
    }
  }

  bool taken = false;
  int64_t owner = 0, round = 0;
  int64_t started = 0;  // threads besides the caller
  int64_t spent = 0, gain = 0, pause = 0, alone_until = 0;  // [ns]
  Task task = nullptr;
  const void *context = nullptr;
  Signal left;  // parts that are not finished
  Member member[MOST_THREADS];
};

inline Team teams[TEAMS];

class Pool {  // threads for one call, or none if there is one part only or no team is left
 public:
  explicit Pool(int64_t parts) : parts(parts < MOST_THREADS ? parts : MOST_THREADS) {
    for (int64_t k = 0; parts > 1 && !team && k < TEAMS; ++k) team = teams[k].take() ? &teams[k] : nullptr;
    if (team) team->grow(this->parts);
  }

  ~Pool() {
    if (team) team->give_back();
  }

  Pool(const Pool &) = delete;
  Pool &operator=(const Pool &) = delete;

  // Calls body(k) for every part k, and waits for all.
  template <class Body>
  void each(const Body &body) {
    if (team) return team->run(parts, [](const void *given, int64_t k) { (*static_cast<const Body *>(given))(k); }, &body);
    for (int64_t k = 0; k < parts; ++k) body(k);
  }

  const int64_t parts;

 private:
  Team *team = nullptr;
};
