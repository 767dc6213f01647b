// Memory of the kernels' results, kept for the next results of the same size.
#pragma once
#include <pybind11/numpy.h>

#include <vector>

namespace ggvs {

// An array of floats that nobody has written yet.
//
// A frame's large maps are as large as those of the frame before. The system hands out fresh pages and clears each of them, which
// takes longer than many a kernel that fills them; so memory that an array has given up is kept for the next one of its size.
// Call it, and let go of its arrays, with the GIL held, which all of Python does.
pybind11::array_t<float> empty(std::vector<pybind11::ssize_t> shape);

// Bytes that are kept at the moment and belong to no array.
size_t idle_bytes();

// Gives them back to the system: other work that follows wants other sizes.
void forget_idle();

}  // namespace ggvs
