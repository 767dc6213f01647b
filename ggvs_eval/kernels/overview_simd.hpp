// The overview of a row of pixels, written once for every instruction set (included by level_*.cpp after register_simd.hpp, whose
// names it uses).
#pragma once
#include "overview.hpp"

namespace ggvs::GGVS_LEVEL {

GGVS_INLINE void overview_packet(const Views& job, const OverviewMaps& out, int64_t first, int count) {
    const int64_t pixels = int64_t(job.height) * job.width;
    const F zero = all(0.0f), one = all(1.0f), least = all(job.covered_alpha);
    Colour sum{zero, zero, zero};  // as `weighted_mean` (blend.cpp) has it
    F total = zero, shown = zero, covered = zero;
    for (int k = 0; k < job.views; ++k) {
        const int64_t at = k * pixels + first;
        const F weight = all(job.weights[k]) * load_part(job.coverage + at, count);
        const Colour colour = load_colour(job.colours + 3 * at, count);
        total = total + weight;
        sum.red = sum.red + weight * colour.red;
        sum.green = sum.green + weight * colour.green;
        sum.blue = sum.blue + weight * colour.blue;
        shown = shown + load_part(job.seen + at, count);
        covered = select(less(least, load_part(job.alphas[k] + first, count)), one, covered);
    }
    total = max(total, all(kNoWeight));
    store_colour(out.mean + 3 * first, {sum.red / total, sum.green / total, sum.blue / total}, count);
    store_part(out.unseen + first, one - min(shown, one), count);
    alignas(64) float lanes[kWidth];
    store(lanes, covered);
    for (int lane = 0; lane < count; ++lane) out.covered[first + lane] = lanes[lane] > 0.0f;
}

static void overview_row(const Views& job, const OverviewMaps& out, int y) {
    const int64_t row = int64_t(y) * job.width;
    for (int x = 0; x < job.width; x += kWidth)
        overview_packet(job, out, row + x, job.width - x < kWidth ? job.width - x : kWidth);
}

}  // namespace ggvs::GGVS_LEVEL
