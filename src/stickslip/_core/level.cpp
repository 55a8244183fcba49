// Levels of processors. The functions that query the level are called from the library of the lowest one.
#include <stdint.h>
#if defined(__x86_64__)
#include <cpuid.h>

namespace {

// Registers a, b, c, d of a CPUID leaf; zeros if the processor does not support the leaf.
struct Leaf {
    uint32_t a = 0, b = 0, c = 0, d = 0;
    explicit Leaf(uint32_t number) {
        if (!__get_cpuid_count(number, 0, &a, &b, &c, &d)) a = b = c = d = 0;
    }
};

template <class... Bits>
constexpr uint32_t mask(Bits... bits) {
    return ((uint32_t(1) << bits) | ...);
}

bool all(uint32_t value, uint32_t bits) { return (value & bits) == bits; }

uint32_t saved_registers() {  // which registers the operating system saves
    uint32_t low, high;
    __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
}

int32_t level() {
    const Leaf features(1), more(7), extended(0x80000001);
    // SSE3, SSSE3, FMA, CX16, SSE4.1, SSE4.2, MOVBE, POPCNT, OSXSAVE, AVX, F16C; BMI, AVX2, BMI2; LAHF, LZCNT
    if (!all(features.c, mask(0, 9, 12, 13, 19, 20, 22, 23, 27, 28, 29))) return 0;
    if (!all(more.b, mask(3, 5, 8)) || !all(extended.c, mask(0, 5))) return 0;
    const uint32_t saved = saved_registers();
    if (!all(saved, 0x06)) return 0;  // xmm, ymm
    if (!all(more.b, mask(16, 17, 28, 30, 31)) || !all(saved, 0xe6)) return 1;  // AVX-512 F, DQ, CD, BW, VL; masks, zmm
    return 2;
}

}  // namespace
#else
static int32_t level() { return 0; }
#endif

extern "C" __attribute__((visibility("default"))) int32_t core_processor_level(void);

// Highest level that this processor and its operating system run: 0 base, 1 avx2, 2 avx512.
int32_t core_processor_level(void) { return level(); }
