// The inner loops of the features for processors with AVX512, in vectors of 64 bytes.
// All other headers come before simd_avx512.hpp: their inline functions must stay runnable everywhere.
#include "feature_levels.hpp"

#if defined(__x86_64__)
#include "simd_avx512.hpp"
// After the vectors, whose names it uses:
#include "feature_maps_simd.hpp"
#include "simd_end.hpp"

namespace ggvs {

const FeatureKernels kAvx512Features = {avx512::filter_tiles, avx512::filter_colours, avx512::compare_pixels};

}  // namespace ggvs
#endif
