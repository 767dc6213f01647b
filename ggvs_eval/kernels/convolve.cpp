// Filters made ready for strips, as the head of convolve.hpp says.
#include "convolve.hpp"

#include <algorithm>

namespace ggvs {

void pack_group(const Filters& filters, int group, float* out) {
    const int first = group * kGroupOutputs, count = std::min(filters.after - first, kGroupOutputs);
    const int64_t step = group_size(filters.before) / kStripSources, *strides = filters.strides;
    std::fill_n(out, group_size(filters.before), 0.0f);
    for (int channel = 0; channel < filters.before; ++channel) {
        for (int right = 0; right < 3; ++right, out += kGroupOutputs) {
            const float* from = filters.weights + first * strides[0] + channel * strides[1] + right * strides[3];
            for (int o = 0; o < count; ++o, from += strides[0]) {
                const auto sums = sum_weights(from[0], from[strides[2]], from[2 * strides[2]]);
                for (int n = 0; n < kStripSources; ++n) out[n * step + o] = float(sums[n]);
            }
        }
    }
}

}  // namespace ggvs
