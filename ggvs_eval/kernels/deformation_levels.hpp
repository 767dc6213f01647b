// The table of inner loops of the deformation field: one per instruction set, the choice is made when the program runs.
#pragma once
#include "deformation.hpp"
#include "level.hpp"

namespace ggvs {

struct FieldKernels {
    // Of `count` points, kPoints at most, from row `first` on.
    void (*evaluate)(const Field&, const float* points, int64_t first, int count, const std::vector<Rows>& out, Activations&);
    // Of the points in `rows`, kPoints at most; adds to the sums of a part, writes (rows, 3).
    void (*gradients)(const Field&, const float* points, const int64_t* rows, int count, const std::vector<Rows>& by_out,
                      float* sums, float* by_points, Activations&);
};

extern const FieldKernels kBaselineField, kAvx2Field, kAvx512Field;

// `level` is a Level that ggvs_eval.kernels found in this processor. Throws std::invalid_argument for any other.
const FieldKernels& field_kernels(int level);

}  // namespace ggvs
