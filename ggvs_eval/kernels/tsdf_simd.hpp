// The inner loops of the TSDF, written once for every instruction set (included by level_*.cpp after a simd_*.hpp).
#pragma once
#include "tsdf.hpp"

namespace ggvs::GGVS_LEVEL {

// Eqs. 11-12: omega = min(noise / sqrt(nu / 49), 1), nu = sum of min((D[u, v] - D[p, q])^2, tau^2) over the 7 x 7 window.
// Invalid and outside neighbours count tau^2. `row.out` may be written up to a multiple of the vector width.
static void fusion_row(const FusionRow& row) {
    const F most = all(row.tau * row.tau);
    for (int x = 0; x < row.width; x += kWidth) {
        F centre = load(row.rows[kReach] + x + kReach);
        F nu = all(0.0f);
        for (int dy = 0; dy < kWindow; ++dy) {
            const float* neighbours = row.rows[dy] + x;
            F line = all(0.0f);
            for (int dx = 0; dx < kWindow; ++dx) {
                F difference = centre - load(neighbours + dx);
                line = line + min(difference * difference, most);
            }
            nu = nu + line;
        }
        F omega = min(all(row.scale) / sqrt(nu), all(1.0f));  // nu = 0 divides to infinity: omega = 1
        store(row.out + x, select(less(centre, all(kFarAway * 0.5f)), omega, all(0.0f)));
    }
}

// A packet of rays in one view: the homogeneous image point of depth z is z * direction + offset.
struct PacketView {
    F x, y, z;
    F gain;
};

struct Distance {
    F mean;   // weighted mean of the clamped distances in units of tau, -1 .. 1
    F total;  // sum of the weights, 0 = unknown
};

GGVS_INLINE F clamp(F x, F low, F high) { return min(max(x, low), high); }

// One view's share at the samples `z`: distance s_k = D_k[u, v] - z_k (Eq. 9, positive in front of the surface) clamped to +-tau,
// weight 0 where it is below -tau (behind the surface = unknown), outside the image or invalid.
GGVS_INLINE void add_view(const FieldView& view, const PacketView& ray, F z, M wanted, float tau, F& sum, F& total) {
    F depth_k = z * ray.z + all(view.map.offset[2]);
    F inverse = all(1.0f) / depth_k;
    F u = (z * ray.x + all(view.map.offset[0])) * inverse;
    F v = (z * ray.y + all(view.map.offset[1])) * inverse;
    const float width = float(view.camera.width), height = float(view.camera.height);
    M inside = both(wanted, less(all(0.0f), depth_k));
    inside =
        both(inside, both(both(at_most(all(0.0f), u), less(u, all(width))), both(at_most(all(0.0f), v), less(v, all(height)))));
    if (!any(inside)) return;

    u = select(inside, u, all(0.5f));
    v = select(inside, v, all(0.5f));
    I stride = all(int32_t(view.camera.width));
    I nearest = truncate(v) * stride + truncate(u);
    F depth = gather(view.depth, nearest);
    inside = both(inside, less(all(0.0f), depth));
    F distance = (depth - depth_k) * all(1.0f / tau);
    // Neighbours that may be interpolated differ from the nearest pixel by less than tau: beyond 2 tau they change nothing.
    M close = both(inside, both(less(all(-2.01f), distance), less(distance, all(2.01f))));
    if (any(close)) {
        F left = clamp(u - all(0.5f), all(0.0f), all(width - 1.0f)), upper = clamp(v - all(0.5f), all(0.0f), all(height - 1.0f));
        I x0 = truncate(left), y0 = truncate(upper), y1 = truncate(min(upper + all(1.0f), all(height - 1.0f)));
        F fx = left - to_float(x0), fy = upper - to_float(y0);
        F d00, d01, d10, d11;
        if (view.camera.width > 1) {
            // In the last column, which is repeated, the pair begins one pixel earlier.
            I first = truncate(min(left, all(width - 2.0f)));
            gather_pairs(view.depth, y0 * stride + first, &d00, &d01);
            gather_pairs(view.depth, y1 * stride + first, &d10, &d11);
            M last = at_most(all(width - 1.0f), left);
            d00 = select(last, d01, d00);
            d10 = select(last, d11, d10);
        } else {
            d00 = d01 = gather(view.depth, y0);
            d10 = d11 = gather(view.depth, y1);
        }
        F low = min(min(d00, d01), min(d10, d11)), high = max(max(d00, d01), max(d10, d11));
        M smooth = both(close, both(less(all(0.0f), low), less(high - low, all(tau))));
        F top = d00 + fx * (d01 - d00), bottom = d10 + fx * (d11 - d10);
        F between = (top + fy * (bottom - top) - depth_k) * all(1.0f / tau);
        distance = select(smooth, between, distance);
    }
    M counts = both(inside, at_most(all(-1.0f), distance));
    if (!any(counts)) return;
    F weight = min(ray.gain * gather(view.weight, nearest), all(view.limit));
    weight = select(counts, weight, all(0.0f));
    sum = sum + weight * min(distance, all(1.0f));
    total = total + weight;
}

// Eq. 10, normalised: the mean of the views' clamped distances.
GGVS_INLINE Distance sample(const March& march, const PacketView* rays, F z, M wanted) {
    F sum = all(0.0f), total = all(0.0f);
    const FieldView* views = march.views.data();
    const int count = int(march.views.size());
    for (int k = 0; k < count; ++k) add_view(views[k], rays[k], z, wanted, march.tau, sum, total);
    F mean = select(less(all(0.0f), total), sum / total, all(0.0f));
    return {mean, total};
}

// How many whole steps from z stay in empty slabs, the last of them still evaluated so that its sign is known.
GGVS_INLINE F empty_steps(const MarchColumn& column, F z, float step) {
    F slab = to_float(bits(z) - all(column.slabs.first_bits)) * all(column.slabs.per_bit);
    F next = gather(column.next_depth, truncate(clamp(slab, all(0.0f), all(float(kSlabs - 1)))));
    F steps = (next - z) * all(1.0f / step) - all(0.01f);
    return to_float(truncate(clamp(steps, all(0.0f), all(1e6f))));
}

struct Packet {
    F base, whole;  // the sample depth is base + whole * step: skipping steps then gives the same bits as taking them
    F previous;     // depth of the previous sample
    M positive;     // rays whose previous sample was known and in front
    M active, hit;
    F front, behind;  // around the zero crossing
};

// Sphere tracing with the minimum step (Eq. 3 with the readings of ggvs_eval/geometry/tsdf.py).
GGVS_INLINE void find_crossings(const March& march, const MarchColumn& column, const PacketView* rays, Packet& p) {
    const float step = march.step_fraction * march.tau;
    while (any(p.active)) {
        F z = p.base + p.whole * all(step);
        if (march.skip_empty) {
            p.whole = p.whole + empty_steps(column, z, step);
            z = p.base + p.whole * all(step);
        }
        p.active = both(p.active, at_most(z, all(march.far)));
        Distance s = sample(march, rays, z, p.active);
        M known = both(p.active, less(all(0.0f), s.total));
        M positive = both(known, less(all(0.0f), s.mean));
        M crossed = both(but_not(known, positive), p.positive);
        p.front = select(crossed, p.previous, p.front);
        p.behind = select(crossed, z, p.behind);
        p.hit = either(p.hit, crossed);
        p.active = but_not(p.active, crossed);

        M shorter = both(positive, less(s.mean, all(1.0f)));
        F advance = max(all(march.step_fraction) * s.mean, all(march.min_step)) * all(march.tau);
        p.base = select(shorter, z + advance, p.base);
        p.whole = select(shorter, all(0.0f), p.whole + all(1.0f));
        p.previous = z;
        p.positive = positive;
    }
}

GGVS_INLINE void bisect(const March& march, const PacketView* rays, Packet& p) {
    for (int n = 0; n < march.bisections; ++n) {
        F middle = all(0.5f) * (p.front + p.behind);
        Distance s = sample(march, rays, middle, p.hit);
        M positive = both(less(all(0.0f), s.total), less(all(0.0f), s.mean));
        p.front = select(positive, middle, p.front);
        p.behind = select(positive, p.behind, middle);
    }
}

GGVS_INLINE void march_packet(const March& march, const MarchColumn& column, int left, int top, PacketView* rays, float* depth,
                              float* weight) {
    const int width = march.target.width, height = march.target.height;
    alignas(64) float u[kWidth], v[kWidth], gain[kWidth];
    alignas(64) int32_t inside[kWidth];
    for (int lane = 0; lane < kWidth; ++lane) {
        const int x = left + lane % kPacket, y = top + lane / kPacket;
        u[lane] = float(x) + 0.5f, v[lane] = float(y) + 0.5f;
        inside[lane] = x < width && y < height;
    }
    const FieldView* views = march.views.data();
    for (int k = 0; k < int(march.views.size()); ++k) {
        const float* m = views[k].map.matrix;
        rays[k].x = all(m[0]) * load(u) + all(m[1]) * load(v) + all(m[2]);
        rays[k].y = all(m[3]) * load(u) + all(m[4]) * load(v) + all(m[5]);
        rays[k].z = all(m[6]) * load(u) + all(m[7]) * load(v) + all(m[8]);
        for (int lane = 0; lane < kWidth; ++lane) {
            const int64_t pixel = int64_t(top + lane / kPacket) * width + left + lane % kPacket;
            gain[lane] = views[k].gain && inside[lane] ? views[k].gain[pixel] : 1.0f;
        }
        rays[k].gain = load(gain);
    }
    Packet p;
    p.base = all(march.near);
    p.whole = p.previous = p.front = p.behind = all(0.0f);
    p.positive = p.hit = no_lanes();
    p.active = less(all(0.5f), to_float(load(inside)));
    find_crossings(march, column, rays, p);

    alignas(64) float z[kWidth] = {}, total[kWidth] = {};
    if (any(p.hit)) {
        bisect(march, rays, p);
        F middle = all(0.5f) * (p.front + p.behind);
        Distance s = sample(march, rays, middle, p.hit);
        store(z, select(p.hit, middle, all(0.0f)));
        store(total, select(p.hit, s.total, all(0.0f)));
    }
    for (int lane = 0; lane < kWidth; ++lane) {
        if (!inside[lane]) continue;
        const int64_t pixel = int64_t(top + lane / kPacket) * width + left + lane % kPacket;
        depth[pixel] = z[lane];
        weight[pixel] = total[lane];
    }
}

// The 8 x 8 rays of one occupancy column.
static void march_column(const March& march, const MarchColumn& column, float* depth, float* weight) {
    constexpr int kRows = kWidth / kPacket;  // of a packet
    PacketView rays[kMaxViews];
    for (int y = column.top; y < column.top + kMarchTile && y < march.target.height; y += kRows)
        for (int x = column.left; x < column.left + kMarchTile && x < march.target.width; x += kPacket)
            march_packet(march, column, x, y, rays, depth, weight);
}

}  // namespace ggvs::GGVS_LEVEL
