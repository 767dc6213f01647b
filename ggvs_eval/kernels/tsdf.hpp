// The image-based TSDF: fusion weights of a depth image and the march through the fused distance field.
#pragma once
#include <algorithm>
#include <cstdint>
#include <vector>

#include "camera.hpp"

namespace ggvs {

constexpr int kWindow = 7, kReach = kWindow / 2;  // neighbourhood N of Eq. 12
constexpr float kFarAway = 1e18f;                 // stands for an invalid depth: any difference to it exceeds tau
constexpr int kMarchTile = 8;                     // target pixels that share one column of the occupancy grid
constexpr int kSlabs = 512;                       // depth intervals of a column, about equal in log depth
constexpr int kPacket = 4;                        // rays are marched in packets of 4 x 4 pixels or a part of it
constexpr int kMaxViews = 32;

// Eqs. 11-12 for one row of a padded image: `rows` points at 7 rows, the output's own in the middle, padded by 3 on the left.
struct FusionRow {
    const float* rows[kWindow];
    float tau, scale;  // scale = 7 * depth noise
    int width;
    float* out;
};

// One depth image of the fused field. Its weight at a sample is min(gain[ray] * weight[pixel], limit).
struct FieldView {
    Pinhole camera;
    const double* from_target;  // target camera -> this camera, rigid 4x4
    const float* depth;         // (height, width), 0 = invalid
    const float* weight;        // (height, width)
    const float* gain;          // (target height, target width), or null for 1
    float limit;
    PixelMap map;  // this and the rest filled by ray_march
    float width, height;
    float last_left, last_upper;  // just before the centres of the last column and row: what lies there has a pixel behind it
};

struct March {
    Pinhole target;
    float near, far, tau;
    float step_fraction, min_step;  // of the distance, and in tau
    bool skip_empty;
    std::vector<FieldView> views;
    float per_tau;  // 1 / tau; filled by ray_march
};

// Slab of a depth: the float's bits are a piecewise linear logarithm, monotone, the same on every machine.
struct SlabScale {
    int32_t first_bits;
    float per_bit;
};

// One column's slabs: next_depth[i] = where the next occupied slabs begin or, of an occupied slab, they began.
struct MarchColumn {
    int left, top;
    SlabScale slabs;
    float next_depth[kSlabs];
};

// The smallest and the largest depth of each pixel column over some rows, taken row by row.
struct Extent {
    float *low, *high;  // kFarAway and 0 to begin with
    int width;
};

// Pieces of a source view's frustum, and the columns, rows of columns and slabs that each reaches: none if the last slab is below
// the first.
struct Shells {
    static constexpr int kMost = 256;
    float left[kMost], right[kMost], top[kMost], bottom[kMost];  // pixels, the last ones excluded
    float low[kMost], high[kMost];                               // depth
    int32_t first_column[kMost], last_column[kMost], first_row[kMost], last_row[kMost], first_slab[kMost], last_slab[kMost];
    int count = 0;
};

struct Range {
    float low, high;
};

struct Block {
    int left, top, right, bottom;  // pixels, the last ones excluded
};

struct Kernels;

// Which slabs of which columns may hold a sample whose distance lies within the truncation of any view.
class Occupancy {
public:
    Occupancy(const March& march, const Kernels& kernels, int threads);
    MarchColumn column(int left, int top) const;

private:
    void mark_view(const FieldView& view, int first_row, int last_row);
    void add_block(const FieldView& view, const PixelMap& to_target, Block block, Range own, Range ring, Shells& shells);
    void mark(const PixelMap& to_target, Shells& shells);
    void mark_shell(const Shells& shells, int n);

    const March& march_;
    const Kernels& kernels_;
    int across_, down_;
    SlabScale slabs_;
    std::vector<uint64_t> bits_;  // (down, across, kSlabs / 64)
};

SlabScale slab_scale(float near, float far);

void fusion_weights(const float* depth, int width, int height, float tau, float depth_noise, float* out, int threads, int level);

// Depth of the first surface along each ray (0 = none) and the sum of the weights there.
void ray_march(March& march, float* depth, float* weight, int threads, int level);

}  // namespace ggvs
