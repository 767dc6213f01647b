// Four lanes in the compiler's vector extension: SSE2 on x86-64, NEON on aarch64, scalar code elsewhere.
// The three simd_*.hpp offer the same names; the kernels are written once against them.
#pragma once
#include <cstdint>

#define GGVS_LEVEL baseline
#define GGVS_INLINE static inline __attribute__((always_inline))

namespace ggvs::GGVS_LEVEL {

constexpr int kWidth = 4;
using F = float __attribute__((vector_size(16)));
using I = int32_t __attribute__((vector_size(16)));
using M = I;  // all bits of a lane set = true

GGVS_INLINE F all(float x) { return F{x, x, x, x}; }
GGVS_INLINE I all(int32_t x) { return I{x, x, x, x}; }
GGVS_INLINE F load(const float* p) {
    F x;
    __builtin_memcpy(&x, p, sizeof x);
    return x;
}
GGVS_INLINE I load(const int32_t* p) {
    I x;
    __builtin_memcpy(&x, p, sizeof x);
    return x;
}
GGVS_INLINE void store(float* p, F x) { __builtin_memcpy(p, &x, sizeof x); }
GGVS_INLINE void store(int32_t* p, I x) { __builtin_memcpy(p, &x, sizeof x); }

GGVS_INLINE M less(F a, F b) { return a < b; }
GGVS_INLINE M at_most(F a, F b) { return a <= b; }
GGVS_INLINE M at_most(I a, I b) { return a <= b; }
// 0 <= x < limit, by bits: -0 is outside.
GGVS_INLINE M within(F x, float limit) { return ((I)x >= 0) & ((I)x < (I)all(limit)); }
GGVS_INLINE M both(M a, M b) { return a & b; }
GGVS_INLINE M either(M a, M b) { return a | b; }
GGVS_INLINE M but_not(M a, M b) { return a & ~b; }
GGVS_INLINE M no_lanes() { return I{0, 0, 0, 0}; }
GGVS_INLINE bool any(M m) {
    int64_t halves[2];
    __builtin_memcpy(halves, &m, sizeof m);
    return (halves[0] | halves[1]) != 0;
}
GGVS_INLINE I bits(F x) { return (I)x; }
GGVS_INLINE F from_bits(I x) { return (F)x; }
GGVS_INLINE F select(M m, F a, F b) { return from_bits((m & bits(a)) | (~m & bits(b))); }
GGVS_INLINE I select(M m, I a, I b) { return (m & a) | (~m & b); }
// x in the lanes of the mask, 0 in the others.
GGVS_INLINE F keep(M m, F x) { return from_bits(m & bits(x)); }
GGVS_INLINE F min(F a, F b) { return a < b ? a : b; }
GGVS_INLINE F max(F a, F b) { return a > b ? a : b; }
// a b + c, rounded once. Without an instruction for it the C library computes it, with the same bits at a tenth of the speed.
GGVS_INLINE F multiply_add(F a, F b, F c) {
    return F{__builtin_fmaf(a[0], b[0], c[0]), __builtin_fmaf(a[1], b[1], c[1]), __builtin_fmaf(a[2], b[2], c[2]),
             __builtin_fmaf(a[3], b[3], c[3])};
}
// c - a b, rounded once.
GGVS_INLINE F without_product(F a, F b, F c) { return multiply_add(-a, b, c); }
GGVS_INLINE F sqrt(F x) { return F{__builtin_sqrtf(x[0]), __builtin_sqrtf(x[1]), __builtin_sqrtf(x[2]), __builtin_sqrtf(x[3])}; }
GGVS_INLINE I truncate(F x) { return __builtin_convertvector(x, I); }
GGVS_INLINE F to_float(I x) { return __builtin_convertvector(x, F); }
// Lanes in which two numbers have a bit in common.
GGVS_INLINE M share_bits(I a, I b) { return (a & b) != all(int32_t(0)); }
// A bit for every lane.
GGVS_INLINE uint32_t lanes_of(M m) { return (m[0] & 1) | (m[1] & 2) | (m[2] & 4) | (m[3] & 8); }
GGVS_INLINE int count_of(M m) { return -(m[0] + m[1] + m[2] + m[3]); }
// The chosen lanes side by side; what comes after them is written over, up to a whole vector.
GGVS_INLINE void pack(M chosen, I x, int32_t* to) {
    for (int lane = 0; lane < kWidth; ++lane) *to = x[lane], to -= chosen[lane];
}
GGVS_INLINE F gather(const float* p, I at) { return F{p[at[0]], p[at[1]], p[at[2]], p[at[3]]}; }
// Floats that lie side by side, at p[at] and p[at + 1].
GGVS_INLINE void gather_pairs(const float* p, I at, F* first, F* second) {
    *first = gather(p, at);
    *second = gather(p + 1, at);
}
// No patches: there is no permutation to look into them by.
constexpr int kPatchColumns = 0, kPatchRows = 0;
struct Patch {};
GGVS_INLINE Patch load_patch(const float*, int64_t) { return {}; }
GGVS_INLINE M half_of_patch(I) { return no_lanes(); }
GGVS_INLINE F look(const Patch&, I, M) { return all(0.0f); }
GGVS_INLINE uint32_t least_halves(I) { return 0; }
GGVS_INLINE bool halves_below(I, I) { return false; }
// Eight 16-bit numbers.
using H = int16_t __attribute__((vector_size(16)));
// The smallest one, none below 0, in every lane.
GGVS_INLINE H least_everywhere(H x) {
    H half{x[4], x[5], x[6], x[7], x[4], x[5], x[6], x[7]};
    x = x < half ? x : half;
    half = H{x[2], x[3], x[2], x[3], x[2], x[3], x[2], x[3]};
    x = x < half ? x : half;
    return H{} + (x[0] < x[1] ? x[0] : x[1]);
}
// Of lanes n and n + 8, where there are so many, the larger one, of these eight the smallest one; numbers below 0 come last.
GGVS_INLINE int least_of_larger(H x) {
    uint16_t least = uint16_t(x[0]);
    for (int n = 1; n < 8; ++n) least = uint16_t(x[n]) < least ? uint16_t(x[n]) : least;
    return least;
}
// What lies one lane before b, and one behind a, where b follows a.
GGVS_INLINE H between(H, H) { return H{}; }
#if defined(__clang__)
GGVS_INLINE H lanes_before(H a, H, H b) { return __builtin_shufflevector(a, b, 7, 8, 9, 10, 11, 12, 13, 14); }
GGVS_INLINE H lanes_after(H a, H, H b) { return __builtin_shufflevector(a, b, 1, 2, 3, 4, 5, 6, 7, 8); }
#else
GGVS_INLINE H lanes_before(H a, H, H b) { return __builtin_shuffle(a, b, H{7, 8, 9, 10, 11, 12, 13, 14}); }
GGVS_INLINE H lanes_after(H a, H, H b) { return __builtin_shuffle(a, b, H{1, 2, 3, 4, 5, 6, 7, 8}); }
#endif
// Bytes a - b, at least 0.
using B = uint8_t __attribute__((vector_size(16)));
GGVS_INLINE B excess(B a, B b) { return (a > b ? a : b) - b; }
// Every four lanes side by side, the next four `row` floats further.
GGVS_INLINE void store_rows(float* p, int, F x) { store(p, x); }
// Four values of every lane side by side, those of the next lane `stride` floats further, of the next four lanes `row` floats.
GGVS_INLINE void store_quads(float* p, int stride, int, F a, F b, F c, F d) {
    for (int lane = 0; lane < kWidth; ++lane) store(p + lane * stride, F{a[lane], b[lane], c[lane], d[lane]});
}
// The same read: the first three of four values.
GGVS_INLINE void load_quads(const float* p, F* a, F* b, F* c) {
    *a = F{p[0], p[4], p[8], p[12]}, *b = F{p[1], p[5], p[9], p[13]}, *c = F{p[2], p[6], p[10], p[14]};
}
// Three values of every lane side by side, read and written.
GGVS_INLINE void load_triples(const float* p, F* a, F* b, F* c) {
    *a = F{p[0], p[3], p[6], p[9]}, *b = F{p[1], p[4], p[7], p[10]}, *c = F{p[2], p[5], p[8], p[11]};
}
GGVS_INLINE void store_triples(float* p, F a, F b, F c) {
    store(p, F{a[0], b[0], c[0], a[1]}), store(p + 4, F{b[1], c[1], a[2], b[2]}), store(p + 8, F{c[2], a[3], b[3], c[3]});
}
// Sixteen bytes from any address, four by four.
GGVS_INLINE void gather_quads(const uint8_t* p, I at, I (&quads)[4]) {
    int32_t lanes[4][kWidth];
    for (int lane = 0; lane < kWidth; ++lane)
        for (int n = 0; n < 4; ++n) __builtin_memcpy(&lanes[n][lane], p + at[lane] + 4 * n, sizeof(int32_t));
    for (int n = 0; n < 4; ++n) quads[n] = load(lanes[n]);
}
// Three bytes of every lane side by side, and any fourth: four bytes behind them are read.
GGVS_INLINE I load_byte_triples(const uint8_t* p) {
    int32_t lanes[kWidth];
    for (int lane = 0; lane < kWidth; ++lane) __builtin_memcpy(lanes + lane, p + 3 * lane, sizeof(int32_t));
    return load(lanes);
}
// Four bytes from any address.
GGVS_INLINE I gather_bytes(const uint8_t* p, I at) {
    int32_t lanes[kWidth];
    for (int lane = 0; lane < kWidth; ++lane) __builtin_memcpy(lanes + lane, p + at[lane], sizeof(int32_t));
    return load(lanes);
}

}  // namespace ggvs::GGVS_LEVEL
