// The inner loops for processors with AVX512, in vectors of 64 bytes.
// All other headers come before simd_avx512.hpp: their inline functions must stay runnable everywhere.
#include "kernels.hpp"

#if defined(__x86_64__)
#include "simd_avx512.hpp"
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

const Kernels kAvx512Kernels = {
    avx512::tile_ranges, avx512::lanes_in_tile, avx512::ellipses, avx512::splat_tile, avx512::fusion_row, avx512::add_to_extent,
    avx512::reach_of_shells, avx512::march_column, avx512::look_up_row, avx512::warp_row, avx512::register_row,
    avx512::overview_row, avx512::compose_row, avx512::read_outputs_chunk, avx512::logarithm_row, avx512::evidence_row,
    avx512::filter_row, avx512::convolve_row, avx512::convolve_strip, avx512::look_strip, avx512::moments_of_row,
    avx512::normalise_row, avx512::pool_ray, avx512::attend_ray,
};

}  // namespace ggvs
#endif
