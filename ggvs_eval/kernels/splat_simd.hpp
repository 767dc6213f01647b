// The inner loops of the splat, written once for every instruction set (included by level_*.cpp after a simd_*.hpp).
// Steps and constants follow 3D Gaussian splatting's forward pass; the numbers in comments are those of the steps there:
// 1 cull, 2 screen position, 3 covariance, 4 extent, 5 sort (splat.cpp), 6 alpha, 7 blending, 8 normalisation.
#pragma once
#include "splat.hpp"

namespace ggvs::GGVS_LEVEL {

alignas(64) static const float kLaneNumber[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
alignas(64) static const float kLaneColumn[16] = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
alignas(64) static const float kLaneRow[16] = {0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3};

struct Footprint {
    M visible;
    F u, v, depth;        // pixel index coordinates in the target, depth there
    F var_x, cov, var_y;  // step 3
    F reach_x, reach_y;   // half extents of the region where alpha >= 1/255
};

// Steps 1 to 4 for the Gaussians of source pixels (column, row).
GGVS_INLINE Footprint project(const Projector& p, F column, F row, F source_depth) {
    const float* m = p.map.matrix;
    F u = column + all(0.5f), v = row + all(0.5f);
    F x = source_depth * (all(m[0]) * u + all(m[1]) * v + all(m[2])) + all(p.map.offset[0]);
    F y = source_depth * (all(m[3]) * u + all(m[4]) * v + all(m[5])) + all(p.map.offset[1]);
    F z = source_depth * (all(m[6]) * u + all(m[7]) * v + all(m[8])) + all(p.map.offset[2]);
    F inverse = all(1.0f) / z;
    F slope_x = x * inverse, slope_y = y * inverse;

    Footprint f;
    f.depth = z;
    f.u = all(p.fx) * slope_x + all(p.cx);
    f.v = all(p.fy) * slope_y + all(p.cy);
    // Isotropic Gaussians: J W Sigma W^T J^T = sigma^2 J J^T, plus the 0.3 that keeps them at least pixel sized.
    F sigma = all(p.sigma) * source_depth * inverse;
    F jx = all(p.fx) * sigma, jy = all(p.fy) * sigma;
    F clamped_x = max(min(slope_x, all(p.max_x)), all(-p.max_x));
    F clamped_y = max(min(slope_y, all(p.max_y)), all(-p.max_y));
    F jxz = jx * clamped_x, jyz = jy * clamped_y;
    f.var_x = jx * jx + jxz * jxz + all(0.3f);
    f.cov = jxz * jyz;
    f.var_y = jy * jy + jyz * jyz + all(0.3f);
    // alpha = exp(-q / 2) >= 1/255 holds for q <= 2 ln 255 = 11.08; the bound is a little generous, alpha itself decides.
    f.reach_x = sqrt(all(11.09f) * f.var_x);
    f.reach_y = sqrt(all(11.09f) * f.var_y);

    M valid = both(less(all(0.0f), source_depth), less(source_depth, all(1e30f)));
    M in_front = less(all(p.near), z);
    M across = both(at_most(all(0.0f), f.u + f.reach_x), at_most(f.u - f.reach_x, all(p.last_x)));
    M down = both(at_most(all(0.0f), f.v + f.reach_y), at_most(f.v - f.reach_y, all(p.last_y)));
    f.visible = both(both(valid, in_front), both(across, down));
    return f;
}

// Which tiles the Gaussians of `count` (at most 16) neighbouring pixels of one source row touch.
static void tile_ranges(const Projector& p, const float* depth, int column, int row, int count, TileRanges* out) {
    alignas(64) float padded[kLanes] = {};
    __builtin_memcpy(padded, depth, count * sizeof(float));
    for (int lane = 0; lane < kLanes; lane += kWidth) {
        F columns = all(float(column + lane)) + load(kLaneNumber);
        Footprint f = project(p, columns, all(float(row)), load(padded + lane));
        F x0 = max(f.u - f.reach_x, all(0.0f)), x1 = min(f.u + f.reach_x, all(p.last_x));
        F y0 = max(f.v - f.reach_y, all(0.0f)), y1 = min(f.v + f.reach_y, all(p.last_y));
        F across = all(1.0f / kTileWidth), down = all(1.0f / kTileHeight);
        store(out->x0 + lane, select(f.visible, truncate(x0 * across), all(int32_t(1))));
        store(out->x1 + lane, select(f.visible, truncate(x1 * across), all(int32_t(0))));
        store(out->y0 + lane, truncate(y0 * down));
        store(out->y1 + lane, truncate(y1 * down));
    }
}

GGVS_INLINE F ceiling(F x) {  // of 0 <= x < 2^31
    F whole = to_float(truncate(x));
    return select(less(whole, x), whole + all(1.0f), whole);
}

template <int kChannels>
static void ellipses_of(const Projector& p, const SplatSource& source, const uint32_t* pixels, int count, int left, int top,
                        Ellipse* out) {
    const F log2e = all(1.44269504f), half = all(-0.5f);
    for (int first = 0; first < count; first += kWidth) {
        int used = count - first < kWidth ? count - first : kWidth;
        alignas(64) int32_t packed[kWidth] = {};
        __builtin_memcpy(packed, pixels + first, used * sizeof(int32_t));
        I pixel = load(packed);
        I column = pixel & all(int32_t(0xffff)), row = (pixel >> 16) & all(int32_t(0xffff));
        I index = row * all(int32_t(source.camera.width)) + column;
        Footprint f = project(p, to_float(column), to_float(row), gather(source.depth, index));

        F determinant = f.var_x * f.var_y - f.cov * f.cov;
        F per = log2e / determinant;
        F u = f.u - all(float(left)), v = f.v - all(float(top));
        const F zero = all(0.0f);
        I x0 = truncate(ceiling(min(max(u - f.reach_x, zero), all(float(kTileWidth - 1))))) >> 2;
        I x1 = truncate(max(min(u + f.reach_x, all(float(kTileWidth - 1))), zero)) >> 2;
        I y0 = truncate(ceiling(min(max(v - f.reach_y, zero), all(float(kTileHeight - 1))))) >> 2;
        I y1 = truncate(max(min(v + f.reach_y, all(float(kTileHeight - 1))), zero)) >> 2;

        alignas(64) float fields[6][kWidth];
        alignas(64) int32_t blocks[kWidth], at[kWidth];
        store(at, index);
        store(fields[0], u);
        store(fields[1], v);
        store(fields[2], half * f.var_y * per);
        store(fields[3], f.cov * per);
        store(fields[4], half * f.var_x * per);
        store(fields[5], f.depth);
        store(blocks, x0 | (x1 << 8) | (y0 << 16) | (y1 << 24));
        for (int lane = 0; lane < used; ++lane) {
            Ellipse& e = out[first + lane];
            __builtin_memcpy(&e.blocks, &blocks[lane], sizeof e.blocks);
            e.u = fields[0][lane], e.v = fields[1][lane], e.depth = fields[5][lane];
            e.xx = fields[2][lane], e.xy = fields[3][lane], e.yy = fields[4][lane];
            if (source.features) {
                const float* features = source.features + int64_t(at[lane]) * kChannels;
                for (int c = 0; c < kChannels; ++c) e.features[c] = features[c];
            } else {
                const uint8_t* colour = source.colours + int64_t(at[lane]) * 3;
                for (int c = 0; c < kChannels && c < 3; ++c) e.features[c] = source.shares[colour[c]];
                if (kChannels > 3) e.features[kChannels - 1] = source.extra[at[lane]];
            }
        }
    }
}

// Ellipses, in the coordinates of the tile that starts at (left, top), of the listed source pixels.
static void ellipses(const Projector& p, const SplatSource& source, int channels, const uint32_t* pixels, int count, int left,
                     int top, Ellipse* out) {
    switch (channels) {
        case 1:
            return ellipses_of<1>(p, source, pixels, count, left, top, out);
        case 2:
            return ellipses_of<2>(p, source, pixels, count, left, top, out);
        case 3:
            return ellipses_of<3>(p, source, pixels, count, left, top, out);
        default:
            return ellipses_of<4>(p, source, pixels, count, left, top, out);
    }
}

// 2^x for -126 < x < 126 to 2e-7, from integer and fractional part; the coefficients are the minimax polynomial on [-1/2, 1/2].
GGVS_INLINE F exp2(F x) {
    F shifted = x + all(12582912.0f);  // 1.5 * 2^23: rounds to the nearest integer in the low mantissa bits
    F f = x - (shifted - all(12582912.0f));
    F p = all(1.326472634e-3f);
    p = p * f + all(9.671513338e-3f);
    p = p * f + all(5.550733752e-2f);
    p = p * f + all(2.402224207e-1f);
    p = p * f + all(6.931469776e-1f);
    p = p * f + all(1.0f);
    return from_bits(bits(p) + (bits(shifted) << 23));
}

// One block's accumulators: transmittance T, depth, features; 16 lanes each. T < 0 marks a pixel that has stopped (|T| counts).
// Steps 6 and 7, `ordered` is front to back. A pixel stops BEFORE the Gaussian that would bring T below 1e-4.
template <int kChannels>
static void blend(const Ellipse* list, const uint32_t* ordered, int count, float* blocks) {
    constexpr int kFloats = (2 + kChannels) * kLanes, kAhead = 8;
    for (int n = 0; n < count; ++n) {
        __builtin_prefetch(&list[ordered[n + kAhead < count ? n + kAhead : n]]);
        const Ellipse& e = list[ordered[n]];
        const int x0 = e.blocks & 255, x1 = e.blocks >> 8 & 255, y0 = e.blocks >> 16 & 255, y1 = e.blocks >> 24;
        const F xx = all(e.xx), xy = all(e.xy), yy = all(e.yy), depth = all(e.depth);
        for (int y = y0; y <= y1; ++y) {
            for (int part = 0; part < kLanes; part += kWidth) {
                F dy = load(kLaneRow + part) + all(float(y * kBlock) - e.v);
                F xy_dy = xy * dy, yy_dy2 = yy * dy * dy;
                for (int x = x0; x <= x1; ++x) {
                    float* here = blocks + int64_t(y * (kTileWidth / kBlock) + x) * kFloats + part;
                    F before = load(here);
                    if (!any(less(all(0.0f), before))) continue;
                    F dx = load(kLaneColumn) + all(float(x * kBlock) - e.u);
                    F exponent = (xx * dx + xy_dy) * dx + yy_dy2;
                    // Not left out where nothing is touched: no processor foretells that, and guessing wrong costs more.
                    M touched = at_most(all(kLog2MinAlpha), exponent);
                    F alpha = min(exp2(exponent), all(0.99f));  // without meaning, and unused, where not touched
                    F share = before * alpha, after = before - share;
                    M blended = both(touched, at_most(all(1e-4f), after));
                    F weight = select(blended, share, all(0.0f));
                    // What is touched and not blended stops, or has stopped already.
                    F stopped = from_bits(bits(before) | bits(all(-0.0f)));
                    store(here, select(blended, after, select(touched, stopped, before)));
                    store(here + kLanes, load(here + kLanes) + weight * depth);
                    for (int c = 0; c < kChannels; ++c) {
                        float* sum = here + (2 + c) * kLanes;
                        store(sum, load(sum) + weight * all(e.features[c]));
                    }
                }
            }
        }
    }
}

static void blend_tile(const Ellipse* list, const uint32_t* ordered, int count, int channels, float* blocks) {
    switch (channels) {
        case 1:
            return blend<1>(list, ordered, count, blocks);
        case 2:
            return blend<2>(list, ordered, count, blocks);
        case 3:
            return blend<3>(list, ordered, count, blocks);
        default:
            return blend<4>(list, ordered, count, blocks);
    }
}

// Turns T into alpha = 1 - |T| and, if asked, divides the sums by it where alpha > 1/255, else sets them to 0 (step 8).
static void finish_blocks(float* blocks, int channels, bool normalised) {
    const int floats = (2 + channels) * kLanes;
    for (int block = 0; block < kTileBlocks; ++block) {
        for (int lane = 0; lane < kLanes; lane += kWidth) {
            float* here = blocks + block * floats + lane;
            F transmittance = load(here);
            F alpha = all(1.0f) - max(transmittance, all(0.0f) - transmittance);
            F factor = normalised ? select(less(all(kMinAlpha), alpha), all(1.0f) / alpha, all(0.0f)) : all(1.0f);
            store(here, alpha);
            for (int c = 1; c < 2 + channels; ++c) store(here + c * kLanes, load(here + c * kLanes) * factor);
        }
    }
}

}  // namespace ggvs::GGVS_LEVEL
