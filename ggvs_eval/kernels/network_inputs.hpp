// The channels that the blending network looks at (ggvs_eval/pipelines/online/network_inputs.py says what they mean).
#pragma once
#include <cstdint>

namespace ggvs {

// K views in the target view and the surface they are looked at by.
struct NetworkInputs {
    int width, height, views;
    int most_views;         // that the network is made for; channels of absent ones are 0
    const float* colours;   // (views, height, width, 3)
    const float* depths;    // (views, height, width), 0 = unknown
    const float* alphas;    // (views, height, width)
    const float* seen;      // (views, height, width), or null if the network does not look at it
    const float* fused;     // (height, width), 0 = unknown
    const float *across, *down;  // slope of the target's rays per column and per row
    float far, unit;             // depth of what is unknown; what depths are measured in
    const float* centres;        // (views, 3) in the target's frame
    const float *distances, *axes;  // (views)
};

// How many channels that is.
int network_channels(const NetworkInputs& job);

// (network_channels, height, width)
void network_inputs(const NetworkInputs& job, float* out, int threads);

}  // namespace ggvs
