// Backward warping: colours of a source image seen along the target's rays, at the target's depth.
#pragma once
#include "blend.hpp"

namespace ggvs {

struct Warping {
    Pinhole target;
    const float* depth;     // (height, width) of the target, 0 = unknown
    LookUpView view;        // its `image` is null where `image` is not
    const float* image;     // (height, width, 3) of the view; null where the change between two images is looked for
    const uint8_t* before;  // likewise, the image before `view.image`
    float tolerance;
    bool bicubic;
};

// `colours` (height, width, 3), of the image or the change, are 0 outside the source image; `visibilities` (height, width) fall from
// 1 to 0 where the source's depth differs from the warped one by one to two tolerances.
void warp(Warping& job, float* colours, float* visibilities, int threads, int level);

}  // namespace ggvs
