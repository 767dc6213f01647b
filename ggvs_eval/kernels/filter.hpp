// The temporal depth filter of the source views (Eqs. 1-2).
#pragma once
#include <cstdint>

namespace ggvs {

// Two RGB images of one size, and how many cells each is averaged into, across and down, before they are subtracted.
struct ImagePair {
    const uint8_t *now, *before;  // (height, width, 3)
    int width, height, cells_across, cells_down;
};

// By how much each cell's mean colour has changed, in [-1, 1], (cells_down, cells_across, 3).
void colour_change(const ImagePair& pair, float* out, int threads);

struct DepthPair {
    const float *depth, *history, *mask;
    int64_t count;    // pixels
    float tolerance;  // share of the depth
};

// mask * depth + (1 - mask) * history where both belong to one surface, else the one that is known (ggvs_eval/kernels/_core.pyi).
void mix_depth(const DepthPair& pair, float* out, int threads);

}  // namespace ggvs
