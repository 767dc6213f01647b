// Arrays as arguments of the bindings. They are taken as they lie in memory: a wrong dtype, shape or layout is a TypeError, never a
// silent copy.
#pragma once
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <string>
#include <vector>

namespace ggvs {

namespace py = pybind11;

inline std::string describe(const py::array& array) {
    return py::cast<std::string>(py::str(array.dtype())) + " " + py::cast<std::string>(py::str(array.attr("shape"))) +
           (array.flags() & py::array::c_style ? "" : ", not C-contiguous");
}

// The data of a C-contiguous T array of exactly this shape.
template <class T>
const T* data_of(const py::handle& object, const char* name, const std::vector<py::ssize_t>& shape) {
    const auto refuse = [&](const std::string& got) {  // words cost more than the check: only what is refused gets them
        py::tuple sizes(shape.size());
        for (size_t n = 0; n < shape.size(); ++n) sizes[n] = shape[n];
        throw py::type_error(std::string(name) + ": wanted " + py::cast<std::string>(py::str(py::dtype::of<T>())) + " " +
                             py::cast<std::string>(py::str(sizes)) + ", C-contiguous, got " + got);
    };
    if (!py::isinstance<py::array>(object)) refuse(Py_TYPE(object.ptr())->tp_name);
    const py::array array = py::reinterpret_borrow<py::array>(object);
    const bool same = py::isinstance<py::array_t<T>>(array) && (array.flags() & py::array::c_style) &&
                      std::vector<py::ssize_t>(array.shape(), array.shape() + array.ndim()) == shape;
    if (!same) refuse(describe(array));
    return static_cast<const T*>(array.data());
}

// The sizes of an array of so many axes.
inline std::vector<py::ssize_t> shape_of(const py::array& array, const char* name, int axes) {
    if (array.ndim() != axes)
        throw py::type_error(std::string(name) + ": wanted " + std::to_string(axes) + " axes, got " + describe(array));
    return {array.shape(), array.shape() + axes};
}

}  // namespace ggvs
