// Holes filled from ever coarser averages of what is known (push-pull).
#pragma once
#include <cstdint>

namespace ggvs {

struct HoledImage {
    const float* colour;   // (height, width, 3)
    const uint8_t* known;  // (height, width), 0 or 1
    int width, height;
};

// Known pixels are copied. `out` may be the colours themselves.
void push_pull(const HoledImage& image, float* out, int threads);

}  // namespace ggvs
