// Background memory of a target: what it saw farthest away at each pixel, and what its holes show of that.
#pragma once
#include <cstdint>
#include <vector>

namespace ggvs {

// How long, and how far behind one another; docs of geometry_guided.py.
struct Remembering {
    double behind, forgetting;
    float renewal, sure_still;
    float covered_alpha, least_alpha;  // a pixel is no hole from the first one up, a hole altogether from the second one down
};

struct BackgroundStep {
    int width, height, cells_across, cells_down;
    const float* depth;                // (height, width), fused, 0 where unknown
    const float* still;                // (cells_down, cells_across), how sure it is that nothing moves
    std::vector<const float*> alphas;  // (height, width), coverages of the splats
    Remembering rules;
};

// `image` (height, width, 3) is remembered and its holes are filled, in place, as is the memory: colours (height, width, 3) and
// depths (height, width), 0 where it is but a filling, negative where it was moving.
void remember(const BackgroundStep& job, float* image, float* past, float* past_depth, int threads);

}  // namespace ggvs
