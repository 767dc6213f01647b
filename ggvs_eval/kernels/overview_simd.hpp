// The overview of a row of pixels, written once for every instruction set (included by level_*.cpp after register_simd.hpp, whose
// names it uses).
#pragma once
#include "overview.hpp"

namespace ggvs::GGVS_LEVEL {

using Bytes = int8_t __attribute__((vector_size(kWidth)));

GGVS_INLINE void overview_packet(const Views& job, const OverviewMaps& out, int y, int x, int count) {
    const int64_t first = int64_t(y) * job.width + x;
    const F zero = all(0.0f), one = all(1.0f), least = all(job.covered_alpha);
    Colour sum{zero, zero, zero};  // as `weighted_mean` (blend.cpp) has it
    F total = zero, shown = zero;
    I covered = all(int32_t(0));
    for (int k = 0; k < job.views; ++k) {
        const int64_t at = (int64_t(k) * job.maps.rows + y - job.maps.first_row) * job.width + x;
        const F weight = all(job.weights[k]) * load_part(job.maps.coverage + at, count);
        const Colour colour = load_colour(job.maps.colours + 3 * at, count);
        total = total + weight;
        add(sum, weight, colour);
        shown = shown + load_part(job.maps.seen + at, count);
        covered = select(less(least, load_part(job.alphas[k] + first, count)), all(int32_t(1)), covered);
    }
    const F per = one / max(total, all(kNoWeight));
    store_colour(out.mean + 3 * first, {sum.red * per, sum.green * per, sum.blue * per}, count);
    store_part(out.unseen + first, one - min(shown, one), count);
    const Bytes bytes = __builtin_convertvector(covered, Bytes);
    __builtin_memcpy(out.covered + first, &bytes, count);
}

static void overview_row(const Views& job, const OverviewMaps& out, int y) {
    for (int x = 0; x < job.width; x += kWidth) overview_packet(job, out, y, x, job.width - x < kWidth ? job.width - x : kWidth);
}

}  // namespace ggvs::GGVS_LEVEL
