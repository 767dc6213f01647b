// The table of inner loops: one per instruction set, the choice is made when the program runs.
#pragma once
#include "blend.hpp"
#include "compose.hpp"
#include "convolve.hpp"
#include "level.hpp"
#include "outputs.hpp"
#include "overview.hpp"
#include "ray_pooling.hpp"
#include "refine.hpp"
#include "register.hpp"
#include "splat.hpp"
#include "tsdf.hpp"
#include "unet.hpp"
#include "warp.hpp"

namespace ggvs {

struct Kernels {
    void (*tile_ranges)(const Projector&, const float* depth, int column, int row, int count, TileRanges* out);
    uint32_t (*lanes_in_tile)(const TileRanges&, int x, int y);
    void (*ellipses)(const Projector&, const SplatSource&, int channels, const uint32_t* pixels, int count, int left, int top,
                     const Ellipses& out);
    void (*splat_tile)(SplatTile&, int channels, const SplatPicture&);
    void (*fusion_row)(const FusionRow&);
    void (*add_to_extent)(const Extent&, const float* depth, const float* weight);
    void (*reach_of_shells)(const Pinhole& target, const PixelMap& to_target, float near, float far, Shells&);
    void (*march_column)(const March&, const MarchColumn&, float* depth, float* weight);
    void (*look_up_row)(const LookUp&, int y, float* out);
    void (*warp_row)(const Warping&, int y, float* colours, float* visibilities);
    void (*register_row)(const Registration&, int view, int y, const RegisteredMaps& out);
    void (*overview_row)(const Views&, const OverviewMaps& out, int y);
    void (*compose_row)(const ComposedRow&);
    void (*read_outputs_chunk)(const RawOutputs&, const ReadOutputs& out, int64_t first, int count);
    void (*logarithm_row)(const float* depth, int count, float* logarithm, float* known);
    void (*evidence_row)(const EvidenceRow&);
    void (*filter_row)(const FilteredRow&);
    void (*convolve_row)(const ConvolvedRow&);      // 1 x 1
    void (*convolve_strip)(const ConvolvedStrip&);  // 3 x 3
    void (*look_strip)(const ConvolvedStrip&);      // the same, leaky
    Moments (*moments_of_row)(const float* row, int64_t stride, int width, int channels);
    void (*normalise_row)(const NormalisedRow&);
    void (*pool_ray)(const RayPooling&, int64_t ray, const RaySamples& out, void* memory);
    void (*attend_ray)(const RayPooling&, const RaySamples& ray, void* memory);
};

extern const Kernels kBaselineKernels, kAvx2Kernels, kAvx512Kernels;

// The highest level this processor runs.
int best_level();

// `level` is a Level. Throws std::invalid_argument for one that this processor lacks.
const Kernels& kernels_of(int level);

}  // namespace ggvs
