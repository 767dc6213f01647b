// The refiner's arithmetic, written once for every instruction set (included by level_*.cpp after compose_simd.hpp).
#pragma once
#include "refine.hpp"

namespace ggvs::GGVS_LEVEL {

constexpr float kDepthGain = 20.0f, kContrastGain = 4.0f;

GGVS_INLINE F limited(F x) { return min(max(x, all(-1.0f)), all(1.0f)); }

// Of positive floats, but for those below 2^-126: to their last bit or nearly so (the polynomial is that of Moshier's logf).
GGVS_INLINE F logarithm_of(F x) {
    constexpr float kCoefficients[] = {-1.1514610310e-1f, 1.1676998740e-1f, -1.2420140846e-1f, 1.4249322787e-1f,
                                       -1.6668057665e-1f, 2.0000714765e-1f, -2.4999993993e-1f, 3.3333331174e-1f};
    const I root_half = all(int32_t(0x3f3504f3)), exponent = (bits(x) - root_half) >> 23;
    const F f = from_bits(bits(x) - (exponent << 23)) - all(1.0f), e = to_float(exponent), square = f * f;
    F p = all(7.0376836292e-2f);
    for (const float coefficient : kCoefficients) p = multiply_add(p, f, all(coefficient));
    const F rest = multiply_add(e, all(-2.12194440e-4f), square * (f * p));  // the logarithm of 2 in two parts
    return multiply_add(e, all(0.693359375f), f + multiply_add(all(-0.5f), square, rest));
}

// The logarithms of known depths and whether they are known; 0 for both where they are not.
static void logarithm_row(const float* depth, int count, float* logarithm, float* known) {
    const F zero = all(0.0f), one = all(1.0f);
    for (int x = 0; x < count; x += kWidth) {
        const int left = count - x < kWidth ? count - x : kWidth;
        const F here = load_part(depth + x, left);
        const M there = less(zero, here);
        store_part(logarithm + x, select(there, logarithm_of(select(there, here, one)), zero), left);
        store_part(known + x, select(there, one, zero), left);
    }
}

// Sums, largest and smallest values of each column of the window.
GGVS_INLINE void column_statistics(const EvidenceRow& row, int x) {
    F sum = all(0.0f), known = sum;
    F high5 = load(row.logarithms[0] + x), low5 = high5, high3 = load(row.logarithms[1] + x), low3 = high3;
    F light = load(row.grey[0] + x), dark = light;
    for (int n = 0; n < 5; ++n) {
        F value = load(row.logarithms[n] + x), there = load(row.known[n] + x);
        sum = sum + value * there, known = known + there;
        high5 = max(high5, value), low5 = min(low5, value);
        if (n > 0 && n < 4) high3 = max(high3, value), low3 = min(low3, value);
    }
    for (int n = 1; n < 3; ++n) light = max(light, load(row.grey[n] + x)), dark = min(dark, load(row.grey[n] + x));
    const F lines[8] = {sum, known, high5, low5, high3, low3, light, dark};
    for (int n = 0; n < 8; ++n) store(row.scratch + n * row.stride + x, lines[n]);
}

GGVS_INLINE F sum5(const float* line) { return load(line) + load(line + 1) + load(line + 2) + load(line + 3) + load(line + 4); }
GGVS_INLINE F highest3(const float* line) { return max(max(load(line), load(line + 1)), load(line + 2)); }
GGVS_INLINE F lowest3(const float* line) { return min(min(load(line), load(line + 1)), load(line + 2)); }
GGVS_INLINE F range3(const float* high, const float* low) { return highest3(high) - lowest3(low); }

GGVS_INLINE F range5(const float* high, const float* low) {
    F highest = max(highest3(high), max(load(high + 3), load(high + 4)));
    return highest - min(lowest3(low), min(load(low + 3), load(low + 4)));
}

static void evidence_row(const EvidenceRow& row) {
    const int64_t stride = row.stride;
    for (int x = 0; x < row.count + 4; x += kWidth) column_statistics(row, x);
    for (int x = 0; x < row.count; x += kWidth) {
        const float* line = row.scratch + x;
        F mean = sum5(line) / max(sum5(line + stride), all(1.0f));
        F relief = (load(row.logarithms[2] + x + 2) - mean) * load(row.known[2] + x + 2);
        store(row.out + x, limited(all(kDepthGain) * relief));
        store(row.out + stride + x, limited(all(kDepthGain) * range3(line + 4 * stride + 1, line + 5 * stride + 1)));
        store(row.out + 2 * stride + x, limited(all(kDepthGain / 2) * range5(line + 2 * stride, line + 3 * stride)));
        store(row.out + 3 * stride + x, limited(all(kContrastGain) * range3(line + 6 * stride + 1, line + 7 * stride + 1)));
    }
}

// Every pixel plus its differences to its neighbours, weighted by its own taps; limited to [0, 1].
static void filter_row(const FilteredRow& row) {
    constexpr int kDown[kTaps] = {-2, -1, -1, -1, 0, 0, 0, 0, 1, 1, 1, 2};
    constexpr int kRight[kTaps] = {0, -1, 0, 1, -2, -1, 1, 2, -1, 0, 1, 0};
    for (int x = 0; x < row.count; x += kWidth) {
        F colours[3];
        for (int c = 0; c < 3; ++c) {
            const float* at = row.picture[c] + x;
            F own = load(at), sum = own;
            for (int tap = 0; tap < kTaps; ++tap) {
                F neighbour = load(at + kDown[tap] * row.stride + kRight[tap]);
                sum = multiply_add(load(row.taps + tap * row.stride + x), neighbour - own, sum);
            }
            colours[c] = min(max(sum, all(0.0f)), all(1.0f));
        }
        const int left = row.count - x;
        store_colour(row.out + 3 * x, {colours[0], colours[1], colours[2]}, left < kWidth ? left : kWidth);
    }
}

}  // namespace ggvs::GGVS_LEVEL
