// Memory that is kept between calls, and memory for a single call. All memory is aligned to cache lines.
#pragma once
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#ifdef _WIN32
#include <malloc.h>
#endif

inline void *allocate(int64_t bytes) {  // null if memory runs out
#ifdef _WIN32
  return _aligned_malloc(bytes, 64);
#else
  void *data = nullptr;
  return posix_memalign(&data, 64, bytes) ? nullptr : data;
#endif
}

inline void release(void *data) {
#ifdef _WIN32
  _aligned_free(data);
#else
  free(data);
#endif
}

template <class T>
struct Buffer {  // memory that is kept while it is long enough; new memory costs more than writing to it
  T *data;
  int64_t room;
};

// Returns false if memory runs out. Contents are lost if the buffer was too short.
template <class T>
bool grow(Buffer<T> &buffer, int64_t need) {
  if (need <= buffer.room) return true;
  const int64_t room = need + need / 8;
  release(buffer.data);
  buffer.data = static_cast<T *>(allocate(room * sizeof(T)));
  buffer.room = buffer.data ? room : 0;
  return buffer.data;
}

template <class... T>
void release_all(Buffer<T> &...buffer) {
  (release(buffer.data), ...);
}

class Scratch {  // memory that lasts as long as this object
 public:
  Scratch() = default;
  ~Scratch() {
    for (int64_t k = 0; k < parts; ++k) release(part[k]);
  }
  Scratch(const Scratch &) = delete;
  Scratch &operator=(const Scratch &) = delete;

  template <class T>
  bool take(T *&data, int64_t length) {  // returns false if memory runs out
    data = static_cast<T *>(allocate((length + 1) * sizeof(T)));
    part[parts++] = data;
    return data;
  }

  template <class T>
  bool take_zeros(T *&data, int64_t length) {
    return take(data, length) && memset(data, 0, length * sizeof(T));
  }

 private:
  void *part[24];
  int64_t parts = 0;
};
