// Python bindings of the kernels around the blending network: its views registered, its outputs composed, the picture refined.
#include "learned.hpp"

#include <limits>

#include "camera_arguments.hpp"
#include "compose.hpp"
#include "refine.hpp"
#include "register.hpp"

namespace ggvs {
namespace {

using namespace py::literals;

// Floats from pixel to pixel of colours (height, width, C), C >= 3, that lie evenly.
int colour_stride(const py::array& image, const Pinhole& target) {
    const py::ssize_t item = sizeof(float);
    const bool even = image.ndim() == 3 && py::isinstance<py::array_t<float>>(image) && image.shape(0) == target.height &&
                      image.shape(1) == target.width && image.shape(2) >= 3 && image.strides(2) == item &&
                      image.strides(1) % item == 0 && image.strides(1) >= 3 * item && image.strides(1) <= 64 * item &&
                      image.strides(0) == image.shape(1) * image.strides(1);
    if (!even)
        throw py::type_error("splat: wanted float32 colours of the target's size, pixels evenly spaced, got " + describe(image));
    return int(image.strides(1) / item);
}

py::tuple register_views_of(const py::handle& target, const py::handle& depth, const py::sequence& views, float tolerance,
                            float faint, int threads, int level) {
    const Pinhole to = pinhole_of(target);
    Registration job{to, image_of(depth, "depth", to), tolerance, faint, {}};
    for (const py::handle& item : views) {
        const py::tuple view = py::cast<py::tuple>(item);
        const Pinhole from = pinhole_of(view[0]);
        const int64_t pixels = int64_t(from.width) * from.height;
        if (pixels < 2 || 3 * pixels > std::numeric_limits<int32_t>::max())
            throw py::value_error("register_views: wanted images of at least two pixels and less than 2 GiB");
        const LookUpView captured{from, data_of<double>(view[1], "from_target", {4, 4}),
                                  data_of<uint8_t>(view[2], "image", {from.height, from.width, 3}),
                                  image_of(view[3], "source depth", from), 1.0f, {}};
        const py::array splat = py::cast<py::array>(view[4]);
        const int stride = colour_stride(splat, to);
        job.views.push_back({captured, static_cast<const float*>(splat.data()), stride, image_of(view[5], "alpha", to)});
    }
    const py::ssize_t count = py::ssize_t(job.views.size());
    py::array_t<float> colours = empty({count, to.height, to.width, 3}), coverage = empty({count, to.height, to.width});
    py::array_t<float> seen = empty({count, to.height, to.width});
    const RegisteredMaps out{colours.mutable_data(), coverage.mutable_data(), seen.mutable_data()};
    {
        py::gil_scoped_release released;
        ggvs::register_views(job, out, threads, level);
    }
    return py::make_tuple(colours, coverage, seen);
}

// Small maps (channels, h, w) of a view of this size, at least so many channels.
SmallMaps small_maps(const py::array& small, int scale, int channels, int height, int width) {
    const auto shape = shape_of(small, "small", 3);
    const bool fits = scale > 0 && shape[0] >= channels && shape[1] == (height + scale - 1) / scale &&
                      shape[2] == (width + scale - 1) / scale;
    if (!fits) throw py::type_error("small: wanted as many channels as are used, and the reduced size, got " + describe(small));
    return {data_of<float>(small, "small", shape), int(shape[2]), int(shape[1]), scale};
}

py::tuple compose_of(const py::array& colours, const py::handle& coverage, const py::handle& unseen, const py::handle& background,
                     const py::array& small, int scale, float sure, int threads, int level) {
    const auto shape = shape_of(colours, "colours", 4);
    if (shape[1] > kMostPixels || shape[2] > kMostPixels || shape[0] > kMostPixels)
        throw py::value_error("compose: images of at most 65535 x 65535 pixels");
    const int views = int(shape[0]), height = int(shape[1]), width = int(shape[2]);
    const Composition job{width,
                          height,
                          views,
                          data_of<float>(colours, "colours", {views, height, width, 3}),
                          data_of<float>(coverage, "coverage", {views, height, width}),
                          data_of<float>(unseen, "unseen", {height, width}),
                          data_of<float>(background, "background", {height, width, 3}),
                          small_maps(small, scale, views + 4, height, width),
                          sure};
    py::array_t<float> picture = empty({3, height, width}), spread = empty({height, width}), shown = empty({height, width});
    const ComposedMaps out{picture.mutable_data(), spread.mutable_data(), shown.mutable_data()};
    {
        py::gil_scoped_release released;
        ggvs::compose(job, out, threads, level);
    }
    return py::make_tuple(picture, spread, shown);
}

// (weights (before, size, size, padded), bias (padded), after)
Layer layer_of(const py::handle& object, int size, int before) {
    const py::tuple layer = py::cast<py::tuple>(object);
    const py::array weights = py::cast<py::array>(layer[0]);
    const int after = py::cast<int>(layer[2]);
    const auto shape = shape_of(weights, "weights", 4);
    if (after < 1 || shape[3] < after || shape[3] % 8 != 0 || shape[3] > kMostPixels)
        throw py::type_error("weights: wanted the outputs filled up to a multiple of 8, got " + describe(weights));
    return {before, after, int(shape[3]), data_of<float>(weights, "weights", {before, size, size, shape[3]}),
            data_of<float>(layer[1], "bias", {shape[3]})};
}

py::array_t<float> refine_of(const py::array& picture, const py::handle& spread, const py::handle& shown, const py::handle& depth,
                          const py::handle& logarithm, const py::array& small, int scale, int first_feature,
                          const py::sequence& layers, int threads, int level) {
    const auto shape = shape_of(picture, "picture", 3);
    if (shape[1] > kMostPixels || shape[2] > kMostPixels || py::len(layers) != 3 || first_feature < 0)
        throw py::value_error("refine: wanted an image of at most 65535 x 65535 pixels and three layers");
    const int height = int(shape[1]), width = int(shape[2]);
    const SmallMaps maps = small_maps(small, scale, first_feature, height, width);
    Refinement job{width,
                   height,
                   data_of<float>(picture, "picture", {3, height, width}),
                   data_of<float>(spread, "spread", {height, width}),
                   data_of<float>(shown, "shown", {height, width}),
                   data_of<float>(depth, "depth", {height, width}),
                   data_of<float>(logarithm, "logarithm", {height, width}),
                   maps,
                   first_feature,
                   int(small.shape(0)) - first_feature,
                   {},
                   {}};
    job.looks[0] = layer_of(layers[0], 3, job.features + kEvidence);
    job.looks[1] = layer_of(layers[1], 3, job.looks[0].after);
    job.taps = layer_of(layers[2], 1, job.looks[1].after);
    if (job.taps.after != kTaps) throw py::value_error("refine: wanted 12 taps");
    py::array_t<float> out = empty({height, width, 3});
    float* data = out.mutable_data();
    py::gil_scoped_release released;
    ggvs::refine(job, data, threads, level);
    return out;
}

}  // namespace

void bind_learned(py::module_& m) {
    m.def("register_views", &register_views_of, "target"_a, "depth"_a, "views"_a, "tolerance"_a, "faint"_a, "threads"_a,
          "level"_a);
    m.def("compose", &compose_of, "colours"_a, "coverage"_a, "unseen"_a, "background"_a, "small"_a, "scale"_a, "sure"_a,
          "threads"_a, "level"_a);
    m.def("refine", &refine_of, "picture"_a, "spread"_a, "shown"_a, "depth"_a, "logarithm"_a, "small"_a, "scale"_a,
          "first_feature"_a, "layers"_a, "threads"_a, "level"_a);
}

}  // namespace ggvs
