// The composition of a blending network's outputs (Eqs. 4-5), and what it tells about how sure the picture is.
#pragma once
#include "enlarge.hpp"

namespace ggvs {

struct Composition {
    int width, height, views;
    const float* colours;     // (views, height, width, 3)
    const float* coverage;    // (views, height, width), factors of the weights
    const float* unseen;      // (height, width), in [0, 1]
    const float* background;  // (height, width, 3)
    SmallMaps small;          // weight of each view, logit of the background's weight, change of its colour (3), and more
    float sure;               // the background's weight starts between this and 1 - this
};

struct ComposedMaps {
    float* picture;  // (3, height, width)
    float* spread;   // (height, width): standard deviation of the views
    float* shown;    // (height, width): sum of the coverages
};

// One row: the enlarged small maps lie in `enlarged`, lines of `stride` floats; `scratch` holds 4 * views packets of 16 floats.
struct ComposedRow {
    const Composition& job;
    const ComposedMaps& out;
    int y;
    const float* enlarged;
    int64_t stride;
    float* scratch;
};

void compose(const Composition& job, const ComposedMaps& out, int threads, int level);

}  // namespace ggvs
