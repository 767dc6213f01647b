// Bindings of the kernels around the blending network: learned.cpp.
#pragma once
#include <pybind11/pybind11.h>

namespace ggvs {

void bind_learned(pybind11::module_& m);

}  // namespace ggvs
