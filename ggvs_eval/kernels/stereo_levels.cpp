// Which inner loops of the stereo kernels run.
#include "stereo_levels.hpp"

#include <stdexcept>

namespace ggvs {

const StereoKernels& stereo_kernels(int level) {
#if defined(__x86_64__)
    if (level == kAvx512) return kAvx512Stereo;
    if (level == kAvx2) return kAvx2Stereo;
#endif
    if (level == kBaseline) return kBaselineStereo;
    throw std::invalid_argument("no such instruction set here");
}

}  // namespace ggvs
