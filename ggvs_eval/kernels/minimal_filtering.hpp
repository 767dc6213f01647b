// Minimal filtering of three taps (Winograd 1980, F(4, 3)): six sums stand for four filtered values, which would take twelve.
#pragma once
#include <array>

namespace ggvs {

constexpr int kFilteredValues = 4, kFilteredSums = kFilteredValues + 2;  // as many sums as values that they look at

// The weights of the six sums that stand for three taps.
inline std::array<double, kFilteredSums> sum_weights(double above, double here, double below) {
    const double even = above / 24.0 + below / 6.0, odd = here / 12.0;
    return {above / 4.0, -(above + here + below) / 6.0, -(above - here + below) / 6.0, even + odd, even - odd, below};
}

}  // namespace ggvs
