// The inner loops of semi-global matching, written once for every instruction set (included by stereo_*.cpp after a simd_*.hpp).
#pragma once
#include "sgm.hpp"

namespace ggvs::GGVS_LEVEL {

constexpr int kBytes = kWidth == 4 ? 16 : 32;
constexpr int kStretch = 64;    // pixels between looks at the row before
constexpr int kNeighbours = 2;  // planes this near to the best one are no rivals
typedef uint8_t Bytes __attribute__((vector_size(kBytes)));
typedef uint8_t Bytes16 __attribute__((vector_size(16)));

GGVS_INLINE Bytes load_bytes(const uint8_t* p) {
    Bytes v;
    __builtin_memcpy(&v, p, sizeof v);
    return v;
}
GGVS_INLINE void store_bytes(uint8_t* p, Bytes v) { __builtin_memcpy(p, &v, sizeof v); }
GGVS_INLINE Bytes least(Bytes a, Bytes b) { return a < b ? a : b; }
GGVS_INLINE Bytes rounded_mean(Bytes a, Bytes b) { return (a | b) - ((a ^ b) >> 1); }  // (a + b + 1) / 2

#if defined(__clang__)
#define GGVS_TURN(v, a, b, c, d, e, f, g, h) \
    __builtin_shufflevector(v, v, a, b, c, d, e, f, g, h, a, b, c, d, e, f, g, h)
#else
#define GGVS_TURN(v, a, b, c, d, e, f, g, h) __builtin_shuffle(v, Bytes16{a, b, c, d, e, f, g, h, a, b, c, d, e, f, g, h})
#endif

GGVS_INLINE int least_lane(Bytes v) {
    Bytes16 m, n;
    __builtin_memcpy(&m, &v, 16);
    __builtin_memcpy(&n, reinterpret_cast<const char*>(&v) + kBytes - 16, 16);
    m = m < n ? m : n;
    n = GGVS_TURN(m, 8, 9, 10, 11, 12, 13, 14, 15), m = m < n ? m : n;
    n = GGVS_TURN(m, 4, 5, 6, 7, 4, 5, 6, 7), m = m < n ? m : n;
    n = GGVS_TURN(m, 2, 3, 2, 3, 2, 3, 2, 3), m = m < n ? m : n;
    n = GGVS_TURN(m, 1, 1, 1, 1, 1, 1, 1, 1), m = m < n ? m : n;
    return m[0];
}
#undef GGVS_TURN

// The costs of one path at one pixel; `before` and `lowest` are those of the pixel before it on the path. Returns the smallest.
GGVS_INLINE uint8_t follow(const uint8_t* costs, const uint8_t* before, int lowest, int small, int large, int planes,
                           uint8_t* path) {
    const Bytes base = Bytes{} + uint8_t(lowest), jump = Bytes{} + uint8_t(lowest + large), slope = Bytes{} + uint8_t(small);
    Bytes smallest = Bytes{} + uint8_t(255);
    for (int d = 0; d < planes; d += kBytes) {
        Bytes beside = least(load_bytes(before + d - 1), load_bytes(before + d + 1)) + slope;
        Bytes value = load_bytes(costs + d) + (least(least(load_bytes(before + d), beside), jump) - base);
        store_bytes(path + d, value);
        smallest = least(smallest, value);
    }
    return uint8_t(least_lane(smallest));
}

// Winner takes all, to a fraction of a plane by the parabola through its neighbours.
GGVS_INLINE void choose(const SgmTask& task, const SgmResult& result, const uint8_t* first, const uint8_t* second,
                        int64_t pixel) {
    uint16_t total[kMaxPlanes];
    uint32_t best = ~0u, rival = 0xffff;
    for (int d = 0; d < task.planes; ++d) {
        total[d] = uint16_t(first[d] + second[d]);
        const uint32_t key = uint32_t(total[d]) << 16 | uint32_t(d);
        best = key < best ? key : best;
    }
    const int plane = int(best & 0xffff), lowest = int(best >> 16);
    for (int d = 0; d < task.planes; ++d) {
        const uint32_t value = (d - plane <= kNeighbours && plane - d <= kNeighbours) ? 0xffffu : uint32_t(total[d]);
        rival = value < rival ? value : rival;
    }
    float fraction = 0.0f;
    if (plane > 0 && plane < task.planes - 1) {
        const int below = total[plane - 1] - lowest, above = total[plane + 1] - lowest;
        if (below + above > 0) fraction = 0.5f * float(below - above) / float(below + above);
    }
    result.surface[pixel] = float(plane) + fraction;
    result.margin[pixel] = 0.5f * float(int(rival) - lowest);
}

GGVS_INLINE uint8_t large_step(const SgmTask& task, int64_t pixel, int64_t neighbour) {
    const int difference = task.guide[pixel] - task.guide[neighbour];
    return task.large_steps[difference < 0 ? -difference : difference];
}

// The path along the row: its costs here and at the pixel before, with edges that no step can come from.
struct AlongRow {
    alignas(64) uint8_t paths[2][kMaxPlanes + 2 * SgmPass::kEdge];
    int lowest;
};

// Returns the costs of the path at column x; there is none before the first column.
GGVS_INLINE const uint8_t* follow_along(const SgmTask& task, int64_t pixel, int64_t before, int x, AlongRow& along) {
    uint8_t* here = along.paths[x % 2];
    __builtin_memset(here, 255 - task.small_step, SgmPass::kEdge);
    __builtin_memset(here + SgmPass::kEdge + task.planes, 255 - task.small_step, SgmPass::kEdge);
    const int large = x > 0 ? large_step(task, pixel, before) : 0;
    const uint8_t* last = along.paths[(x + 1) % 2] + SgmPass::kEdge;
    const uint8_t* costs = task.costs + pixel * task.planes;
    along.lowest = follow(costs, last, along.lowest, task.small_step, large, task.planes, here + SgmPass::kEdge);
    return here + SgmPass::kEdge;
}

// The three paths that come from the row before; beyond the image they start anew.
GGVS_INLINE void follow_down(SgmPass& pass, int row, int x, int64_t pixel, int turn) {
    const SgmTask& task = pass.task;
    for (int n = 0; n < SgmPass::kRowPaths; ++n) {
        const int from = x + n - 1;
        const bool inside = row > 0 && from >= 0 && from < task.width;
        const int large = inside ? large_step(task, pixel, pixel + turn * (n - 1 - int64_t(task.width))) : 0;
        const uint8_t* costs = task.costs + pixel * task.planes;
        pass.minimum(row, n, x) = follow(costs, pass.path(row - 1, n, from), pass.minimum(row - 1, n, from), task.small_step, large,
                                         task.planes, pass.path(row, n, x));
    }
}

GGVS_INLINE void store_means(SgmPass& pass, int row, int x, const uint8_t* along, uint8_t* out) {
    for (int d = 0; d < pass.task.planes; d += kBytes) {
        Bytes first = rounded_mean(load_bytes(pass.path(row, 0, x) + d), load_bytes(pass.path(row, 1, x) + d));
        Bytes second = rounded_mean(load_bytes(pass.path(row, 2, x) + d), load_bytes(along + d));
        store_bytes(out + d, rounded_mean(first, second));
    }
}

static void aggregate_row(SgmPass& pass, int row) {
    const SgmTask& task = pass.task;
    const bool mirrored = pass.result != nullptr;
    const int width = task.width, turn = mirrored ? -1 : 1;
    const int64_t first = mirrored ? int64_t(task.height - row) * width - 1 : int64_t(row) * width;
    AlongRow along{};
    alignas(64) uint8_t means[kMaxPlanes];
    for (int x = 0; x < width; ++x) {
        if (row > 0 && x % kStretch == 0) pass.wait_for(row - 1, x + kStretch < width ? x + kStretch + 1 : width);
        const int64_t pixel = first + turn * x;
        const uint8_t* beside = follow_along(task, pixel, pixel - turn, x, along);
        follow_down(pass, row, x, pixel, turn);
        store_means(pass, row, x, beside, mirrored ? means : pass.means + pixel * task.planes);
        if (mirrored) choose(task, *pass.result, pass.means + pixel * task.planes, means, pixel);
        if ((x + 1) % kStretch == 0) pass.finish(row, x + 1);
    }
    pass.finish(row, width);
}

}  // namespace ggvs::GGVS_LEVEL
