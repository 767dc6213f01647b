// Cameras, and images that fit them, as arguments of the bindings.
#pragma once
#include <limits>
#include <tuple>
#include <utility>

#include "array_arguments.hpp"
#include "blend.hpp"
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

// A view to be looked up: its camera, from_target, 8-bit image, depth and what is forgiven.
inline LookUpView look_up_view(const py::tuple& view, float factor) {
    const Pinhole from = pinhole_of(view[0]);
    const int64_t pixels = int64_t(from.width) * from.height;
    if (pixels < 2 || 3 * pixels > std::numeric_limits<int32_t>::max())
        throw py::value_error("wanted images of at least two pixels and less than 2 GiB");
    const auto [slack, far] = py::cast<std::pair<float, float>>(view[4]);
    return {from, data_of<double>(view[1], "from_target", {4, 4}), data_of<uint8_t>(view[2], "image", {from.height, from.width, 3}),
            image_of(view[3], "source depth", from), factor, {slack, far}, {}};
}

// Height and width: the first two axes.
inline std::pair<int, int> size_of(const py::array& array, const char* name) {
    if (array.ndim() < 2 || array.shape(0) > kMostPixels || array.shape(1) > kMostPixels)
        throw py::type_error(std::string(name) + ": wanted an image of at most 65535 x 65535 pixels, got " + describe(array));
    return {int(array.shape(0)), int(array.shape(1))};
}

}  // namespace ggvs
