// The inner loops for processors with AVX512, in vectors of 64 bytes.
// Headers of the standard library come before the target pragma: their inline functions must stay runnable everywhere.
#include "kernels.hpp"

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
#include "blend_simd.hpp"
#include "splat_simd.hpp"
#include "tsdf_simd.hpp"

#if defined(__clang__)
#pragma clang attribute pop
#else
#pragma GCC pop_options
#endif

namespace ggvs {

const Kernels kAvx512Kernels = {avx512::tile_ranges,   avx512::ellipses,   avx512::blend_tile,
                                avx512::finish_blocks, avx512::fusion_row, avx512::march_column, avx512::look_up_row};

}  // namespace ggvs
#endif
