// Minimal filtering's arithmetic beside the sums (included after a simd_*.hpp).
#pragma once
#include "minimal_filtering.hpp"

namespace ggvs::GGVS_LEVEL {

// What six sums are taken of, made of six neighbours.
GGVS_INLINE void make_sources(const F (&d)[kFilteredSums], F (&sources)[kFilteredSums]) {
    const F four = all(4.0f), two = all(2.0f), minus_five = all(-5.0f), minus_four = all(-4.0f);
    const F even = multiply_add(minus_four, d[2], d[4]), odd = multiply_add(minus_four, d[1], d[3]);
    const F wide = d[4] - d[2], twice = two * (d[3] - d[1]);
    sources[0] = multiply_add(four, d[0], multiply_add(minus_five, d[2], d[4]));
    sources[1] = even + odd;
    sources[2] = even - odd;
    sources[3] = wide + twice;
    sources[4] = wide - twice;
    sources[5] = multiply_add(four, d[1], multiply_add(minus_five, d[3], d[5]));
}

// The four values that six sums stand for.
GGVS_INLINE void make_values(const F (&sums)[kFilteredSums], F (&values)[kFilteredValues]) {
    const F even = sums[1] + sums[2], odd = sums[1] - sums[2], far_even = sums[3] + sums[4], far_odd = sums[3] - sums[4];
    values[0] = sums[0] + even + far_even;
    values[1] = multiply_add(all(2.0f), far_odd, odd);
    values[2] = multiply_add(all(4.0f), far_even, even);
    values[3] = multiply_add(all(8.0f), far_odd, odd) + sums[5];
}

}  // namespace ggvs::GGVS_LEVEL
