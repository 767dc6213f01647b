// Semi-global matching over a cost volume (Hirschmueller 2008) along eight directions.
//
// Four directions are followed in each of two passes over the image, one from the top left corner and one from the bottom right.
// A pixel needs the row before it only up to its next neighbour, so that several threads work on successive rows at once. The
// mean of four paths is kept in a byte: less than the noise of the costs, and a volume of half the size.
#pragma once
#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

namespace ggvs {

constexpr int kMaxPlanes = 256;
constexpr int kLargestPenalties = 128;  // small and large step together: a path's cost then fits in a byte
constexpr int kPathPlanes = 32;         // planes come in multiples of it

struct SgmTask {
    const uint8_t* costs;        // (height, width, planes), at most kCostLimit
    const uint8_t* guide;        // (height, width), grey
    int height, width, planes;
    int small_step;              // penalty of a step by one plane
    const uint8_t* large_steps;  // (256), penalty of a larger step where grey values differ by so much
};

struct SgmResult {
    float* surface;  // (height, width), in planes
    float* margin;   // (height, width), how much worse the best plane elsewhere is, of kCostLimit
};

// One pass over the image, in the mirror if it starts at the bottom right.
class SgmPass {
public:
    static constexpr int kRowPaths = 3;  // that come from the row before; the fourth runs along the row
    static constexpr int kEdge = 32;     // bytes before and behind the costs of a path, which no step can come from

    SgmPass(const SgmTask& task, uint8_t* means, const SgmResult* result, int threads);

    // Costs of a path of a row at a column from -1 to width, and their smallest one.
    uint8_t* path(int row, int n, int column) {
        return paths_.data() + (slot(row, n) * (task.width + 2) + column + 1) * int64_t(task.planes + 2 * kEdge) + kEdge;
    }
    uint8_t& minimum(int row, int n, int column) { return minima_[slot(row, n) * (task.width + 2) + column + 1]; }

    // Columns of a row are done; waits until they are.
    void finish(int row, int columns) { done_[row].store(columns, std::memory_order_release); }
    void wait_for(int row, int columns) const;

    const SgmTask& task;
    uint8_t* const means;           // (height, width, planes), of the first pass's paths
    const SgmResult* const result;  // null in the first pass

private:
    int64_t slot(int row, int n) const { return int64_t((row + rows_kept_) % rows_kept_) * kRowPaths + n; }

    int rows_kept_;  // one more than there can be unfinished ones
    std::vector<uint8_t> paths_, minima_;
    std::unique_ptr<std::atomic<int>[]> done_;
};

// `means` is room for (height, width, planes).
void aggregate(const SgmTask& task, uint8_t* means, const SgmResult& result, int threads, int level);

}  // namespace ggvs
