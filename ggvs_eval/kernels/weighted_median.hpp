// Edges of a depth map, moved to those of the image.
#pragma once
#include <cstdint>

namespace ggvs {

struct MedianTask {
    const float* surface;  // (height, width), in planes from 0
    const uint8_t* guide;  // (height, width, 3), colour
    int height, width, planes;
    int radius;          // of the window, pixels
    float colour_scale;  // weights fall by e for each so many grey values of difference
    float tolerance;     // what lies within so many planes of the median stays as it is
};

// Replaces what is far from the weighted median of its window by the mean of what is near that median.
void weighted_median(const MedianTask& task, float* filtered, int threads);

}  // namespace ggvs
