// The arithmetic of the outputs' reading, written once for every instruction set (included by level_*.cpp after compose_simd.hpp,
// whose names it uses).
#pragma once
#include "outputs.hpp"

namespace ggvs::GGVS_LEVEL {

constexpr float kLog2OfE = 1.44269504f;

// Within what `exp2` takes; beyond, weights are 0 but for 2^-126.
GGVS_INLINE F exponential_of(F x) { return exp2(min(max(x * all(kLog2OfE), all(-125.0f)), all(125.0f))); }

GGVS_INLINE F hyperbolic_tangent(F x) {
    const F one = all(1.0f), squared = exponential_of(min(max(x, all(-20.0f)), all(20.0f)) * all(2.0f));
    return (squared - one) / (squared + one);
}

GGVS_INLINE void read_outputs_packet(const RawOutputs& job, const ReadOutputs& out, int64_t first, int count) {
    const F zero = all(0.0f), one = all(1.0f);
    const auto logit = [&](int k) { return load_part(job.raw + k * job.cells + first, count) + all(job.logarithms[k]); };
    F highest = logit(0), total = zero, covered = zero, seen = zero;
    for (int k = 1; k < job.views; ++k) highest = max(highest, logit(k));
    for (int k = 0; k < job.views; ++k) total = total + exponential_of(logit(k) - highest);
    const F per = one / total;
    for (int k = 0; k < job.views; ++k) {
        const F weight = exponential_of(logit(k) - highest) * per;
        store_part(out.small + k * job.cells + first, weight, count);
        covered = multiply_add(weight, load_part(job.coverage + k * job.cells + first, count), covered);
        seen = seen + load_part(job.seen + k * job.cells + first, count);
    }
    const F change = load_part(job.raw + job.most_views * job.cells + first, count);
    store_part(out.small + job.views * job.cells + first, change, count);
    for (int c = 1; c < 4; ++c)
        store_part(out.small + (job.views + c) * job.cells + first,
                   hyperbolic_tangent(load_part(job.raw + (job.most_views + c) * job.cells + first, count)), count);
    const F foreground = one - background_weight(change, one - min(seen, one), job.sure);
    const F share = foreground / max(covered, all(kNoWeight));
    for (int k = 0; k < job.views; ++k) {
        const int64_t at = k * job.cells + first;
        store_part(out.shares + at, load_part(out.small + at, count) * load_part(job.coverage + at, count) * share, count);
    }
}

static void read_outputs_chunk(const RawOutputs& job, const ReadOutputs& out, int64_t first, int count) {
    for (int x = 0; x < count; x += kWidth) read_outputs_packet(job, out, first + x, count - x < kWidth ? count - x : kWidth);
}

}  // namespace ggvs::GGVS_LEVEL
