// The inner loops for any processor, in vectors of 16 bytes.
#include "kernels.hpp"
#include "simd_portable.hpp"
// After the vectors, whose names they use:
#include "blend_simd.hpp"
#include "splat_project_simd.hpp"
#include "splat_simd.hpp"
#include "occupancy_simd.hpp"
#include "tsdf_simd.hpp"
#include "register_simd.hpp"
#include "warp_simd.hpp"
#include "overview_simd.hpp"
#include "compose_simd.hpp"
#include "outputs_simd.hpp"
#include "convolve_simd.hpp"
#include "refine_simd.hpp"
#include "unet_simd.hpp"
#include "ray_pooling_simd.hpp"
#include "ray_attention_simd.hpp"

namespace ggvs {

const Kernels kBaselineKernels = {
    baseline::tile_ranges, baseline::lanes_in_tile, baseline::ellipses, baseline::splat_tile, baseline::fusion_row,
    baseline::add_to_extent, baseline::reach_of_shells, baseline::march_column, baseline::look_up_row, baseline::warp_row,
    baseline::register_row, baseline::overview_row, baseline::compose_row, baseline::read_outputs_chunk, baseline::logarithm_row,
    baseline::evidence_row, baseline::filter_row, baseline::convolve_row, baseline::convolve_strip, baseline::look_strip,
    baseline::moments_of_row, baseline::normalise_row, baseline::pool_ray, baseline::attend_ray,
};

}  // namespace ggvs
