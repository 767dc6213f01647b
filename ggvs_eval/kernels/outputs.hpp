// What the raw outputs of the blending network mean, at its own size.
#pragma once
#include <cstdint>

namespace ggvs {

// Maps of `cells` values each; `views` of the `most_views` that the network takes are there.
struct RawOutputs {
    int64_t cells;
    int views, most_views, features;
    const float* raw;        // (most_views + 4 + features), as `read_outputs` (blend_network.py) says
    const float* logarithms;  // (views), of each view's weight beside the others
    const float* coverage;   // (views), factors of the weights
    const float* seen;       // (views), how far they show what the target sees
    float sure;              // the background's weight starts between this and 1 - this
};

struct ReadOutputs {
    float* small;   // (views + 4 + features): weights that sum to 1, change of the background's, change of its colour, features
    float* shares;  // (views): of each in the composed picture
};

void read_outputs(const RawOutputs& job, const ReadOutputs& out, int threads, int level);

}  // namespace ggvs
