// The refiner's arithmetic, written once for every instruction set (included by level_*.cpp after compose_simd.hpp).
// The U-Net before it uses the same convolutions.
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

constexpr int kLineFloats = 16;    // of the cache
constexpr int kAheadChannels = 2;  // are fetched before they are wanted

// kOutputs outputs from `first` on, of kPackets packets of pixels from x on, all in registers.
template <int kSize, int kOutputs, int kPackets>
GGVS_INLINE void convolve_packets(const ConvolvedRow& row, int first, int x, bool leaky) {
    F sums[kOutputs][kPackets];
#pragma GCC unroll 16
    for (int o = 0; o < kOutputs; ++o)
#pragma GCC unroll 4
        for (int n = 0; n < kPackets; ++n) sums[o][n] = all(row.layer.bias[first + o]);
    const float* weights = row.layer.weights + first;
    for (int channel = 0; channel < row.layer.before; ++channel) {
        for (int down = 0; down < kSize; ++down) {
            const float* line = row.rows[down] + channel * row.stride + x;
            // Lines of further channels lie too far apart for a processor to foresee them.
            for (int n = 0; n <= kPackets * kWidth; n += kLineFloats) __builtin_prefetch(line + kAheadChannels * row.stride + n);
#pragma GCC unroll 3
            for (int right = 0; right < kSize; ++right, weights += row.layer.padded) {
                F values[kPackets];
#pragma GCC unroll 4
                for (int n = 0; n < kPackets; ++n) values[n] = load(line + right + n * kWidth);
#pragma GCC unroll 16
                for (int o = 0; o < kOutputs; ++o) {
                    F weight = all(weights[o]);
#pragma GCC unroll 4
                    for (int n = 0; n < kPackets; ++n) sums[o][n] = multiply_add(values[n], weight, sums[o][n]);
                }
            }
        }
    }
#pragma GCC unroll 16
    for (int o = 0; o < kOutputs; ++o)
#pragma GCC unroll 4
        for (int n = 0; n < kPackets; ++n) {
            F sum = sums[o][n];
            if (leaky) sum = max(sum, all(0.1f) * sum);
            store(row.out + (first + o) * row.stride + x + n * kWidth, sum);
        }
}

template <int kSize>
GGVS_INLINE void convolve(const ConvolvedRow& row, bool leaky) {
    // As many sums as registers hold beside the packets that are read.
    constexpr int kOutputs = kWidth == 16 ? 8 : 4, kPackets = kWidth == 4 ? 2 : 3;
    for (int first = 0; first < row.layer.after; first += kOutputs) {
        int x = 0;
        for (; x + kPackets * kWidth < row.count + kWidth; x += kPackets * kWidth)
            convolve_packets<kSize, kOutputs, kPackets>(row, first, x, leaky);
        for (; x + 2 * kWidth < row.count + kWidth; x += 2 * kWidth) convolve_packets<kSize, kOutputs, 2>(row, first, x, leaky);
        for (; x < row.count; x += kWidth) convolve_packets<kSize, kOutputs, 1>(row, first, x, leaky);
    }
}

static void look_row(const ConvolvedRow& row) { convolve<3>(row, true); }

static void taps_row(const ConvolvedRow& row) { convolve<1>(row, false); }

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
