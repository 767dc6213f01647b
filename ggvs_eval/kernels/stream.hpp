// Copies past the caches: memory that nobody reads for a while need not be fetched before it is written.
#pragma once
#include <cstdint>
#include <cstring>
#if defined(__SSE2__)
#include <emmintrin.h>
#endif

namespace ggvs {

inline void stream_copy(const float* from, int64_t count, float* to) {
    int64_t n = 0;
#if defined(__SSE2__)
    while (n < count && reinterpret_cast<uintptr_t>(to + n) % sizeof(__m128i) != 0) to[n] = from[n], ++n;
    for (; n + 4 <= count; n += 4) _mm_stream_ps(to + n, _mm_loadu_ps(from + n));
    _mm_sfence();
#endif
    std::memcpy(to + n, from + n, (count - n) * sizeof(float));
}

}  // namespace ggvs
