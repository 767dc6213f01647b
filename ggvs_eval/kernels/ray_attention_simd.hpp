// IBRNet's attention along a ray, four heads, and the density that follows; a sample that asks per lane
// (included by level_*.cpp after ray_pooling_simd.hpp). Layers use fused multiply-adds.
#pragma once
#include "ray_pooling.hpp"

namespace ggvs::GGVS_LEVEL {

constexpr int kHeads = 4, kHeadWidth = kRayOut / kHeads;
constexpr float kScoreScale = 0.5f, kNormEpsilon = 1e-6f;  // 1 / sqrt(width of a head)

// Features of a packet of samples, each told apart by its place on the ray; lanes beyond the last sample are of no use.
GGVS_INLINE void placed_features(const RayPooling& job, const RaySamples& ray, int first, F* out) {
    alignas(64) float place[kWidth];
    for (int c = 0; c < kRayOut; ++c) {
        for (int lane = 0; lane < kWidth; ++lane)
            place[lane] = first + lane < job.n_samples ? job.places[(first + lane) * kRayOut + c] : 0.0f;
        out[c] = load(ray.features + c * ray.stride + first) + load(place);
    }
}

GGVS_INLINE F score_of(const RaySamples& ray, const F* query, int head, int key) {
    F score = all(0.0f);
    for (int d = 0; d < kHeadWidth; ++d)
        score = multiply_add(all(ray.keys[(head * kHeadWidth + d) * ray.stride + key]), query[head * kHeadWidth + d], score);
    return score;
}

// The values of all samples, mixed by softmax of the scores of a packet of samples.
GGVS_INLINE void mix_values(const RaySamples& ray, int samples, const F* query, F* out) {
    for (int head = 0; head < kHeads; ++head) {
        F highest = all(-3.0e38f), sum = all(0.0f), mixed[kHeadWidth];
        for (int key = 0; key < samples; ++key) highest = max(highest, score_of(ray, query, head, key));
        for (int d = 0; d < kHeadWidth; ++d) mixed[d] = all(0.0f);
        for (int key = 0; key < samples; ++key) {
            F share = exponential(score_of(ray, query, head, key) - highest);
            sum = sum + share;
            for (int d = 0; d < kHeadWidth; ++d)
                mixed[d] = multiply_add(all(ray.values[(head * kHeadWidth + d) * ray.stride + key]), share, mixed[d]);
        }
        for (int d = 0; d < kHeadWidth; ++d) out[head * kHeadWidth + d] = mixed[d] / sum;
    }
}

GGVS_INLINE void normalise_sample(const RayLayers& layers, F* x) {
    F mean = all(0.0f), variance = all(0.0f);
    for (int c = 0; c < kRayOut; ++c) mean = mean + x[c];
    mean = mean * all(1.0f / kRayOut);
    for (int c = 0; c < kRayOut; ++c) variance = variance + (x[c] - mean) * (x[c] - mean);
    F deviation = sqrt(variance * all(1.0f / kRayOut) + all(kNormEpsilon));
    for (int c = 0; c < kRayOut; ++c)
        x[c] = (x[c] - mean) / deviation * all(layers.norm_gain[c]) + all(layers.norm_shift[c]);
}

// Density of all samples of a ray; 0 where no view sees one. What fewer than two views see asks nothing and takes the mean.
static void attend_ray(const RayPooling& job, const RaySamples& ray, void* memory) {
    const RayLayers& layers = job.layers;
    F *placed = static_cast<F*>(memory), *query = placed + kRayOut, *other = query + kRayOut, *mixed = other + kRayOut;
    for (int first = 0; first < job.n_samples; first += kWidth) {
        placed_features(job, ray, first, placed);
        layer_sums<true>(layers.keys, placed, query);
        layer_sums<true>(layers.values, placed, other);
        for (int c = 0; c < kRayOut; ++c) store(ray.keys + c * ray.stride + first, query[c]);
        for (int c = 0; c < kRayOut; ++c) store(ray.values + c * ray.stride + first, other[c]);
    }
    for (int first = 0; first < job.n_samples; first += kWidth) {
        F seen_by = load(ray.seen_by + first);
        placed_features(job, ray, first, placed);
        layer_sums<true>(layers.queries, placed, query);
        F scale = select(less(all(1.0f), seen_by), all(kScoreScale), all(0.0f));
        for (int c = 0; c < kRayOut; ++c) query[c] = query[c] * scale;
        mix_values(ray, job.n_samples, query, mixed);
        layer_sums<true>(layers.mixed, mixed, other);
        for (int c = 0; c < kRayOut; ++c) other[c] = other[c] + placed[c];
        normalise_sample(layers, other);
        elu_layer(layers.density[0], other, mixed);
        layer_sums<true>(layers.density[1], mixed, query);
        store(ray.density + first, select(less(all(0.0f), seen_by), max(query[0], all(0.0f)), all(0.0f)));
    }
}

}  // namespace ggvs::GGVS_LEVEL
