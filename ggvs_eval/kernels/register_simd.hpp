// The registration of views, written once for every instruction set (included by level_*.cpp after blend_simd.hpp).
#pragma once
#include "register.hpp"

namespace ggvs::GGVS_LEVEL {

// Up to kWidth values; lanes beyond them are 0.
GGVS_INLINE F load_part(const float* p, int count) {
    if (count == kWidth) return load(p);
    alignas(64) float lanes[kWidth] = {};
    __builtin_memcpy(lanes, p, count * sizeof(float));
    return load(lanes);
}

GGVS_INLINE void store_part(float* p, F x, int count) {
    if (count == kWidth) return store(p, x);
    alignas(64) float lanes[kWidth];
    store(lanes, x);
    __builtin_memcpy(p, lanes, count * sizeof(float));
}

// Where `count` pixels begin that lie `stride` floats apart; lanes beyond them repeat the last.
GGVS_INLINE I strides(int stride, int count) {
    alignas(64) int32_t lanes[kWidth];
    for (int lane = 0; lane < kWidth; ++lane) lanes[lane] = stride * (lane < count ? lane : count - 1);
    return load(lanes);
}

GGVS_INLINE Colour gather_colour(const float* p, I at) { return {gather(p, at), gather(p + 1, at), gather(p + 2, at)}; }

GGVS_INLINE void store_colour(float* out, const Colour& colour, int count) {
    alignas(64) float channels[3][kWidth];
    store(channels[0], colour.red);
    store(channels[1], colour.green);
    store(channels[2], colour.blue);
    for (int lane = 0; lane < count; ++lane)
        for (int c = 0; c < 3; ++c) out[3 * lane + c] = channels[c][lane];
}

GGVS_INLINE void register_packet(const Registration& job, const RegisteredView& view, int y, int left, int count, F column,
                                 float* colours, float* coverage, float* seen) {
    const int64_t first = int64_t(y) * job.target.width + left;
    for (int ahead = 0; ahead < kWidth * view.stride; ahead += 16)  // floats of a cache line
        __builtin_prefetch(view.splat + (first + 4 * kWidth) * view.stride + ahead);
    F depth = load_part(job.depth + first, count);
    Colour colour = gather_colour(view.splat + first * view.stride, strides(view.stride, count));
    F visibility = all(0.0f);
    if (any(less(all(0.0f), depth))) {
        Seen found = see(view.captured, column, all(float(y) + 0.5f), depth, job.tolerance);
        visibility = found.visibility;
        F per = all(1.0f / 255.0f);
        colour.red = colour.red + visibility * (found.colour.red * per - colour.red);
        colour.green = colour.green + visibility * (found.colour.green * per - colour.green);
        colour.blue = colour.blue + visibility * (found.colour.blue * per - colour.blue);
    }
    store_colour(colours, colour, count);
    store_part(coverage, max(visibility, all(job.faint) * load_part(view.alpha + first, count)), count);
    store_part(seen, visibility, count);
}

// Row y of one view.
static void register_row(const Registration& job, int k, int y, const RegisteredMaps& out) {
    const int width = job.target.width;
    const int64_t row = (int64_t(k) * job.target.height + y) * width;
    alignas(64) float columns[kWidth];
    for (int lane = 0; lane < kWidth; ++lane) columns[lane] = float(lane) + 0.5f;
    for (int x = 0; x < width; x += kWidth) {
        const int count = width - x < kWidth ? width - x : kWidth;
        register_packet(job, job.views[k], y, x, count, load(columns) + all(float(x)), out.colours + 3 * (row + x),
                        out.coverage + row + x, out.seen + row + x);
    }
}

}  // namespace ggvs::GGVS_LEVEL
