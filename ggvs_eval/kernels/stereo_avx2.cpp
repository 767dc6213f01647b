// The inner loops of the stereo kernels for processors with AVX2, in vectors of 32 bytes.
// All other headers come before simd_avx2.hpp: their inline functions must stay runnable everywhere.
#include "stereo_levels.hpp"

#if defined(__x86_64__)
#include "simd_avx2.hpp"
// After the vectors, whose names they use:
#include "sweep_window_simd.hpp"
#include "sweep_warp_simd.hpp"
#include "sweep_tile_simd.hpp"
#include "sgm_simd.hpp"
#include "block_match_simd.hpp"
#include "simd_end.hpp"

namespace ggvs {

const StereoKernels kAvx2Stereo = {avx2::sweep_tile, avx2::aggregate_row, avx2::block_differences,
                                    avx2::block_forward, avx2::block_backward};

}  // namespace ggvs
#endif
