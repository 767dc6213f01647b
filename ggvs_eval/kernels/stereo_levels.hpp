// The table of inner loops of the stereo kernels: one per instruction set, the choice is made when the program runs.
#pragma once
#include "block_match.hpp"
#include "level.hpp"
#include "plane_sweep.hpp"
#include "sgm.hpp"

namespace ggvs {

struct StereoKernels {
    void (*sweep_tile)(const SweepTask&, const Tile&, uint8_t* costs, SweepWorkspace&);
    void (*aggregate_row)(SgmPass&, int row);
    void (*block_differences)(const BlockTask&, const BlockRows&, uint8_t* out);
    void (*block_forward)(const BlockTask&, BlockRows&, const uint8_t* const* window);
    void (*block_backward)(const BlockTask&, BlockRows&);
};

extern const StereoKernels kBaselineStereo, kAvx2Stereo, kAvx512Stereo;

// `level` is a Level that ggvs_eval.kernels found in this processor. Throws std::invalid_argument for any other.
const StereoKernels& stereo_kernels(int level);

}  // namespace ggvs
