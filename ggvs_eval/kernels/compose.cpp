// The driver of the composition. Its arithmetic stands in compose_simd.hpp.
#include "compose.hpp"

#include "kernels.hpp"
#include "parallel.hpp"

namespace ggvs {

constexpr int kBandRows = 16, kMostLanes = 16;

void compose(const Composition& job, const ComposedMaps& out, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
    const FinePixels across(job.width, job.small.width, job.small.scale), down(job.height, job.small.height, job.small.scale);
    const int channels = job.views + 4;
    const int64_t stride = job.width + kMostLanes;  // the last packet may read beyond the row
    parallel_for((job.height + kBandRows - 1) / kBandRows, threads, [&](int band, int) {
        EnlargedRows rows(job.small, across, down, 0, channels, 0, job.width);
        std::vector<float> enlarged(size_t(channels) * stride), scratch(size_t(4) * job.views * kMostLanes);
        for (int y = band * kBandRows; y < std::min((band + 1) * kBandRows, job.height); ++y) {
            rows.write(y, enlarged.data(), stride);
            kernels.compose_row({job, out, y, enlarged.data(), stride, scratch.data()});
        }
    });
}

}  // namespace ggvs
