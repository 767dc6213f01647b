// Backward warping of one source image into the target view.
#include "warp.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kBandRows = 8;

// Up to four pixels of a line and their weights; the border is repeated.
struct Taps {
    int at[4];
    float weight[4];
    int count;
};

Taps linear_taps(float x, int size) {
    const float at = std::min(std::max(x - 0.5f, 0.0f), float(size - 1));
    const int first = int(at);
    const float f = at - float(first);
    return {{first, std::min(first + 1, size - 1)}, {1.0f - f, f}, 2};
}

// Catmull-Rom: interpolates, sums to 1, keeps more detail than linear interpolation.
Taps cubic_taps(float x, int size) {
    const float at = std::floor(x - 0.5f), f = x - 0.5f - at;
    Taps taps{{}, {}, 4};
    for (int n = 0; n < 4; ++n) taps.at[n] = std::min(std::max(int(at) - 1 + n, 0), size - 1);
    taps.weight[0] = f * (-0.5f + f * (1.0f - 0.5f * f));
    taps.weight[1] = 1.0f + f * f * (-2.5f + 1.5f * f);
    taps.weight[2] = f * (0.5f + f * (2.0f - 1.5f * f));
    taps.weight[3] = f * f * (-0.5f + 0.5f * f);
    return taps;
}

// Bilinear where the four neighbours belong to one surface (valid, within the tolerance), else the nearest pixel's.
float sample_depth(const WarpSource& source, float u, float v, float tolerance) {
    const int width = source.camera.width;
    const Taps x = linear_taps(u, width), y = linear_taps(v, source.camera.height);
    float low = 1e30f, high = 0.0f, mean = 0.0f;
    for (int j = 0; j < 2; ++j) {
        for (int i = 0; i < 2; ++i) {
            const float d = source.depth[int64_t(y.at[j]) * width + x.at[i]];
            low = std::min(low, d), high = std::max(high, d);
            mean += y.weight[j] * x.weight[i] * d;
        }
    }
    if (low > 0.0f && high - low < tolerance) return mean;
    return source.depth[int64_t(v) * width + int(u)];
}

float value_of(const WarpSource& source, int64_t n) {
    return source.image ? source.image[n] : float(source.now[n] - source.before[n]) / 255.0f;
}

void sample_colour(const WarpSource& source, float u, float v, bool bicubic, float* colour) {
    const Taps x = bicubic ? cubic_taps(u, source.camera.width) : linear_taps(u, source.camera.width);
    const Taps y = bicubic ? cubic_taps(v, source.camera.height) : linear_taps(v, source.camera.height);
    float sum[3] = {};
    for (int j = 0; j < y.count; ++j) {
        const int64_t row = int64_t(y.at[j]) * source.camera.width * 3;
        for (int i = 0; i < x.count; ++i) {
            const float weight = y.weight[j] * x.weight[i];
            for (int c = 0; c < 3; ++c) sum[c] += weight * value_of(source, row + 3 * x.at[i] + c);
        }
    }
    for (int c = 0; c < 3; ++c) colour[c] = bicubic ? std::min(std::max(sum[c], 0.0f), 1.0f) : sum[c];
}

}  // namespace

void warp(const Pinhole& target, const float* target_depth, const WarpSource& source, float tolerance, bool bicubic,
          float* colour, float* visibility, int threads) {
    const PixelMap map = pixel_map(target, source.from_target, source.camera, true);
    const float* m = map.matrix;
    const float width = float(source.camera.width), height = float(source.camera.height);
    parallel_for((target.height + kBandRows - 1) / kBandRows, threads, [&](int band, int) {
        const int64_t first = int64_t(band) * kBandRows * target.width;
        const int64_t last = std::min(first + int64_t(kBandRows) * target.width, int64_t(target.height) * target.width);
        for (int64_t pixel = first; pixel < last; ++pixel) {
            const float column = float(pixel % target.width) + 0.5f, row = float(pixel / target.width) + 0.5f;
            const float depth = target_depth[pixel];
            const float z = depth * (m[6] * column + m[7] * row + m[8]) + map.offset[2];
            const float u = (depth * (m[0] * column + m[1] * row + m[2]) + map.offset[0]) / z;
            const float v = (depth * (m[3] * column + m[4] * row + m[5]) + map.offset[1]) / z;
            colour[3 * pixel] = colour[3 * pixel + 1] = colour[3 * pixel + 2] = visibility[pixel] = 0.0f;
            if (!(depth > 0.0f && z > 0.0f && u >= 0.0f && u < width && v >= 0.0f && v < height)) continue;
            sample_colour(source, u, v, bicubic, colour + 3 * pixel);
            const float there = sample_depth(source, u, v, tolerance);
            const float excess = std::fabs(there - z) / tolerance;
            visibility[pixel] = there > 0.0f ? std::min(std::max(2.0f - excess, 0.0f), 1.0f) : 0.0f;
        }
    });
}

}  // namespace ggvs
