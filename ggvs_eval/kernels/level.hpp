// The instruction sets that the inner loops are compiled for, slowest first, as in ggvs_eval.kernels.LEVELS.
#pragma once

namespace ggvs {

enum Level { kBaseline = 0, kAvx2 = 1, kAvx512 = 2 };

}  // namespace ggvs
