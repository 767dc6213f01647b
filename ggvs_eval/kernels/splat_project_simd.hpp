// Where the splat's Gaussians lie in the picture, written once for every instruction set (included by level_*.cpp after a
// simd_*.hpp). Steps and constants follow 3D Gaussian splatting's forward pass; numbers in comments are those of the steps there:
// 1 cull, 2 screen position, 3 covariance, 4 extent, 5 sort (splat.cpp), 6 alpha, 7 blending, 8 normalisation.
#pragma once
#include "splat.hpp"

namespace ggvs::GGVS_LEVEL {

alignas(64) static const float kLaneNumber[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
alignas(64) static const float kLaneColumn[16] = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
alignas(64) static const float kLaneRow[16] = {0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3};

// alpha = exp(-q / 2) is 1/255 where q = 2 ln 255. What is looked at reaches a little further, since alpha itself decides.
constexpr float kSquaredCut = 11.0825270f, kSquaredReach = 11.09f, kReachPerCut = 1.00033709f;

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
    f.reach_x = sqrt(all(kSquaredReach) * f.var_x);
    f.reach_y = sqrt(all(kSquaredReach) * f.var_y);

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
        F per = all(1.0f / kTile);
        I most = all(INT32_MAX), least = all(int32_t(-1));
        store(out->x0 + lane, select(f.visible, truncate(x0 * per), most));
        store(out->x1 + lane, select(f.visible, truncate(x1 * per), least));
        store(out->y0 + lane, select(f.visible, truncate(y0 * per), most));
        store(out->y1 + lane, select(f.visible, truncate(y1 * per), least));
    }
}

// Which of them, a bit each, touch the tile (x, y).
static uint32_t lanes_in_tile(const TileRanges& ranges, int x, int y) {
    uint32_t lanes = 0;
    for (int lane = 0; lane < kLanes; lane += kWidth) {
        M across = both(at_most(load(ranges.x0 + lane), all(int32_t(x))), at_most(all(int32_t(x)), load(ranges.x1 + lane)));
        M down = both(at_most(load(ranges.y0 + lane), all(int32_t(y))), at_most(all(int32_t(y)), load(ranges.y1 + lane)));
        lanes |= lanes_of(both(across, down)) << lane;
    }
    return lanes;
}

GGVS_INLINE F ceiling(F x) {  // of 0 <= x < 2^31
    F whole = to_float(truncate(x));
    return select(less(whole, x), whole + all(1.0f), whole);
}

// The bits of `from` and `to`, from 0 to 31, and those between them; none where `to` comes just before `from`.
GGVS_INLINE I bits_between(I from, I to) { return (all(int32_t(2)) << to) - (all(int32_t(1)) << from); }

// Neighbours in a list are neighbours in a row of the source, but its rows lie too far apart for a processor to foresee them.
template <int kChannels>
GGVS_INLINE void prefetch_pixel(const SplatSource& source, uint32_t pixel) {
    const int64_t index = int64_t(pixel >> 16) * source.camera.width + (pixel & 0xffff);
    __builtin_prefetch(source.depth + index);
    if (source.features) {
        __builtin_prefetch(source.features + index * kChannels);
        if (kChannels > 2) __builtin_prefetch(source.features + (index + 8) * kChannels);
    } else {
        __builtin_prefetch(source.colours + index * 3);
        if (kChannels > 3) __builtin_prefetch(source.extra + index);
    }
}

// Some pixels of a source. Those of a tile mostly lie side by side in a row, where no gather is wanted.
struct Pixels {
    I index;
    int64_t first;  // of them, where they lie side by side with two more behind them; else -1
};

GGVS_INLINE F read(const float* map, const Pixels& pixels) {
    return pixels.first < 0 ? gather(map, pixels.index) : load(map + pixels.first);
}

// Colours, one byte per channel from the lowest on.
GGVS_INLINE I read_bytes(const SplatSource& source, const Pixels& pixels) {
    return pixels.first < 0 ? colour_bytes(source.colours, source.camera, pixels.index)
                            : load_byte_triples(source.colours + 3 * pixels.first);
}

// x / 255 with the bits of the division for each whole x from 0 to 255: by its inverse in two parts.
GGVS_INLINE F share_of_255(F x) { return multiply_add(x, all(3.921569e-3f), x * all(-2.3191758e-10f)); }

template <int kChannels>
GGVS_INLINE void read_features(const SplatSource& source, const Pixels& pixels, F* features) {
    if (source.features) {
#pragma GCC unroll 4
        for (int c = 0; c < kChannels; ++c) features[c] = gather(source.features + c, pixels.index * all(int32_t(kChannels)));
        return;
    }
    const I raw = read_bytes(source, pixels), level = all(int32_t(255));
#pragma GCC unroll 3
    for (int c = 0; c < kChannels && c < 3; ++c) features[c] = share_of_255(to_float((raw >> (8 * c)) & level));
    if (kChannels > 3) features[3] = read(source.extra, pixels);
}

template <int kChannels>
static void ellipses_of(const Projector& p, const SplatSource& source, const uint32_t* pixels, int count, int left, int top,
                        const Ellipses& out) {
    const F zero = all(0.0f);
    F least = all(1e38f), most = zero;
    for (int first = 0; first < count; first += kWidth) {
        int used = count - first < kWidth ? count - first : kWidth;
        constexpr int kAhead = 64;
        prefetch_pixel<kChannels>(source, pixels[first + kAhead < count ? first + kAhead : count - 1]);
        I pixel = load((const int32_t*)pixels + first);
        if (used < kWidth) pixel = select(less(load(kLaneNumber), all(float(used))), pixel, all(int32_t(pixels[first])));
        I column = pixel & all(int32_t(0xffff)), row = (pixel >> 16) & all(int32_t(0xffff));
        const int64_t begin = int64_t(pixels[first] >> 16) * source.camera.width + (pixels[first] & 0xffff);
        const bool row_of_them = used == kWidth && pixels[first + kWidth - 1] - pixels[first] == kWidth - 1 &&
                                 begin + kWidth + 2 <= int64_t(source.camera.width) * source.camera.height;
        const Pixels read_at{row * all(int32_t(source.camera.width)) + column, row_of_them ? begin : -1};
        Footprint f = project(p, to_float(column), to_float(row), read(source.depth, read_at));

        // To the unit circle by the covariance's factors: the deviation of v, and that of what v does not say of u.
        F yy = all(kReachPerCut) / f.reach_y, slope = f.cov * (yy * yy * all(kSquaredCut));
        F xx = all(kReachPerCut) / sqrt(all(kSquaredReach) * (f.var_x - slope * f.cov)), xy = zero - slope * xx;
        F u = f.u - all(float(left)), v = f.v - all(float(top));
        F last = all(float(kTile - 1));
        I x0 = truncate(ceiling(min(max(u - f.reach_x, zero), last))), x1 = truncate(max(min(u + f.reach_x, last), zero));
        I y0 = truncate(ceiling(min(max(v - f.reach_y, zero), last))), y1 = truncate(max(min(v + f.reach_y, last), zero));

        F features[kMaxFeatures] = {zero, zero, zero, zero};
        read_features<kChannels>(source, read_at, features);
        // Lanes beyond the last are written too, and overwritten by what follows.
        float* fields = &out.list[first].xx;
        constexpr int kStride = sizeof(Ellipse) / sizeof(float);
        store_quads(fields, kStride, 4 * kStride, xx, xy, zero - (xx * u + xy * v), yy);
        store_quads(fields + 4, kStride, 4 * kStride, zero - yy * v, f.depth, features[0], features[1]);
        store_quads(fields + 8, kStride, 4 * kStride, features[2], features[3], zero, zero);
        store(out.columns + first, bits_between(x0 >> 2, x1 >> 2));
        store(out.rows + first, bits_between(y0 >> 1, y1 >> 1));
        store(out.depths + first, bits(f.depth));
        least = min(least, f.depth), most = max(most, f.depth);
    }
    alignas(64) int32_t lanes[2][kWidth];
    store(lanes[0], bits(least)), store(lanes[1], bits(most));
    for (int lane = 0; lane < kWidth; ++lane) {
        if (lanes[0][lane] < out.range->least) out.range->least = lanes[0][lane];
        if (lanes[1][lane] > out.range->most) out.range->most = lanes[1][lane];
    }
}

// Ellipses, in the coordinates of the tile that starts at (left, top), of the listed source pixels.
static void ellipses(const Projector& p, const SplatSource& source, int channels, const uint32_t* pixels, int count, int left,
                     int top, const Ellipses& out) {
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

}  // namespace ggvs::GGVS_LEVEL
