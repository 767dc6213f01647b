// The refiner's arithmetic, written once for every instruction set (included by level_*.cpp after compose_simd.hpp).
#pragma once
#include "refine.hpp"

namespace ggvs::GGVS_LEVEL {

constexpr float kDepthGain = 20.0f, kContrastGain = 4.0f;

GGVS_INLINE F limited(F x) { return min(max(x, all(-1.0f)), all(1.0f)); }

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
