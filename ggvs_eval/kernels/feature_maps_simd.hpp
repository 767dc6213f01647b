// The features' arithmetic, written once for every instruction set (included by feature_*.cpp after a simd_*.hpp).
#pragma once
#include "feature_maps.hpp"
#include "minimal_filtering_simd.hpp"

namespace ggvs::GGVS_LEVEL {

// As many sums as registers hold beside the weights: rows are tiles or pixels.
constexpr int kRows = kWidth == 16 ? 14 : 6, kVectors = 2;
static_assert(kRowsMultiple % kRows == 0);

// kRows x (kVectors * kWidth) outputs: each row's inputs, kDepthChunk at a time, times the weights of its outputs.
GGVS_INLINE void multiply_rows(const float* rows, int64_t chunk_step, int depth, const float* weights, float* out, int64_t out_step) {
    F sums[kRows][kVectors];
#pragma GCC unroll 16
    for (int r = 0; r < kRows; ++r)
#pragma GCC unroll 2
        for (int n = 0; n < kVectors; ++n) sums[r][n] = all(0.0f);
    for (int first = 0; first < depth; first += kDepthChunk, rows += chunk_step) {
        const int count = depth - first < kDepthChunk ? depth - first : kDepthChunk;
        for (int c = 0; c < count; ++c, weights += kPanel) {
            F weight[kVectors];
#pragma GCC unroll 2
            for (int n = 0; n < kVectors; ++n) weight[n] = load(weights + n * kWidth);
#pragma GCC unroll 16
            for (int r = 0; r < kRows; ++r) {
                const F value = all(rows[r * kDepthChunk + c]);
#pragma GCC unroll 2
                for (int n = 0; n < kVectors; ++n) sums[r][n] = multiply_add(value, weight[n], sums[r][n]);
            }
        }
    }
#pragma GCC unroll 16
    for (int r = 0; r < kRows; ++r)
#pragma GCC unroll 2
        for (int n = 0; n < kVectors; ++n) store(out + r * out_step + n * kWidth, sums[r][n]);
}

// The product of `count` rows with weights (after / kPanel, depth, kPanel); panels first, so that their weights stay in cache.
static void multiply(const Block& block, const float* rows, int count, int depth, const float* weights, float* out, int after) {
    const int64_t chunk_step = int64_t(block.rows) * kDepthChunk;
    for (int panel = 0; panel < after; panel += kPanel, weights += int64_t(depth) * kPanel)
        for (int part = 0; part < kPanel; part += kVectors * kWidth)
            for (int row = 0; row < count; row += kRows)
                multiply_rows(rows + int64_t(row) * kDepthChunk, chunk_step, depth, weights + part,
                              out + int64_t(row) * after + panel + part, after);
}

// The 36 sources of a tile, a matrix apart.
GGVS_INLINE void read_tile(const float* corner, int64_t row, int channels, const Block& block, float* to) {
    for (int c = 0; c < channels; c += kWidth) {
        F down[6][6];  // of each column
#pragma GCC unroll 6
        for (int x = 0; x < 6; ++x) {
            F d[6];
#pragma GCC unroll 6
            for (int y = 0; y < 6; ++y) d[y] = load(corner + y * row + int64_t(x) * channels + c);
            make_sources(d, down[x]);
        }
        float* at = to + c / kDepthChunk * int64_t(block.rows) * kDepthChunk + c % kDepthChunk;
#pragma GCC unroll 6
        for (int y = 0; y < 6; ++y) {
            const F d[6] = {down[0][y], down[1][y], down[2][y], down[3][y], down[4][y], down[5][y]};
            F s[6];
            make_sources(d, s);
#pragma GCC unroll 6
            for (int x = 0; x < 6; ++x, at += block.source_step) store(at, s[x]);
        }
    }
}

// A tile's pixels, ReLU included, and their maxima of 2 x 2, from its 36 sums.
GGVS_INLINE void write_tile(const TileJob& job, const float* sums, int y0, int x0) {
    const int channels = job.layer.after, rows = job.out.height - y0 < kTile ? job.out.height - y0 : kTile;
    const int columns = job.out.width - x0 < kTile ? job.out.width - x0 : kTile;
    float* out = job.out.data + y0 * job.out.row + int64_t(x0) * channels;
    float* halved = job.halved.data ? job.halved.data + y0 / 2 * job.halved.row + int64_t(x0 / 2) * channels : nullptr;
    for (int c = 0; c < channels; c += kWidth) {
        F down[6][4];  // of each column
#pragma GCC unroll 6
        for (int x = 0; x < 6; ++x) {
            F s[6];
#pragma GCC unroll 6
            for (int y = 0; y < 6; ++y) s[y] = load(sums + (6 * y + x) * job.block.sums_step + c);
            make_values(s, down[x]);
        }
        const F bias = load(job.layer.bias + c), zero = all(0.0f);
        F pixels[4][4];
#pragma GCC unroll 4
        for (int y = 0; y < 4; ++y) {
            const F s[6] = {down[0][y], down[1][y], down[2][y], down[3][y], down[4][y], down[5][y]};
            make_values(s, pixels[y]);
#pragma GCC unroll 4
            for (int x = 0; x < 4; ++x) pixels[y][x] = max(pixels[y][x] + bias, zero);
        }
#pragma GCC unroll 4
        for (int y = 0; y < 4; ++y)
#pragma GCC unroll 4
            for (int x = 0; x < 4; ++x)
                if (y < rows && x < columns) store(out + y * job.out.row + int64_t(x) * channels + c, pixels[y][x]);
        if (!halved) continue;
#pragma GCC unroll 2
        for (int y = 0; y < 4; y += 2)
#pragma GCC unroll 2
            for (int x = 0; x < 4; x += 2)
                if (y + 1 < rows && x + 1 < columns)
                    store(halved + y / 2 * job.halved.row + int64_t(x / 2) * channels + c,
                          max(max(pixels[y][x], pixels[y][x + 1]), max(pixels[y + 1][x], pixels[y + 1][x + 1])));
    }
}

static void filter_tiles(const TileJob& job) {
    const FeatureLayer& layer = job.layer;
    const Block& block = job.block;
    float *sources = job.memory, *sums = job.memory + kTileSums * block.source_step;
    const int columns = job.source.tile_columns;
    for (int n = 0; n < job.count; ++n) {
        const int y0 = (job.first + n) / columns * kTile, x0 = (job.first + n) % columns * kTile;
        read_tile(job.source.pixel(y0 - 1, x0 - 1), job.source.row, layer.before, block,
                  sources + n * int64_t(kDepthChunk));
    }
    const int64_t weights = int64_t(layer.before) * layer.after;
    for (int part = 0; part < kTileSums; ++part)
        multiply(block, sources + part * block.source_step, job.count, layer.before, layer.weights + part * weights,
                 sums + part * block.sums_step, layer.after);
    for (int n = 0; n < job.count; ++n) {
        const int y0 = (job.first + n) / columns * kTile, x0 = (job.first + n) % columns * kTile;
        write_tile(job, sums + int64_t(n) * layer.after, y0, x0);
    }
}

static void filter_colours(const ColourJob& job) {
    const FeatureLayer& layer = job.layer;
    float *rows = job.memory, *sums = job.memory + job.block.source_step;
    for (int n = 0; n < job.count; ++n)
        for (int down = 0; down < 3; ++down) {
            const float* from = job.source.pixel(job.y + down - 1, job.first + n - 1);
            for (int tap = 0; tap < 3 * kColours; ++tap) rows[n * int64_t(kDepthChunk) + down * 3 * kColours + tap] = from[tap];
        }
    multiply(job.block, rows, job.count, kColourTaps, layer.weights, sums, layer.after);
    float* out = job.out.data + job.y * job.out.row + int64_t(job.first) * layer.after;
    for (int n = 0; n < job.count; ++n)
        for (int c = 0; c < layer.after; c += kWidth) {
            const int64_t at = int64_t(n) * layer.after + c;
            store(out + at, max(load(sums + at) + load(layer.bias + c), all(0.0f)));
        }
}

constexpr int kLaneParts = 16 / kWidth;  // sums are kept in 16 lanes whatever the vectors' size

GGVS_INLINE float total_of(const F (&sums)[kLaneParts]) {
    alignas(64) float lanes[16];
    for (int n = 0; n < kLaneParts; ++n) store(lanes + n * kWidth, sums[n]);
    for (int half = 8; half > 0; half /= 2)
        for (int lane = 0; lane < half; ++lane) lanes[lane] += lanes[lane + half];
    return lanes[0];
}

// One over the length of a vector of features.
GGVS_INLINE F inverse_length(const float* features, int channels) {
    F squares[kLaneParts];
    for (int n = 0; n < kLaneParts; ++n) squares[n] = all(0.0f);
    for (int c = 0; c < channels; c += 16)
        for (int n = 0; n < kLaneParts; ++n) {
            const F value = load(features + c + n * kWidth);
            squares[n] = multiply_add(value, value, squares[n]);
        }
    return all(1.0f / (std::sqrt(total_of(squares)) + kLeastLength));
}

static void compare_pixels(const ComparedPixels& job) {
    const float *ours = job.ours, *theirs = job.theirs;
    for (int pixel = 0; pixel < job.count; ++pixel, ours += job.channels, theirs += job.channels) {
        const F our_scale = inverse_length(ours, job.channels), their_scale = inverse_length(theirs, job.channels);
        F sums[kLaneParts];
        for (int n = 0; n < kLaneParts; ++n) sums[n] = all(0.0f);
        for (int c = 0; c < job.channels; c += 16)
            for (int n = 0; n < kLaneParts; ++n) {
                const int at = c + n * kWidth;
                const F difference = load(ours + at) * our_scale - load(theirs + at) * their_scale;
                sums[n] = multiply_add(difference * difference, load(job.weights + at), sums[n]);
            }
        job.out[pixel] = total_of(sums);
    }
}

}  // namespace ggvs::GGVS_LEVEL
