// Sixteen 16-bit numbers and thirty-two bytes, for AVX2 and AVX-512 alike: what simd_portable.hpp offers of half the width. Included by
// simd_avx2.hpp and simd_avx512.hpp.
#pragma once

namespace ggvs::GGVS_LEVEL {

// Sixteen 16-bit numbers.
using H = int16_t __attribute__((vector_size(32)));
// The smallest one, none below 0, in every lane.
GGVS_INLINE H least_everywhere(H x) {
    const __m128i eight = _mm_min_epu16(_mm256_castsi256_si128((__m256i)x), _mm256_extracti128_si256((__m256i)x, 1));
    return (H)_mm256_broadcastw_epi16(_mm_minpos_epu16(eight));
}
// Of lanes n and n + 8 the larger one, of these eight the smallest one; numbers below 0 come last.
GGVS_INLINE int least_of_larger(H x) {
    const __m128i eight = _mm_max_epi16(_mm256_castsi256_si128((__m256i)x), _mm256_extracti128_si256((__m256i)x, 1));
    return _mm_extract_epi16(_mm_minpos_epu16(eight), 0);
}
// The last lanes of a and the first ones of b; and what lies one lane before b, and one behind a.
GGVS_INLINE H between(H a, H b) { return (H)_mm256_permute2x128_si256((__m256i)a, (__m256i)b, 0x21); }
GGVS_INLINE H lanes_before(H, H middle, H b) { return (H)_mm256_alignr_epi8((__m256i)b, (__m256i)middle, 14); }
GGVS_INLINE H lanes_after(H a, H middle, H) { return (H)_mm256_alignr_epi8((__m256i)middle, (__m256i)a, 2); }
// Bytes a - b, at least 0.
using B = uint8_t __attribute__((vector_size(32)));
GGVS_INLINE B excess(B a, B b) { return (B)_mm256_subs_epu8((__m256i)a, (__m256i)b); }

}  // namespace ggvs::GGVS_LEVEL
