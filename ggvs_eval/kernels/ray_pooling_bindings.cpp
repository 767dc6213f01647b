// Python binding of IBRNet's pooling.
#include "ray_pooling.hpp"

#include "camera_arguments.hpp"
#include "learned.hpp"

namespace ggvs {
namespace {

using namespace py::literals;

constexpr int kLayers = 20;

// (weights (before, padded), bias (padded)) of a layer whose sizes are known.
DenseLayer layer_of(const py::handle& object, int before, int after) {
    const py::tuple layer = py::cast<py::tuple>(object);
    const int padded = (after + kRayOutputs - 1) / kRayOutputs * kRayOutputs;
    return {before, after, padded, data_of<float>(layer[0], "weights", {before, padded}),
            data_of<float>(layer[1], "bias", {padded})};
}

RayLayers layers_of(const py::sequence& layers, const py::handle& norm, float closeness) {
    if (py::len(layers) != kLayers) throw py::value_error("pool_views: wanted 20 layers");
    const int seen = kRaySeen, features = kRayFeatures;
    return {{layer_of(layers[0], 4, 16), layer_of(layers[1], 16, seen)},
            layer_of(layers[2], 2 * seen, 64),
            layer_of(layers[3], seen, 64),
            layer_of(layers[4], 64, features),
            {layer_of(layers[5], features, 32), layer_of(layers[6], 32, features + 1)},
            {layer_of(layers[7], features, 32), layer_of(layers[8], 32, 1)},
            {layer_of(layers[9], 2 * features + 1, 64), layer_of(layers[10], 64, kRayOut)},
            {layer_of(layers[11], features + 5, 16), layer_of(layers[12], 16, 8), layer_of(layers[13], 8, 1)},
            layer_of(layers[14], kRayOut, kRayOut),
            layer_of(layers[15], kRayOut, kRayOut),
            layer_of(layers[16], kRayOut, kRayOut),
            layer_of(layers[17], kRayOut, kRayOut),
            {layer_of(layers[18], kRayOut, 16), layer_of(layers[19], 16, 1)},
            data_of<float>(norm, "norm", {2, kRayOut}),
            data_of<float>(norm, "norm", {2, kRayOut}) + kRayOut,
            closeness};
}

// (image (H, W, 3), features (h, w, 32), projection (3, 4), centre (3))
RayView view_of(const py::handle& object) {
    const py::tuple view = py::cast<py::tuple>(object);
    const py::array image = py::cast<py::array>(view[0]), features = py::cast<py::array>(view[1]);
    const auto [height, width] = size_of(image, "image");
    const auto [feature_height, feature_width] = size_of(features, "features");
    RayView made{data_of<float>(image, "image", {height, width, 3}),
                 height,
                 width,
                 data_of<float>(features, "features", {feature_height, feature_width, kRayFeatures}),
                 feature_height,
                 feature_width,
                 {},
                 {}};
    std::copy_n(data_of<float>(view[2], "projection", {3, 4}), 12, made.projection);
    std::copy_n(data_of<float>(view[3], "centre", {3}), 3, made.centre);
    return made;
}

py::tuple pool_views_of(const py::sequence& layers, const py::array& norm, float closeness, const py::sequence& views,
                        const py::array& centre, const py::array& rays, const py::array& depths, const py::array& places,
                        int level) {
    RayPooling job{layers_of(layers, norm, closeness), {}, {}, nullptr, nullptr, nullptr, 0, 0};
    for (const py::handle& view : views) job.views.push_back(view_of(view));
    if (job.views.empty()) throw py::value_error("pool_views: wanted at least one view");
    std::copy_n(data_of<float>(centre, "centre", {3}), 3, job.centre);
    const auto shape = shape_of(depths, "depths", 2);
    job.n_rays = shape[0];
    job.n_samples = int(shape[1]);
    job.depths = data_of<float>(depths, "depths", {shape[0], shape[1]});
    job.rays = data_of<float>(rays, "rays", {shape[0], 3});
    job.places = data_of<float>(places, "places", {shape[1], kRayOut});
    py::array_t<float> colours({shape[0], shape[1], py::ssize_t(3)}), density({shape[0], shape[1]});
    const RayColours out{colours.mutable_data(), density.mutable_data()};
    {
        py::gil_scoped_release released;
        pool_views(job, out, level);
    }
    return py::make_tuple(colours, density);
}

}  // namespace

void bind_ray_pooling(py::module_& m) {
    m.def("pool_views", &pool_views_of, "layers"_a, "norm"_a, "closeness"_a, "views"_a, "centre"_a, "rays"_a, "depths"_a,
          "places"_a, "level"_a);
}

}  // namespace ggvs
