// What blending wants to know of the views before it looks closer, in one pass over them.
#pragma once
#include <cstdint>
#include <vector>

#include "register.hpp"

namespace ggvs {

// K views in the target view, nearest first.
struct Views {
    int width, height, views, scale;
    RegisteredMaps maps;               // colours, factors of the weights, how far they show what the target sees
    std::vector<const float*> alphas;  // of each view (height, width), coverage of its splat
    std::vector<const float*> depths;  // some maps (height, width)
    const float* weights;              // (views), of each beside the others
    float covered_alpha;               // coverage from which a splat shows something
};

struct OverviewMaps {
    float* mean;      // (height, width, 3): of the colours, weighted by coverage and view
    float* unseen;    // (height, width): how little of what the target sees any view shows
    bool* covered;    // (height, width): whether a splat shows something
    float* small[4];  // colours, coverage, seen, alphas: means of scale x scale pixels, the last row and column repeated
    float* depths;    // one pixel of each so many, of each of the depths
};

void overview(const Views& job, const OverviewMaps& out, int threads, int level);

// Registers the views into the maps of `job`, all rows of them, and looks at each band of them while it lies in the cache.
void register_and_overview(Registration& registration, const Views& job, const OverviewMaps& out, int threads, int level);

}  // namespace ggvs
