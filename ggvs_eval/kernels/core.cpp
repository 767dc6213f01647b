// Python bindings of the geometric kernels. Arrays are taken as they lie in memory: a wrong dtype, shape or layout is a
// TypeError, never a silent copy. The GIL is released while a kernel runs.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <limits>
#include <string>
#include <vector>

#include "kernels.hpp"
#include "warp.hpp"

namespace py = pybind11;
using namespace py::literals;

namespace {

std::string describe(const py::array& array) {
    return py::cast<std::string>(py::str(array.dtype())) + " " + py::cast<std::string>(py::str(array.attr("shape"))) +
           (array.flags() & py::array::c_style ? "" : ", not C-contiguous");
}

// The data of a C-contiguous T array of exactly this shape.
template <class T>
const T* data_of(const py::handle& object, const char* name, const std::vector<py::ssize_t>& shape) {
    py::tuple sizes(shape.size());
    for (size_t n = 0; n < shape.size(); ++n) sizes[n] = shape[n];
    const std::string wanted =
        py::cast<std::string>(py::str(py::dtype::of<T>())) + " " + py::cast<std::string>(py::str(sizes)) + ", C-contiguous";
    if (!py::isinstance<py::array>(object))
        throw py::type_error(std::string(name) + ": wanted " + wanted + ", got " + Py_TYPE(object.ptr())->tp_name);
    const py::array array = py::reinterpret_borrow<py::array>(object);
    const bool same = py::isinstance<py::array_t<T>>(array) && (array.flags() & py::array::c_style) &&
                      std::vector<py::ssize_t>(array.shape(), array.shape() + array.ndim()) == shape;
    if (!same) throw py::type_error(std::string(name) + ": wanted " + wanted + ", got " + describe(array));
    return static_cast<const T*>(array.data());
}

const float* image_of(const py::handle& object, const char* name, const ggvs::Pinhole& camera) {
    return data_of<float>(object, name, {camera.height, camera.width});
}

// (fx, fy, cx, cy, width, height)
ggvs::Pinhole pinhole(const py::handle& object) {
    const auto [fx, fy, cx, cy, width, height] = py::cast<std::tuple<double, double, double, double, int, int>>(object);
    if (width < 0 || height < 0 || width > 65535 || height > 65535)
        throw py::value_error("images of at most 65535 x 65535 pixels");
    return {fx, fy, cx, cy, width, height};
}

py::array_t<float> empty(std::vector<py::ssize_t> shape) { return py::array_t<float>(std::move(shape)); }

py::tuple splat(const py::sequence& sources, const py::handle& target, float near, float scale, int channels, bool normalised,
                int threads, int level) {
    std::vector<ggvs::SplatSource> list;
    for (const py::handle& item : sources) {
        const py::tuple source = py::cast<py::tuple>(item);
        ggvs::SplatSource s{pinhole(source[0]), data_of<double>(source[1], "to_target", {4, 4}), nullptr, nullptr};
        s.depth = image_of(source[2], "depth", s.camera);
        s.features = data_of<float>(source[3], "features", {s.camera.height, s.camera.width, channels});
        list.push_back(s);
    }
    if (channels < 1 || channels > ggvs::kMaxFeatures) throw py::value_error("splat: wanted 1 to 4 feature channels");
    const ggvs::SplatTarget to{pinhole(target), near};
    py::array_t<float> features = empty({to.camera.height, to.camera.width, channels});
    py::array_t<float> alpha = empty({to.camera.height, to.camera.width}), depth = empty({to.camera.height, to.camera.width});
    const ggvs::SplatImages out{features.mutable_data(), alpha.mutable_data(), depth.mutable_data()};
    {
        py::gil_scoped_release released;
        ggvs::splat(list, channels, to, scale, normalised, out, threads, level);
    }
    return py::make_tuple(features, alpha, depth);
}

py::array_t<float> fusion_weights(const py::array& depth, float tau, float depth_noise, int threads, int level) {
    if (depth.ndim() != 2) throw py::type_error("depth: wanted float32 (H, W), got " + describe(depth));
    const int height = int(depth.shape(0)), width = int(depth.shape(1));
    const float* data = data_of<float>(depth, "depth", {height, width});
    py::array_t<float> weights = empty({height, width});
    float* out = weights.mutable_data();
    py::gil_scoped_release released;
    ggvs::fusion_weights(data, width, height, tau, depth_noise, out, threads, level);
    return weights;
}

py::tuple ray_march(const py::handle& target, const py::tuple& range, const py::sequence& views, float tau, float step_fraction,
                    float min_step, int bisections, bool skip_empty, int threads, int level) {
    ggvs::March march{pinhole(target),
                      py::cast<float>(range[0]),
                      py::cast<float>(range[1]),
                      tau,
                      step_fraction,
                      min_step,
                      bisections,
                      skip_empty,
                      {}};
    for (const py::handle& item : views) {
        const py::tuple view = py::cast<py::tuple>(item);
        ggvs::FieldView field{pinhole(view[0]),
                              data_of<double>(view[1], "from_target", {4, 4}),
                              nullptr,
                              nullptr,
                              nullptr,
                              std::numeric_limits<float>::max(),
                              {}};
        field.depth = image_of(view[2], "depth", field.camera);
        field.weight = image_of(view[3], "weight", field.camera);
        if (!view[4].is_none()) {
            field.gain = image_of(view[4], "gain", march.target);
            field.limit = py::cast<float>(view[5]);
        }
        march.views.push_back(field);
    }
    if (march.views.size() > size_t(ggvs::kMaxViews)) throw py::value_error("ray_march: wanted at most 32 views");
    py::array_t<float> depth = empty({march.target.height, march.target.width});
    py::array_t<float> weight = empty({march.target.height, march.target.width});
    float *depth_out = depth.mutable_data(), *weight_out = weight.mutable_data();
    {
        py::gil_scoped_release released;
        ggvs::ray_march(march, depth_out, weight_out, threads, level);
    }
    return py::make_tuple(depth, weight);
}

py::tuple warp(const py::handle& target, const py::handle& target_depth, const py::handle& source, const py::handle& from_target,
               const py::handle& image, const py::handle& source_depth, float tolerance, bool bicubic, int threads) {
    const ggvs::Pinhole to = pinhole(target), from = pinhole(source);
    const float* depth = image_of(target_depth, "target_depth", to);
    const ggvs::WarpSource s{from, data_of<double>(from_target, "from_target", {4, 4}),
                             data_of<float>(image, "image", {from.height, from.width, 3}),
                             image_of(source_depth, "source_depth", from)};
    py::array_t<float> colour = empty({to.height, to.width, 3}), visibility = empty({to.height, to.width});
    float *colour_out = colour.mutable_data(), *visibility_out = visibility.mutable_data();
    {
        py::gil_scoped_release released;
        ggvs::warp(to, depth, s, tolerance, bicubic, colour_out, visibility_out, threads);
    }
    return py::make_tuple(colour, visibility);
}

}  // namespace

PYBIND11_MODULE(_core, m) {
    m.doc() = "Splat, TSDF weights, ray march and warp on CPU threads; ggvs_eval.geometry is the face of it.";
    m.def("best_level", &ggvs::best_level,
          "Index of the highest instruction set this processor runs: 0 baseline, 1 avx2, 2 avx512.");
    m.def("splat", &splat, "sources"_a, "target"_a, "near"_a, "scale"_a, "channels"_a, "normalised"_a, "threads"_a, "level"_a);
    m.def("fusion_weights", &fusion_weights, "depth"_a, "tau"_a, "depth_noise"_a, "threads"_a, "level"_a);
    m.def("ray_march", &ray_march, "target"_a, "range"_a, "views"_a, "tau"_a, "step_fraction"_a, "min_step"_a, "bisections"_a,
          "skip_empty"_a, "threads"_a, "level"_a);
    m.def("warp", &warp, "target"_a, "target_depth"_a, "source"_a, "from_target"_a, "image"_a, "source_depth"_a, "tolerance"_a,
          "bicubic"_a, "threads"_a);
}
