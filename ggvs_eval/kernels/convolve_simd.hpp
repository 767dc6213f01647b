// The convolutions' arithmetic, written once for every instruction set (included by level_*.cpp after a simd_*.hpp).
#pragma once
#include "convolve.hpp"
#include "minimal_filtering_simd.hpp"

namespace ggvs::GGVS_LEVEL {

// As many sums as registers hold beside the packets that are read.
constexpr int kSumOutputs = kWidth == 16 ? 8 : 4, kSumPackets = kWidth == 4 ? 2 : 3;
constexpr int kCacheLine = 16;     // floats
constexpr int kAheadChannels = 2;  // are fetched before they are wanted

// Adds to some packets of some outputs what kSize neighbours along the lines of all channels give them.
template <int kSize, int kOutputs, int kPackets>
GGVS_INLINE void add_lines(const float* line, int64_t stride, int channels, const float* weights, int padded,
                           F (&sums)[kOutputs][kPackets]) {
    for (int channel = 0; channel < channels; ++channel, line += stride) {
#pragma GCC unroll 3
        for (int right = 0; right < kSize; ++right, weights += padded) {
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

// Calls job(x, packets) for all columns, as many packets at once as may be; `packets` is a constant.
template <class Job>
GGVS_INLINE void for_packets(int count, const Job& job) {
    int x = 0;
    for (; x + kSumPackets * kWidth < count + kWidth; x += kSumPackets * kWidth) job(x, std::integral_constant<int, kSumPackets>());
    for (; x + 2 * kWidth < count + kWidth; x += 2 * kWidth) job(x, std::integral_constant<int, 2>());
    for (; x < count; x += kWidth) job(x, std::integral_constant<int, 1>());
}

// Some packets of kSumOutputs outputs from `first` on.
template <int kPackets>
GGVS_INLINE void convolve_packets(const ConvolvedRow& row, int first, int x) {
    const Layer& layer = row.layer;
    F sums[kSumOutputs][kPackets];
#pragma GCC unroll 16
    for (int o = 0; o < kSumOutputs; ++o)
#pragma GCC unroll 4
        for (int n = 0; n < kPackets; ++n) sums[o][n] = all(layer.bias[first + o]);
    add_lines<1>(row.row + x, row.stride, layer.before, layer.weights + first, layer.padded, sums);
#pragma GCC unroll 16
    for (int o = 0; o < kSumOutputs; ++o)
#pragma GCC unroll 4
        for (int n = 0; n < kPackets; ++n) store(row.out + (first + o) * row.stride + x + n * kWidth, sums[o][n]);
}

static void convolve_row(const ConvolvedRow& row) {
    for_packets(row.count, [&](int x, auto packets) {
        for (int first = 0; first < row.layer.after; first += kSumOutputs) convolve_packets<packets>(row, first, x);
    });
}

// What the six sums are taken of, made of six rows.
GGVS_INLINE void write_sources(const float* const (&rows)[kStripSources], int64_t at, float* out, int64_t stride) {
    const F neighbours[kStripSources] = {load(rows[0] + at), load(rows[1] + at), load(rows[2] + at),
                                         load(rows[3] + at), load(rows[4] + at), load(rows[5] + at)};
    F sources[kStripSources];
    make_sources(neighbours, sources);
#pragma GCC unroll 6
    for (int n = 0; n < kStripSources; ++n) store(out + n * stride, sources[n]);
}

// The four rows that six sums, `stride` apart, stand for.
GGVS_INLINE void write_rows(const F* parts, int stride, bool leaky, float* const (&out)[kStripRows], int64_t at) {
    const F sums[kStripSources] = {parts[0],          parts[stride],     parts[2 * stride],
                                   parts[3 * stride], parts[4 * stride], parts[5 * stride]};
    F rows[kStripRows];
    make_values(sums, rows);
#pragma GCC unroll 4
    for (int n = 0; n < kStripRows; ++n) store(out[n] + at, leaky ? max(rows[n], all(0.1f) * rows[n]) : rows[n]);
}

// Some packets of kSumOutputs outputs from `first` on.
template <int kPackets>
GGVS_INLINE void convolve_packets(const ConvolvedStrip& strip, int first, int x, bool leaky) {
    constexpr int kSums = kSumOutputs * kPackets;
    const Layer& layer = strip.layer;
    const int64_t source = int64_t(layer.before) * kStripLine, step = group_size(layer.before) / kStripSources;
    const float* weights = layer.weights + first / kGroupOutputs * group_size(layer.before) + first % kGroupOutputs;
    F parts[kStripSources * kSums];
    for (int part = 0; part < kStripSources; ++part) {
        F sums[kSumOutputs][kPackets];
#pragma GCC unroll 16
        for (int o = 0; o < kSumOutputs; ++o)
#pragma GCC unroll 4
            for (int n = 0; n < kPackets; ++n) sums[o][n] = all(part == 1 ? layer.bias[first + o] : 0.0f);  // goes into all rows
        add_lines<3>(strip.scratch + part * source, kStripLine, layer.before, weights + part * step, kGroupOutputs, sums);
#pragma GCC unroll 16
        for (int o = 0; o < kSumOutputs; ++o)
#pragma GCC unroll 4
            for (int n = 0; n < kPackets; ++n) parts[part * kSums + o * kPackets + n] = sums[o][n];
    }
    float* const out[kStripRows] = {strip.out[0], strip.out[1], strip.out[2], strip.out[3]};
    const int64_t stride = strip.stride;
    for (int o = 0; o < kSumOutputs; ++o)
#pragma GCC unroll 4
        for (int n = 0; n < kPackets; ++n)
            write_rows(parts + o * kPackets + n, kSums, leaky, out, (first + o) * stride + x + n * kWidth);
}

// What the packets from column x on, and the one behind them, are filtered from; the first is the one behind those before.
template <int kPackets>
GGVS_INLINE void fill_scratch(const ConvolvedStrip& strip, int x) {
    const float* const rows[kStripSources] = {strip.sources[0], strip.sources[1], strip.sources[2],
                                              strip.sources[3], strip.sources[4], strip.sources[5]};
    const int64_t stride = strip.stride, source = int64_t(strip.layer.before) * kStripLine;
    for (int channel = 0; channel < strip.layer.before; ++channel) {
        float* to = strip.scratch + channel * kStripLine;
        const int64_t at = channel * stride + x;
        // Lines of further channels lie too far apart for a processor to foresee them.
        const int64_t ahead = at + kAheadChannels * stride + kWidth;
        for (int row = 0; row < kStripSources; ++row)
            for (int n = 0; n < kPackets * kWidth; n += kCacheLine) __builtin_prefetch(rows[row] + ahead + n);
        if (x > 0) {
            for (int row = 0; row < kStripSources; ++row) store(to + row * source, load(to + row * source + kSumPackets * kWidth));
        } else {
            write_sources(rows, at, to, source);
        }
#pragma GCC unroll 4
        for (int n = 1; n <= kPackets; ++n) write_sources(rows, at + n * kWidth, to + n * kWidth, source);
    }
}

GGVS_INLINE void convolve(const ConvolvedStrip& strip, bool leaky) {
    for_packets(strip.count, [&](int x, auto packets) {
        fill_scratch<packets>(strip, x);
        for (int first = 0; first < strip.layer.after; first += kSumOutputs) convolve_packets<packets>(strip, first, x, leaky);
    });
}

static void convolve_strip(const ConvolvedStrip& strip) { convolve(strip, false); }

static void look_strip(const ConvolvedStrip& strip) { convolve(strip, true); }

}  // namespace ggvs::GGVS_LEVEL
