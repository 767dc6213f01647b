// The image-based TSDF (paper 3.2 and supplement A.1): the drivers. The arithmetic stands in tsdf_simd.hpp.
#include "tsdf.hpp"

#include <algorithm>
#include <memory>

#include "kernels.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kBandRows = 16;
constexpr float kJustBelow = 0.99999994f;  // the largest number below 1: times another one, the next to that
constexpr int kPadding = kReach + 16;  // on the right also what the last vector reads too much

// Copies image row y, invalid depth and everything outside as kFarAway, into a padded row.
void pad_row(const float* depth, int width, int height, int y, float* padded) {
    std::fill_n(padded, width + kReach + kPadding, kFarAway);
    if (y < 0 || y >= height) return;
    const float* row = depth + int64_t(y) * width;
    for (int x = 0; x < width; ++x) padded[kReach + x] = row[x] > 0.0f && row[x] < kFarAway ? row[x] : kFarAway;
}

}  // namespace

void fusion_weights(const float* depth, int width, int height, float tau, float depth_noise, float* out, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
    const int stride = width + kReach + kPadding;
    parallel_for((height + kBandRows - 1) / kBandRows, threads, [&](int band, int) {
        const int first = band * kBandRows, last = std::min(first + kBandRows, height);
        std::vector<float> padded(size_t(last - first + 2 * kReach) * stride), omega(stride);
        for (int y = first - kReach; y < last + kReach; ++y)
            pad_row(depth, width, height, y, padded.data() + size_t(y - first + kReach) * stride);
        for (int y = first; y < last; ++y) {
            FusionRow row{{}, tau, kWindow * depth_noise, width, omega.data()};
            for (int dy = 0; dy < kWindow; ++dy) row.rows[dy] = padded.data() + size_t(y - first + dy) * stride;
            kernels.fusion_row(row);
            std::copy_n(omega.data(), width, out + int64_t(y) * width);
        }
    });
}

void ray_march(March& march, float* depth, float* weight, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
    for (FieldView& view : march.views) {
        view.map = pixel_map(march.target, view.from_target, view.camera, true);
        view.width = float(view.camera.width), view.height = float(view.camera.height);
        view.last_left = kJustBelow * (view.width - 1.0f), view.last_upper = kJustBelow * (view.height - 1.0f);
    }
    march.per_tau = 1.0f / march.tau;
    const std::unique_ptr<Occupancy> occupancy = march.skip_empty ? std::make_unique<Occupancy>(march, kernels, threads) : nullptr;
    const int across = (march.target.width + kMarchTile - 1) / kMarchTile;
    const int down = (march.target.height + kMarchTile - 1) / kMarchTile;
    parallel_for(down, threads, [&](int row, int) {
        for (int n = 0; n < across; ++n) {
            const int left = n * kMarchTile, top = row * kMarchTile;
            const MarchColumn column = occupancy ? occupancy->column(left, top) : MarchColumn{left, top, {}, {}};
            kernels.march_column(march, column, depth, weight);
        }
    });
}

}  // namespace ggvs
