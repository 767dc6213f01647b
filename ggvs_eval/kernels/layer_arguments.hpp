// Convolutions as arguments of the bindings.
#pragma once
#include "array_arguments.hpp"
#include "convolve.hpp"

namespace ggvs {

inline int groups_of(int outputs) { return (outputs + kGroupOutputs - 1) / kGroupOutputs; }

// A convolution of 3 x 3 as `pack_filters` (unet_bindings.cpp) makes it.
inline Layer packed_layer(const py::handle& filters, const py::handle& bias, int before, int after) {
    const int groups = groups_of(after), padded = groups * kGroupOutputs;
    return {before, after, padded, data_of<float>(filters, "filters", {groups, kStripSources, before, 3, kGroupOutputs}),
            data_of<float>(bias, "bias", {padded})};
}

}  // namespace ggvs
