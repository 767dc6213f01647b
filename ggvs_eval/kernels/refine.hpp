// The refiner of the blending network in one pass over tiles that stay in the cache: evidence, convolutions, each pixel's filter.
#pragma once
#include <vector>

#include "convolve.hpp"
#include "enlarge.hpp"

namespace ggvs {

constexpr int kTaps = 12;            // neighbours that a filter mixes, see refine_simd.hpp
constexpr int kEvidence = 6;         // channels that are no features

struct Refinement {
    int width, height;
    const float* picture;    // (3, height, width)
    const float* spread;     // (height, width)
    const float* shown;      // (height, width)
    const float* depth;      // (height, width), 0 where unknown
    SmallMaps small;
    int first_feature, features;  // channels of `small`
    Layer looks[2];               // 3 x 3, leaky
    Layer taps;                   // 1 x 1
};

// A row of the evidence that comes from depth and picture. Lines of the window begin two columns before those of `out`.
struct EvidenceRow {
    const float *logarithms[5], *known[5];  // rows y - 2 .. y + 2
    const float* grey[3];                   // rows y - 1 .. y + 1
    int count;
    float* scratch;  // 8 lines of `stride`
    float* out;      // channels 2 .. 5, lines of `stride`
    int64_t stride;
};

// A row of the refined picture.
struct FilteredRow {
    const float* taps;        // (kTaps, stride)
    const float* picture[3];  // each colour at row y, columns as in `taps`; neighbours lie `stride` floats below and above
    int count;
    int64_t stride;
    float* out;  // (count, 3)
};

void refine(const Refinement& job, float* out, int threads, int level);

}  // namespace ggvs
