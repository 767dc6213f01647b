// Which inner loops of the Gaussian splat run.
#include "gaussian_levels.hpp"

#include <stdexcept>

namespace ggvs {

const GaussianKernels& gaussian_kernels(int level) {
#if defined(__x86_64__)
    if (level == kAvx512) return kAvx512Gaussians;
    if (level == kAvx2) return kAvx2Gaussians;
#endif
    if (level == kBaseline) return kBaselineGaussians;
    throw std::invalid_argument("no such instruction set here");
}

}  // namespace ggvs
