// IBRNet's pooling, a sample per lane: what the views show there, what each makes of the others, and what they say together
// (included by level_*.cpp after compose_simd.hpp and register_simd.hpp). Layers use fused multiply-adds.
#pragma once
#include "ray_pooling.hpp"

namespace ggvs::GGVS_LEVEL {

constexpr float kLog2E = 1.44269504f, kTiny = 1e-8f;

GGVS_INLINE F exponential(F x) { return exp2(min(max(x, all(-80.0f)), all(80.0f)) * all(kLog2E)); }
GGVS_INLINE F elu(F x) { return select(less(all(0.0f), x), x, exponential(min(x, all(0.0f))) - all(1.0f)); }
GGVS_INLINE F logistic(F x) { return all(1.0f) / (all(1.0f) + exponential(all(0.0f) - x)); }

// Adds weights times `x` to `y`, or to the bias where `y` is to be begun.
template <bool kBegin>
GGVS_INLINE void layer_sums(const DenseLayer& layer, const F* x, F* y) {
    for (int first = 0; first < layer.padded; first += kRayOutputs) {
        const float* w = layer.weights + first;
        F sums[kRayOutputs];
#pragma GCC unroll 8
        for (int o = 0; o < kRayOutputs; ++o) sums[o] = kBegin ? all(layer.bias[first + o]) : y[first + o];
        for (int i = 0; i < layer.before; ++i, w += layer.padded) {
            F value = x[i];
#pragma GCC unroll 8
            for (int o = 0; o < kRayOutputs; ++o) sums[o] = multiply_add(all(w[o]), value, sums[o]);
        }
#pragma GCC unroll 8
        for (int o = 0; o < kRayOutputs; ++o) y[first + o] = sums[o];
    }
}

GGVS_INLINE void elu_layer(const DenseLayer& layer, const F* x, F* y) {
    layer_sums<true>(layer, x, y);
    for (int o = 0; o < layer.after; ++o) y[o] = elu(y[o]);
}

// What is kept of a view while the others are looked at.
struct RayLook {
    F *features, *hidden;  // kRaySeen, then kRayFeatures in `hidden`
    F *colour, *direction;  // 3, 4
    F *weight, *mask, *visible;
};

GGVS_INLINE RayLook look_of(F* memory, int view) {
    F* at = memory + view * (kRaySeen + kRayFeatures + 10);
    F* hidden = at + kRaySeen;
    F* colour = hidden + kRayFeatures;
    return {at, hidden, colour, colour + 3, colour + 7, colour + 8, colour + 9};
}

// Whether the view sees any of the samples: what it says of the others has no weight.
GGVS_INLINE bool sees_any(const RayLook& look) { return any(less(all(0.0f), look.mask[0])); }

// Linear between pixels, 0 beyond the border: `channels` values of each lane at (x, y), whole numbers at pixel centres.
GGVS_INLINE void look_up_lanes(const float* image, int height, int width, int channels, F x, F y, F* out) {
    alignas(64) float xs[kWidth], ys[kWidth], shown[kWidth * kRayFeatures];
    store(xs, x);
    store(ys, y);
    for (int lane = 0; lane < kWidth; ++lane) {
        float* to = shown + lane * channels;
        for (int c = 0; c < channels; ++c) to[c] = 0.0f;
        if (!(xs[lane] > -1.0f && ys[lane] > -1.0f && xs[lane] < float(width) && ys[lane] < float(height))) continue;
        const int left = int(xs[lane] + 1.0f) - 1, top = int(ys[lane] + 1.0f) - 1;  // rounded down
        const float right_share = xs[lane] - float(left), lower_share = ys[lane] - float(top);
        for (int corner = 0; corner < 4; ++corner) {
            const int column = left + corner % 2, row = top + corner / 2;
            if (column < 0 || row < 0 || column >= width || row >= height) continue;
            const float share = (corner % 2 ? right_share : 1.0f - right_share) * (corner / 2 ? lower_share : 1.0f - lower_share);
            const float* from = image + (int64_t(row) * width + column) * channels;
            for (int c = 0; c < channels; ++c) to[c] += share * from[c];
        }
    }
    alignas(64) int32_t begins[kWidth];
    for (int lane = 0; lane < kWidth; ++lane) begins[lane] = lane * channels;
    for (int c = 0; c < channels; ++c) out[c] = gather(shown + c, load(begins));
}

struct F3 {
    F x, y, z;
};

GGVS_INLINE F dot(const F3& a, const F3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
GGVS_INLINE F3 minus(const F3& a, const F3& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
GGVS_INLINE F3 over(const F3& a, F length) { return {a.x / length, a.y / length, a.z / length}; }
GGVS_INLINE F3 everywhere(const float* p) { return {all(p[0]), all(p[1]), all(p[2])}; }
GGVS_INLINE F3 unit(const F3& a) { return over(a, sqrt(dot(a, a)) + all(1e-6f)); }

// Colour and features of one view at points of the world, and how differently it looks at them than the target.
GGVS_INLINE void look_at(const RayView& view, const F3& point, const F3& target, const RayLook& look) {
    const float* p = view.projection;
    F3 projected{};
    F* rows[3] = {&projected.x, &projected.y, &projected.z};
    for (int row = 0; row < 3; ++row, p += 4) *rows[row] = dot({all(p[0]), all(p[1]), all(p[2])}, point) + all(p[3]);
    F depth = max(projected.z, all(kTiny)), limit = all(1e6f);
    F u = min(max(projected.x / depth, all(0.0f) - limit), limit), v = min(max(projected.y / depth, all(0.0f) - limit), limit);
    F right = all(float(view.width - 1)), bottom = all(float(view.height - 1));
    M inside = both(both(at_most(all(0.0f), u), at_most(u, right)), both(at_most(all(0.0f), v), at_most(v, bottom)));
    look.mask[0] = select(both(inside, less(all(0.0f), projected.z)), all(1.0f), all(0.0f));
    look_up_lanes(view.image, view.height, view.width, 3, u, v, look.features);
    look_up_lanes(view.features, view.feature_height, view.feature_width, kRayFeatures,
                  u / right * all(float(view.feature_width - 1)), v / bottom * all(float(view.feature_height - 1)),
                  look.features + 3);
    for (int c = 0; c < 3; ++c) look.colour[c] = look.features[c];
    F3 of_target = unit(minus(target, point)), of_view = unit(minus(everywhere(view.centre), point));
    F3 difference = minus(of_target, of_view);
    difference = over(difference, max(sqrt(dot(difference, difference)), all(1e-6f)));
    look.direction[0] = difference.x, look.direction[1] = difference.y, look.direction[2] = difference.z;
    look.direction[3] = dot(of_target, of_view);
}

// Mean and variance over the views of some channels that begin at `channels(view)`, weighted by `weight(view)`.
template <class Channels, class Weight>
GGVS_INLINE void moments_over_views(int views, int count, const Channels& channels, const Weight& weight, F* out) {
    for (int c = 0; c < count; ++c) {
        F mean = all(0.0f), variance = all(0.0f);
        for (int k = 0; k < views; ++k) mean = mean + weight(k) * channels(k)[c];
        for (int k = 0; k < views; ++k) {
            F apart = channels(k)[c] - mean;
            variance = variance + weight(k) * (apart * apart);
        }
        out[c] = mean;
        out[count + c] = variance;
    }
}

// Weights that prefer views along the target's ray, the worst one nothing ("anti-alias pooling").
GGVS_INLINE void weigh_directions(float closeness, F* memory, int views) {
    F least = all(3.0e38f), sum = all(0.0f);
    for (int k = 0; k < views; ++k) {
        RayLook look = look_of(memory, k);
        look.weight[0] = exponential(all(closeness) * (look.direction[3] - all(1.0f)));
        least = min(least, look.weight[0]);
    }
    for (int k = 0; k < views; ++k) {
        RayLook look = look_of(memory, k);
        look.weight[0] = (look.weight[0] - least) * look.mask[0];
        sum = sum + look.weight[0];
    }
    for (int k = 0; k < views; ++k) look_of(memory, k).weight[0] = look_of(memory, k).weight[0] / (sum + all(kTiny));
}

// What each view makes of what all see: `hidden` and `visible`.
GGVS_INLINE void understand(const RayLayers& layers, F* memory, int views, F* scratch) {
    F *pooled = scratch, *shared = pooled + 2 * kRaySeen, *first = shared + kMostRayWidth, *second = first + kMostRayWidth;
    for (int k = 0; k < views; ++k) {
        RayLook look = look_of(memory, k);
        if (!sees_any(look)) continue;
        elu_layer(layers.direction[0], look.direction, first);
        elu_layer(layers.direction[1], first, second);
        for (int c = 0; c < kRaySeen; ++c) look.features[c] = look.features[c] + second[c];
    }
    moments_over_views(
        views, kRaySeen, [&](int k) { return look_of(memory, k).features; }, [&](int k) { return look_of(memory, k).weight[0]; },
        pooled);
    layer_sums<true>(layers.base_shared, pooled, shared);
    for (int k = 0; k < views; ++k) {
        RayLook look = look_of(memory, k);
        if (!sees_any(look)) {
            for (int c = 0; c < kRayFeatures; ++c) look.hidden[c] = all(0.0f);
            look.visible[0] = all(0.0f);
            continue;
        }
        for (int o = 0; o < kMostRayWidth; ++o) first[o] = shared[o];
        layer_sums<false>(layers.base_own, look.features, first);
        for (int o = 0; o < kMostRayWidth; ++o) first[o] = elu(first[o]);
        elu_layer(layers.base, first, look.hidden);
        for (int c = 0; c < kRayFeatures; ++c) first[c] = look.hidden[c] * look.weight[0];
        elu_layer(layers.vis[0], first, second);
        elu_layer(layers.vis[1], second, first);
        for (int c = 0; c < kRayFeatures; ++c) look.hidden[c] = look.hidden[c] + first[c];
        F surely = logistic(first[kRayFeatures]) * look.mask[0];
        for (int c = 0; c < kRayFeatures; ++c) first[c] = look.hidden[c] * surely;
        elu_layer(layers.vis2[0], first, second);
        layer_sums<true>(layers.vis2[1], second, first);
        look.visible[0] = logistic(first[0]) * look.mask[0];
    }
}

// The views' colours mixed by their scores; where none sees the sample, all alike.
GGVS_INLINE void mix_colours(const RayLayers& layers, F* memory, int views, F* scratch, F* colours) {
    F *input = scratch, *first = input + 2 * kRaySeen, *second = first + kMostRayWidth;
    F highest = all(-3.0e38f), sum = all(0.0f);
    for (int k = 0; k < views; ++k) {
        RayLook look = look_of(memory, k);
        look.weight[0] = all(-1e9f);
        highest = max(highest, look.weight[0]);
        if (!sees_any(look)) continue;
        for (int c = 0; c < kRayFeatures; ++c) input[c] = look.hidden[c];
        input[kRayFeatures] = look.visible[0];
        for (int c = 0; c < 4; ++c) input[kRayFeatures + 1 + c] = look.direction[c];
        elu_layer(layers.rgb[0], input, first);
        elu_layer(layers.rgb[1], first, second);
        layer_sums<true>(layers.rgb[2], second, first);
        look.weight[0] = select(less(all(0.0f), look.mask[0]), first[0], all(-1e9f));
        highest = max(highest, look.weight[0]);
    }
    for (int c = 0; c < 3; ++c) colours[c] = all(0.0f);
    for (int k = 0; k < views; ++k) {
        RayLook look = look_of(memory, k);
        F share = exponential(look.weight[0] - highest);
        sum = sum + share;
        for (int c = 0; c < 3; ++c) colours[c] = colours[c] + share * look.colour[c];
    }
    for (int c = 0; c < 3; ++c) colours[c] = colours[c] / sum;
}

// What the sample is, from all views together: 16 values for the attention.
GGVS_INLINE void describe_samples(const RayLayers& layers, F* memory, int views, F* scratch, F* out) {
    F *pooled = scratch, *first = pooled + 2 * kRaySeen, *second = first + kMostRayWidth;
    F sum = all(0.0f), mean = all(0.0f);
    for (int k = 0; k < views; ++k) sum = sum + look_of(memory, k).visible[0];
    for (int k = 0; k < views; ++k) {
        RayLook look = look_of(memory, k);
        look.weight[0] = look.visible[0] / (sum + all(kTiny));
        mean = mean + look.weight[0];
    }
    moments_over_views(
        views, kRayFeatures, [&](int k) { return look_of(memory, k).hidden; },
        [&](int k) { return look_of(memory, k).weight[0]; }, pooled);
    pooled[2 * kRayFeatures] = mean / all(float(views));
    elu_layer(layers.geometry[0], pooled, first);
    elu_layer(layers.geometry[1], first, second);
    for (int c = 0; c < kRayOut; ++c) out[c] = second[c];
}

// Points of a packet of samples of a ray; lanes beyond the last repeat it.
GGVS_INLINE F3 points_of(const RayPooling& job, int64_t ray, int first) {
    alignas(64) float depths[kWidth];
    for (int lane = 0; lane < kWidth; ++lane) {
        const int sample = first + lane < job.n_samples ? first + lane : job.n_samples - 1;
        depths[lane] = job.depths[ray * job.n_samples + sample];
    }
    F depth = load(depths);
    F3 from = everywhere(job.centre), along = everywhere(job.rays + 3 * ray);
    return {from.x + depth * along.x, from.y + depth * along.y, from.z + depth * along.z};
}

// All samples of one ray.
static void pool_ray(const RayPooling& job, int64_t ray, const RaySamples& out, void* memory) {
    const int views = int(job.views.size());
    F* looks = static_cast<F*>(memory);
    F* scratch = looks + views * (kRaySeen + kRayFeatures + 10);
    for (int first = 0; first < job.n_samples; first += kWidth) {
        const F3 points = points_of(job, ray, first);
        F seen_by = all(0.0f), colours[3], features[kRayOut];
        for (int k = 0; k < views; ++k) {
            look_at(job.views[k], points, everywhere(job.centre), look_of(looks, k));
            seen_by = seen_by + look_of(looks, k).mask[0];
        }
        weigh_directions(job.layers.closeness, looks, views);
        understand(job.layers, looks, views, scratch);
        mix_colours(job.layers, looks, views, scratch, colours);
        describe_samples(job.layers, looks, views, scratch, features);
        for (int c = 0; c < 3; ++c) store(out.colours + c * out.stride + first, colours[c]);
        for (int c = 0; c < kRayOut; ++c) store(out.features + c * out.stride + first, features[c]);
        store(out.seen_by + first, seen_by);
    }
}

}  // namespace ggvs::GGVS_LEVEL
