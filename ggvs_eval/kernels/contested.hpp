// Fused depth that the views' own depths contradict: settled by what the views' colours say.
#pragma once
#include <cstdint>
#include <vector>

#include "camera.hpp"

namespace ggvs {

// A captured view, and what it looks like splatted into the target view.
struct Witness {
    Pinhole camera;
    const double* from_target;  // target camera -> this camera, rigid 4x4
    const uint8_t* image;       // (height, width, 3), at least two rows and columns
    const float* alpha;         // (height, width) of the target: coverage of the splat
    const float* depth;         // (height, width) of the target: its depth, 0 = unknown
    float weight;               // of its vote on the fused depth
    PixelMap map;               // filled by settle_depth
};

struct Contest {
    Pinhole target;
    const float* fused;  // (height, width) of the target, 0 = unknown
    float tolerance;     // depths that differ by less are the same surface
    float least_alpha;   // coverage from which a splat has a say
    float least_share;   // of the votes, with which the fused depth stands uncontested
    float ratio;         // of the spread of colours, below which another depth wins
    std::vector<Witness> views;
};

constexpr int kMostWitnesses = 64;

// The fused depth, (height, width), in which contested pixels have the depth of the splat at which the views' colours agree best.
void settle_depth(Contest& contest, float* out, int threads);

}  // namespace ggvs
