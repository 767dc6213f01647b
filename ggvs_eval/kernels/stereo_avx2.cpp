// The inner loops of the stereo kernels for processors with AVX2, in vectors of 32 bytes.
// Headers of the standard library come before the target pragma: their inline functions must stay runnable everywhere.
#include "stereo_levels.hpp"

#if defined(__x86_64__)
#include <immintrin.h>
#if defined(__clang__)
#pragma clang attribute push(__attribute__((target("avx2"))), apply_to = function)
#else
#pragma GCC push_options
#pragma GCC target("avx2")
#endif

#define GGVS_LEVEL avx2
#include "simd_avx2.hpp"
// After the vectors, whose names they use:
#include "sweep_window_simd.hpp"
#include "sweep_warp_simd.hpp"
#include "sweep_tile_simd.hpp"
#include "sgm_simd.hpp"

#if defined(__clang__)
#pragma clang attribute pop
#else
#pragma GCC pop_options
#endif

namespace ggvs {

const StereoKernels kAvx2Stereo = {avx2::sweep_tile, avx2::aggregate_row};

}  // namespace ggvs
#endif
