// The table of inner loops of the stereo kernels: one per instruction set, the choice is made when the program runs.
#pragma once
#include "level.hpp"
#include "plane_sweep.hpp"
#include "sgm.hpp"

namespace ggvs {

struct StereoKernels {
    void (*sweep_tile)(const SweepTask&, const Tile&, uint8_t* costs, SweepWorkspace&);
    void (*aggregate_row)(SgmPass&, int row);
};

extern const StereoKernels kBaselineStereo, kAvx2Stereo, kAvx512Stereo;

// `level` is a Level that ggvs_eval.kernels found in this processor. Throws std::invalid_argument for any other.
const StereoKernels& stereo_kernels(int level);

}  // namespace ggvs
