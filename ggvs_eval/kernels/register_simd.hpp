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

// Up to kWidth colours side by side; lanes beyond them are 0.
GGVS_INLINE Colour load_colour(const float* p, int count) {
    alignas(64) float part[3 * kWidth] = {};
    if (count < kWidth) p = (const float*)__builtin_memcpy(part, p, 3 * count * sizeof(float));
    Colour colour;
    load_triples(p, &colour.red, &colour.green, &colour.blue);
    return colour;
}

GGVS_INLINE void store_colour(float* out, const Colour& colour, int count) {
    if (count == kWidth) return store_triples(out, colour.red, colour.green, colour.blue);
    alignas(64) float part[3 * kWidth];
    store_triples(part, colour.red, colour.green, colour.blue);
    __builtin_memcpy(out, part, 3 * count * sizeof(float));
}

// A view's splatted colours.
GGVS_INLINE Colour splatted_colour(const RegisteredView& view, const float* splat, int count) {
    if (view.stride == 3) return load_colour(splat, count);
    Colour colour;
    if (view.stride == 4 && count == kWidth) {
        load_quads(splat, &colour.red, &colour.green, &colour.blue);
        return colour;
    }
    const I at = strides(view.stride, count);
    return {gather(splat, at), gather(splat + 1, at), gather(splat + 2, at)};
}

// Some packets of a row at once, step by step: each step waits for the one before, and a processor looks ahead for work of its own
// only so far.
constexpr int kTogetherPackets = 4;

GGVS_INLINE void register_packets(const Registration& job, const RegisteredView& view, int y, int left, int pixels,
                                  const RegisteredMaps& out, int64_t row) {
    const int64_t first = int64_t(y) * job.target.width + left;
    const int packets = (pixels + kWidth - 1) / kWidth;
    F visibility[kTogetherPackets];
    Sight sights[kTogetherPackets];
    const auto each = [&](const auto& step) {
        for (int n = 0; n < packets; ++n) step(n, pixels - n * kWidth < kWidth ? pixels - n * kWidth : kWidth);
    };
    each([&](int n, int count) {
        F depth = load_part(job.depth + first + n * kWidth, count);
        F column = load(kLaneNumber) + all(0.5f) + all(float(left + n * kWidth));
        sights[n] = sight_of(view.captured, column, all(float(y) + 0.5f), depth);
    });
    each([&](int n, int) { visibility[n] = visibility_of(view.captured, sights[n], job.tolerance); });
    each([&](int n, int count) {
        const float* splat = view.splat + (first + n * kWidth) * view.stride;
        for (int ahead = 0; ahead < kWidth * view.stride; ahead += 16)  // floats of a cache line
            __builtin_prefetch(splat + kTogetherPackets * kWidth * view.stride + ahead);
        Colour colour = splatted_colour(view, splat, count);
        const F alpha = load_part(view.alpha + first + n * kWidth, count);
        if (any(less(all(0.0f), visibility[n]))) {
            const Colour seen = colour_at(view.captured, sights[n], visibility[n]);
            F per = all(1.0f / 255.0f);
            // Where nothing was splatted there is no colour to mix with.
            const F whole = select(less(all(0.0f), visibility[n]), all(1.0f), all(0.0f));
            const F share = select(less(all(0.0f), alpha), visibility[n], whole);
            add(colour, share, {seen.red * per - colour.red, seen.green * per - colour.green, seen.blue * per - colour.blue});
        }
        const int64_t at = row + left + n * kWidth;
        store_colour(out.colours + 3 * at, colour, count);
        F faint = all(job.faint) * alpha;
        store_part(out.coverage + at, max(visibility[n], faint), count);
        store_part(out.seen + at, visibility[n], count);
    });
}

// Row y of one view.
static void register_row(const Registration& job, int k, int y, const RegisteredMaps& out) {
    constexpr int kPixels = kTogetherPackets * kWidth;
    const int width = job.target.width;
    const int64_t row = (int64_t(k) * out.rows + y - out.first_row) * width;
    for (int x = 0; x < width; x += kPixels)
        register_packets(job, job.views[k], y, x, width - x < kPixels ? width - x : kPixels, out, row);
}

}  // namespace ggvs::GGVS_LEVEL
