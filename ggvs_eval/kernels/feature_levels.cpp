// Which inner loops of the features run.
#include "feature_levels.hpp"

#include <stdexcept>

namespace ggvs {

const FeatureKernels& feature_kernels(int level) {
#if defined(__x86_64__)
    if (level == kAvx512) return kAvx512Features;
    if (level == kAvx2) return kAvx2Features;
#endif
    if (level == kBaseline) return kBaselineFeatures;
    throw std::invalid_argument("no such instruction set here");
}

}  // namespace ggvs
