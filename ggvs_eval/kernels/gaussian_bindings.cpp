// Python bindings of the differentiable splat of 3D Gaussians.
#include <limits>
#include <memory>

#include "camera_arguments.hpp"
#include "gaussian_splat.hpp"
#include "sources.hpp"

namespace {

namespace py = pybind11;
using namespace py::literals;
using ggvs::data_of;

struct Cloud {
    ggvs::CloudArrays arrays;
    py::ssize_t terms;
};

// (means, log_scales, quaternions, opacity_logits, sh, offsets or None)
Cloud cloud_of(const py::tuple& tensors) {
    if (tensors.size() != 6) throw py::type_error("cloud: wanted five arrays and the screen offsets or None");
    const py::array sh = py::cast<py::array>(tensors[4]);
    const auto sizes = ggvs::shape_of(sh, "sh", 3);
    const py::ssize_t count = sizes[0];
    int degree = 0;
    while (degree < ggvs::kMostDegree && (degree + 1) * (degree + 1) < sizes[1]) ++degree;
    if ((degree + 1) * (degree + 1) != sizes[1]) throw py::type_error("sh: wanted 1, 4, 9, 16 or 25 terms, got " + ggvs::describe(sh));
    if (count > std::numeric_limits<int32_t>::max()) throw py::value_error("cloud: more Gaussians than can be numbered");
    return {{count, degree, data_of<float>(tensors[0], "means", {count, 3}), data_of<float>(tensors[1], "log_scales", {count, 3}),
             data_of<float>(tensors[2], "quaternions", {count, 4}), data_of<float>(tensors[3], "opacity_logits", {count}),
             data_of<float>(sh, "sh", {count, sizes[1], 3}),
             tensors[5].is_none() ? nullptr : data_of<float>(tensors[5], "offsets", {count, 2})},
            sizes[1]};
}

ggvs::GaussianView view_of(const py::handle& camera, const py::handle& world_to_camera, const py::handle& centre, double near,
                           double slope_margin) {
    const ggvs::Pinhole p = ggvs::pinhole_of(camera);
    if (p.width < 1 || p.height < 1) throw py::value_error("view: wanted at least one pixel");
    const double* pose = data_of<double>(world_to_camera, "world_to_camera", {4, 4});
    const double* place = data_of<double>(centre, "centre", {3});
    ggvs::GaussianView view;
    for (int row = 0; row < 3; ++row) {
        for (int n = 0; n < 3; ++n) view.rotation[3 * row + n] = float(pose[4 * row + n]);
        view.shift[row] = float(pose[4 * row + 3]);
        view.centre[row] = float(place[row]);
    }
    view.fx = float(p.fx), view.fy = float(p.fy), view.cx = float(p.cx - 0.5), view.cy = float(p.cy - 0.5);
    const double margin_x = slope_margin * p.width / (2 * p.fx), margin_y = slope_margin * p.height / (2 * p.fy);
    view.low_x = float(-p.cx / p.fx - margin_x), view.high_x = float((p.width - p.cx) / p.fx + margin_x);
    view.low_y = float(-p.cy / p.fy - margin_y), view.high_y = float((p.height - p.cy) / p.fy + margin_y);
    view.near = float(near), view.width = p.width, view.height = p.height;
    return view;
}

py::tuple render(const py::tuple& tensors, const py::handle& camera, const py::handle& world_to_camera, const py::handle& centre,
                 double near, double slope_margin, int threads, int level) {
    const Cloud cloud = cloud_of(tensors);
    const ggvs::GaussianView view = view_of(camera, world_to_camera, centre, near, slope_margin);
    py::array_t<float> colour = ggvs::empty({view.height, view.width, 3}), depth = ggvs::empty({view.height, view.width});
    py::array_t<float> transmittance = ggvs::empty({view.height, view.width});
    py::array_t<int32_t> radii({py::ssize_t(cloud.arrays.count)});
    const ggvs::GaussianPictures out{colour.mutable_data(), transmittance.mutable_data(), depth.mutable_data(),
                                     radii.mutable_data()};
    std::unique_ptr<ggvs::GaussianFrame> frame;
    {
        py::gil_scoped_release released;
        frame = std::make_unique<ggvs::GaussianFrame>(ggvs::render_gaussians(cloud.arrays, view, out, threads, level));
    }
    return py::make_tuple(colour, transmittance, depth, radii, std::move(frame));
}

py::tuple gradients(const ggvs::GaussianFrame& frame, const py::tuple& tensors, const py::handle& by_colour,
                    const py::handle& by_transmittance, const py::handle& by_depth, int threads, int level) {
    const Cloud cloud = cloud_of(tensors);
    const py::ssize_t count = cloud.arrays.count, height = frame.view.height, width = frame.view.width;
    if (count != py::ssize_t(frame.boxes.size())) throw py::value_error("gradients: wanted the cloud that was rendered");
    const ggvs::PictureGradients given{data_of<float>(by_colour, "by_colour", {height, width, 3}),
                                       data_of<float>(by_transmittance, "by_transmittance", {height, width}),
                                       data_of<float>(by_depth, "by_depth", {height, width})};
    py::array_t<float> means = ggvs::empty({count, 3}), log_scales = ggvs::empty({count, 3});
    py::array_t<float> quaternions = ggvs::empty({count, 4}), opacity_logits = ggvs::empty({count});
    py::array_t<float> sh = ggvs::empty({count, cloud.terms, 3}), offsets = ggvs::empty({count, 2});
    const ggvs::CloudGradients out{means.mutable_data(), log_scales.mutable_data(), quaternions.mutable_data(),
                                   opacity_logits.mutable_data(), sh.mutable_data(), offsets.mutable_data()};
    {
        py::gil_scoped_release released;
        ggvs::gaussian_gradients(frame, cloud.arrays, given, out, threads, level);
    }
    return py::make_tuple(means, log_scales, quaternions, opacity_logits, sh, offsets);
}

}  // namespace

PYBIND11_MODULE(_gaussians, module) {
    module.doc() = "Differentiable splat of 3D Gaussians; ggvs_eval.gaussians is the face of it.";
    py::class_<ggvs::GaussianFrame>(module, "Frame", "What the backward pass of a rendered frame looks up.");
    module.attr("TILE") = ggvs::kTile;
    module.def("render", &render, "cloud"_a, "camera"_a, "world_to_camera"_a, "centre"_a, "near"_a, "slope_margin"_a, "threads"_a,
               "level"_a, "Sums of colour, transmittance, sums of depth, radii, and the frame.");
    module.def("gradients", &gradients, "frame"_a, "cloud"_a, "by_colour"_a, "by_transmittance"_a, "by_depth"_a, "threads"_a,
               "level"_a, "Derivatives by the five parameters and by the screen offsets.");
}
