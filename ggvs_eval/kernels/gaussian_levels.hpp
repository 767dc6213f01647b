// The table of inner loops of the Gaussian splat: one per instruction set, the choice is made when the program runs.
#pragma once
#include "gaussian_splat.hpp"
#include "level.hpp"

namespace ggvs {

struct GaussianKernels {
    // Of the batch of Gaussians that starts at `first`.
    void (*project)(const GaussianView&, const CloudArrays&, int64_t first, ScreenGaussian* out, TileBox* boxes, int32_t* radii);
    void (*blend_tile)(const ScreenGaussian*, const uint32_t* listed, int count, int left, int top, TilePixels&);
    // `pixels` holds the derivatives by colour and depth in red .. depth; writes the sums of the n-th Gaussian of the list to
    // sums[n].
    void (*blend_gradients)(const ScreenGaussian*, const uint32_t* listed, int count, int left, int top, TilePixels& pixels,
                            const float* behind, float (*sums)[kSums]);
    // `sums` of each Gaussian of the batch.
    void (*project_gradients)(const GaussianView&, const CloudArrays&, int64_t first, const float (*sums)[kBatch],
                              const TileBox* boxes, const CloudGradients& out);
};

extern const GaussianKernels kBaselineGaussians, kAvx2Gaussians, kAvx512Gaussians;

// `level` is a Level that ggvs_eval.kernels found in this processor. Throws std::invalid_argument for any other.
const GaussianKernels& gaussian_kernels(int level);

}  // namespace ggvs
