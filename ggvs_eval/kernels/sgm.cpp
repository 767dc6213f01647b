// The two passes of semi-global matching and what they keep of each row.
#include "sgm.hpp"

#include <algorithm>
#include <cstring>
#include <thread>

#include "parallel.hpp"
#include "stereo_levels.hpp"

namespace ggvs {

SgmPass::SgmPass(const SgmTask& task, uint8_t* means, const SgmResult* result, int threads)
    : task(task),
      means(means),
      result(result),
      rows_kept_(std::max(threads, 1) + 1),
      paths_(int64_t(rows_kept_) * kRowPaths * (task.width + 2) * (task.planes + 2 * kEdge), uint8_t(255 - task.small_step)),
      minima_(int64_t(rows_kept_) * kRowPaths * (task.width + 2), 0),
      done_(new std::atomic<int>[task.height]) {
    for (int row = 0; row < task.height; ++row) done_[row] = 0;
    // Beyond the image, above the first row and beside each one, every plane is as good.
    for (int row = -1; row < rows_kept_ - 1; ++row) {
        for (int n = 0; n < kRowPaths; ++n) {
            const int stride = row == -1 ? 1 : task.width + 1;
            for (int column = -1; column <= task.width; column += stride) std::memset(path(row, n, column), 0, task.planes);
        }
    }
}

void SgmPass::wait_for(int row, int columns) const {
    while (done_[row].load(std::memory_order_acquire) < columns) std::this_thread::yield();
}

void aggregate(const SgmTask& task, uint8_t* means, const SgmResult& result, int threads, int level) {
    const StereoKernels& kernels = stereo_kernels(level);
    for (const SgmResult* wanted : {static_cast<const SgmResult*>(nullptr), &result}) {
        SgmPass pass(task, means, wanted, threads);
        // Rows are handed out in order: whoever waits for a row waits for a thread that works on it.
        parallel_for(task.height, threads, [&](int row, int) { kernels.aggregate_row(pass, row); });
    }
}

}  // namespace ggvs
