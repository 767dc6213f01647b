// Convolutions of the blending network and of its refiner. The arithmetic stands in convolve_simd.hpp.
//
// Those of 3 x 3 filter four rows at once by minimal filtering down the columns. Across, where neighbours are lanes of one vector,
// they are filtered as usual.
#pragma once
#include <cstdint>
#include <type_traits>

#include "minimal_filtering.hpp"

namespace ggvs {

constexpr int kStripRows = kFilteredValues;   // are filtered at once
constexpr int kStripSources = kFilteredSums;  // that they look at, and sums that they take
constexpr int kStripLine = 64;               // floats of a line of a strip: columns that are filtered at once and what they look at

constexpr int kGroupOutputs = 8;             // are summed at once

// A convolution. Weights (before, padded) with the outputs side by side if it is 1 x 1, groups of `pack_group` if it is 3 x 3;
// bias (padded). Outputs are filled up to a multiple of kGroupOutputs.
struct Layer {
    int before, after, padded;
    const float *weights, *bias;
};

// Filters of 3 x 3 as they come, with the strides in floats of outputs, inputs, rows and columns.
struct Filters {
    int before, after;
    const float* weights;
    int64_t strides[4];
};

// Floats of a group.
inline int64_t group_size(int before) { return int64_t(kStripSources) * before * 3 * kGroupOutputs; }

// The filters of some outputs as strips take them: (kStripSources, before, 3, kGroupOutputs), zeros for outputs that are not there.
void pack_group(const Filters& filters, int group, float* out);

// A row of a convolution of 1 x 1.
struct ConvolvedRow {
    const Layer& layer;
    const float* row;  // (before, stride)
    float* out;        // (padded, stride)
    int count;         // written and read in whole packets
    int64_t stride;
};

// Four rows of a convolution of 3 x 3.
struct ConvolvedStrip {
    const Layer& layer;
    const float* sources[kStripSources];  // each (before, stride), lines begin one column before those of `out`
    float* out[kStripRows];               // each (padded, stride)
    int count;                            // columns are written and read in whole packets, and one packet further is read
    int64_t stride;
    float* scratch;  // (kStripSources, before, kStripLine)
};

}  // namespace ggvs
