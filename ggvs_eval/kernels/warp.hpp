// Backward warping: colours of a source image seen along the target's rays, at the target's depth.
#pragma once
#include <cstdint>

#include "camera.hpp"

namespace ggvs {

struct WarpSource {
    Pinhole camera;
    const double* from_target;  // target camera -> source camera, rigid 4x4
    const float* image;         // (height, width, 3); null where the change between two images is looked for
    const float* depth;         // (height, width), 0 = invalid
    const uint8_t *now = nullptr, *before = nullptr;  // (height, width, 3) both
};

// `colour` (height, width, 3), of the image or the change, is 0 outside the source image; `visibility` (height, width) falls from 1 to 0 where the source's
// depth differs from the warped one by one to two tolerances.
void warp(const Pinhole& target, const float* target_depth, const WarpSource& source, float tolerance, bool bicubic,
          float* colour, float* visibility, int threads);

}  // namespace ggvs
