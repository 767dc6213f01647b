// Bindings of the kernels of networks: learned.cpp and unet_bindings.cpp for ours, ray_pooling_bindings.cpp for IBRNet.
#pragma once
#include <pybind11/pybind11.h>

namespace ggvs {

void bind_learned(pybind11::module_& m);
void bind_unet(pybind11::module_& m);
void bind_ray_pooling(pybind11::module_& m);

}  // namespace ggvs
