// Least squares on the images along their rows (Lucas and Kanade 1981), which moves every disparity to where both fit best.
//
// Interpolation is rounded once, as cv2.remap rounds it with fused multiply-adds, and means over windows are cv2.blur's running
// sums, so that the refined disparity has the same bits as one by these.
#pragma once
#include <cstdint>

namespace ggvs {

struct SubpixelTask {
    const uint8_t *left, *right;  // (height, width), grey
    const float* slope;           // (height, width), of the right image along its rows, grey values per pixel
    const float* disparity;       // (height, width), pixels, 0 = invalid and left so
    int height, width;
    float gain;          // of the right image, so that it has the left one's contrast
    int window;          // side of the windows, pixels
    float largest_step;  // of one iteration, pixels
    float noise;         // mean squared slope that noise alone makes
};

// The right image's grey values at the matches of a left one's pixels, (height, width).
void sample_matches(const SubpixelTask& task, float* matched);

// `refined` may be none of the inputs.
void refine_matches(const SubpixelTask& task, int iterations, float* refined);

}  // namespace ggvs
