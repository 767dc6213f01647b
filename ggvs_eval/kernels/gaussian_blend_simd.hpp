// Blending of a tile's Gaussians front to back, and its derivatives back to front (included by gaussian_*.cpp after
// gaussian_project_simd.hpp).
#pragma once
#include "gaussian_splat.hpp"

namespace ggvs::GGVS_LEVEL {

alignas(64) static const float kPixelColumn[kPixels] = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
alignas(64) static const float kPixelRow[kPixels] = {0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3};

// A Gaussian in the coordinates of a tile, and the blocks that its box touches.
struct Footprint {
    F xx, xy, yy, opacity;
    float u, v;
    int x0, x1, y0, y1;
};

GGVS_INLINE int block_at(float pixel) { return int(pixel < 0 ? 0 : pixel > kTile - 1 ? kTile - 1 : pixel) / kSide; }

GGVS_INLINE Footprint footprint(const ScreenGaussian& g, int left, int top) {
    const float u = g.u - float(left), v = g.v - float(top);
    return {all(g.xx), all(g.xy), all(g.yy), all(g.opacity), u, v, block_at(u - g.reach_x), block_at(u + g.reach_x),
            block_at(v - g.reach_y), block_at(v + g.reach_y)};
}

// alpha, before it is held at 0.99, where a block's pixels lie (dx, dy) from the Gaussian's centre.
GGVS_INLINE F coverage(const Footprint& g, F dx, F dy) {
    F exponent = (g.xx * dx + g.xy * dy) * dx + g.yy * dy * dy;
    return g.opacity * power_of_two(max(min(exponent, all(0.0f)), all(-64.0f)));
}

// A pixel that stops keeps its transmittance with a minus sign, as those outside of the image have from the start.
static void blend_gaussians(const ScreenGaussian* gaussians, const uint32_t* listed, int count, int left, int top,
                            TilePixels& pixels) {
    constexpr int kAhead = 8;
    bool open[kBlocks];
    int remaining = 0;
    for (int block = 0; block < kBlocks; ++block) {
        open[block] = false;
        for (float t : pixels.transmittance[block]) open[block] |= t > 0;
        remaining += open[block];
    }
    for (int n = 0; n < count && remaining > 0; ++n) {
        __builtin_prefetch(&gaussians[listed[n + kAhead < count ? n + kAhead : n]]);
        const ScreenGaussian& gaussian = gaussians[listed[n]];
        const Footprint g = footprint(gaussian, left, top);
        const F red = all(gaussian.red), green = all(gaussian.green), blue = all(gaussian.blue), depth = all(gaussian.depth);
        for (int y = g.y0; y <= g.y1; ++y) {
            for (int x = g.x0; x <= g.x1; ++x) {
                const int block = y * kAcross + x;
                if (!open[block]) continue;
                bool still_open = false;
                for (int part = 0; part < kPixels; part += kWidth) {
                    F dx = load(kPixelColumn + part) + all(float(x * kSide) - g.u);
                    F dy = load(kPixelRow + part) + all(float(y * kSide) - g.v);
                    F alpha = min(coverage(g, dx, dy), all(kMostAlpha));
                    F before = load(pixels.transmittance[block] + part);
                    M touched = at_most(all(kLeastAlpha), alpha);
                    F share = before * alpha, after = before - share;
                    M blended = both(touched, at_most(all(kLeastTransmittance), after));
                    F weight = select(blended, share, all(0.0f));
                    // What is touched and not blended stops, or has stopped already.
                    F stopped = from_bits(bits(before) | bits(all(-0.0f)));
                    F now = select(blended, after, select(touched, stopped, before));
                    still_open |= any(less(all(0.0f), now));
                    store(pixels.transmittance[block] + part, now);
                    store(pixels.red[block] + part, load(pixels.red[block] + part) + weight * red);
                    store(pixels.green[block] + part, load(pixels.green[block] + part) + weight * green);
                    store(pixels.blue[block] + part, load(pixels.blue[block] + part) + weight * blue);
                    store(pixels.depth[block] + part, load(pixels.depth[block] + part) + weight * depth);
                    I last = load(pixels.last[block] + part);
                    store(pixels.last[block] + part, select(blended, all(int32_t(n + 1)), last));
                }
                if (!still_open) open[block] = false, --remaining;
            }
        }
    }
}

// One number of 16 lanes, in the same order at every width.
GGVS_INLINE float sum_of(float* lanes) {
    for (int half = kPixels / 2; half > 0; half /= 2)
        for (int n = 0; n < half; ++n) lanes[n] += lanes[n + half];
    return lanes[0];
}

// With v what the loss gains by a Gaussian's whole colour and depth at a pixel, and B the same of all behind it and the background,
// the derivative by alpha is T (v - B), where T is what comes through to the Gaussian. B goes from back to front by
// alpha v + (1 - alpha) B. `behind` holds, per pixel, B of the background.
static void blend_gradients(const ScreenGaussian* gaussians, const uint32_t* listed, int count, int left, int top,
                            TilePixels& pixels, const float* behind, float (*sums)[kSums]) {
    alignas(64) float following[kBlocks][kPixels];
    __builtin_memcpy(following, behind, sizeof following);
    int32_t last[kBlocks], longest = 0;
    for (int block = 0; block < kBlocks; ++block) {
        last[block] = 0;
        for (int32_t n : pixels.last[block]) last[block] = n > last[block] ? n : last[block];
        longest = last[block] > longest ? last[block] : longest;
    }
    for (int n = count - 1; n >= longest; --n) __builtin_memset(sums[n], 0, sizeof sums[n]);
    for (int n = longest - 1; n >= 0; --n) {
        const ScreenGaussian& gaussian = gaussians[listed[n]];
        const Footprint g = footprint(gaussian, left, top);
        const F red = all(gaussian.red), green = all(gaussian.green), blue = all(gaussian.blue), depth = all(gaussian.depth);
        const F zero = all(0.0f), one = all(1.0f);
        alignas(64) float lanes[kSums][kPixels];
        for (int part = 0; part < kPixels; part += kWidth) {
            F sum[kSums];
            for (F& each : sum) each = zero;
            for (int y = g.y0; y <= g.y1; ++y) {
                F dy = load(kPixelRow + part) + all(float(y * kSide) - g.v);
                for (int x = g.x0; x <= g.x1; ++x) {
                    const int block = y * kAcross + x;
                    if (n >= last[block]) continue;
                    F dx = load(kPixelColumn + part) + all(float(x * kSide) - g.u);
                    F covered = coverage(g, dx, dy), alpha = min(covered, all(kMostAlpha));
                    F further = to_float(load(pixels.last[block] + part));
                    M blended = both(at_most(all(kLeastAlpha), alpha), less(all(float(n)), further));
                    alpha = select(blended, alpha, zero);
                    F left_over = one - alpha, after = load(pixels.transmittance[block] + part);
                    F before = after / left_over;
                    F by_red = load(pixels.red[block] + part), by_green = load(pixels.green[block] + part);
                    F by_blue = load(pixels.blue[block] + part), by_depth = load(pixels.depth[block] + part);
                    F value = red * by_red + green * by_green + blue * by_blue + depth * by_depth;
                    F rest = load(following[block] + part), weight = before * alpha;
                    // A Gaussian that is held at 0.99 stays there.
                    F p = select(at_most(covered, all(kMostAlpha)), weight * (value - rest), zero);
                    store(following[block] + part, alpha * value + left_over * rest);
                    store(pixels.transmittance[block] + part, before);
                    sum[kRed] = sum[kRed] + weight * by_red, sum[kGreen] = sum[kGreen] + weight * by_green;
                    sum[kBlue] = sum[kBlue] + weight * by_blue, sum[kDepth] = sum[kDepth] + weight * by_depth;
                    F p_dx = p * dx, p_dy = p * dy;
                    sum[kP] = sum[kP] + p, sum[kPx] = sum[kPx] + p_dx, sum[kPy] = sum[kPy] + p_dy;
                    sum[kPxx] = sum[kPxx] + p_dx * dx, sum[kPxy] = sum[kPxy] + p_dx * dy, sum[kPyy] = sum[kPyy] + p_dy * dy;
                }
            }
            for (int each = 0; each < kSums; ++each) store(lanes[each] + part, sum[each]);
        }
        for (int each = 0; each < kSums; ++each) sums[n][each] = sum_of(lanes[each]);
    }
}

}  // namespace ggvs::GGVS_LEVEL
