// Cameras, and images that fit them, as arguments of the bindings.
#pragma once
#include <tuple>
#include <utility>

#include "array_arguments.hpp"
#include "camera.hpp"
#include "memory.hpp"

namespace ggvs {

constexpr int kMostPixels = 65535;  // of an image, across and down

inline const float* image_of(const py::handle& object, const char* name, const Pinhole& camera) {
    return data_of<float>(object, name, {camera.height, camera.width});
}

// (fx, fy, cx, cy, width, height)
inline Pinhole pinhole_of(const py::handle& object) {
    const auto [fx, fy, cx, cy, width, height] = py::cast<std::tuple<double, double, double, double, int, int>>(object);
    if (width < 0 || height < 0 || width > kMostPixels || height > kMostPixels)
        throw py::value_error("images of at most 65535 x 65535 pixels");
    return {fx, fy, cx, cy, width, height};
}

// Height and width: the first two axes.
inline std::pair<int, int> size_of(const py::array& array, const char* name) {
    if (array.ndim() < 2 || array.shape(0) > kMostPixels || array.shape(1) > kMostPixels)
        throw py::type_error(std::string(name) + ": wanted an image of at most 65535 x 65535 pixels, got " + describe(array));
    return {int(array.shape(0)), int(array.shape(1))};
}

}  // namespace ggvs
