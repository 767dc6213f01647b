// Views registered in the target view: captured colours at the fused surface, splatted ones where a view does not see that.
#pragma once
#include <vector>

#include "blend.hpp"

namespace ggvs {

struct RegisteredView {
    LookUpView captured;  // its factor is 1
    const float* splat;   // (pixels, stride) of the target, the first three are the colour
    int stride;
    const float* alpha;  // (pixels) of the target: coverage of the splat
};

struct Registration {
    Pinhole target;
    const float* depth;  // (height, width) of the target, 0 = unknown
    float tolerance;     // visibility as in warp.hpp
    float faint;         // coverage where only a splat shows, per coverage of that splat
    std::vector<RegisteredView> views;
};

// What is registered, views one after another: some rows of the target, or all.
struct RegisteredMaps {
    float* colours;      // (views, rows, width, 3)
    float* coverage;     // (views, rows, width): visibility, or the faint coverage of the splat if that is more
    float* seen;         // (views, rows, width): visibility
    int first_row, rows;
};

// Finds out how the target's pixels map to those of the views; before any row is registered.
void find_pixel_maps(Registration& job);

void register_views(Registration& job, const RegisteredMaps& out, int threads, int level);

}  // namespace ggvs
