// The inner loops for any processor, in vectors of 16 bytes.
#include "kernels.hpp"
#include "simd_portable.hpp"
// After the vectors, whose names they use:
#include "blend_simd.hpp"
#include "splat_simd.hpp"
#include "tsdf_simd.hpp"

namespace ggvs {

const Kernels kBaselineKernels = {baseline::tile_ranges,   baseline::ellipses,   baseline::blend_tile,
                                  baseline::finish_blocks, baseline::fusion_row, baseline::march_column, baseline::look_up_row};

}  // namespace ggvs
