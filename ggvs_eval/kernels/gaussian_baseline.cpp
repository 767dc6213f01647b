// The inner loops of the Gaussian splat for any processor, in vectors of 16 bytes.
#include "gaussian_levels.hpp"
#include "simd_portable.hpp"
// After the vectors, whose names they use:
#include "gaussian_harmonics_simd.hpp"
#include "gaussian_project_simd.hpp"
#include "gaussian_gradients_simd.hpp"
#include "gaussian_blend_simd.hpp"

namespace ggvs {

const GaussianKernels kBaselineGaussians = {baseline::project_batch, baseline::blend_gaussians, baseline::blend_gradients, baseline::project_gradients};

}  // namespace ggvs
