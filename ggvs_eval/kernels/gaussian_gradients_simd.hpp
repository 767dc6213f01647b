// From derivatives by Gaussians in the image to derivatives by their parameters, a batch at a time (included by gaussian_*.cpp
// after gaussian_project_simd.hpp): the chain rule through project_batch, backwards.
#pragma once
#include "gaussian_splat.hpp"

namespace ggvs::GGVS_LEVEL {

// p = d loss / d ln alpha, summed over pixels, turns into derivatives by the centre in the image.
GGVS_INLINE void centre_gradient(const Placed& p, const F* sums, F* du, F* dv) {
    *du = p.a * sums[kPx] + p.b * sums[kPy];
    *dv = p.b * sums[kPx] + p.c * sums[kPy];
}

// ... by the two rows whose products are the covariance. With M its inverse and S the sums of p times (dx, dy) (dx, dy)^T the
// derivative by the covariance is M S M / 2, that by the rows A is M S M A.
GGVS_INLINE void rows_gradient(const Placed& p, const F* sums, F* d_row_x, F* d_row_y) {
    F left_xx = p.a * sums[kPxx] + p.b * sums[kPxy], left_xy = p.a * sums[kPxy] + p.b * sums[kPyy];
    F left_yx = p.b * sums[kPxx] + p.c * sums[kPxy], left_yy = p.b * sums[kPxy] + p.c * sums[kPyy];
    F xx = left_xx * p.a + left_xy * p.b, xy = left_xx * p.b + left_xy * p.c, yy = left_yx * p.b + left_yy * p.c;
    for (int n = 0; n < 3; ++n) {
        d_row_x[n] = xx * p.row_x[n] + xy * p.row_y[n];
        d_row_y[n] = xy * p.row_x[n] + yy * p.row_y[n];
    }
}

// Derivatives by the point in the camera, from those by the centre in the image, its depth and the rows J axes.
GGVS_INLINE void point_gradient(const GaussianView& view, const Placed& p, F du, F dv, F d_depth, const F* d_row_x,
                                const F* d_row_y, F* out) {
    const F zero = all(0.0f);
    F jx = all(view.fx) * p.inverse, jy = all(view.fy) * p.inverse;
    F along_x = zero, along_y = zero, across_x = zero, across_y = zero;
    for (int n = 0; n < 3; ++n) {
        along_x = along_x + d_row_x[n] * p.row_x[n], along_y = along_y + d_row_y[n] * p.row_y[n];
        across_x = across_x + d_row_x[n] * p.axes[6 + n], across_y = across_y + d_row_y[n] * p.axes[6 + n];
    }
    // row_x = jx (axes_x - slope_x axes_z): by z through jx, by the slope where it is not held.
    F by_slope_x = select(p.free_x, zero - jx * across_x, zero), by_slope_y = select(p.free_y, zero - jy * across_y, zero);
    out[0] = du * jx + by_slope_x * p.inverse;
    out[1] = dv * jy + by_slope_y * p.inverse;
    // Of the centre the true slope counts, x / z; where the held one has a derivative it is the same.
    F slope_x = p.x * p.inverse, slope_y = p.y * p.inverse;
    out[2] = d_depth - p.inverse * (along_x + along_y + slope_x * (du * all(view.fx) + by_slope_x) +
                                    slope_y * (dv * all(view.fy) + by_slope_y));
}

GGVS_INLINE void quaternion_gradient(const Placed& p, const F* g, F* out) {
    const F two = all(2.0f), w = p.quaternion[0], x = p.quaternion[1], y = p.quaternion[2], z = p.quaternion[3];
    F by[4] = {
        two * (x * (g[7] - g[5]) + y * (g[2] - g[6]) + z * (g[3] - g[1])),
        two * (y * (g[1] + g[3]) + z * (g[2] + g[6]) + w * (g[7] - g[5]) - two * x * (g[4] + g[8])),
        two * (x * (g[1] + g[3]) + z * (g[5] + g[7]) + w * (g[2] - g[6]) - two * y * (g[0] + g[8])),
        two * (x * (g[2] + g[6]) + y * (g[5] + g[7]) + w * (g[3] - g[1]) - two * z * (g[0] + g[4])),
    };
    F along = by[0] * w + by[1] * x + by[2] * y + by[3] * z;  // what would change the length alone
    for (int n = 0; n < 4; ++n) out[n] = (by[n] - along * p.quaternion[n]) * p.per_length;
}

// Derivatives by scales and quaternion, from those by the rows.
GGVS_INLINE void axes_gradient(const GaussianView& view, const Placed& p, const F* d_row_x, const F* d_row_y, F* d_log_scales,
                               F* d_quaternion) {
    const float* r = view.rotation;
    F jx = all(view.fx) * p.inverse, jy = all(view.fy) * p.inverse;
    F by_turn[9];
    for (int n = 0; n < 3; ++n) {
        F camera[3] = {jx * d_row_x[n], jy * d_row_y[n],
                       all(0.0f) - (jx * p.slope_x * d_row_x[n] + jy * p.slope_y * d_row_y[n])};
        F sum = all(0.0f);
        for (int row = 0; row < 3; ++row) {
            F world = all(r[row]) * camera[0] + all(r[3 + row]) * camera[1] + all(r[6 + row]) * camera[2];
            by_turn[3 * row + n] = world * p.scales[n];
            sum = sum + by_turn[3 * row + n] * p.turn[3 * row + n];
        }
        d_log_scales[n] = sum;
    }
    quaternion_gradient(p, by_turn, d_quaternion);
}

// A batch's derivatives, columns side by side, to rows of an array.
GGVS_INLINE void write_rows(const F* columns, int size, M visible, int64_t first, int64_t count, float* out) {
    alignas(64) float fields[3 * kMostTerms][kWidth];
    for (int n = 0; n < size; ++n) store(fields[n], select(visible, columns[n], all(0.0f)));
    for (int lane = 0; lane < kWidth && first + lane < count; ++lane)
        for (int n = 0; n < size; ++n) out[(first + lane) * size + n] = fields[n][lane];
}

// Derivatives by the coefficients, and by the mean through the direction, which is added to `d_mean`.
GGVS_INLINE void colour_gradient(const CloudArrays& cloud, const Placed& p, const F* sums, M visible, int64_t first, I lanes,
                                 F* d_mean, float* out) {
    const int terms = (cloud.degree + 1) * (cloud.degree + 1);
    F basis[kMostTerms], weights[kMostTerms], columns[3 * kMostTerms], by_colour[3];
    harmonics(cloud.degree, p.direction, basis);
    for (int channel = 0; channel < 3; ++channel) {
        M shown = at_most(all(0.0f), colour_of(cloud, first, lanes, basis, channel));
        by_colour[channel] = select(shown, sums[kRed + channel], all(0.0f));
    }
    for (int n = 0; n < terms; ++n) {
        weights[n] = all(0.0f);
        for (int channel = 0; channel < 3; ++channel) {
            columns[3 * n + channel] = basis[n] * by_colour[channel];
            if (n > 0)
                weights[n] = weights[n] + by_colour[channel] * column_of(cloud.sh, first, lanes, 3 * terms, 3 * n + channel);
        }
    }
    write_rows(columns, 3 * terms, visible, first, cloud.count, out);
    if (cloud.degree == 0) return;
    F by[3];
    harmonics_gradient(cloud.degree, p.direction, weights, by);
    F along = by[0] * p.direction[0] + by[1] * p.direction[1] + by[2] * p.direction[2];
    for (int n = 0; n < 3; ++n) d_mean[n] = d_mean[n] + (by[n] - along * p.direction[n]) * p.per_distance;
}

static void project_gradients(const GaussianView& view, const CloudArrays& cloud, int64_t batch, const float (*all_sums)[kBatch],
                              const TileBox* boxes, const CloudGradients& out) {
    const float* r = view.rotation;
    for (int64_t first = batch; first < batch + kBatch && first < cloud.count; first += kWidth) {
        const I lanes = lanes_of(first, cloud.count);
        alignas(64) float shown[kWidth] = {};
        for (int lane = 0; lane < kWidth && first + lane < cloud.count; ++lane)
            shown[lane] = boxes[first + lane].size() ? 1.0f : 0.0f;
        const M visible = less(all(0.0f), load(shown));
        const Placed p = place(view, cloud, first, lanes);
        F sums[kSums];
        for (int n = 0; n < kSums; ++n) sums[n] = load(all_sums[n] + (first - batch));

        F centre[2], d_row_x[3], d_row_y[3], point[3], mean[3], d_log_scales[3], d_quaternion[4];
        centre_gradient(p, sums, &centre[0], &centre[1]);
        rows_gradient(p, sums, d_row_x, d_row_y);
        point_gradient(view, p, centre[0], centre[1], sums[kDepth], d_row_x, d_row_y, point);
        for (int n = 0; n < 3; ++n) mean[n] = all(r[n]) * point[0] + all(r[3 + n]) * point[1] + all(r[6 + n]) * point[2];
        axes_gradient(view, p, d_row_x, d_row_y, d_log_scales, d_quaternion);
        F d_logit = sums[kP] * (all(1.0f) - p.opacity);
        colour_gradient(cloud, p, sums, visible, first, lanes, mean, out.sh);
        write_rows(mean, 3, visible, first, cloud.count, out.means);
        write_rows(d_log_scales, 3, visible, first, cloud.count, out.log_scales);
        write_rows(d_quaternion, 4, visible, first, cloud.count, out.quaternions);
        write_rows(&d_logit, 1, visible, first, cloud.count, out.opacity_logits);
        write_rows(centre, 2, visible, first, cloud.count, out.offsets);
    }
}

}  // namespace ggvs::GGVS_LEVEL
