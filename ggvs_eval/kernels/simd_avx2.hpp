// Eight lanes of AVX2; the names of simd_portable.hpp. No FMA but by multiply_add, so that every level gives the same bits.
// All that follows is compiled for these instructions, up to simd_end.hpp. What must run everywhere is included before.
#pragma once
#include <immintrin.h>

#include <cstdint>

#if defined(__clang__)
#pragma clang attribute push(__attribute__((target("avx2,fma"))), apply_to = function)
#else
// GCC 12's own intrinsics start from undefined registers on purpose and warn about it (GCC bug 105593).
#pragma GCC diagnostic ignored "-Wuninitialized"
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#pragma GCC push_options
#pragma GCC target("avx2,fma")
#endif

#define GGVS_LEVEL avx2
#define GGVS_INLINE static inline __attribute__((always_inline))

namespace ggvs::GGVS_LEVEL {

constexpr int kWidth = 8;
using F = __m256;
using I = int32_t __attribute__((vector_size(32)));
using M = I;  // all bits of a lane set = true

GGVS_INLINE F all(float x) { return _mm256_set1_ps(x); }
GGVS_INLINE I all(int32_t x) { return (I)_mm256_set1_epi32(x); }
GGVS_INLINE F load(const float* p) { return _mm256_loadu_ps(p); }
GGVS_INLINE I load(const int32_t* p) { return (I)_mm256_loadu_si256((const __m256i*)p); }
GGVS_INLINE void store(float* p, F x) { _mm256_storeu_ps(p, x); }
GGVS_INLINE void store(int32_t* p, I x) { _mm256_storeu_si256((__m256i*)p, (__m256i)x); }

GGVS_INLINE M less(F a, F b) { return (M)_mm256_cmp_ps(a, b, _CMP_LT_OQ); }
GGVS_INLINE M at_most(F a, F b) { return (M)_mm256_cmp_ps(a, b, _CMP_LE_OQ); }
GGVS_INLINE M at_most(I a, I b) { return a <= b; }
// 0 <= x < limit, by bits: -0 is outside.
GGVS_INLINE M within(F x, float limit) {
    const __m256i bits = (__m256i)x, below = _mm256_sub_epi32(bits, (__m256i)_mm256_set1_ps(limit));
    return (M)_mm256_srai_epi32(_mm256_andnot_si256(bits, below), 31);
}
GGVS_INLINE M both(M a, M b) { return a & b; }
GGVS_INLINE M either(M a, M b) { return a | b; }
GGVS_INLINE M but_not(M a, M b) { return a & ~b; }
GGVS_INLINE M no_lanes() { return (M)_mm256_setzero_si256(); }
GGVS_INLINE bool any(M m) { return _mm256_movemask_ps((__m256)m) != 0; }
GGVS_INLINE I bits(F x) { return (I)x; }
GGVS_INLINE F from_bits(I x) { return (F)x; }
GGVS_INLINE F select(M m, F a, F b) { return _mm256_blendv_ps(b, a, (__m256)m); }
GGVS_INLINE I select(M m, I a, I b) { return (I)_mm256_blendv_ps((__m256)b, (__m256)a, (__m256)m); }
// x in the lanes of the mask, 0 in the others.
GGVS_INLINE F keep(M m, F x) { return _mm256_and_ps(x, (__m256)m); }
GGVS_INLINE F min(F a, F b) { return _mm256_min_ps(a, b); }
GGVS_INLINE F max(F a, F b) { return _mm256_max_ps(a, b); }
// a b + c, rounded once.
GGVS_INLINE F multiply_add(F a, F b, F c) { return _mm256_fmadd_ps(a, b, c); }
// c - a b, rounded once.
GGVS_INLINE F without_product(F a, F b, F c) { return _mm256_fnmadd_ps(a, b, c); }
GGVS_INLINE F sqrt(F x) { return _mm256_sqrt_ps(x); }
GGVS_INLINE I truncate(F x) { return (I)_mm256_cvttps_epi32(x); }
GGVS_INLINE F to_float(I x) { return _mm256_cvtepi32_ps((__m256i)x); }
// For every choice of lanes, their numbers.
struct PackedLanes {
    uint8_t lanes[256][8];
    constexpr PackedLanes() : lanes{} {
        for (int chosen = 0; chosen < 256; ++chosen)
            for (int lane = 0, count = 0; lane < 8; ++lane)
                if (chosen >> lane & 1) lanes[chosen][count++] = uint8_t(lane);
    }
};
alignas(64) static constexpr PackedLanes kPacked;
// Lanes in which two numbers have a bit in common.
GGVS_INLINE M share_bits(I a, I b) { return (a & b) != all(int32_t(0)); }
// A bit for every lane.
GGVS_INLINE uint32_t lanes_of(M m) { return uint32_t(_mm256_movemask_ps((__m256)m)); }
GGVS_INLINE int count_of(M m) { return __builtin_popcount(lanes_of(m)); }
// The chosen lanes side by side; what comes after them is written over, up to a whole vector.
GGVS_INLINE void pack(M chosen, I x, int32_t* to) {
    const __m256i from = _mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i*)kPacked.lanes[lanes_of(chosen)]));
    store(to, (I)_mm256_permutevar8x32_epi32((__m256i)x, from));
}
GGVS_INLINE F gather(const float* p, I at) { return _mm256_i32gather_ps(p, (__m256i)at, 4); }
// Floats that lie side by side, at p[at] and p[at + 1]: half the reads of two gathers.
GGVS_INLINE void gather_pairs(const float* p, I at, F* first, F* second) {
    const double* pairs = (const double*)p;
    F low = _mm256_castpd_ps(_mm256_i32gather_pd(pairs, _mm256_castsi256_si128((__m256i)at), 4));
    F high = _mm256_castpd_ps(_mm256_i32gather_pd(pairs, _mm256_extracti128_si256((__m256i)at, 1), 4));
    F even = _mm256_shuffle_ps(low, high, 0x88), odd = _mm256_shuffle_ps(low, high, 0xdd);
    *first = _mm256_castpd_ps(_mm256_permute4x64_pd(_mm256_castps_pd(even), 0xd8));
    *second = _mm256_castpd_ps(_mm256_permute4x64_pd(_mm256_castps_pd(odd), 0xd8));
}
// A patch of 8 x 4 floats in registers: lanes that look at neighbouring pixels read it once, and a look costs less than a gather.
constexpr int kPatchColumns = 8, kPatchRows = 4;
struct Patch {
    F rows[4];
};
GGVS_INLINE Patch load_patch(const float* p, int64_t stride) {
    return {{load(p), load(p + stride), load(p + 2 * stride), load(p + 3 * stride)}};
}
// Where 8 * row + column lies in the lower half of the patch; of a lane, the sign says it.
GGVS_INLINE M half_of_patch(I at) { return at << 27; }
// The floats at 8 * row + column of the patch, which lie in these halves.
GGVS_INLINE F look(const Patch& patch, I at, M half) {
    const F odd = (F)(at << 28), lower = (F)half;  // the bits that choose the row become signs
    const __m256i column = (__m256i)at;
    const F above = _mm256_blendv_ps(_mm256_permutevar8x32_ps(patch.rows[0], column),
                                     _mm256_permutevar8x32_ps(patch.rows[1], column), odd);
    const F below = _mm256_blendv_ps(_mm256_permutevar8x32_ps(patch.rows[2], column),
                                     _mm256_permutevar8x32_ps(patch.rows[3], column), odd);
    return _mm256_blendv_ps(above, below, lower);
}
// The smallest of each of two 16-bit numbers, over all lanes.
GGVS_INLINE uint32_t least_halves(I halves) {
    __m128i four = _mm_min_epu16(_mm256_castsi256_si128((__m256i)halves), _mm256_extracti128_si256((__m256i)halves, 1));
    four = _mm_min_epu16(four, _mm_shuffle_epi32(four, 0x4e));
    return uint32_t(_mm_cvtsi128_si32(_mm_min_epu16(four, _mm_shuffle_epi32(four, 0xb1))));
}
// Whether both 16-bit numbers of all lanes are below those of `limits`.
GGVS_INLINE bool halves_below(I halves, I limits) {
    const __m256i beyond = _mm256_subs_epu16((__m256i)limits, (__m256i)halves);
    return _mm256_movemask_epi8(_mm256_cmpeq_epi16(beyond, _mm256_setzero_si256())) == 0;
}
// Every four lanes side by side, the next four `row` floats further.
GGVS_INLINE void store_rows(float* p, int row, F x) {
    _mm_storeu_ps(p, _mm256_castps256_ps128(x)), _mm_storeu_ps(p + row, _mm256_extractf128_ps(x, 1));
}
// Four values of every lane side by side, those of the next lane `stride` floats further, of the next four lanes `row` floats.
GGVS_INLINE void store_quads(float* p, int stride, int row, F a, F b, F c, F d) {
    const F ab[2] = {_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b)}, cd[2] = {_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d)};
#pragma GCC unroll 4
    for (int n = 0; n < 4; ++n) {  // lanes n and n + 4
        const __m256d left = _mm256_castps_pd(ab[n / 2]), right = _mm256_castps_pd(cd[n / 2]);
        const F quads = _mm256_castpd_ps(n % 2 ? _mm256_unpackhi_pd(left, right) : _mm256_unpacklo_pd(left, right));
        _mm_storeu_ps(p + n * stride, _mm256_castps256_ps128(quads));
        _mm_storeu_ps(p + n * stride + row, _mm256_extractf128_ps(quads, 1));
    }
}
// The first three of four values of every lane side by side.
GGVS_INLINE void load_quads(const float* p, F* a, F* b, F* c) {
    const auto lanes = [p](int n) {  // n and n + 4
        return _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(p + 4 * n)), _mm_loadu_ps(p + 4 * n + 16), 1);
    };
    const F ab[2] = {_mm256_unpacklo_ps(lanes(0), lanes(1)), _mm256_unpacklo_ps(lanes(2), lanes(3))};
    const F cd[2] = {_mm256_unpackhi_ps(lanes(0), lanes(1)), _mm256_unpackhi_ps(lanes(2), lanes(3))};
    *a = _mm256_shuffle_ps(ab[0], ab[1], 0x44), *b = _mm256_shuffle_ps(ab[0], ab[1], 0xee);
    *c = _mm256_shuffle_ps(cd[0], cd[1], 0x44);
}
// Three values of every lane side by side, read and written: the two halves of a vector on their own.
GGVS_INLINE void load_triples(const float* p, F* a, F* b, F* c) {
    const auto halves = [p](int n) {
        return _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(p + n)), _mm_loadu_ps(p + n + 12), 1);
    };
    const F first = halves(0), second = halves(4), third = halves(8);  // a b c a, b c a b, c a b c
    *a = _mm256_shuffle_ps(first, _mm256_shuffle_ps(second, third, 0x5a), 0x8c);
    *b = _mm256_shuffle_ps(_mm256_shuffle_ps(first, second, 0x05), _mm256_shuffle_ps(second, third, 0xaf), 0x88);
    *c = _mm256_shuffle_ps(_mm256_shuffle_ps(first, second, 0x5a), third, 0xc8);
}
GGVS_INLINE void store_triples(float* p, F a, F b, F c) {
    const F first = _mm256_shuffle_ps(_mm256_unpacklo_ps(a, b), _mm256_shuffle_ps(c, a, 0x50), 0x84);
    const F second = _mm256_shuffle_ps(_mm256_shuffle_ps(b, c, 0x55), _mm256_unpackhi_ps(a, b), 0x48);
    const F third = _mm256_shuffle_ps(_mm256_shuffle_ps(c, a, 0xfa), _mm256_shuffle_ps(b, c, 0xff), 0x88);
    _mm_storeu_ps(p, _mm256_castps256_ps128(first)), _mm_storeu_ps(p + 12, _mm256_extractf128_ps(first, 1));
    _mm_storeu_ps(p + 4, _mm256_castps256_ps128(second)), _mm_storeu_ps(p + 16, _mm256_extractf128_ps(second, 1));
    _mm_storeu_ps(p + 8, _mm256_castps256_ps128(third)), _mm_storeu_ps(p + 20, _mm256_extractf128_ps(third, 1));
}
// Sixteen bytes from any address, four by four: reads of whole lanes and a transposition, where gathers read every four alone.
GGVS_INLINE void gather_quads(const uint8_t* p, I at, I (&quads)[4]) {
    alignas(32) int32_t from[8];
    store(from, at);
    __m256i rows[4];  // lanes n and n + 4
#pragma GCC unroll 4
    for (int n = 0; n < 4; ++n)
        rows[n] = _mm256_inserti128_si256(_mm256_castsi128_si256(_mm_loadu_si128((const __m128i*)(p + from[n]))),
                                          _mm_loadu_si128((const __m128i*)(p + from[n + 4])), 1);
    const __m256i low[2] = {_mm256_unpacklo_epi32(rows[0], rows[1]), _mm256_unpacklo_epi32(rows[2], rows[3])};
    const __m256i high[2] = {_mm256_unpackhi_epi32(rows[0], rows[1]), _mm256_unpackhi_epi32(rows[2], rows[3])};
    quads[0] = (I)_mm256_unpacklo_epi64(low[0], low[1]), quads[1] = (I)_mm256_unpackhi_epi64(low[0], low[1]);
    quads[2] = (I)_mm256_unpacklo_epi64(high[0], high[1]), quads[3] = (I)_mm256_unpackhi_epi64(high[0], high[1]);
}
// Three bytes of every lane side by side, and a fourth that is 0: four bytes behind them are read.
GGVS_INLINE I load_byte_triples(const uint8_t* p) {
    const __m128i spread = _mm_setr_epi8(0, 1, 2, -1, 3, 4, 5, -1, 6, 7, 8, -1, 9, 10, 11, -1);
    const __m128i low = _mm_loadu_si128((const __m128i*)p), high = _mm_loadu_si128((const __m128i*)(p + 12));
    const __m256i both_halves = _mm256_inserti128_si256(_mm256_castsi128_si256(low), high, 1);
    return (I)_mm256_shuffle_epi8(both_halves, _mm256_broadcastsi128_si256(spread));
}
GGVS_INLINE I gather_bytes(const uint8_t* p, I at) { return (I)_mm256_i32gather_epi32((const int*)p, (__m256i)at, 1); }

}  // namespace ggvs::GGVS_LEVEL

#include "simd_halves.hpp"
