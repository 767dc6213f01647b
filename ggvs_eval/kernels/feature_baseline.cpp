// The inner loops of the features for any processor, in vectors of 16 bytes.
#include "simd_portable.hpp"
#include "feature_levels.hpp"
// After the vectors, whose names it uses:
#include "feature_maps_simd.hpp"

namespace ggvs {

const FeatureKernels kBaselineFeatures = {baseline::filter_tiles, baseline::filter_colours, baseline::compare_pixels};

}  // namespace ggvs
