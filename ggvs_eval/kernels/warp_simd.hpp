// The warp's arithmetic, written once for every instruction set (included by level_*.cpp after register_simd.hpp, whose names it
// uses).
#pragma once
#include "warp.hpp"

namespace ggvs::GGVS_LEVEL {

// Some pixels of a line and their weights; the border is repeated.
template <int kCount>
struct Line {
    I at[kCount];
    F weight[kCount];
};

GGVS_INLINE Line<2> linear_line(F x, int size) {
    const F last = all(float(size - 1)), one = all(1.0f), at = min(max(x - all(0.5f), all(0.0f)), last);
    const I first = truncate(at);
    const F f = at - to_float(first);
    return {{first, truncate(min(to_float(first) + one, last))}, {one - f, f}};
}

// Catmull-Rom: interpolates, sums to 1, keeps more detail than linear interpolation.
GGVS_INLINE Line<4> cubic_line(F x, int size) {
    const F zero = all(0.0f), half = all(0.5f), minus_half = all(-0.5f), from_centre = x - half;
    const F before = select(less(from_centre, zero), all(-1.0f), to_float(truncate(from_centre))), f = from_centre - before;
    Line<4> line;
#pragma GCC unroll 4
    for (int n = 0; n < 4; ++n) line.at[n] = truncate(min(max(before + all(float(n - 1)), zero), all(float(size - 1))));
    line.weight[0] = f * (minus_half + f * (all(1.0f) - half * f));
    line.weight[1] = all(1.0f) + f * f * (all(-2.5f) + all(1.5f) * f);
    line.weight[2] = f * (half + f * (all(2.0f) - all(1.5f) * f));
    line.weight[3] = f * f * (minus_half + half * f);
    return line;
}

// The image's colours, or their change.
GGVS_INLINE Colour colour_of(const Warping& job, I pixel) {
    if (job.image) {
        const I at = pixel * all(int32_t(3));
        return {gather(job.image, at), gather(job.image + 1, at), gather(job.image + 2, at)};
    }
    const I now = colour_bytes(job.view.image, job.view.camera, pixel), before = colour_bytes(job.before, job.view.camera, pixel);
    const auto change = [&](int n) { return share_of_255(byte_of(now, n) - byte_of(before, n)); };
    return {change(0), change(1), change(2)};
}

template <int kCount>
GGVS_INLINE Colour warped(const Warping& job, const Line<kCount>& x, const Line<kCount>& y) {
    const F zero = all(0.0f);
    Colour sum{zero, zero, zero};
    for (int j = 0; j < kCount; ++j) {
        for (int i = 0; i < kCount; ++i) {
            const F weight = y.weight[j] * x.weight[i];
            const Colour colour = colour_of(job, y.at[j] * all(int32_t(job.view.camera.width)) + x.at[i]);
            sum = {sum.red + weight * colour.red, sum.green + weight * colour.green, sum.blue + weight * colour.blue};
        }
    }
    return sum;
}

GGVS_INLINE Colour warped(const Warping& job, F u, F v) {
    const Pinhole& camera = job.view.camera;
    if (!job.bicubic) return warped(job, linear_line(u, camera.width), linear_line(v, camera.height));
    const F zero = all(0.0f), one = all(1.0f);
    const Colour sum = warped(job, cubic_line(u, camera.width), cubic_line(v, camera.height));
    return {min(max(sum.red, zero), one), min(max(sum.green, zero), one), min(max(sum.blue, zero), one)};
}

static void warp_row(const Warping& job, int y, float* colours, float* visibilities) {
    const int width = job.target.width;
    for (int x = 0; x < width; x += kWidth) {
        const int count = width - x < kWidth ? width - x : kWidth;
        const int64_t first = int64_t(y) * width + x;
        const F column = all(float(x)) + load(kLaneNumber) + all(0.5f), zero = all(0.0f);
        const Sight sight = sight_of(job.view, column, all(float(y) + 0.5f), load_part(job.depth + first, count));
        Colour colour{zero, zero, zero};
        if (any(sight.inside)) colour = warped(job, sight.u, sight.v);
        colour = {select(sight.inside, colour.red, zero), select(sight.inside, colour.green, zero),
                  select(sight.inside, colour.blue, zero)};
        store_colour(colours + 3 * first, colour, count);
        store_part(visibilities + first, visibility_of(job.view, sight, job.tolerance), count);
    }
}

}  // namespace ggvs::GGVS_LEVEL
