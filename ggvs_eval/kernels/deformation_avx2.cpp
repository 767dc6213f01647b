// The inner loops of the deformation field for processors with AVX2, in vectors of 32 bytes.
// All other headers come before simd_avx2.hpp: their inline functions must stay runnable everywhere.
#include <algorithm>

#include "deformation_levels.hpp"

#if defined(__x86_64__)
#include "simd_avx2.hpp"
// After the vectors, whose names they use:
#include "deformation_planes_simd.hpp"
#include "deformation_layers_simd.hpp"
#include "simd_end.hpp"

namespace ggvs {

const FieldKernels kAvx2Field = {avx2::evaluate_batch, avx2::batch_gradients};

}  // namespace ggvs
#endif
