// What blending wants to know of the views before it looks closer, in one pass over them.
#pragma once
#include <cstdint>
#include <vector>

namespace ggvs {

// K views in the target view, nearest first.
struct Views {
    int width, height, views, scale;
    const float* colours;              // (views, height, width, 3)
    const float* coverage;             // (views, height, width), factors of the weights
    const float* seen;                 // (views, height, width), how far they show what the target sees
    std::vector<const float*> alphas;  // of each view (height, width), coverage of its splat
    const float* weights;              // (views), of each beside the others
    float covered_alpha;               // coverage from which a splat shows something
};

struct OverviewMaps {
    float* mean;      // (height, width, 3): of the colours, weighted by coverage and view
    float* unseen;    // (height, width): how little of what the target sees any view shows
    bool* covered;    // (height, width): whether a splat shows something
    float* small[4];  // colours, coverage, seen, alphas: means of scale x scale pixels, the last row and column repeated
};

void overview(const Views& job, const OverviewMaps& out, int threads, int level);

}  // namespace ggvs
