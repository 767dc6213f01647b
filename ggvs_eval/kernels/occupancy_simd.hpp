// The inner loops of the occupancy, written once for every instruction set (included by level_*.cpp after a simd_*.hpp).
#pragma once
#include "tsdf.hpp"

namespace ggvs::GGVS_LEVEL {

// Adds a row of an image; a pixel counts if its depth is valid and, where weights are given, its weight is not 0.
static void add_to_extent(const Extent& extent, const float* depth, const float* weight) {
    // Plain loops: any compiler makes vectors of them.
    const auto include = [&](int x, bool valid) {
        const float low = valid ? depth[x] : kFarAway, high = valid ? depth[x] : 0.0f;
        extent.low[x] = low < extent.low[x] ? low : extent.low[x];
        extent.high[x] = high > extent.high[x] ? high : extent.high[x];
    };
    if (weight)
        for (int x = 0; x < extent.width; ++x) include(x, (depth[x] > 0.0f) & (weight[x] > 0.0f));
    else
        for (int x = 0; x < extent.width; ++x) include(x, depth[x] > 0.0f);
}

// The smallest and the largest of what was added.
struct Bounds {
    F low, high;
};

GGVS_INLINE void add(Bounds& bounds, F x) { bounds.low = min(bounds.low, x), bounds.high = max(bounds.high, x); }

GGVS_INLINE I slab_of(const SlabScale& scale, F z) {
    const F slab = to_float(bits(z) - all(scale.first_bits)) * all(scale.per_bit);
    return truncate(min(max(slab, all(0.0f)), all(float(kSlabs - 1))));
}

// A piece of a frustum is convex, so its eight corners bound its image and its depth.
static void reach_of_shells(const Pinhole& target, const PixelMap& to_target, float near, float far, Shells& shells) {
    constexpr float kRounding = 0.01f;  // pixels; far above the error of the arithmetic
    const SlabScale slabs = slab_scale(near, far);
    const float *m = to_target.matrix, *offset = to_target.offset;
    const F zero = all(0.0f), width = all(float(target.width)), height = all(float(target.height)), margin = all(kRounding);
    const F tile = all(1.0f / kMarchTile);
    for (int n = 0; n < shells.count; n += kWidth) {
        const F depths[2] = {max(load(shells.low + n), zero), max(load(shells.high + n), zero)};
        const Bounds nothing{all(kFarAway), all(-kFarAway)};
        Bounds across = nothing, down = nothing, ahead = nothing;
        for (const float* columns : {shells.left, shells.right}) {
            for (const float* rows : {shells.top, shells.bottom}) {
                const F u = load(columns + n), v = load(rows + n);
                const auto along = [&](int row) { return all(m[row]) * u + all(m[row + 1]) * v + all(m[row + 2]); };
                const F x = along(0), y = along(3), z = along(6);
                for (const F depth : depths) {
                    const F there = depth * z + all(offset[2]), inverse = all(1.0f) / there;
                    add(across, (depth * x + all(offset[0])) * inverse), add(down, (depth * y + all(offset[1])) * inverse);
                    add(ahead, there);
                }
            }
        }
        const M behind = less(ahead.low, all(0.1f * near));  // the camera, and the image is no bound
        across = {select(behind, zero, across.low), select(behind, width, across.high)};
        down = {select(behind, zero, down.low), select(behind, height, down.high)};
        ahead = {ahead.low * all(1.0f - 1e-5f), ahead.high * all(1.0f + 1e-5f)};
        const auto meets = [&](const Bounds& bounds, F low, F high) {
            return both(at_most(low, bounds.high), at_most(bounds.low, high));
        };
        const M in_image = both(meets(across, zero - margin, width), meets(down, zero - margin, height));
        const M seen = both(in_image, meets(ahead, all(near), all(far)));
        const auto first = [&](F low) { return truncate(max(low - margin, zero) * tile); };
        const auto last = [&](F high, F size) { return truncate(min(high + margin, size - all(1.0f)) * tile); };
        store(shells.first_column + n, first(across.low)), store(shells.last_column + n, last(across.high, width));
        store(shells.first_row + n, first(down.low)), store(shells.last_row + n, last(down.high, height));
        store(shells.first_slab + n, slab_of(slabs, max(ahead.low, all(near))));
        store(shells.last_slab + n, select(seen, slab_of(slabs, min(ahead.high, all(far))), all(int32_t(-1))));
    }
}

}  // namespace ggvs::GGVS_LEVEL
