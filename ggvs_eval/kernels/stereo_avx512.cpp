// The inner loops of the stereo kernels for processors with AVX512, in vectors of 64 bytes.
// Headers of the standard library come before the target pragma: their inline functions must stay runnable everywhere.
#include "stereo_levels.hpp"

#if defined(__x86_64__)
#include <immintrin.h>
#if defined(__clang__)
#pragma clang attribute push(__attribute__((target("avx512f,avx512bw,avx512dq,avx512vl"))), apply_to = function)
#else
// GCC 12's own intrinsics start from undefined registers on purpose and warn about it (GCC bug 105593).
#pragma GCC diagnostic ignored "-Wuninitialized"
#pragma GCC diagnostic ignored "-Wmaybe-uninitialized"
#pragma GCC push_options
#pragma GCC target("avx512f,avx512bw,avx512dq,avx512vl")
#endif

#define GGVS_LEVEL avx512
#include "simd_avx512.hpp"
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

const StereoKernels kAvx512Stereo = {avx512::sweep_tile, avx512::aggregate_row};

}  // namespace ggvs
#endif
