// IBRNet's ray network: what it makes of its source views at the samples of rays, and of the samples of a ray together.
// The arithmetic stands in ray_pooling_simd.hpp and ray_attention_simd.hpp.
#pragma once
#include <cstdint>
#include <vector>

namespace ggvs {

constexpr int kRayFeatures = 32;                 // of a source view, beside its colour
constexpr int kRaySeen = 3 + kRayFeatures;       // colour and features
constexpr int kRayOut = 16;                      // of a sample, for the attention
constexpr int kRayOutputs = 8;                   // outputs of a layer that are summed side by side
constexpr int kMostRayWidth = 64;                // of a layer
constexpr int kRayPacket = 16;                   // samples that are worked on together: the lanes of the widest vector

// A linear layer: weights (before, padded) with the outputs side by side, bias (padded); `after` filled up to a multiple of 8.
struct DenseLayer {
    int before, after, padded;
    const float *weights, *bias;
};

// The layers in the order in which they are used; those of base_fc cut into what the views share and what is a view's own.
struct RayLayers {
    DenseLayer direction[2];  // ray_dir_fc: 4 - 16 - 35
    DenseLayer base_shared;   // first of base_fc, for mean and variance: 70 - 64
    DenseLayer base_own;      // the same for a view: 35 - 64, without bias
    DenseLayer base;          // 64 - 32
    DenseLayer vis[2];        // vis_fc: 32 - 32 - 33
    DenseLayer vis2[2];       // vis_fc2: 32 - 32 - 1
    DenseLayer geometry[2];   // geometry_fc: 65 - 64 - 16
    DenseLayer rgb[3];        // rgb_fc: 37 - 16 - 8 - 1
    DenseLayer queries, keys, values, mixed;  // of the attention: 16 - 16, without bias
    DenseLayer density[2];    // out_geometry_fc: 16 - 16 - 1
    const float *norm_gain, *norm_shift;  // of its layer norm, (16)
    float closeness;          // |s|, how much a view that looks along the target's ray is preferred
};

struct RayView {
    const float* image;  // (height, width, 3), [0, 1]
    int height, width;
    const float* features;  // (feature_height, feature_width, 32)
    int feature_height, feature_width;
    float projection[12];  // world to image, pixel centres at whole numbers
    float centre[3];
};

struct RayPooling {
    RayLayers layers;
    std::vector<RayView> views;
    float centre[3];      // of the target camera
    const float* rays;    // (rays, 3), such that centre + depth * ray has that depth
    const float* depths;  // (rays, samples)
    const float* places;  // (samples, 16): sinusoids that tell the samples of a ray apart
    int64_t n_rays;
    int n_samples;
};

// The samples of one ray, channels one after another, filled up to whole packets.
struct RaySamples {
    float* colours;   // (3, stride)
    float* features;  // (16, stride)
    float* seen_by;   // (stride): number of views that see it
    float* density;   // (stride)
    float *keys, *values;  // (16, stride)
    int stride;
};

struct RayColours {
    float* colours;  // (rays, samples, 3)
    float* density;  // (rays, samples), per sample, not per length
};

void pool_views(const RayPooling& job, const RayColours& out, int level);

}  // namespace ggvs
