// The recurrent output in one pass over the picture, band by band.
#include "recur.hpp"

#include <algorithm>

#include "enlarge.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kBandRows = 16, kMaps = 4;

// What the past adds: nothing where it is not finite, so that it is forgotten at once (0 x NaN is NaN).
inline float step_back(float now, float past) {
    const float step = past - now;
    return step - step == 0.0f ? step : 0.0f;
}

void mix_row(const float* now, const float* past, const float* maps, int width, float* out) {
    const float *weight = maps, *red = maps + width, *green = red + width, *blue = green + width;
    for (int x = 0; x < width; ++x, now += 3, past += 3, out += 3) {
        out[0] = now[0] + weight[x] * step_back(now[0], past[0]) - red[x];
        out[1] = now[1] + weight[x] * step_back(now[1], past[1]) - green[x];
        out[2] = now[2] + weight[x] * step_back(now[2], past[2]) - blue[x];
    }
}

}  // namespace

void recur(const Recurrence& job, float* out, int threads) {
    const FinePixels across(job.width, job.across, double(job.width) / job.across);
    const FinePixels down(job.height, job.down, double(job.height) / job.down);
    const SmallMaps cells{job.cells, job.across, job.down, 1};
    parallel_for((job.height + kBandRows - 1) / kBandRows, threads, [&](int band, int) {
        EnlargedRows rows(cells, across, down, 0, kMaps, 0, job.width);
        std::vector<float> maps(size_t(kMaps) * job.width);
        for (int y = band * kBandRows; y < std::min((band + 1) * kBandRows, job.height); ++y) {
            rows.write(y, maps.data(), job.width);
            const int64_t first = int64_t(3) * y * job.width;
            mix_row(job.now + first, job.past + first, maps.data(), job.width, out + first);
        }
    });
}

}  // namespace ggvs
