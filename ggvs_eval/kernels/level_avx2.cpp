// The inner loops for processors with AVX2, in vectors of 32 bytes.
// Headers of the standard library come before the target pragma: their inline functions must stay runnable everywhere.
#include "kernels.hpp"

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
#include "blend_simd.hpp"
#include "splat_simd.hpp"
#include "tsdf_simd.hpp"

#if defined(__clang__)
#pragma clang attribute pop
#else
#pragma GCC pop_options
#endif

namespace ggvs {

const Kernels kAvx2Kernels = {avx2::tile_ranges,   avx2::ellipses,   avx2::blend_tile,
                              avx2::finish_blocks, avx2::fusion_row, avx2::march_column, avx2::look_up_row};

}  // namespace ggvs
#endif
