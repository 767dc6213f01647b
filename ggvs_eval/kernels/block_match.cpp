// The stripes of semi-global block matching, their rows, and the check of each row against itself.
#include "block_match.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>

#include "parallel.hpp"
#include "stereo_levels.hpp"

namespace ggvs {
namespace {

constexpr int kStripes = 4;
constexpr int16_t kSlopeLimit = 15;
constexpr int kSlack = 64;   // bytes that vectors may read and write behind a row
constexpr int kLargestGap = 1;  // between the disparities of both sides, pixels

void resize(BlockGuide& guide, int width) {
    for (auto& channel : guide.channels)
        for (auto* values : {&channel.value, &channel.low, &channel.high}) values->resize(width + kSlack);
}

// The least and the greatest of a value and its means with both neighbours.
void find_range(const uint8_t* __restrict value, int width, uint8_t* __restrict low, uint8_t* __restrict high) {
    std::copy(value, value + width, low);
    std::copy(value, value + width, high);
    for (int side : {-1, 1}) {
        for (int x = side < 0; x < width - (side > 0); ++x) {
            const auto mean = uint8_t((value[x] + value[x + side]) / 2);
            low[x] = mean < low[x] ? mean : low[x], high[x] = mean > high[x] ? mean : high[x];
        }
    }
}

// Sobel's slope along a row, clipped, from 0.
void find_slopes(const uint8_t* __restrict above, const uint8_t* __restrict row, const uint8_t* __restrict below, int width,
                 uint8_t* __restrict slope) {
    for (int x = 1; x < width - 1; ++x) {
        const auto change = int16_t(2 * (row[x + 1] - row[x - 1]) + above[x + 1] - above[x - 1] + below[x + 1] - below[x - 1]);
        slope[x] = uint8_t(std::min(std::max(change, int16_t(-kSlopeLimit)), kSlopeLimit) + kSlopeLimit);
    }
}

void fill_guide(const BlockTask& task, const uint8_t* image, int y, bool mirrored, BlockGuide& guide) {
    const int width = task.width;
    const uint8_t* row = image + int64_t(y) * width;
    uint8_t *slope = guide.channels[0].value.data(), *grey = guide.channels[1].value.data();
    find_slopes(y > 0 ? row - width : row, row, y < task.height - 1 ? row + width : row, width, slope);
    std::copy(row, row + width, grey);
    slope[0] = slope[width - 1] = grey[0] = grey[width - 1] = kSlopeLimit;
    for (auto& channel : guide.channels) {
        if (mirrored) std::reverse(channel.value.begin(), channel.value.begin() + width);
        find_range(channel.value.data(), width, channel.low.data(), channel.high.data());
    }
}

// Drops what the right image, asked for its best match, would match with something else; a match outside of it there is none.
void check_row(const BlockTask& task, const BlockRows& rows, int16_t* out) {
    const auto differs = [&](int x, int disparity) {
        const int other = rows.match_of[x - disparity];
        return (other >= 0) & (std::abs(other - disparity) > kLargestGap);
    };
    std::fill_n(out, task.count, int16_t(kUnmatched));
    for (int x = task.count; x < task.width; ++x) {
        const int found = rows.found[x], low = found / kDisparityStep, high = (found + kDisparityStep - 1) / kDisparityStep;
        out[x] = int16_t(differs(x, low) & differs(x, high) ? kUnmatched : found);
    }
}

void match_stripe(const BlockTask& task, int first, int shown, int end, int16_t* disparity, const StereoKernels& kernels) {
    BlockRows rows(task);
    int ready = first;  // rows whose differences are known
    for (int y = first; y < end; ++y) {
        for (const int last = std::min(y + task.radius, task.height - 1); ready <= last; ++ready) {
            fill_guide(task, task.left, ready, false, rows.left);
            fill_guide(task, task.right, ready, true, rows.right);
            kernels.block_differences(task, rows, rows.difference(ready));
        }
        std::vector<const uint8_t*> window;
        for (int k = y - task.radius; k <= y + task.radius; ++k)
            window.push_back(rows.difference(std::min(std::max(k, first), task.height - 1)));
        kernels.block_forward(task, rows, window.data());
        if (y < shown) continue;  // only the path from above is wanted
        std::fill(rows.total_of.begin(), rows.total_of.end(), int16_t(kLargestTotal));
        std::fill(rows.match_of.begin(), rows.match_of.end(), int16_t(-1));
        kernels.block_backward(task, rows);
        check_row(task, rows, disparity + int64_t(y) * task.width);
    }
}

}  // namespace

BlockRows::BlockRows(const BlockTask& task)
    : count(task.count),
      block(2 * task.radius + 1),
      stride(int64_t(task.columns()) * count + kSlack),
      differences(block * stride),
      costs(stride),
      sums(stride),
      down(int64_t(task.columns()) * (count + kEdge) + 2 * kEdge, int16_t(kLargestTotal - task.small_step)),
      down_least(task.columns(), 0),
      column_sums(int64_t(block + 1) * count),
      running(count),
      along(count + 2 * kEdge, int16_t(kLargestTotal - task.small_step)),
      found(task.width),
      total_of(task.width),
      match_of(task.width) {
    resize(left, task.width);
    resize(right, task.width);
    for (int column = 0; column < task.columns(); ++column) std::fill_n(down_path(column), count, int16_t(0));
}

int16_t* BlockRows::new_path() {
    std::fill_n(along.data() + kEdge, count, int16_t(0));
    return along.data() + kEdge;
}

void match_blocks(const BlockTask& task, int16_t* disparity, int threads, int level) {
    const StereoKernels& kernels = stereo_kernels(level);
    const int size = (task.height + kStripes - 1) / kStripes;
    const int before = task.radius + 1 + int(std::ceil(0.1 * size));
    parallel_for(kStripes, threads, [&](int stripe, int) {
        const int shown = std::min(stripe * size, task.height), end = std::min(shown + size, task.height);
        match_stripe(task, std::max(shown - before, 0), shown, end, disparity, kernels);
    });
}

}  // namespace ggvs
