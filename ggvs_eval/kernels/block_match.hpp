// Semi-global block matching of a rectified pair along three directions, with the results of OpenCV's StereoSGBM in its mode
// MODE_SGBM_3WAY: costs after Birchfield and Tomasi (1998) of grey values and of their clipped slopes, summed over a block; paths
// from the left, from above and from the right (Hirschmueller 2008).
//
// The image is matched in four stripes, each with some rows above it that are only followed, so that threads need nothing of each
// other. Of a stripe only single rows are kept, which fit in the processor's second cache. Two things OpenCV does otherwise are left
// out: in images of about ten rows its stripes show rows that lie lower, and with fewer columns than a block has it reads beyond.
#pragma once
#include <cstdint>
#include <vector>

namespace ggvs {

constexpr int kDisparityStep = 16;      // disparities come in multiples of it, and in sixteenths of a pixel
constexpr int kUnmatched = -16;         // the result where no disparity is found
constexpr int kLargestDifference = 93;  // of two pixels: 30 of slopes, a quarter of 255 of grey values
constexpr int kLargestTotal = 0x7fff;   // of three paths

struct BlockTask {
    const uint8_t *left, *right;  // (height, width), grey; what lies at x on the left lies at x - disparity on the right
    int height, width;
    int count;                   // disparities 0 .. count - 1, less than the width
    int radius;                  // of the block
    int small_step, large_step;  // penalties of a step by one pixel and of a larger one

    int columns() const { return width - count; }  // those from `count` on are matched, the others have no match
};

// Grey values (second) and slopes (first) of a row, each with its least and greatest value within half a pixel.
struct BlockGuide {
    struct Channel {
        std::vector<uint8_t> value, low, high;  // (width + slack)
    } channels[2];
};

// What is kept of the rows of a stripe.
struct BlockRows {
    static constexpr int kEdge = 16;  // between the paths of two pixels, where no step can come from

    explicit BlockRows(const BlockTask& task);

    uint8_t* difference(int row) { return differences.data() + int64_t(row % block) * stride; }
    int16_t* column_sum(int slot) { return column_sums.data() + int64_t(slot) * count; }
    int16_t* new_path();
    int16_t* down_path(int column) { return down.data() + kEdge + int64_t(column) * (count + kEdge); }

    int count, block;
    int64_t stride;
    BlockGuide left, right;            // the right one mirrored
    std::vector<uint8_t> differences;  // (block, columns, count) of the last rows, of single pixels
    std::vector<int16_t> costs;        // (columns, count) of blocks
    std::vector<int16_t> sums;         // (columns, count) of the first two paths
    std::vector<int16_t> down;         // (columns, count) of the path from above, with edges
    std::vector<int16_t> down_least;   // (columns)
    std::vector<int16_t> column_sums;  // (block + 1, count) over the rows of a block
    std::vector<int16_t> running;      // (count) over a block, or of three paths
    std::vector<int16_t> along;        // (count) of a path along the row, with edges
    std::vector<int16_t> found;        // (width) disparities of the row in sixteenths of a pixel
    std::vector<int16_t> total_of;     // (width) least total of what was matched with a column of the right image, and ...
    std::vector<int16_t> match_of;     // (width) ... its disparity
};

// Disparity in sixteenths of a pixel, (height, width). `level` as in `stereo_kernels`.
void match_blocks(const BlockTask& task, int16_t* disparity, int threads, int level);

}  // namespace ggvs
