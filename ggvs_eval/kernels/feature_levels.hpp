// The table of inner loops of the features: one per instruction set, the choice is made when the program runs.
#pragma once
#include "feature_maps.hpp"
#include "level.hpp"

namespace ggvs {

struct FeatureKernels {
    void (*filter_tiles)(const TileJob&);
    void (*filter_colours)(const ColourJob&);
    void (*compare_pixels)(const ComparedPixels&);
};

extern const FeatureKernels kBaselineFeatures, kAvx2Features, kAvx512Features;

// `level` is a Level that ggvs_eval.kernels found in this processor. Throws std::invalid_argument for any other.
const FeatureKernels& feature_kernels(int level);

}  // namespace ggvs
