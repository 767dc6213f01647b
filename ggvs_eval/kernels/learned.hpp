// Bindings of the kernels of the blending network: learned.cpp, and unet_bindings.cpp for its U-Net.
#pragma once
#include <pybind11/pybind11.h>

namespace ggvs {

void bind_learned(pybind11::module_& m);
void bind_unet(pybind11::module_& m);

}  // namespace ggvs
