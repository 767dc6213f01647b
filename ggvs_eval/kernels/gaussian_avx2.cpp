// The inner loops of the Gaussian splat for processors with AVX2, in vectors of 32 bytes.
// All other headers come before simd_avx2.hpp: their inline functions must stay runnable everywhere.
#include "gaussian_levels.hpp"

#if defined(__x86_64__)
#include "simd_avx2.hpp"
// After the vectors, whose names they use:
#include "gaussian_harmonics_simd.hpp"
#include "gaussian_project_simd.hpp"
#include "gaussian_gradients_simd.hpp"
#include "gaussian_blend_simd.hpp"
#include "simd_end.hpp"

namespace ggvs {

const GaussianKernels kAvx2Gaussians = {avx2::project_batch, avx2::blend_gaussians, avx2::blend_gradients, avx2::project_gradients};

}  // namespace ggvs
#endif
