// The inner loops of the features for processors with AVX2, in vectors of 32 bytes.
// All other headers come before simd_avx2.hpp: their inline functions must stay runnable everywhere.
#include "feature_levels.hpp"

#if defined(__x86_64__)
#include "simd_avx2.hpp"
// After the vectors, whose names it uses:
#include "feature_maps_simd.hpp"
#include "simd_end.hpp"

namespace ggvs {

const FeatureKernels kAvx2Features = {avx2::filter_tiles, avx2::filter_colours, avx2::compare_pixels};

}  // namespace ggvs
#endif
