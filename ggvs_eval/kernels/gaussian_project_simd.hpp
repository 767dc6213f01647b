// Gaussians in the world to Gaussians in the image, a batch at a time (included by gaussian_*.cpp after a simd_*.hpp).
// Steps and constants are those of ggvs_eval/gaussians/torch_splat.py.
#pragma once
#include "gaussian_splat.hpp"

namespace ggvs::GGVS_LEVEL {

constexpr float kLog2E = 1.44269504f;

// 2^x for -126 < x < 126 to 2e-7: the integer part goes into the exponent, a polynomial takes the rest.
GGVS_INLINE F power_of_two(F x) {
    F shifted = x + all(12582912.0f);  // 1.5 * 2^23: rounds to the nearest integer in the low mantissa bits
    F rest = x - (shifted - all(12582912.0f));
    F p = all(1.326472634e-3f);
    p = p * rest + all(9.671513338e-3f);
    p = p * rest + all(5.550733752e-2f);
    p = p * rest + all(2.402224207e-1f);
    p = p * rest + all(6.931469776e-1f);
    p = p * rest + all(1.0f);
    return from_bits(bits(p) + (bits(shifted) << 23));
}

GGVS_INLINE F exponential(F x) { return power_of_two(max(min(x * all(kLog2E), all(125.0f)), all(-125.0f))); }

// log2 of a positive number or a little more, by at most 0.02: a parabola through the mantissa.
GGVS_INLINE F log2_bound(F x) {
    I raw = bits(x);
    F whole = to_float((raw >> 23) - all(int32_t(127)));
    F mantissa = from_bits((raw & all(int32_t(0x7fffff))) | all(int32_t(0x3f800000)));
    return whole + (mantissa * (all(2.0f) - all(1.0f / 3) * mantissa) - all(5.0f / 3)) + all(0.01f);
}

GGVS_INLINE F ceiling(F x) {  // of 0 <= x < 2^31
    F whole = to_float(truncate(x));
    return select(less(whole, x), whole + all(1.0f), whole);
}

// The Gaussians that a vector's lanes work on: kWidth of them from `first` on, the last one again where there are no more.
static inline I lanes_of(int64_t first, int64_t count) {
    alignas(64) int32_t numbers[kWidth];
    for (int lane = 0; lane < kWidth; ++lane) numbers[lane] = int32_t(first + lane < count ? lane : count - 1 - first);
    return load(numbers);
}

// Column `column` of rows of `size` floats.
GGVS_INLINE F column_of(const float* rows, int64_t first, I lanes, int size, int column) {
    return gather(rows + first * size + column, lanes * all(int32_t(size)));
}

// All that the forward and the backward pass both need of a Gaussian.
struct Placed {
    M in_front, free_x, free_y;     // z > near; slopes that are not held
    F x, y, z, inverse;             // in the camera; 1 / z
    F slope_x, slope_y;             // held
    F quaternion[4], per_length;    // of unit length, 1 / length as given
    F turn[9], scales[3];           // own axes to the world, standard deviations
    F axes[9];                      // camera's rotation times turn times scales
    F row_x[3], row_y[3];           // J times axes: the covariance in the image is that of these rows
    F var_x, covariance, var_y;     // with the low pass
    F determinant, a, b, c;         // of the covariance; its inverse
    F opacity, u, v;
    F direction[3], per_distance;   // from the camera's centre
};

GGVS_INLINE void turn_of(const F* q, F* turn) {
    const F one = all(1.0f), two = all(2.0f), w = q[0], x = q[1], y = q[2], z = q[3];
    turn[0] = one - two * (y * y + z * z), turn[1] = two * (x * y - w * z), turn[2] = two * (x * z + w * y);
    turn[3] = two * (x * y + w * z), turn[4] = one - two * (x * x + z * z), turn[5] = two * (y * z - w * x);
    turn[6] = two * (x * z - w * y), turn[7] = two * (y * z + w * x), turn[8] = one - two * (x * x + y * y);
}

GGVS_INLINE Placed place(const GaussianView& view, const CloudArrays& cloud, int64_t first, I lanes) {
    Placed p;
    const float* r = view.rotation;
    const F one = all(1.0f);
    F mean[3];
    for (int n = 0; n < 3; ++n) mean[n] = column_of(cloud.means, first, lanes, 3, n);
    p.x = all(r[0]) * mean[0] + all(r[1]) * mean[1] + all(r[2]) * mean[2] + all(view.shift[0]);
    p.y = all(r[3]) * mean[0] + all(r[4]) * mean[1] + all(r[5]) * mean[2] + all(view.shift[1]);
    F z = all(r[6]) * mean[0] + all(r[7]) * mean[1] + all(r[8]) * mean[2] + all(view.shift[2]);
    p.in_front = less(all(view.near), z);
    p.z = select(p.in_front, z, one);
    p.inverse = one / p.z;
    F slope_x = p.x * p.inverse, slope_y = p.y * p.inverse;
    p.u = all(view.fx) * slope_x + all(view.cx);
    p.v = all(view.fy) * slope_y + all(view.cy);
    if (cloud.offsets) {
        p.u = p.u + column_of(cloud.offsets, first, lanes, 2, 0);
        p.v = p.v + column_of(cloud.offsets, first, lanes, 2, 1);
    }
    p.free_x = both(at_most(all(view.low_x), slope_x), at_most(slope_x, all(view.high_x)));
    p.free_y = both(at_most(all(view.low_y), slope_y), at_most(slope_y, all(view.high_y)));
    p.slope_x = max(min(slope_x, all(view.high_x)), all(view.low_x));
    p.slope_y = max(min(slope_y, all(view.high_y)), all(view.low_y));

    F square = all(0.0f);
    for (int n = 0; n < 4; ++n) {
        p.quaternion[n] = column_of(cloud.quaternions, first, lanes, 4, n);
        square = square + p.quaternion[n] * p.quaternion[n];
    }
    p.per_length = one / max(sqrt(square), all(1e-12f));
    for (F& part : p.quaternion) part = part * p.per_length;
    turn_of(p.quaternion, p.turn);
    for (int n = 0; n < 3; ++n) p.scales[n] = exponential(column_of(cloud.log_scales, first, lanes, 3, n));
    for (int row = 0; row < 3; ++row)
        for (int n = 0; n < 3; ++n)
            p.axes[3 * row + n] = (all(r[3 * row]) * p.turn[n] + all(r[3 * row + 1]) * p.turn[3 + n] +
                                   all(r[3 * row + 2]) * p.turn[6 + n]) * p.scales[n];
    F jx = all(view.fx) * p.inverse, jy = all(view.fy) * p.inverse;
    for (int n = 0; n < 3; ++n) {
        p.row_x[n] = jx * (p.axes[n] - p.slope_x * p.axes[6 + n]);
        p.row_y[n] = jy * (p.axes[3 + n] - p.slope_y * p.axes[6 + n]);
    }
    const F *s = p.row_x, *t = p.row_y;
    F var_x = s[0] * s[0] + s[1] * s[1] + s[2] * s[2], var_y = t[0] * t[0] + t[1] * t[1] + t[2] * t[2];
    F cross[3] = {s[1] * t[2] - s[2] * t[1], s[2] * t[0] - s[0] * t[2], s[0] * t[1] - s[1] * t[0]};
    // Lagrange's identity for var_x var_y - covariance^2, which would cancel for thin Gaussians.
    p.determinant = cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2] + all(kLowPass) * (var_x + var_y) +
                    all(kLowPass * kLowPass);
    p.covariance = s[0] * t[0] + s[1] * t[1] + s[2] * t[2];
    p.var_x = var_x + all(kLowPass), p.var_y = var_y + all(kLowPass);
    F per = one / p.determinant;
    p.a = p.var_y * per, p.b = all(0.0f) - p.covariance * per, p.c = p.var_x * per;
    p.opacity = one / (one + exponential(all(0.0f) - column_of(cloud.opacity_logits, first, lanes, 1, 0)));

    F distance = all(0.0f);
    for (int n = 0; n < 3; ++n) {
        p.direction[n] = mean[n] - all(view.centre[n]);
        distance = distance + p.direction[n] * p.direction[n];
    }
    p.per_distance = one / max(sqrt(distance), all(1e-12f));
    for (F& part : p.direction) part = part * p.per_distance;
    return p;
}

// One colour channel before it is held at 0.
GGVS_INLINE F colour_of(const CloudArrays& cloud, int64_t first, I lanes, const F* basis, int channel) {
    const int terms = (cloud.degree + 1) * (cloud.degree + 1);
    F sum = all(0.5f);
    for (int n = 0; n < terms; ++n) sum = sum + basis[n] * column_of(cloud.sh, first, lanes, 3 * terms, 3 * n + channel);
    return sum;
}

static void project_batch(const GaussianView& view, const CloudArrays& cloud, int64_t batch, ScreenGaussian* out, TileBox* boxes,
                          int32_t* radii) {
    const F zero = all(0.0f), last_x = all(float(view.width - 1)), last_y = all(float(view.height - 1));
    for (int64_t first = batch; first < batch + kBatch && first < cloud.count; first += kWidth) {
        const I lanes = lanes_of(first, cloud.count);
        const Placed p = place(view, cloud, first, lanes);
        // alpha = o exp(-q / 2) >= 1/255 holds up to q = 2 ln(255 o); the bound is a little generous, alpha itself decides.
        F furthest = max(all(1.38629436f) * (log2_bound(p.opacity) + all(7.99435344f)), zero);
        F reach_x = sqrt(furthest * p.var_x), reach_y = sqrt(furthest * p.var_y);
        M across = both(at_most(zero, p.u + reach_x), at_most(p.u - reach_x, last_x));
        M down = both(at_most(zero, p.v + reach_y), at_most(p.v - reach_y, last_y));
        M visible = both(both(both(across, down), p.in_front), both(at_most(all(kLeastAlpha), p.opacity),
                                                                    less(p.determinant, all(3e38f))));
        if (!any(visible)) {
            for (int lane = 0; lane < kWidth && first + lane < cloud.count; ++lane)
                boxes[first + lane] = {1, 0, 0, 0}, radii[first + lane] = 0;
            continue;
        }
        F basis[kMostTerms];
        harmonics(cloud.degree, p.direction, basis);
        F middle = all(0.5f) * (p.var_x + p.var_y);
        F largest = middle + sqrt(max(middle * middle - p.determinant, all(0.1f)));
        F radius = ceiling(min(all(3.0f) * sqrt(largest), all(1073741824.0f)));

        alignas(64) float fields[12][kWidth];
        alignas(64) int32_t box[5][kWidth];
        store(fields[0], p.u), store(fields[1], p.v);
        store(fields[2], all(-0.5f * kLog2E) * p.a), store(fields[3], all(-kLog2E) * p.b), store(fields[4], all(-0.5f * kLog2E) * p.c);
        store(fields[5], p.opacity);
        for (int channel = 0; channel < 3; ++channel) store(fields[6 + channel], max(colour_of(cloud, first, lanes, basis, channel), zero));
        store(fields[9], p.z), store(fields[10], reach_x), store(fields[11], reach_y);
        const F per_tile = all(1.0f / kTile);
        store(box[0], select(visible, truncate(max(p.u - reach_x, zero) * per_tile), all(int32_t(1))));
        store(box[1], select(visible, truncate(min(p.u + reach_x, last_x) * per_tile), all(int32_t(0))));
        store(box[2], truncate(max(p.v - reach_y, zero) * per_tile));
        store(box[3], truncate(min(p.v + reach_y, last_y) * per_tile));
        store(box[4], select(visible, truncate(radius), all(int32_t(0))));
        for (int lane = 0; lane < kWidth && first + lane < cloud.count; ++lane) {
            float* fields_out = &out[first + lane].u;
            for (int n = 0; n < 12; ++n) fields_out[n] = fields[n][lane];
            boxes[first + lane] = {box[0][lane], box[1][lane], box[2][lane], box[3][lane]};
            radii[first + lane] = box[4][lane];
        }
    }
}

}  // namespace ggvs::GGVS_LEVEL
