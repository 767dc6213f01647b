// What IBRNet makes of its source views at the samples of rays: colours, and what the ray attention goes on with.
// The arithmetic stands in ray_pooling_simd.hpp.
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
    int64_t n_rays;
    int n_samples;
};

struct RaySamples {
    float* colours;   // (rays, samples, 3)
    float* features;  // (rays, samples, 16)
    float* seen_by;   // (rays, samples): number of views that see it
};

void pool_views(const RayPooling& job, const RaySamples& out, int level);

// Floats of memory that a packet of samples needs for so many views.
int64_t packet_floats(int views);

}  // namespace ggvs
