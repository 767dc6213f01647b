// The composition's arithmetic, written once for every instruction set (included by level_*.cpp after register_simd.hpp,
// whose names it uses).
#pragma once
#include "compose.hpp"

namespace ggvs::GGVS_LEVEL {

GGVS_INLINE F mixed(F share, F from, F to) { return multiply_add(share, to - from, from); }

// 2^x for -126 < x < 126 to 2e-7, from integer and fractional part; the coefficients are the minimax polynomial on [-1/2, 1/2].
GGVS_INLINE F exp2(F x) {
    constexpr float kCoefficients[] = {9.671513338e-3f, 5.550733752e-2f, 2.402224207e-1f, 6.931469776e-1f, 1.0f};
    F shifted = x + all(12582912.0f);  // 1.5 * 2^23: rounds to the nearest integer in the low mantissa bits
    F rest = x - (shifted - all(12582912.0f)), p = all(1.326472634e-3f);
#pragma GCC unroll 5
    for (const float coefficient : kCoefficients) p = p * rest + all(coefficient);
    return from_bits(bits(p) + (bits(shifted) << 23));
}

// The background's weight: the sigmoid of a change plus the logit of where it starts.
GGVS_INLINE F background_weight(F change, F start, float sure) {
    const F one = all(1.0f);
    start = min(max(start, all(sure)), all(1.0f - sure));
    change = min(max(change, all(-80.0f)), all(80.0f));  // beyond, the weight is 0 or 1, and the exponential no float
    F odds = exp2(change * all(-1.44269504f));
    return start / (start + (one - start) * odds);
}

// The views' mean colours and one over the sum of their weights; weights and colours are kept in `kept`, four packets a view.
GGVS_INLINE Colour foreground(const ComposedRow& row, int x, int count, F* per, F* shown, float* kept) {
    const Composition& job = row.job;
    const int64_t pixels = int64_t(job.height) * job.width, first = int64_t(row.y) * job.width + x;
    Colour sum{all(0.0f), all(0.0f), all(0.0f)};
    F total = all(0.0f);
    *shown = all(0.0f);
    for (int k = 0; k < job.views; ++k, kept += 4 * kWidth) {
        F coverage = load_part(job.coverage + k * pixels + first, count);
        F weight = load(row.enlarged + k * row.stride + x) * coverage;
        Colour colour = load_colour(job.colours + 3 * (k * pixels + first), count);
        add(sum, weight, colour);
        total = total + weight, *shown = *shown + coverage;
        store(kept, weight), store(kept + kWidth, colour.red);
        store(kept + 2 * kWidth, colour.green), store(kept + 3 * kWidth, colour.blue);
    }
    *per = all(1.0f) / max(total, all(kNoWeight));
    return {sum.red * *per, sum.green * *per, sum.blue * *per};
}

GGVS_INLINE void compose_packet(const ComposedRow& row, int x, int count) {
    const Composition& job = row.job;
    const int64_t pixels = int64_t(job.height) * job.width, first = int64_t(row.y) * job.width + x;
    const float* change = row.enlarged + job.views * row.stride + x;
    F per, shown, zero = all(0.0f), one = all(1.0f);
    Colour picture = foreground(row, x, count, &per, &shown, row.scratch);
    Colour behind = load_colour(job.background + 3 * first, count);
    F share = background_weight(load(change), load_part(job.unseen + first, count), job.sure);
    picture.red = mixed(share, picture.red, min(max(behind.red + load(change + row.stride), zero), one));
    picture.green = mixed(share, picture.green, min(max(behind.green + load(change + 2 * row.stride), zero), one));
    picture.blue = mixed(share, picture.blue, min(max(behind.blue + load(change + 3 * row.stride), zero), one));
    F variance = zero;
    const float* kept = row.scratch;
    for (int k = 0; k < job.views; ++k, kept += 4 * kWidth) {
        F red = load(kept + kWidth) - picture.red, green = load(kept + 2 * kWidth) - picture.green;
        F blue = load(kept + 3 * kWidth) - picture.blue;
        variance = multiply_add(load(kept), multiply_add(red, red, multiply_add(green, green, blue * blue)), variance);
    }
    store_part(row.out.picture + first, picture.red, count);
    store_part(row.out.picture + pixels + first, picture.green, count);
    store_part(row.out.picture + 2 * pixels + first, picture.blue, count);
    store_part(row.out.spread + first, sqrt(variance * per * all(1.0f / 3.0f)), count);
    store_part(row.out.shown + first, shown, count);
}

static void compose_row(const ComposedRow& row) {
    const int width = row.job.width;
    for (int x = 0; x < width; x += kWidth) compose_packet(row, x, width - x < kWidth ? width - x : kWidth);
}

}  // namespace ggvs::GGVS_LEVEL
