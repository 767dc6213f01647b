// The driver of the warp. Its arithmetic stands in warp_simd.hpp.
#include "warp.hpp"

#include <algorithm>

#include "kernels.hpp"
#include "parallel.hpp"

namespace ggvs {

constexpr int kBandRows = 8;

void warp(Warping& job, float* colours, float* visibilities, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
    job.view.map = pixel_map(job.target, job.view.from_target, job.view.camera, true);
    const int height = job.target.height;
    parallel_for((height + kBandRows - 1) / kBandRows, threads, [&](int band, int) {
        for (int y = band * kBandRows; y < std::min((band + 1) * kBandRows, height); ++y)
            kernels.warp_row(job, y, colours, visibilities);
    });
}

}  // namespace ggvs
