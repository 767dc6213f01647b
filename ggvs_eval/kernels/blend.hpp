// Several views made one image: splatted ones by their weights, captured ones where a known surface projects into them.
#pragma once
#include <cstdint>
#include <vector>

#include "camera.hpp"

namespace ggvs {

// A view's colours in the target view and its weight, factor * weight[pixel].
struct WeightedView {
    const float* colour;  // (pixels, stride), the first three count
    int stride;
    const float* weight;  // (pixels)
    float factor;
};

// A sum of weights below this is none: it keeps a division by zero away and darkens nothing, however small the weights are.
constexpr float kNoWeight = 1e-30f;

// Weighted mean of the views, (pixels, 3), black where no view has weight.
void weighted_mean(const std::vector<WeightedView>& views, int64_t pixels, float* out, int threads);

// One splatted feature and the coverage it came with.
struct CoveredFeature {
    const float* feature;  // (pixels, stride), the first counts
    int stride;
    const float* alpha;  // (pixels)
};

// Largest feature of the views that cover a pixel by at least `least_alpha`; `otherwise` where none does.
void largest_feature(const std::vector<CoveredFeature>& views, int64_t pixels, float least_alpha, float otherwise, float* out,
                     int threads);

// What a view shows of a surface whose depth is uncertain: errors of depth move it by less, the nearer the view is to the target.
struct Forgiven {
    float slack;  // differences of inverse depth that count as none
    float far;    // depth at which surfaces of unknown depth are looked up; 0: nowhere
};

// A captured view that a surface is looked up in.
struct LookUpView {
    Pinhole camera;
    const double* from_target;  // target camera -> this camera, rigid 4x4
    const uint8_t* image;       // (height, width, 3), at least two pixels
    const float* depth;         // (height, width), 0 = invalid
    float factor;               // of its visibility among those of the views that see the surface
    Forgiven forgiven;
    PixelMap map;  // filled by look_up
};

struct LookUp {
    Pinhole target;
    const float* depth;       // (height, width) of the target, 0 = unknown
    const float* background;  // (height, width, 3)
    float tolerance;          // visibility as in warp.hpp
    std::vector<LookUpView> views;
};

// Each view sampled at the target's surface, their weighted mean, over the background: (height, width, 3).
void look_up(LookUp& job, float* out, int threads, int level);

}  // namespace ggvs
