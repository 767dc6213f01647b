// Filters made ready for strips, as the head of convolve.hpp says.
#include "convolve.hpp"

#include <algorithm>

namespace ggvs {
namespace {

// The weights of the six sums that stand for a column of a filter, one every `step` floats.
void write_sums(double above, double here, double below, float* out, int64_t step) {
    const double even = above / 24.0 + below / 6.0, odd = here / 12.0;
    const double sums[kStripSources] = {above / 4.0, -(above + here + below) / 6.0, -(above - here + below) / 6.0,
                                        even + odd,  even - odd,                    below};
    for (int n = 0; n < kStripSources; ++n) out[n * step] = float(sums[n]);
}

}  // namespace

void pack_group(const Filters& filters, int group, float* out) {
    const int first = group * kGroupOutputs, count = std::min(filters.after - first, kGroupOutputs);
    const int64_t step = group_size(filters.before) / kStripSources, *strides = filters.strides;
    std::fill_n(out, group_size(filters.before), 0.0f);
    for (int channel = 0; channel < filters.before; ++channel) {
        for (int right = 0; right < 3; ++right, out += kGroupOutputs) {
            const float* from = filters.weights + first * strides[0] + channel * strides[1] + right * strides[3];
            for (int o = 0; o < count; ++o, from += strides[0])
                write_sums(from[0], from[strides[2]], from[2 * strides[2]], out + o, step);
        }
    }
}

}  // namespace ggvs
