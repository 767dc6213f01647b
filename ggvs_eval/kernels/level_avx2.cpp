// The inner loops for processors with AVX2, in vectors of 32 bytes.
// All other headers come before simd_avx2.hpp: their inline functions must stay runnable everywhere.
#include "kernels.hpp"

#if defined(__x86_64__)
#include "simd_avx2.hpp"
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
#include "simd_end.hpp"

namespace ggvs {

const Kernels kAvx2Kernels = {
    avx2::tile_ranges, avx2::lanes_in_tile, avx2::ellipses, avx2::splat_tile, avx2::fusion_row, avx2::add_to_extent,
    avx2::reach_of_shells, avx2::march_column, avx2::look_up_row, avx2::warp_row, avx2::register_row, avx2::overview_row,
    avx2::compose_row, avx2::read_outputs_chunk, avx2::logarithm_row, avx2::evidence_row, avx2::filter_row, avx2::convolve_row,
    avx2::convolve_strip, avx2::look_strip, avx2::moments_of_row, avx2::normalise_row, avx2::pool_ray, avx2::attend_ray,
};

}  // namespace ggvs
#endif
