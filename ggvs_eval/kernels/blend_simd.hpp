// The look-up of captured views, written once for every instruction set (included by level_*.cpp after a simd_*.hpp).
#pragma once
#include "blend.hpp"

namespace ggvs::GGVS_LEVEL {

struct Colour {
    F red, green, blue;
};

// A view's colours in one packet of target pixels, and whether it sees them; where it does not the colour means nothing.
struct Seen {
    Colour colour;  // 0 .. 255
    F visibility;
};

// Four neighbours and their weights; the border is repeated.
struct Corners {
    I upper, lower;  // pixels on the left of each row
    M last;          // the column is the last one: on the right is the same pixel
    M right, below;  // where the nearest is
    F share[4];
};

GGVS_INLINE Corners corners(const Pinhole& camera, F u, F v) {
    const F zero = all(0.0f), half = all(0.5f), one = all(1.0f);
    const F last_x = all(float(camera.width - 1)), last_y = all(float(camera.height - 1));
    F x = min(max(u - half, zero), last_x), y = min(max(v - half, zero), last_y);
    I x0 = truncate(x), y0 = truncate(y), y1 = truncate(min(to_float(y0) + one, last_y));
    F fx = x - to_float(x0), fy = y - to_float(y0);
    I stride = all(int32_t(camera.width));
    return {y0 * stride + x0,
            y1 * stride + x0,
            at_most(last_x, x),
            at_most(half, fx),
            at_most(half, fy),
            {(one - fy) * (one - fx), (one - fy) * fx, fy * (one - fx), fy * fx}};
}

// The depth at a pixel and on its right.
GGVS_INLINE void neighbours(const LookUpView& view, I at, M last, F* left, F* right) {
    if (view.camera.width < 2) {
        *left = *right = gather(view.depth, at);
        return;
    }
    F first, second;  // from the last column but one on where there is nothing on the right
    gather_pairs(view.depth, select(last, at - all(int32_t(1)), at), &first, &second);
    *left = select(last, second, first), *right = second;
}

// Bilinear where the four neighbours belong to one surface (valid, within the tolerance), else the nearest pixel's.
GGVS_INLINE F depth_at(const LookUpView& view, const Corners& c, float tolerance) {
    F d0, d1, d2, d3;
    neighbours(view, c.upper, c.last, &d0, &d1);
    neighbours(view, c.lower, c.last, &d2, &d3);
    F low = min(min(d0, d1), min(d2, d3)), high = max(max(d0, d1), max(d2, d3));
    F mean = c.share[0] * d0 + c.share[1] * d1 + c.share[2] * d2 + c.share[3] * d3;
    M smooth = both(less(all(0.0f), low), less(high - low, all(tolerance)));
    return select(smooth, mean, select(c.below, select(c.right, d3, d2), select(c.right, d1, d0)));
}

// Four pixels of a line from `first` on and their Catmull-Rom weights, as in warp.cpp.
struct Taps {
    F first;  // may lie before the border, which is repeated
    F share[4];
};

GGVS_INLINE Taps cubic_taps(F coordinate) {
    // The index before is found by truncation, which rounds down here: coordinates are not negative.
    const F one = all(1.0f), half = all(0.5f), three_halves = all(1.5f), minus_half = all(-0.5f);
    F before = to_float(truncate(coordinate + half)) - one, f = coordinate - half - before, square = f * f;
    Taps taps;
    taps.first = before - one;
    taps.share[0] = f * multiply_add(f, multiply_add(minus_half, f, one), minus_half);
    taps.share[1] = multiply_add(square, multiply_add(three_halves, f, all(-2.5f)), one);
    taps.share[2] = f * multiply_add(f, multiply_add(all(-1.5f), f, all(2.0f)), half);
    taps.share[3] = square * multiply_add(half, f, minus_half);
    return taps;
}

// Whether one of the four pixels lies beyond the border of a line.
GGVS_INLINE M beyond_border(const Taps& taps, int size) {
    return either(less(taps.first, all(0.0f)), less(all(float(size - 4)), taps.first));
}

// The n-th pixel, the border repeated.
GGVS_INLINE I tap(const Taps& taps, int n, int size) {
    return truncate(min(max(taps.first + all(float(n)), all(0.0f)), all(float(size - 1))));
}

GGVS_INLINE F byte_of(I raw, int n) { return to_float((raw >> (8 * n)) & all(int32_t(255))); }

// Pixels of an image (height, width, 3), one byte per channel from the lowest on. Four bytes are read at a time; the last pixel has
// three, so they are read one byte earlier and shifted.
GGVS_INLINE I colour_bytes(const uint8_t* image, const Pinhole& camera, I pixel) {
    const I last = all(int32_t(3 * (int64_t(camera.width) * camera.height - 1))), byte = pixel * all(int32_t(3));
    const M at_end = less(to_float(last - byte), all(1.0f));
    const I raw = gather_bytes(image, select(at_end, byte - all(int32_t(1)), byte));
    return select(at_end, raw >> 8, raw);
}

// Adds a colour times its share.
GGVS_INLINE void add(Colour& sum, F share, const Colour& colour) {
    sum.red = multiply_add(share, colour.red, sum.red);
    sum.green = multiply_add(share, colour.green, sum.green);
    sum.blue = multiply_add(share, colour.blue, sum.blue);
}

// Sixteen pixels one by one: any of them may be repeated by the border.
GGVS_INLINE Colour colour_near_border(const LookUpView& view, const Taps& x, const Taps& y) {
    const F zero = all(0.0f);
    Colour sum{zero, zero, zero};
    for (int row = 0; row < 4; ++row) {
        const I first = tap(y, row, view.camera.height) * all(int32_t(view.camera.width));
        Colour line{zero, zero, zero};
        for (int column = 0; column < 4; ++column) {
            const I raw = colour_bytes(view.image, view.camera, first + tap(x, column, view.camera.width));
            add(line, x.share[column], {byte_of(raw, 0), byte_of(raw, 1), byte_of(raw, 2)});
        }
        add(sum, y.share[row], line);
    }
    return sum;
}

// The same where no pixel is repeated: four side by side are twelve bytes, which are read with the four behind them.
GGVS_INLINE Colour colour_inside(const LookUpView& view, const Taps& x, const Taps& y) {
    const I first = (truncate(y.first) * all(int32_t(view.camera.width)) + truncate(x.first)) * all(int32_t(3));
    const F zero = all(0.0f);
    Colour sum{zero, zero, zero};
#pragma GCC unroll 4
    for (int row = 0; row < 4; ++row) {
        I quads[4];
        gather_quads(view.image + int64_t(3) * row * view.camera.width, first, quads);
        Colour line{zero, zero, zero};
#pragma GCC unroll 4
        for (int n = 0; n < 4; ++n) {
            const auto byte = [&](int at) { return byte_of(quads[at / 4], at % 4); };
            add(line, x.share[n], {byte(3 * n), byte(3 * n + 1), byte(3 * n + 2)});
        }
        add(sum, y.share[row], line);
    }
    return sum;
}

// Where the surface of some target pixels lies in a view.
struct Sight {
    F u, v, z;
    M inside;  // the view's image
};

// Catmull-Rom, clipped to the range of colours; where a view sees nothing it is some colour of its.
GGVS_INLINE Colour colour_at(const LookUpView& view, const Sight& sight, F visibility) {
    const F zero = all(0.0f), most = all(255.0f), half = all(0.5f);
    const M visible = less(zero, visibility);  // the others must not make all wait for the border
    const F u = select(visible, sight.u, half * all(float(view.camera.width)));
    const F v = select(visible, sight.v, half * all(float(view.camera.height)));
    const Taps x = cubic_taps(u), y = cubic_taps(v);
    const int width = view.camera.width, height = view.camera.height;
    M beyond = either(beyond_border(x, width), beyond_border(y, height));
    // Nor may sixteen bytes reach beyond the image, as they do from its last five pixels.
    beyond = either(beyond, both(at_most(all(float(height - 4)), y.first), at_most(all(float(width - 5)), x.first)));
    const Colour sum = any(beyond) ? colour_near_border(view, x, y) : colour_inside(view, x, y);
    return {min(max(sum.red, zero), most), min(max(sum.green, zero), most), min(max(sum.blue, zero), most)};
}

// What the packets after this one look at: the row below is the first of this row to be read, and gathers are foreseen by nobody.
GGVS_INLINE void prefetch_ahead(const LookUpView& view, const Corners& c) {
    constexpr int kAheadPixels = 64;
    const int64_t pixel = int64_t(c.lower[0]) + kAheadPixels;
    __builtin_prefetch(view.depth + pixel);
    __builtin_prefetch(view.image + 3 * (pixel + view.camera.width));
}

GGVS_INLINE Sight sight_of(const LookUpView& view, F column, F row, F depth) {
    const float *m = view.map.matrix, *o = view.map.offset;
    depth = select(less(all(0.0f), depth), depth, all(view.forgiven.far));
    F z = depth * (all(m[6]) * column + all(m[7]) * row + all(m[8])) + all(o[2]);
    F u = (depth * (all(m[0]) * column + all(m[1]) * row + all(m[2])) + all(o[0])) / z;
    F v = (depth * (all(m[3]) * column + all(m[4]) * row + all(m[5])) + all(o[1])) / z;
    M across = both(at_most(all(0.0f), u), less(u, all(float(view.camera.width))));
    M down = both(at_most(all(0.0f), v), less(v, all(float(view.camera.height))));
    M inside = both(both(less(all(0.0f), depth), less(all(0.0f), z)), both(across, down));
    return {select(inside, u, all(0.5f)), select(inside, v, all(0.5f)), z, inside};
}

constexpr float kFarTimes = 1000.0f;  // times the depth of what is looked up

// How far the view's own depth agrees that it sees the surface, or is forgiven.
GGVS_INLINE F visibility_of(const LookUpView& view, const Sight& sight, float tolerance) {
    if (!any(sight.inside)) return all(0.0f);
    const Corners around = corners(view.camera, sight.u, sight.v);
    prefetch_ahead(view, around);
    F there = depth_at(view, around, tolerance);
    M known = less(all(0.0f), there);
    if (view.forgiven.slack > 0.0f) {  // unknown depth is far away
        there = select(known, there, all(kFarTimes) * sight.z);
        known = sight.inside;
    }
    F difference = there - sight.z;
    F allowed = max(all(tolerance), all(view.forgiven.slack) * there * sight.z);
    F excess = max(difference, all(0.0f) - difference) / allowed;
    F visibility = min(max(all(2.0f) - excess, all(0.0f)), all(1.0f));
    M visible = both(sight.inside, both(known, less(all(0.0f), visibility)));
    return select(visible, visibility, all(0.0f));
}

// What one view shows at the surface of target pixels (column, row) of this depth.
GGVS_INLINE Seen see(const LookUpView& view, F column, F row, F depth, float tolerance) {
    const Sight sight = sight_of(view, column, row, depth);
    Seen seen{{all(0.0f), all(0.0f), all(0.0f)}, visibility_of(view, sight, tolerance)};
    if (any(less(all(0.0f), seen.visibility))) seen.colour = colour_at(view, sight, seen.visibility);
    return seen;
}

// Pixels left .. left + count - 1 of a row.
GGVS_INLINE void look_up_packet(const LookUp& job, int y, int left, int count, float* out) {
    alignas(64) float column[kWidth], depth[kWidth] = {}, channels[3][kWidth], cover[kWidth];
    const int64_t first = int64_t(y) * job.target.width + left;
    for (int lane = 0; lane < kWidth; ++lane) column[lane] = float(left + lane) + 0.5f;
    __builtin_memcpy(depth, job.depth + first, count * sizeof(float));
    F red = all(0.0f), green = red, blue = red, total = red, shown = red;
    for (const LookUpView& view : job.views) {
        Seen seen = see(view, load(column), all(float(y) + 0.5f), load(depth), job.tolerance);
        F weight = seen.visibility * all(view.factor);
        red = red + weight * seen.colour.red;
        green = green + weight * seen.colour.green;
        blue = blue + weight * seen.colour.blue;
        total = total + weight, shown = shown + seen.visibility;
    }
    F per = all(1.0f) / (max(total, all(kNoWeight)) * all(255.0f));
    store(channels[0], red * per);
    store(channels[1], green * per);
    store(channels[2], blue * per);
    store(cover, min(shown, all(1.0f)));
    for (int lane = 0; lane < count; ++lane) {
        for (int c = 0; c < 3; ++c) {
            const int64_t at = 3 * (first + lane) + c;
            const float colour = channels[c][lane];
            out[at] = colour + (1.0f - cover[lane]) * (job.background[at] - colour);
        }
    }
}

static void look_up_row(const LookUp& job, int y, float* out) {
    const int width = job.target.width;
    for (int x = 0; x < width; x += kWidth) look_up_packet(job, y, x, width - x < kWidth ? width - x : kWidth, out);
}

}  // namespace ggvs::GGVS_LEVEL
