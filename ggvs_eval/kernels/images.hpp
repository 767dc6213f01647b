// Bindings of the kernels that work on images in one view (filter, blending, holes): images.cpp.
#pragma once
#include <pybind11/pybind11.h>

namespace ggvs {

void bind_images(pybind11::module_& m);

}  // namespace ggvs
