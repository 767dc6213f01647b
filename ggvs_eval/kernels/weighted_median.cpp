// The median of a window, weighted by likeness in colour, by a histogram over planes.
#include "weighted_median.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kLevels = 3 * 255 + 1;  // of the summed difference of three channels

struct Histogram {
    std::vector<float> weights, sums;  // per plane: weights, and weights times surface
};

// Also of what is no number: then 0.
int plane_of(float surface, int planes) {
    const float at = surface + 0.5f;
    return at > 0.0f ? int(at < float(planes - 1) ? at : float(planes - 1)) : 0;
}

struct Window {
    int top, bottom, left, right;  // inclusive
};

bool is_flat(const MedianTask& task, const Window& window) {
    float low = task.surface[int64_t(window.top) * task.width + window.left], high = low;
    for (int j = window.top; j <= window.bottom; ++j) {
        const float* row = task.surface + int64_t(j) * task.width;
        for (int i = window.left; i <= window.right; ++i) low = std::min(low, row[i]), high = std::max(high, row[i]);
    }
    return high - low <= task.tolerance;
}

// Fills the histogram and returns the sum of the weights.
float fill(const MedianTask& task, const Window& window, const uint8_t* middle, const std::vector<float>& likeness,
           Histogram& h) {
    std::fill(h.weights.begin(), h.weights.end(), 0.0f);
    std::fill(h.sums.begin(), h.sums.end(), 0.0f);
    float total = 0.0f;
    for (int j = window.top; j <= window.bottom; ++j) {
        for (int i = window.left; i <= window.right; ++i) {
            const int64_t pixel = int64_t(j) * task.width + i;
            const uint8_t* colour = task.guide + 3 * pixel;
            int difference = 0;
            for (int c = 0; c < 3; ++c) difference += std::abs(colour[c] - middle[c]);
            const float weight = likeness[difference];
            const int plane = plane_of(task.surface[pixel], task.planes);
            h.weights[plane] += weight;
            h.sums[plane] += weight * task.surface[pixel];
            total += weight;
        }
    }
    return total;
}

float filter(const MedianTask& task, const Histogram& h, float total, float own) {
    int median = 0;
    for (float below = h.weights[0]; 2.0f * below < total && median < task.planes - 1;) below += h.weights[++median];
    if (std::fabs(own - float(median)) <= task.tolerance) return own;
    float weight = 0.0f, sum = 0.0f;
    for (int n = std::max(median - 1, 0); n <= std::min(median + 1, task.planes - 1); ++n) {
        weight += h.weights[n];
        sum += h.sums[n];
    }
    return sum / weight;
}

}  // namespace

void weighted_median(const MedianTask& task, float* filtered, int threads) {
    std::vector<float> likeness(kLevels);
    for (int n = 0; n < kLevels; ++n) likeness[n] = float(std::exp(-double(n) / (3.0 * task.colour_scale)));
    parallel_for(task.height, threads, [&](int row, int) {
        Histogram histogram{std::vector<float>(task.planes), std::vector<float>(task.planes)};
        for (int column = 0; column < task.width; ++column) {
            const int64_t pixel = int64_t(row) * task.width + column;
            const Window window{std::max(row - task.radius, 0), std::min(row + task.radius, task.height - 1),
                                std::max(column - task.radius, 0), std::min(column + task.radius, task.width - 1)};
            filtered[pixel] = task.surface[pixel];
            if (is_flat(task, window)) continue;
            const float total = fill(task, window, task.guide + 3 * pixel, likeness, histogram);
            filtered[pixel] = filter(task, histogram, total, task.surface[pixel]);
        }
    });
}

}  // namespace ggvs
