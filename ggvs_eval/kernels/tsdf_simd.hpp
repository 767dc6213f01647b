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

// Rays on their way to the surface.
struct Packet {
    PacketView views[kMaxViews];
    F base, whole;  // the sample depth is base + whole * step: skipping steps then gives the same bits as taking them
    F previous;     // depth of the previous sample
    Distance before;  // there
    M positive;       // rays whose previous sample was known and in front
    M active;
    F depth, weight;  // of the surface, 0 before it is met
};

// Packets are marched side by side, and each step is taken for all packets and views before the next: each waits for the one
// before, and a processor looks ahead for work of its own only so far.
constexpr int kMarchedPackets = 2;

GGVS_INLINE F clamp(F x, F low, F high) { return min(max(x, low), high); }

// Where samples lie in an image: the two pixels to interpolate between in each of two rows, and the nearest one.
struct Place {
    I x, y0, y1;  // the pairs begin at (x, y0) and (x, y1)
    I near_x, near_y;
    M last;  // in the last column, which is repeated, the pair begins one pixel earlier
    F fx, fy;
};

GGVS_INLINE Place place_of(const Pinhole& camera, F u, F v) {
    const F width = all(float(camera.width)), height = all(float(camera.height)), zero = all(0.0f), one = all(1.0f);
    F left = clamp(u - all(0.5f), zero, width - one), upper = clamp(v - all(0.5f), zero, height - one);
    Place place;
    place.x = truncate(min(left, max(width - all(2.0f), zero)));
    place.y0 = truncate(upper), place.y1 = truncate(min(upper + one, height - one));
    place.near_x = truncate(u), place.near_y = truncate(v);
    place.last = at_most(width - one, left);
    place.fx = left - to_float(truncate(left)), place.fy = upper - to_float(place.y0);
    return place;
}

// What a view holds at a place.
struct Around {
    F d00, d01, d10, d11, nearest, weight;
};

// The samples of one packet in one view.
struct Site {
    F u, v, depth;  // in its image, and seen from the view
    M inside;       // the image
    Place place;
    int left, top;  // corner of the patch that holds them all, as is usual; -1 if they lie too far apart
    Around around;
};

// Projects the samples `z` into a view's image.
GGVS_INLINE void project(const FieldView& view, const PacketView& ray, F z, Site& site) {
    site.depth = z * ray.z + all(view.map.offset[2]);
    F inverse = all(1.0f) / site.depth;
    site.u = (z * ray.x + all(view.map.offset[0])) * inverse;
    site.v = (z * ray.y + all(view.map.offset[1])) * inverse;
}

GGVS_INLINE void find_place(const FieldView& view, M wanted, Site& site) {
    const F width = all(float(view.camera.width)), height = all(float(view.camera.height)), zero = all(0.0f);
    const F u = site.u, v = site.v;
    M across = both(at_most(zero, u), less(u, width)), down = both(at_most(zero, v), less(v, height));
    site.inside = both(both(wanted, less(zero, site.depth)), both(across, down));
    site.place = place_of(view.camera, u, v);
}

GGVS_INLINE void choose_patch(const FieldView& view, Site& site) {
    const int width = view.camera.width, height = view.camera.height;
    const Place& place = site.place;
    site.left = site.top = -1;
    if (kPatchRows == 0 || width < kPatchColumns || height < kPatchRows || !any(site.inside)) return;
    const uint32_t least = least_halves(select(site.inside, place.x | (place.y0 << 16), all(int32_t(-1))));
    const int left = int(least & 0xffff) < width - kPatchColumns ? int(least & 0xffff) : width - kPatchColumns;
    const int top = int(least >> 16) < height - kPatchRows ? int(least >> 16) : height - kPatchRows;
    const I reach = (place.x - all(int32_t(left))) | ((place.y1 - all(int32_t(top))) << 16);
    if (halves_below(reach, all(int32_t((kPatchColumns - 1) | kPatchRows << 16)), site.inside)) site.left = left, site.top = top;
}

GGVS_INLINE Around read_patch(const FieldView& view, const Site& site) {
    const Place& place = site.place;
    const int64_t corner = int64_t(site.top) * view.camera.width + site.left;
    const Patch depth = load_patch(view.depth + corner, view.camera.width);
    const Patch weight = load_patch(view.weight + corner, view.camera.width);
    const I left = all(int32_t(site.left)), top = all(int32_t(site.top)), one = all(int32_t(1));
    const I upper = ((place.y0 - top) << 3) + (place.x - left), lower = ((place.y1 - top) << 3) + (place.x - left);
    const I nearest = ((place.near_y - top) << 3) + (place.near_x - left);
    return {look(depth, upper),       look(depth, upper + one), look(depth, lower),
            look(depth, lower + one), look(depth, nearest),     look(weight, nearest)};
}

GGVS_INLINE Around gather_around(const FieldView& view, const Place& place, M chosen) {
    const I stride = all(int32_t(view.camera.width)), zero = all(int32_t(0));
    const I nearest = select(chosen, place.near_y * stride + place.near_x, zero);
    const I upper = select(chosen, place.y0 * stride + place.x, zero), lower = select(chosen, place.y1 * stride + place.x, zero);
    Around around;
    around.nearest = gather(view.depth, nearest);
    around.weight = gather(view.weight, nearest);
    if (view.camera.width > 1) {
        gather_pairs(view.depth, upper, &around.d00, &around.d01);
        gather_pairs(view.depth, lower, &around.d10, &around.d11);
    } else {
        around.d00 = around.d01 = gather(view.depth, upper);
        around.d10 = around.d11 = gather(view.depth, lower);
    }
    return around;
}

GGVS_INLINE void look_around(const FieldView& view, Site& site) {
    site.around = site.left >= 0 ? read_patch(view, site) : gather_around(view, site.place, site.inside);
}

// One view's share: distance s_k = D_k[u, v] - z_k (Eq. 9, positive in front of the surface) clamped to +-tau, weight 0 where it is
// below -tau (behind the surface = unknown), outside the image or invalid.
GGVS_INLINE void add_view(const March& march, const FieldView& view, const PacketView& ray, const Site& site, F& sum, F& total) {
    const Place& place = site.place;
    const Around& a = site.around;
    const F per_tau = all(march.per_tau);
    M inside = both(site.inside, less(all(0.0f), a.nearest));
    F distance = (a.nearest - site.depth) * per_tau;
    // Neighbours that may be interpolated differ from the nearest pixel by less than tau: beyond 2 tau they change nothing.
    M close = both(inside, both(less(all(-2.01f), distance), less(distance, all(2.01f))));
    F d00 = select(place.last, a.d01, a.d00), d10 = select(place.last, a.d11, a.d10);
    F low = min(min(d00, a.d01), min(d10, a.d11)), high = max(max(d00, a.d01), max(d10, a.d11));
    M smooth = both(close, both(less(all(0.0f), low), less(high - low, all(march.tau))));
    F top = d00 + place.fx * (a.d01 - d00), bottom = d10 + place.fx * (a.d11 - d10);
    F between = (top + place.fy * (bottom - top) - site.depth) * per_tau;
    distance = select(smooth, between, distance);
    M counts = both(inside, at_most(all(-1.0f), distance));
    F weight = select(counts, min(ray.gain * a.weight, all(view.limit)), all(0.0f));
    sum = sum + weight * min(distance, all(1.0f));
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
    F sum[kCount], total[kCount];
    for (int n = 0; n < kCount; ++n) sum[n] = total[n] = all(0.0f);
    each([&](const FieldView& view, const PacketView& ray, Site& site, int n) { project(view, ray, z[n], site); });
    each([&](const FieldView& view, const PacketView&, Site& site, int n) { find_place(view, wanted[n], site); });
    each([&](const FieldView& view, const PacketView&, Site& site, int) { choose_patch(view, site); });
    each([&](const FieldView& view, const PacketView&, Site& site, int) { look_around(view, site); });
    each([&](const FieldView& view, const PacketView& ray, Site& site, int n) {
        add_view(march, view, ray, site, sum[n], total[n]);
    });
    for (int n = 0; n < kCount; ++n) out[n] = {select(less(all(0.0f), total[n]), sum[n] / total[n], all(0.0f)), total[n]};
}

// How many whole steps from z stay in empty slabs, the last of them still evaluated so that its sign is known.
GGVS_INLINE F empty_steps(const MarchColumn& column, F z, float step) {
    F slab = to_float(bits(z) - all(column.slabs.first_bits)) * all(column.slabs.per_bit);
    F next = gather(column.next_depth, truncate(clamp(slab, all(0.0f), all(float(kSlabs - 1)))));
    F steps = (next - z) * all(1.0f / step) - all(0.01f);
    return to_float(truncate(clamp(steps, all(0.0f), all(1e6f))));
}

// The depth of a packet's next sample; rays that leave the range end there.
GGVS_INLINE F next_depth(const March& march, const MarchColumn& column, Packet& p) {
    const float step = march.step_fraction * march.tau;
    F z = p.base + p.whole * all(step);
    if (march.skip_empty) {
        p.whole = p.whole + empty_steps(column, z, step);
        z = p.base + p.whole * all(step);
    }
    p.active = both(p.active, at_most(z, all(march.far)));
    return z;
}

// What a packet's rays do after the sample at z.
GGVS_INLINE void advance(const March& march, F z, const Distance& s, Packet& p) {
    M known = both(p.active, less(all(0.0f), s.total));
    M positive = both(known, less(all(0.0f), s.mean));
    M crossed = both(but_not(known, positive), p.positive);
    // The surface is where the straight line through the two distances is zero.
    const F share = p.before.mean / (p.before.mean - s.mean);
    p.depth = select(crossed, multiply_add(share, z - p.previous, p.previous), p.depth);
    p.weight = select(crossed, multiply_add(share, s.total - p.before.total, p.before.total), p.weight);
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
        ray.x = all(m[0]) * load(u) + all(m[1]) * load(v) + all(m[2]);
        ray.y = all(m[3]) * load(u) + all(m[4]) * load(v) + all(m[5]);
        ray.z = all(m[6]) * load(u) + all(m[7]) * load(v) + all(m[8]);
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
    p.positive = no_lanes();
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
        for (int n = 0; n < kMarchedPackets; ++n)
            write(march, column.left + n * kPacket, y, packets[n], depth, weight);
    }
}

}  // namespace ggvs::GGVS_LEVEL
