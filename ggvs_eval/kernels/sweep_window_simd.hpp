// The windows of the plane sweep: their weights and their correlation, once for every instruction set (included by stereo_*.cpp
// after a simd_*.hpp).
#pragma once
#include "plane_sweep.hpp"

namespace ggvs::GGVS_LEVEL {

GGVS_INLINE int clamp_index(int x, int last) { return x < 0 ? 0 : x > last ? last : x; }

// 1 / sqrt(x) to about 1e-6 by multiplications only: a third of the time, and the same bits everywhere.
GGVS_INLINE F inverse_root(F x) {
    F y = from_bits(all(int32_t(0x5f375a86)) - (bits(x) >> 1)), half = all(0.5f) * x;
    y = y * (all(1.5f) - half * y * y);
    y = y * (all(1.5f) - half * y * y);
    return y * (all(1.5f) - half * y * y);
}

// Grey values and colours of the tile with its border; beyond the image the nearest pixels are repeated.
static void load_pixels(const SweepTask& task, const Tile& tile, SweepWorkspace& w) {
    const int radius = task.window.radius;
    for (int r = 0; r < tile.rows + 2 * radius; ++r) {
        const int64_t row = int64_t(clamp_index(tile.row + r - radius, task.height - 1)) * task.width;
        for (int x = 0; x < kTileColumns + 2 * radius; ++x) {
            const int64_t pixel = row + clamp_index(tile.column + x - radius, task.width - 1);
            w.grey[r][x] = task.reference[pixel];
            for (int c = 0; c < 3; ++c) w.colour[c][r][x] = float(task.guide[3 * pixel + c]);
        }
    }
}

// The weight falls with the distance in place as 1 / (1 + d^2), and with that in colour about as fast as a bell curve.
GGVS_INLINE F weight_of(F colour_difference, float distance) {
    F q = colour_difference;
    return all(1.0f) / ((all(1.0f) + all(0.5f) * q * (all(1.0f) + q)) * all(1.0f + distance));
}

// How much each pixel counts in the windows around pixels (r, x ...); returns the windows' mean grey.
GGVS_INLINE F weigh_window(const SweepWindow& window, int r, int x, SweepWorkspace& w) {
    const int radius = window.radius, side = 2 * radius + 1;
    const F colour_share = all(1.0f / (3.0f * window.colour_scale * window.colour_scale));
    const float distance_share = 1.0f / (window.distance_scale * window.distance_scale);
    F red = load(&w.colour[0][r + radius][x + radius]), green = load(&w.colour[1][r + radius][x + radius]);
    F blue = load(&w.colour[2][r + radius][x + radius]);
    F total = all(0.0f), sum = all(0.0f);
    for (int j = 0, tap = 0; j < side; ++j) {
        for (int i = 0; i < side; ++i, ++tap) {
            F d = load(&w.colour[0][r + j][x + i]) - red, e = load(&w.colour[1][r + j][x + i]) - green;
            F f = load(&w.colour[2][r + j][x + i]) - blue;
            const float distance = float((j - radius) * (j - radius) + (i - radius) * (i - radius)) * distance_share;
            F weight = weight_of((d * d + e * e + f * f) * colour_share, distance);
            store(&w.weights[r][tap][x], weight);
            total = total + weight;
            sum = sum + weight * load(&w.grey[r + j][x + i]);
        }
    }
    const F share = all(1.0f) / total;
    for (int tap = 0; tap < side * side; ++tap) store(&w.weights[r][tap][x], load(&w.weights[r][tap][x]) * share);
    return sum * share;
}

// All of the correlation that depends on the reference alone.
GGVS_INLINE void prepare_window(const SweepWindow& window, int r, int x, SweepWorkspace& w) {
    const int side = 2 * window.radius + 1;
    const F mean = weigh_window(window, r, x, w);
    F variance = all(0.0f);
    for (int j = 0, tap = 0; j < side; ++j) {
        for (int i = 0; i < side; ++i, ++tap) {
            F weight = load(&w.weights[r][tap][x]), difference = load(&w.grey[r + j][x + i]) - mean;
            store(&w.contrast[r][tap][x], weight * difference);
            variance = variance + weight * difference * difference;
        }
    }
    store(&w.scale[r][x], inverse_root(variance + all(window.noise)));
}

// Correlations of two vectors of neighbouring pixels with what lies in w.warped.
GGVS_INLINE void correlate(const SweepWindow& window, const SweepWorkspace& w, int r, int x, F* score) {
    const int side = 2 * window.radius + 1;
    F mean0 = all(0.0f), mean1 = mean0, square0 = mean0, square1 = mean0, product0 = mean0, product1 = mean0;
    const float* weights = &w.weights[r][0][x];
    const float* contrast = &w.contrast[r][0][x];
    for (int j = 0; j < side; ++j) {
        const float* warped = &w.warped[r + j][x];
        for (int i = 0; i < side; ++i, weights += kTileColumns, contrast += kTileColumns) {
            F value0 = load(warped + i), value1 = load(warped + i + kWidth);
            F weighted0 = value0 * load(weights), weighted1 = value1 * load(weights + kWidth);
            mean0 = mean0 + weighted0, mean1 = mean1 + weighted1;
            square0 = square0 + weighted0 * value0, square1 = square1 + weighted1 * value1;
            product0 = product0 + value0 * load(contrast), product1 = product1 + value1 * load(contrast + kWidth);
        }
    }
    F variance0 = max(square0 - mean0 * mean0, all(0.0f)) + all(window.noise);
    F variance1 = max(square1 - mean1 * mean1, all(0.0f)) + all(window.noise);
    score[0] = product0 * load(&w.scale[r][x]) * inverse_root(variance0);
    score[1] = product1 * load(&w.scale[r][x + kWidth]) * inverse_root(variance1);
}

}  // namespace ggvs::GGVS_LEVEL
