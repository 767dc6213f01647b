// The inner loops of the deformation field for any processor, in vectors of 16 bytes.
#include <algorithm>

#include "deformation_levels.hpp"
#include "simd_portable.hpp"
// After the vectors, whose names they use:
#include "deformation_planes_simd.hpp"
#include "deformation_layers_simd.hpp"

namespace ggvs {

const FieldKernels kBaselineField = {baseline::evaluate_batch, baseline::batch_gradients};

}  // namespace ggvs
