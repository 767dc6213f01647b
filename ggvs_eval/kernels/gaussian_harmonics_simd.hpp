// Real spherical harmonics of a batch of directions, and their derivatives (included by gaussian_*.cpp after a simd_*.hpp).
// Y(l, m) = Q(l, |m|)(z) times the real part of (x + i y)^m for m >= 0, the imaginary part of (x + i y)^|m| for m < 0.
#pragma once
#include "gaussian_splat.hpp"

namespace ggvs::GGVS_LEVEL {

// Q(l, m) as a polynomial in z, constant first, with the Condon-Shortley phase; l (l + 1) / 2 + m is its row.
static const float kPolynomials[15][5] = {
    {0.28209479177387814f},
    {0, 0.4886025119029199f},
    {-0.4886025119029199f},
    {-0.31539156525252005f, 0, 0.9461746957575601f},
    {0, -1.0925484305920792f},
    {0.5462742152960396f},
    {0, -1.1195289977703462f, 0, 1.865881662950577f},
    {0.4570457994644658f, 0, -2.285228997322329f},
    {0, 1.445305721320277f},
    {-0.5900435899266435f},
    {0.31735664074561293f, 0, -3.1735664074561294f, 0, 3.7024941420321507f},
    {0, 2.0071396306718676f, 0, -4.683325804901024f},
    {-0.47308734787878004f, 0, 3.3116114351514603f},
    {0, -1.7701307697799304f},
    {0.6258357354491761f},
};

// Powers of x + i y: real and imaginary parts.
struct Turns {
    F real[kMostDegree + 1], imaginary[kMostDegree + 1];
};

GGVS_INLINE Turns turns_of(F x, F y, int degree) {
    Turns t;
    t.real[0] = all(1.0f), t.imaginary[0] = all(0.0f);
    for (int m = 1; m <= degree; ++m) {
        t.real[m] = x * t.real[m - 1] - y * t.imaginary[m - 1];
        t.imaginary[m] = x * t.imaginary[m - 1] + y * t.real[m - 1];
    }
    return t;
}

// The polynomial of degree l - m, and its derivative.
GGVS_INLINE void evaluate(int l, int m, F z, F* value, F* slope) {
    const float* terms = kPolynomials[l * (l + 1) / 2 + m];
    F sum = all(terms[l - m]), derivative = all(0.0f);
    for (int n = l - m - 1; n >= 0; --n) {
        derivative = derivative * z + sum;
        sum = sum * z + all(terms[n]);
    }
    *value = sum, *slope = derivative;
}

// All harmonics up to a degree, in the order l^2 + l + m.
GGVS_INLINE void harmonics(int degree, const F* direction, F* out) {
    const Turns t = turns_of(direction[0], direction[1], degree);
    for (int l = 0; l <= degree; ++l) {
        for (int m = 0; m <= l; ++m) {
            F value, slope;
            evaluate(l, m, direction[2], &value, &slope);
            out[l * l + l - m] = value * t.imaginary[m];
            out[l * l + l + m] = value * t.real[m];  // for m = 0 this one stays
        }
    }
}

// The derivative by the direction of the sum of harmonics times `weights`.
GGVS_INLINE void harmonics_gradient(int degree, const F* direction, const F* weights, F* out) {
    const Turns t = turns_of(direction[0], direction[1], degree);
    F x = all(0.0f), y = x, z = x;
    for (int l = 1; l <= degree; ++l) {
        for (int m = 0; m <= l; ++m) {
            F value, slope;
            evaluate(l, m, direction[2], &value, &slope);
            F real = weights[l * l + l + m], imaginary = m ? weights[l * l + l - m] : all(0.0f);
            z = z + slope * (real * t.real[m] + imaginary * t.imaginary[m]);
            if (m == 0) continue;
            F times = all(float(m)) * value;  // d (x + i y)^m = m (x + i y)^(m - 1) (dx + i dy)
            x = x + times * (real * t.real[m - 1] + imaginary * t.imaginary[m - 1]);
            y = y + times * (imaginary * t.real[m - 1] - real * t.imaginary[m - 1]);
        }
    }
    out[0] = x, out[1] = y, out[2] = z;
}

}  // namespace ggvs::GGVS_LEVEL
