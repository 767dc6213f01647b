// The driver of the outputs' reading. Its arithmetic stands in outputs_simd.hpp.
#include "outputs.hpp"

#include <algorithm>

#include "kernels.hpp"
#include "parallel.hpp"

namespace ggvs {

constexpr int64_t kChunk = 4096;  // cells

void read_outputs(const RawOutputs& job, const ReadOutputs& out, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
    parallel_for(int((job.cells + kChunk - 1) / kChunk), threads, [&](int chunk, int) {
        const int64_t first = chunk * kChunk, count = std::min(kChunk, job.cells - first);
        kernels.read_outputs_chunk(job, out, first, int(count));
        for (int feature = 0; feature < job.features; ++feature)
            std::copy_n(job.raw + (job.most_views + 4 + feature) * job.cells + first, count,
                        out.small + (job.views + 4 + feature) * job.cells + first);
    });
}

}  // namespace ggvs
