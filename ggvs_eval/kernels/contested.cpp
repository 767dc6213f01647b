// A plane sweep over the few depths that the views themselves propose, at the few pixels where they contradict the fused one.
#include "contested.hpp"

#include <algorithm>
#include <cmath>

#include "parallel.hpp"

namespace ggvs {
namespace {

// Bilinear sample at (u, v), pixel centres at halves; false outside of the outermost centres.
bool sample(const Witness& view, float u, float v, float* colour) {
    const float x = u - 0.5f, y = v - 0.5f;
    const int width = view.camera.width, height = view.camera.height;
    if (!(x >= 0 && y >= 0 && x <= float(width - 1) && y <= float(height - 1))) return false;
    const int left = std::min(int(x), width - 2), top = std::min(int(y), height - 2);
    const float across = x - float(left), down = y - float(top);
    const uint8_t* upper = view.image + 3 * (int64_t(top) * width + left);
    const uint8_t* lower = upper + 3 * int64_t(width);
    for (int c = 0; c < 3; ++c) {
        const float above = float(upper[c]) + across * (float(upper[c + 3]) - float(upper[c]));
        const float below = float(lower[c]) + across * (float(lower[c + 3]) - float(lower[c]));
        colour[c] = above + down * (below - above);
    }
    return true;
}

// Variance of the views' colours at a point of the target's ray, summed over channels; negative where fewer than two see it.
float spread(const Contest& contest, float column, float row, float depth) {
    float sums[3] = {}, squares = 0;
    int count = 0;
    for (const Witness& view : contest.views) {
        const float* m = view.map.matrix;
        const float z = depth * (m[6] * column + m[7] * row + m[8]) + view.map.offset[2];
        if (!(z > 0)) continue;
        const float u = (depth * (m[0] * column + m[1] * row + m[2]) + view.map.offset[0]) / z;
        const float v = (depth * (m[3] * column + m[4] * row + m[5]) + view.map.offset[1]) / z;
        float colour[3];
        if (!sample(view, u, v, colour)) continue;
        ++count;
        for (int c = 0; c < 3; ++c) {
            sums[c] += colour[c];
            squares += colour[c] * colour[c];
        }
    }
    if (count < 2) return -1;
    const float square_of_sums = sums[0] * sums[0] + sums[1] * sums[1] + sums[2] * sums[2];
    return std::max(squares - square_of_sums / float(count), 0.0f) / float(count);
}

float settled(const Contest& contest, int64_t pixel, float column, float row) {
    const float fused = contest.fused[pixel];
    if (!(fused > 0)) return fused;
    float agreeing = 0, voting = 0, proposals[kMostWitnesses];
    int count = 0;
    for (const Witness& view : contest.views) {
        const float depth = view.depth[pixel];
        if (!(view.alpha[pixel] > contest.least_alpha && depth > 0)) continue;
        voting += view.weight;
        if (std::abs(depth - fused) <= contest.tolerance)
            agreeing += view.weight;
        else
            proposals[count++] = depth;
    }
    if (count == 0 || agreeing >= contest.least_share * voting) return fused;
    float least = contest.ratio * spread(contest, column, row, fused), best = fused;
    for (int k = 0; k < count; ++k) {
        const float here = spread(contest, column, row, proposals[k]);
        if (here >= 0 && here < least) {
            least = here;
            best = proposals[k];
        }
    }
    return best;
}

}  // namespace

void settle_depth(Contest& contest, float* out, int threads) {
    for (Witness& view : contest.views) view.map = pixel_map(contest.target, view.from_target, view.camera, true);
    const int width = contest.target.width;
    parallel_for(contest.target.height, threads, [&](int y, int) {
        const int64_t row = int64_t(y) * width;
        for (int x = 0; x < width; ++x) out[row + x] = settled(contest, row + x, float(x) + 0.5f, float(y) + 0.5f);
    });
}

}  // namespace ggvs
