// Python bindings of the geometric kernels; those of the image kernels stand in images.cpp. The GIL is released while one runs.
#include <pybind11/stl.h>

#include <limits>

#include "camera_arguments.hpp"
#include "images.hpp"
#include "kernels.hpp"
#include "learned.hpp"
#include "sources.hpp"
#include "warp.hpp"

namespace py = pybind11;
using namespace py::literals;

namespace {

using ggvs::data_of, ggvs::describe, ggvs::empty, ggvs::image_of, ggvs::pinhole_of;

py::tuple splat(const py::sequence& sources, const py::handle& target, float near, float scale, int channels, bool normalised,
                int threads, int level) {
    std::vector<ggvs::SplatSource> list;
    for (const py::handle& item : sources) {
        const py::tuple source = py::cast<py::tuple>(item);
        ggvs::SplatSource s{pinhole_of(source[0]), data_of<double>(source[1], "to_target", {4, 4}), nullptr, nullptr, nullptr,
                            nullptr};
        s.depth = image_of(source[2], "depth", s.camera);
        if (py::isinstance<py::array_t<uint8_t>>(source[3])) {
            s.colours = data_of<uint8_t>(source[3], "features", {s.camera.height, s.camera.width, 3});
            if (!source[4].is_none()) s.extra = image_of(source[4], "extra", s.camera);
            const int64_t pixels = int64_t(s.camera.width) * s.camera.height;
            if (pixels < 2 || 3 * pixels > std::numeric_limits<int32_t>::max())
                throw py::value_error("splat: wanted 8-bit images of at least two pixels and less than 2 GiB");
            if (channels != (s.extra ? 4 : 3)) throw py::value_error("splat: wanted 3 channels, or 4 with an extra one");
        } else {
            s.features = data_of<float>(source[3], "features", {s.camera.height, s.camera.width, channels});
        }
        list.push_back(s);
    }
    if (channels < 1 || channels > ggvs::kMaxFeatures) throw py::value_error("splat: wanted 1 to 4 feature channels");
    const ggvs::SplatTarget to{pinhole_of(target), near};
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
                    float min_step, bool skip_empty, int threads, int level) {
    ggvs::March march{pinhole_of(target),
                      py::cast<float>(range[0]),
                      py::cast<float>(range[1]),
                      tau,
                      step_fraction,
                      min_step,
                      skip_empty,
                      {},
                      0.0f};
    for (const py::handle& item : views) {
        const py::tuple view = py::cast<py::tuple>(item);
        ggvs::FieldView field{pinhole_of(view[0]),
                              data_of<double>(view[1], "from_target", {4, 4}),
                              nullptr,
                              nullptr,
                              nullptr,
                              std::numeric_limits<float>::max(),
                              {},
                              0.0f,
                              0.0f,
                              0.0f,
                              0.0f};
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
               const py::handle& image, const py::handle& source_depth, std::pair<float, float> forgiven, float tolerance,
               bool bicubic, int threads, int level) {
    const ggvs::Pinhole to = pinhole_of(target), from = pinhole_of(source);
    if (3 * int64_t(from.width) * from.height > std::numeric_limits<int32_t>::max())
        throw py::value_error("warp: wanted an image of less than 2 GiB");
    ggvs::Warping job{to, image_of(target_depth, "target_depth", to),
                      {from, data_of<double>(from_target, "from_target", {4, 4}), nullptr,
                       image_of(source_depth, "source_depth", from), 1.0f, {forgiven.first, forgiven.second}, {}},
                      nullptr, nullptr, tolerance, bicubic};
    if (py::isinstance<py::tuple>(image)) {
        const auto [now, before] = py::cast<std::pair<py::object, py::object>>(image);
        if (from.width * from.height < 2) throw py::value_error("warp: wanted images of at least two pixels");
        job.view.image = data_of<uint8_t>(now, "now", {from.height, from.width, 3});
        job.before = data_of<uint8_t>(before, "before", {from.height, from.width, 3});
    } else {
        job.image = data_of<float>(image, "image", {from.height, from.width, 3});
    }
    py::array_t<float> colour = empty({to.height, to.width, 3}), visibility = empty({to.height, to.width});
    float *colour_out = colour.mutable_data(), *visibility_out = visibility.mutable_data();
    {
        py::gil_scoped_release released;
        ggvs::warp(job, colour_out, visibility_out, threads, level);
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
    m.def("ray_march", &ray_march, "target"_a, "range"_a, "views"_a, "tau"_a, "step_fraction"_a, "min_step"_a,
          "skip_empty"_a, "threads"_a, "level"_a);
    m.def("warp", &warp, "target"_a, "target_depth"_a, "source"_a, "from_target"_a, "image"_a, "source_depth"_a,
          "forgiven"_a, "tolerance"_a, "bicubic"_a, "threads"_a, "level"_a);
    m.def("empty", &ggvs::empty, "shape"_a, "An array of floats that nobody has written yet, of the memory kept for results.");
    m.def("idle_bytes", &ggvs::idle_bytes, "Bytes that are kept for the next large results.");
    m.def("forget_idle", &ggvs::forget_idle, "Give them back to the system.");
    ggvs::bind_images(m);
    ggvs::bind_learned(m);
    ggvs::bind_unet(m);
    ggvs::bind_ray_pooling(m);
}
