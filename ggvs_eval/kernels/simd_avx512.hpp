// Sixteen lanes of AVX-512; the names of simd_portable.hpp. No FMA but by multiply_add, so that every level gives the same bits.
// All that follows is compiled for these instructions, up to simd_end.hpp. What must run everywhere is included before.
#pragma once
#include <immintrin.h>

#include <cstdint>

#if defined(__clang__)
#pragma clang attribute push(__attribute__((target("avx512f,avx512bw,avx512dq,avx512vl"))), apply_to = function)
#else
// GCC 12's own intrinsics start from undefined registers on purpose and warn about it (GCC bug 105593).
#pragma GCC diagnostic ignored "-Wuninitialized"
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#pragma GCC push_options
#pragma GCC target("avx512f,avx512bw,avx512dq,avx512vl")
#endif

#define GGVS_LEVEL avx512
#define GGVS_INLINE static inline __attribute__((always_inline))

namespace ggvs::GGVS_LEVEL {

constexpr int kWidth = 16;
using F = __m512;
using I = int32_t __attribute__((vector_size(64)));
using M = __mmask16;  // one bit per lane

GGVS_INLINE F all(float x) { return _mm512_set1_ps(x); }
GGVS_INLINE I all(int32_t x) { return (I)_mm512_set1_epi32(x); }
GGVS_INLINE F load(const float* p) { return _mm512_loadu_ps(p); }
GGVS_INLINE I load(const int32_t* p) { return (I)_mm512_loadu_si512(p); }
GGVS_INLINE void store(float* p, F x) { _mm512_storeu_ps(p, x); }
GGVS_INLINE void store(int32_t* p, I x) { _mm512_storeu_si512(p, (__m512i)x); }

GGVS_INLINE M less(F a, F b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
GGVS_INLINE M at_most(F a, F b) { return _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ); }
GGVS_INLINE M at_most(I a, I b) { return _mm512_cmple_epi32_mask((__m512i)a, (__m512i)b); }
// 0 <= x < limit: as bits, numbers below 0 are beyond all others.
GGVS_INLINE M within(F x, float limit) { return _mm512_cmplt_epu32_mask((__m512i)x, (__m512i)_mm512_set1_ps(limit)); }
GGVS_INLINE M both(M a, M b) { return M(a & b); }
GGVS_INLINE M either(M a, M b) { return M(a | b); }
GGVS_INLINE M but_not(M a, M b) { return M(a & ~b); }
GGVS_INLINE M no_lanes() { return 0; }
GGVS_INLINE bool any(M m) { return m != 0; }
GGVS_INLINE I bits(F x) { return (I)x; }
GGVS_INLINE F from_bits(I x) { return (F)x; }
GGVS_INLINE F select(M m, F a, F b) { return _mm512_mask_blend_ps(m, b, a); }
GGVS_INLINE I select(M m, I a, I b) { return (I)_mm512_mask_blend_epi32(m, (__m512i)b, (__m512i)a); }
// x in the lanes of the mask, 0 in the others.
GGVS_INLINE F keep(M m, F x) { return _mm512_maskz_mov_ps(m, x); }
GGVS_INLINE F min(F a, F b) { return _mm512_min_ps(a, b); }
GGVS_INLINE F max(F a, F b) { return _mm512_max_ps(a, b); }
// a b + c, rounded once.
GGVS_INLINE F multiply_add(F a, F b, F c) { return _mm512_fmadd_ps(a, b, c); }
// c - a b, rounded once.
GGVS_INLINE F without_product(F a, F b, F c) { return _mm512_fnmadd_ps(a, b, c); }
GGVS_INLINE F sqrt(F x) { return _mm512_sqrt_ps(x); }
GGVS_INLINE I truncate(F x) { return (I)_mm512_cvttps_epi32(x); }
GGVS_INLINE F to_float(I x) { return _mm512_cvtepi32_ps((__m512i)x); }
// Lanes in which two numbers have a bit in common.
GGVS_INLINE M share_bits(I a, I b) { return _mm512_test_epi32_mask((__m512i)a, (__m512i)b); }
// A bit for every lane.
GGVS_INLINE uint32_t lanes_of(M m) { return m; }
GGVS_INLINE int count_of(M m) { return __builtin_popcount(m); }
// The chosen lanes side by side; what comes after them is written over, up to a whole vector.
GGVS_INLINE void pack(M chosen, I x, int32_t* to) { store(to, (I)_mm512_maskz_compress_epi32(chosen, (__m512i)x)); }
GGVS_INLINE F gather(const float* p, I at) { return _mm512_i32gather_ps((__m512i)at, p, 4); }
// Floats that lie side by side, at p[at] and p[at + 1]: half the reads of two gathers.
GGVS_INLINE void gather_pairs(const float* p, I at, F* first, F* second) {
    const __m512i even = _mm512_set_epi32(30, 28, 26, 24, 22, 20, 18, 16, 14, 12, 10, 8, 6, 4, 2, 0);
    const __m512i odd = _mm512_set_epi32(31, 29, 27, 25, 23, 21, 19, 17, 15, 13, 11, 9, 7, 5, 3, 1);
    F low = _mm512_castpd_ps(_mm512_i32gather_pd(_mm512_castsi512_si256((__m512i)at), p, 4));
    F high = _mm512_castpd_ps(_mm512_i32gather_pd(_mm512_extracti64x4_epi64((__m512i)at, 1), p, 4));
    *first = _mm512_permutex2var_ps(low, even, high);
    *second = _mm512_permutex2var_ps(low, odd, high);
}
// A patch of 8 x 8 floats in registers, two rows each: lanes that look at neighbouring pixels read it once, and a look costs a few
// permutations where a gather costs twenty cycles.
constexpr int kPatchColumns = 8, kPatchRows = 8;
struct Patch {
    F rows[4];
};
GGVS_INLINE Patch load_patch(const float* p, int64_t stride) {
    Patch patch;
#pragma GCC unroll 4
    for (int n = 0; n < 4; ++n)
        patch.rows[n] = _mm512_insertf32x8(_mm512_castps256_ps512(_mm256_loadu_ps(p + 2 * n * stride)),
                                           _mm256_loadu_ps(p + (2 * n + 1) * stride), 1);
    return patch;
}
// Where 8 * row + column lies in the lower half of the patch.
GGVS_INLINE M half_of_patch(I at) { return _mm512_test_epi32_mask((__m512i)at, _mm512_set1_epi32(32)); }
// The floats at 8 * row + column of the patch, which lie in these halves.
GGVS_INLINE F look(const Patch& patch, I at, M half) {
    const F above = _mm512_permutex2var_ps(patch.rows[0], (__m512i)at, patch.rows[1]);
    const F below = _mm512_permutex2var_ps(patch.rows[2], (__m512i)at, patch.rows[3]);
    return _mm512_mask_blend_ps(half, above, below);
}
// The smallest of each of two 16-bit numbers, over all lanes.
GGVS_INLINE uint32_t least_halves(I halves) {
    const __m256i eight = _mm256_min_epu16(_mm512_castsi512_si256((__m512i)halves), _mm512_extracti64x4_epi64((__m512i)halves, 1));
    __m128i four = _mm_min_epu16(_mm256_castsi256_si128(eight), _mm256_extracti128_si256(eight, 1));
    four = _mm_min_epu16(four, _mm_shuffle_epi32(four, 0x4e));
    return uint32_t(_mm_cvtsi128_si32(_mm_min_epu16(four, _mm_shuffle_epi32(four, 0xb1))));
}
// Whether both 16-bit numbers of all lanes are below those of `limits`.
GGVS_INLINE bool halves_below(I halves, I limits) {
    return _mm512_cmplt_epu16_mask((__m512i)halves, (__m512i)limits) == 0xffffffffu;
}
// Every four lanes side by side, the next four `row` floats further.
GGVS_INLINE void store_rows(float* p, int row, F x) {
    _mm_storeu_ps(p, _mm512_castps512_ps128(x)), _mm_storeu_ps(p + row, _mm512_extractf32x4_ps(x, 1));
    _mm_storeu_ps(p + 2 * row, _mm512_extractf32x4_ps(x, 2)), _mm_storeu_ps(p + 3 * row, _mm512_extractf32x4_ps(x, 3));
}
// Four values of every lane side by side, those of the next lane `stride` floats further, of the next four lanes `row` floats.
GGVS_INLINE void store_quads(float* p, int stride, int row, F a, F b, F c, F d) {
    const F ab[2] = {_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b)}, cd[2] = {_mm512_unpacklo_ps(c, d), _mm512_unpackhi_ps(c, d)};
#pragma GCC unroll 4
    for (int n = 0; n < 4; ++n) {  // lanes n, n + 4, n + 8, n + 12
        const __m512d left = _mm512_castps_pd(ab[n / 2]), right = _mm512_castps_pd(cd[n / 2]);
        const F quads = _mm512_castpd_ps(n % 2 ? _mm512_unpackhi_pd(left, right) : _mm512_unpacklo_pd(left, right));
        _mm_storeu_ps(p + n * stride, _mm512_castps512_ps128(quads));
        _mm_storeu_ps(p + n * stride + row, _mm512_extractf32x4_ps(quads, 1));
        _mm_storeu_ps(p + n * stride + 2 * row, _mm512_extractf32x4_ps(quads, 2));
        _mm_storeu_ps(p + n * stride + 3 * row, _mm512_extractf32x4_ps(quads, 3));
    }
}
// The first three of four values of every lane side by side.
GGVS_INLINE void load_quads(const float* p, F* a, F* b, F* c) {
    const F quarters[4] = {load(p), load(p + 16), load(p + 32), load(p + 48)};
    const auto every_fourth = [&](__m512i of_two) {
        return _mm512_shuffle_f32x4(_mm512_permutex2var_ps(quarters[0], of_two, quarters[1]),
                                    _mm512_permutex2var_ps(quarters[2], of_two, quarters[3]), 0x44);
    };
    *a = every_fourth(_mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 0, 0, 0, 0, 0, 0, 0, 0));
    *b = every_fourth(_mm512_setr_epi32(1, 5, 9, 13, 17, 21, 25, 29, 0, 0, 0, 0, 0, 0, 0, 0));
    *c = every_fourth(_mm512_setr_epi32(2, 6, 10, 14, 18, 22, 26, 30, 0, 0, 0, 0, 0, 0, 0, 0));
}
// Three values of every lane side by side, read and written.
GGVS_INLINE void load_triples(const float* p, F* a, F* b, F* c) {
    const F first = load(p), second = load(p + 16), third = load(p + 32);
    const auto every_third = [&](__m512i of_two, __m512i of_all) {
        return _mm512_permutex2var_ps(_mm512_permutex2var_ps(first, of_two, second), of_all, third);
    };
    *a = every_third(_mm512_setr_epi32(0, 3, 6, 9, 12, 15, 18, 21, 24, 27, 30, 0, 0, 0, 0, 0),
                     _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 17, 20, 23, 26, 29));
    *b = every_third(_mm512_setr_epi32(1, 4, 7, 10, 13, 16, 19, 22, 25, 28, 31, 0, 0, 0, 0, 0),
                     _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 18, 21, 24, 27, 30));
    *c = every_third(_mm512_setr_epi32(2, 5, 8, 11, 14, 17, 20, 23, 26, 29, 0, 0, 0, 0, 0, 0),
                     _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 16, 19, 22, 25, 28, 31));
}
GGVS_INLINE void store_triples(float* p, F a, F b, F c) {
    const auto woven = [&](__m512i of_two, __m512i of_all) {
        return _mm512_permutex2var_ps(_mm512_permutex2var_ps(a, of_two, b), of_all, c);
    };
    store(p, woven(_mm512_setr_epi32(0, 16, 0, 1, 17, 0, 2, 18, 0, 3, 19, 0, 4, 20, 0, 5),
                   _mm512_setr_epi32(0, 1, 16, 3, 4, 17, 6, 7, 18, 9, 10, 19, 12, 13, 20, 15)));
    store(p + 16, woven(_mm512_setr_epi32(21, 0, 6, 22, 0, 7, 23, 0, 8, 24, 0, 9, 25, 0, 10, 26),
                        _mm512_setr_epi32(0, 21, 2, 3, 22, 5, 6, 23, 8, 9, 24, 11, 12, 25, 14, 15)));
    store(p + 32, woven(_mm512_setr_epi32(0, 11, 27, 0, 12, 28, 0, 13, 29, 0, 14, 30, 0, 15, 31, 0),
                        _mm512_setr_epi32(26, 1, 2, 27, 4, 5, 28, 7, 8, 29, 10, 11, 30, 13, 14, 31)));
}
// Sixteen bytes from any address, four by four: reads of whole lanes and a transposition, where gathers read every four alone.
GGVS_INLINE void gather_quads(const uint8_t* p, I at, I (&quads)[4]) {
    alignas(64) int32_t from[16];
    store(from, at);
    const auto lane = [&](int n) { return _mm_loadu_si128((const __m128i*)(p + from[n])); };
    __m512i rows[4];  // lanes n, n + 4, n + 8, n + 12
#pragma GCC unroll 4
    for (int n = 0; n < 4; ++n) {
        rows[n] = _mm512_inserti32x4(_mm512_castsi128_si512(lane(n)), lane(n + 4), 1);
        rows[n] = _mm512_inserti32x4(_mm512_inserti32x4(rows[n], lane(n + 8), 2), lane(n + 12), 3);
    }
    const __m512i low[2] = {_mm512_unpacklo_epi32(rows[0], rows[1]), _mm512_unpacklo_epi32(rows[2], rows[3])};
    const __m512i high[2] = {_mm512_unpackhi_epi32(rows[0], rows[1]), _mm512_unpackhi_epi32(rows[2], rows[3])};
    quads[0] = (I)_mm512_unpacklo_epi64(low[0], low[1]), quads[1] = (I)_mm512_unpackhi_epi64(low[0], low[1]);
    quads[2] = (I)_mm512_unpacklo_epi64(high[0], high[1]), quads[3] = (I)_mm512_unpackhi_epi64(high[0], high[1]);
}
// Three bytes of every lane side by side, and a fourth that is 0: four bytes behind them are read.
GGVS_INLINE I load_byte_triples(const uint8_t* p) {
    const __m128i spread = _mm_setr_epi8(0, 1, 2, -1, 3, 4, 5, -1, 6, 7, 8, -1, 9, 10, 11, -1);
    const auto quarter = [p](int n) { return _mm_loadu_si128((const __m128i*)(p + 12 * n)); };
    __m512i quarters = _mm512_inserti32x4(_mm512_castsi128_si512(quarter(0)), quarter(1), 1);
    quarters = _mm512_inserti32x4(_mm512_inserti32x4(quarters, quarter(2), 2), quarter(3), 3);
    return (I)_mm512_shuffle_epi8(quarters, _mm512_broadcast_i32x4(spread));
}
GGVS_INLINE I gather_bytes(const uint8_t* p, I at) { return (I)_mm512_i32gather_epi32((__m512i)at, p, 1); }

}  // namespace ggvs::GGVS_LEVEL

#include "simd_halves.hpp"
