// The U-Net's arithmetic beside the convolutions (included by level_*.cpp after register_simd.hpp, whose names it uses).
// Sums are kept in 16 lanes whatever the vectors' size, and added up in one order.
#pragma once
#include "unet.hpp"

namespace ggvs::GGVS_LEVEL {

static Moments moments_of_row(const float* row, int64_t stride, int width, int channels) {
    constexpr int kSums = 16 / kWidth;
    F sums[kSums], squares[kSums];
    for (int n = 0; n < kSums; ++n) sums[n] = squares[n] = all(0.0f);
    for (int channel = 0; channel < channels; ++channel, row += stride) {
        for (int x = 0; x < width; x += kWidth) {
            const int n = x / kWidth % kSums;
            F value = load_part(row + 1 + x, width - x < kWidth ? width - x : kWidth);
            sums[n] = sums[n] + value;
            squares[n] = squares[n] + value * value;
        }
    }
    alignas(64) float lanes[2][16];
    for (int n = 0; n < kSums; ++n) store(lanes[0] + n * kWidth, sums[n]), store(lanes[1] + n * kWidth, squares[n]);
    Moments moments{0.0, 0.0};
    for (int lane = 0; lane < 16; ++lane) moments.sum += double(lanes[0][lane]), moments.squares += double(lanes[1][lane]);
    return moments;
}

static void normalise_row(const NormalisedRow& job) {
    for (int channel = 0; channel < job.channels; ++channel) {
        float* line = job.row + channel * job.stride + 1;
        const F gain = all(job.gain[channel]), shift = all(job.shift[channel]);
        for (int x = 0; x < job.width; x += kWidth) store(line + x, max(load(line + x) * gain + shift, all(0.0f)));
        line[-1] = line[1];
        line[job.width] = line[job.width - 2];
    }
}

}  // namespace ggvs::GGVS_LEVEL
