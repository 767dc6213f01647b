// The inner loops of the stereo kernels for any processor, in vectors of 16 bytes.
#include "simd_portable.hpp"
#include "stereo_levels.hpp"
// After the vectors, whose names they use:
#include "sweep_window_simd.hpp"
#include "sweep_warp_simd.hpp"
#include "sweep_tile_simd.hpp"
#include "sgm_simd.hpp"
#include "block_match_simd.hpp"

namespace ggvs {

const StereoKernels kBaselineStereo = {baseline::sweep_tile, baseline::aggregate_row, baseline::block_differences,
                                    baseline::block_forward, baseline::block_backward};

}  // namespace ggvs
