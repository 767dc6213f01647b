// The driver of the registration. Its arithmetic stands in register_simd.hpp.
#include "register.hpp"

#include <algorithm>

#include "kernels.hpp"
#include "parallel.hpp"

namespace ggvs {

constexpr int kBandRows = 8;

void find_pixel_maps(Registration& job) {
    for (RegisteredView& view : job.views)
        view.captured.map = pixel_map(job.target, view.captured.from_target, view.captured.camera, true);
}

void register_views(Registration& job, const RegisteredMaps& out, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
    find_pixel_maps(job);
    const int height = job.target.height, bands = (height + kBandRows - 1) / kBandRows;
    parallel_for(bands, threads, [&](int band, int) {
        const int first = band * kBandRows, last = std::min(first + kBandRows, height);
        for (size_t k = 0; k < job.views.size(); ++k)  // view by view: the source's rows stay in the cache
            for (int y = first; y < last; ++y) kernels.register_row(job, int(k), y, out);
    });
}

}  // namespace ggvs
