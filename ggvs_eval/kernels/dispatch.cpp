// Which inner loops run, and the camera algebra that they all share.
#include <stdexcept>

#include "kernels.hpp"

namespace ggvs {

int best_level() {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl"))
        return kAvx512;
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) return kAvx2;
#endif
    return kBaseline;
}

const Kernels& kernels_of(int level) {
    if (level < kBaseline || level > best_level()) throw std::invalid_argument("this processor lacks the wanted instruction set");
#if defined(__x86_64__)
    if (level == kAvx512) return kAvx512Kernels;
    if (level == kAvx2) return kAvx2Kernels;
#endif
    return kBaselineKernels;
}

PixelMap pixel_map(const Pinhole& first, const double* first_to_second, const Pinhole& second, bool to_pixels) {
    // Rows of K_second, or of the identity.
    const double to_image[9] = {second.fx, 0, second.cx, 0, second.fy, second.cy, 0, 0, 1};
    const double identity[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    const double* k = to_pixels ? to_image : identity;
    PixelMap map;
    for (int row = 0; row < 3; ++row) {
        double turned[4] = {};  // row of K_second [R | t]
        for (int column = 0; column < 4; ++column)
            for (int n = 0; n < 3; ++n) turned[column] += k[3 * row + n] * first_to_second[4 * n + column];
        // times K_first^-1
        map.matrix[3 * row] = float(turned[0] / first.fx);
        map.matrix[3 * row + 1] = float(turned[1] / first.fy);
        map.matrix[3 * row + 2] = float(turned[2] - turned[0] * first.cx / first.fx - turned[1] * first.cy / first.fy);
        map.offset[row] = float(turned[3]);
    }
    return map;
}

}  // namespace ggvs
