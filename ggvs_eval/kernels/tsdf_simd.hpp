// The inner loops of the TSDF, written once for every instruction set (included by level_*.cpp after a simd_*.hpp).
// Products are rounded before they are added: the march on a device (contrib/warp/march.py) has the same bits.
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

// Rays on their way to the surface.
struct Packet {
    PacketView views[kMaxViews];
    F base, whole;    // the sample depth is base + whole * step: skipping steps then gives the same bits as taking them
    F previous;       // depth of the previous sample
    Distance before;  // there
    M positive;       // rays whose previous sample was known and in front
    M skipped;        // rays that took whole steps through empty space to this sample, the last without a sample before it
    M active;
    F depth, weight;  // of the surface, 0 before it is met
};

// Packets are marched side by side, and each step is taken for all packets and views before the next: each waits for the one
// before, and a processor looks ahead for work of its own only so far.
constexpr int kMarchedPackets = 2;

GGVS_INLINE F clamp(F x, F low, F high) { return min(max(x, low), high); }

// The samples of one packet in one view. Each lies between four pixels, the upper left one of which is (x, y): at the border
// between the last four.
struct Site {
    F depth;         // seen from the view
    M inside;        // the image
    I x, y;          // columns and rows of the upper left pixels
    F fx, fy;        // from their centres, in pixels
    I at;            // the upper left pixels in a patch that holds them all, 8 * row + column
    int64_t corner;  // where the patch begins; -1 if they lie too far apart for one, which is rare
};

// Projects the samples `z` into a view's image.
GGVS_INLINE void project(const FieldView& view, const PacketView& ray, F z, M wanted, Site& site) {
    const F zero = all(0.0f);
    site.depth = z * ray.z + all(view.map.offset[2]);
    const F inverse = all(1.0f) / site.depth;
    const F u = (z * ray.x + all(view.map.offset[0])) * inverse;
    const F v = (z * ray.y + all(view.map.offset[1])) * inverse;
    const M across = within(u, view.width), down = within(v, view.height);
    site.inside = both(both(wanted, less(zero, site.depth)), both(across, down));
    const F left = clamp(u - all(0.5f), zero, all(view.last_left)), upper = clamp(v - all(0.5f), zero, all(view.last_upper));
    site.x = truncate(left), site.y = truncate(upper);
    site.fx = left - to_float(site.x), site.fy = upper - to_float(site.y);
}

GGVS_INLINE void choose_patch(const FieldView& view, Site& site) {
    const int width = view.camera.width, height = view.camera.height;
    site.corner = -1;
    if (kPatchRows == 0 || width < kPatchColumns || height < kPatchRows || !any(site.inside)) return;
    const I pixel = site.x | (site.y << 16);
    const uint32_t least = least_halves(select(site.inside, pixel, all(int32_t(-1))));
    const int left = std::min(int(least & 0xffff), width - kPatchColumns);
    const int top = std::min(int(least >> 16), height - kPatchRows);
    const I reach = select(site.inside, pixel - all(int32_t(left | top << 16)), all(int32_t(0)));
    if (!halves_below(reach, all(int32_t((kPatchColumns - 1) | (kPatchRows - 1) << 16)))) return;
    site.at = reach | (reach >> 13);
    site.corner = int64_t(top) * width + left;
}

// What a view holds around the samples: the depths of the four pixels, and the weight of the nearest of them.
struct Around {
    F d00, d01, d10, d11, weight;
};

// Asks for what the columns of rays beside this one will look at: each row of each image is a stream of addresses, more than a
// processor foresees by itself.
GGVS_INLINE void prefetch_beside(const float* corner, int64_t stride) {
    constexpr int kAhead = 3 * kMarchTile;
    for (int row = 0; row < kMarchTile; ++row) __builtin_prefetch(corner + row * stride + kAhead);
}

// `right` and `below`: where the nearest of the four pixels lies.
GGVS_INLINE Around read_patch(const FieldView& view, const Site& site, M right, M below) {
    const Patch depth = load_patch(view.depth + site.corner, view.camera.width);
    const Patch weight = load_patch(view.weight + site.corner, view.camera.width);
    prefetch_beside(view.depth + site.corner, view.camera.width);
    prefetch_beside(view.weight + site.corner, view.camera.width);
    const I one = all(int32_t(1)), row = all(int32_t(kPatchColumns)), lower = site.at + row;
    const I nearest = select(below, lower, site.at);
    const M upper_half = half_of_patch(site.at), lower_half = half_of_patch(lower);
    return {look(depth, site.at, upper_half), look(depth, site.at + one, upper_half), look(depth, lower, lower_half),
            look(depth, lower + one, lower_half), look(weight, select(right, nearest + one, nearest), half_of_patch(nearest))};
}

GGVS_INLINE Around gather_around(const FieldView& view, const Site& site, M right, M below) {
    const int32_t width = view.camera.width;
    const I one = all(int32_t(width > 1)), row = all(int32_t(view.camera.height > 1 ? width : 0)), zero = all(int32_t(0));
    const I upper = select(site.inside, site.y * all(width) + site.x, zero), lower = upper + row;
    const I nearest = select(below, lower, upper);
    Around around;
    around.weight = gather(view.weight, select(right, nearest + one, nearest));
    if (width > 1) {
        gather_pairs(view.depth, upper, &around.d00, &around.d01);
        gather_pairs(view.depth, lower, &around.d10, &around.d11);
    } else {
        around.d00 = around.d01 = gather(view.depth, upper);
        around.d10 = around.d11 = gather(view.depth, lower);
    }
    return around;
}

// One view's share: distance s_k = D_k[u, v] - z_k (Eq. 9, positive in front of the surface) clamped to +-tau, weight 0 where it is
// below -tau (behind the surface = unknown), outside the image or invalid.
GGVS_INLINE void add_view(F tau, F per_tau, const FieldView& view, const PacketView& ray, const Site& site, F& sum, F& total) {
    const F zero = all(0.0f), one = all(1.0f);
    const M right = at_most(all(0.5f), site.fx), below = at_most(all(0.5f), site.fy);
    const Around a = site.corner >= 0 ? read_patch(view, site, right, below) : gather_around(view, site, right, below);
    const F nearest = select(below, select(right, a.d11, a.d10), select(right, a.d01, a.d00));
    const F low = min(min(a.d00, a.d01), min(a.d10, a.d11)), high = max(max(a.d00, a.d01), max(a.d10, a.d11));
    const M smooth = both(less(zero, low), less(high - low, tau));
    const F top = a.d00 + site.fx * (a.d01 - a.d00), bottom = a.d10 + site.fx * (a.d11 - a.d10);
    const F between = top + site.fy * (bottom - top);
    const F distance = (select(smooth, between, nearest) - site.depth) * per_tau;
    const M counts = both(both(site.inside, less(zero, nearest)), at_most(all(-1.0f), distance));
    const F weight = select(counts, view.gain ? min(ray.gain * a.weight, all(view.limit)) : a.weight, zero);
    sum = sum + weight * min(distance, one);
    total = total + weight;
}

// Eq. 10, normalised: the mean of the views' clamped distances, at one depth of each ray that is wanted.
template <int kCount>
GGVS_INLINE void sample(const March& march, const Packet* packets, const F (&z)[kCount], const M (&wanted)[kCount],
                        Distance (&out)[kCount]) {
    Site sites[kMaxViews][kCount];
    const auto each = [&](const auto& step) {
        for (size_t k = 0; k < march.views.size(); ++k)
#pragma GCC unroll 2
            for (int n = 0; n < kCount; ++n) step(march.views[k], packets[n].views[k], sites[k][n], n);
    };
    const F tau = all(march.tau), per_tau = all(march.per_tau);
    F sum[kCount], total[kCount];
    for (int n = 0; n < kCount; ++n) sum[n] = total[n] = all(0.0f);
    each([&](const FieldView& view, const PacketView& ray, Site& site, int n) { project(view, ray, z[n], wanted[n], site); });
    each([&](const FieldView& view, const PacketView&, Site& site, int) { choose_patch(view, site); });
    each([&](const FieldView& view, const PacketView& ray, Site& site, int n) {
        add_view(tau, per_tau, view, ray, site, sum[n], total[n]);
    });
    for (int n = 0; n < kCount; ++n) out[n] = {select(less(all(0.0f), total[n]), sum[n] / total[n], all(0.0f)), total[n]};
}

// How many whole steps lead from z to where a sample is needed: all but the last end in empty slabs, where views say 'free' or
// 'unknown', and another whole step follows.
GGVS_INLINE F empty_steps(const MarchColumn& column, F z, float step) {
    F slab = to_float(bits(z) - all(column.slabs.first_bits)) * all(column.slabs.per_bit);
    F next = gather(column.next_depth, truncate(clamp(slab, all(0.0f), all(float(kSlabs - 1)))));
    F steps = (next - z) * all(1.0f / step) - all(0.01f);
    return select(less(all(0.0f), steps), to_float(truncate(min(steps, all(1e6f)))) + all(1.0f), all(0.0f));
}

// The depth of a packet's next sample; rays that leave the range end there.
GGVS_INLINE F next_depth(const March& march, const MarchColumn& column, Packet& p) {
    const float step = march.step_fraction * march.tau;
    F z = p.base + p.whole * all(step);
    if (march.skip_empty) {
        const F skipped = empty_steps(column, z, step);
        p.whole = p.whole + skipped;
        z = p.base + p.whole * all(step);
        p.skipped = less(all(0.0f), skipped);
    }
    p.active = both(p.active, at_most(z, all(march.far)));
    return z;
}

// Takes the last sample that was skipped after all, for rays that may have crossed the surface since. That is rare, as most
// surfaces have occupied slabs before them.
static __attribute__((noinline)) void look_back(const March& march, M rays, Packet& p) {
    const F z[1] = {p.base + (p.whole - all(1.0f)) * all(march.step_fraction * march.tau)};
    const M wanted[1] = {rays};
    Distance found[1];
    sample<1>(march, &p, z, wanted, found);
    p.previous = select(rays, z[0], p.previous);
    p.before = {select(rays, found[0].mean, p.before.mean), select(rays, found[0].total, p.before.total)};
    p.positive = either(p.positive, both(rays, both(less(all(0.0f), found[0].total), less(all(0.0f), found[0].mean))));
}

// What a packet's rays do after the sample at z.
GGVS_INLINE void advance(const March& march, F z, const Distance& s, Packet& p) {
    M known = both(p.active, less(all(0.0f), s.total));
    M positive = both(known, less(all(0.0f), s.mean));
    if (march.skip_empty) {
        p.positive = but_not(p.positive, p.skipped);
        const M doubtful = both(but_not(known, positive), p.skipped);
        if (any(doubtful)) look_back(march, doubtful, p);
    }
    M crossed = both(but_not(known, positive), p.positive);
    // The surface is where the straight line through the two distances is zero.
    const F share = p.before.mean / (p.before.mean - s.mean);
    p.depth = select(crossed, p.previous + share * (z - p.previous), p.depth);
    p.weight = select(crossed, p.before.total + share * (s.total - p.before.total), p.weight);
    p.active = but_not(p.active, crossed);

    M shorter = both(positive, less(s.mean, all(1.0f)));
    F length = max(all(march.step_fraction) * s.mean, all(march.min_step)) * all(march.tau);
    p.base = select(shorter, z + length, p.base);
    p.whole = select(shorter, all(0.0f), p.whole + all(1.0f));
    p.previous = z, p.before = s;
    p.positive = positive;
}

template <int kCount>
GGVS_INLINE void take_step(const March& march, const MarchColumn& column, Packet* packets) {
    F z[kCount];
    M active[kCount];
    Distance found[kCount];
    for (int n = 0; n < kCount; ++n) z[n] = next_depth(march, column, packets[n]), active[n] = packets[n].active;
    sample<kCount>(march, packets, z, active, found);
    for (int n = 0; n < kCount; ++n) advance(march, z[n], found[n], packets[n]);
}

// Sphere tracing with the minimum step (Eq. 3 with the readings of ggvs_eval/geometry/tsdf.py).
GGVS_INLINE void find_crossings(const March& march, const MarchColumn& column, Packet (&packets)[kMarchedPackets]) {
    while (any(packets[0].active) && any(packets[1].active)) take_step<kMarchedPackets>(march, column, packets);
    for (Packet& packet : packets)
        while (any(packet.active)) take_step<1>(march, column, &packet);
}

GGVS_INLINE void start(const March& march, int left, int top, Packet& p) {
    const int width = march.target.width, height = march.target.height;
    alignas(64) float u[kWidth], v[kWidth];
    alignas(64) int32_t inside[kWidth];
    for (int lane = 0; lane < kWidth; ++lane) {
        const int x = left + lane % kPacket, y = top + lane / kPacket;
        u[lane] = float(x) + 0.5f, v[lane] = float(y) + 0.5f;
        inside[lane] = x < width && y < height;
    }
    for (size_t k = 0; k < march.views.size(); ++k) {
        const FieldView& view = march.views[k];
        const float* m = view.map.matrix;
        PacketView& ray = p.views[k];
        const auto along = [&](const float* row) { return all(row[0]) * load(u) + all(row[1]) * load(v) + all(row[2]); };
        ray.x = along(m), ray.y = along(m + 3), ray.z = along(m + 6);
        ray.gain = all(1.0f);
        if (!view.gain) continue;
        alignas(64) float gain[kWidth];
        for (int lane = 0; lane < kWidth; ++lane) {
            const int64_t pixel = int64_t(top + lane / kPacket) * width + left + lane % kPacket;
            gain[lane] = inside[lane] ? view.gain[pixel] : 1.0f;
        }
        ray.gain = load(gain);
    }
    p.base = all(march.near);
    p.whole = p.previous = p.before.mean = p.before.total = p.depth = p.weight = all(0.0f);
    p.positive = p.skipped = no_lanes();
    p.active = less(all(0.5f), to_float(load(inside)));
}

GGVS_INLINE void write(const March& march, int left, int top, const Packet& p, float* depth, float* weight) {
    alignas(64) float lanes[2][kWidth];
    store(lanes[0], p.depth), store(lanes[1], p.weight);
    for (int lane = 0; lane < kWidth; ++lane) {
        const int x = left + lane % kPacket, y = top + lane / kPacket;
        if (x >= march.target.width || y >= march.target.height) continue;
        const int64_t pixel = int64_t(y) * march.target.width + x;
        depth[pixel] = lanes[0][lane], weight[pixel] = lanes[1][lane];
    }
}

// The 8 x 8 rays of one occupancy column.
static void march_column(const March& march, const MarchColumn& column, float* depth, float* weight) {
    constexpr int kRows = kWidth / kPacket;  // of a packet
    static_assert(kMarchTile == kMarchedPackets * kPacket, "the packets that are marched together lie side by side in a column");
    Packet packets[kMarchedPackets];
    for (int y = column.top; y < column.top + kMarchTile && y < march.target.height; y += kRows) {
        for (int n = 0; n < kMarchedPackets; ++n) start(march, column.left + n * kPacket, y, packets[n]);
        find_crossings(march, column, packets);
        for (int n = 0; n < kMarchedPackets; ++n) write(march, column.left + n * kPacket, y, packets[n], depth, weight);
    }
}

}  // namespace ggvs::GGVS_LEVEL
