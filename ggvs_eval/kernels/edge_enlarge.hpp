// Depth brought to the size of a larger image, ending where that image's edges are.
#pragma once
#include <cstdint>

namespace ggvs {

// Small maps and the image that they belong to, beside that image at full size.
struct EdgeTask {
    const float *depth, *confidence;  // (small_height, small_width)
    const uint8_t* small_image;       // (small_height, small_width, 3)
    const uint8_t* image;             // (height, width, 3)
    const float* smooth;              // (height, width), the depth interpolated across edges
    int height, width, small_height, small_width;
    float same_surface;  // share of the depth by which interpolated depth may differ and is taken
};

// Each pixel takes the depth and the confidence of that of the four nearest small pixels whose colour is most like its own.
void enlarge_to_edges(const EdgeTask& task, float* depth, float* confidence, int threads);

}  // namespace ggvs
