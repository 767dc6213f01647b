// An 8-bit picture times a gain per channel and a smooth factor that is a product of one over rows and one over columns.
#pragma once
#include <cstdint>

namespace ggvs {

struct Shading {
    const uint8_t* image;  // (height, width, 3)
    const float* gain;     // (3)
    const float* down;     // (height)
    const float* across;   // (width)
    int width, height;
};

// Rounded and clipped to 8 bit, (height, width, 3).
void shade(const Shading& job, uint8_t* out, int threads);

}  // namespace ggvs
