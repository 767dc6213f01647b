// Python bindings of the kernels around the blending network: its views registered, its outputs composed, the picture refined.
#include "learned.hpp"

#include <limits>

#include "camera_arguments.hpp"
#include "compose.hpp"
#include "layer_arguments.hpp"
#include "network_inputs.hpp"
#include "outputs.hpp"
#include "overview.hpp"
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

Registration registration_of(const py::handle& target, const py::handle& depth, const py::sequence& views, float tolerance,
                             float faint) {
    const Pinhole to = pinhole_of(target);
    Registration job{to, image_of(depth, "depth", to), tolerance, faint, {}};
    for (const py::handle& item : views) {
        const py::tuple view = py::cast<py::tuple>(item);
        const py::array splat = py::cast<py::array>(view[5]);
        const int stride = colour_stride(splat, to);
        const float* alpha = image_of(view[6], "alpha", to);
        job.views.push_back({look_up_view(view, 1.0f), static_cast<const float*>(splat.data()), stride, alpha});
    }
    return job;
}

// Colours, coverage and visibility of registered views.
struct RegisteredArrays {
    py::array_t<float> colours, coverage, seen;
    RegisteredMaps maps;

    explicit RegisteredArrays(const Registration& job)
        : colours(empty({py::ssize_t(job.views.size()), job.target.height, job.target.width, 3})),
          coverage(empty({py::ssize_t(job.views.size()), job.target.height, job.target.width})),
          seen(empty({py::ssize_t(job.views.size()), job.target.height, job.target.width})),
          maps{colours.mutable_data(), coverage.mutable_data(), seen.mutable_data(), 0, job.target.height} {}

    py::tuple tuple() const { return py::make_tuple(colours, coverage, seen); }
};

py::tuple register_views_of(const py::handle& target, const py::handle& depth, const py::sequence& views, float tolerance,
                            float faint, int threads, int level) {
    Registration job = registration_of(target, depth, views, tolerance, faint);
    const RegisteredArrays out(job);
    {
        py::gil_scoped_release released;
        ggvs::register_views(job, out.maps, threads, level);
    }
    return out.tuple();
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

std::vector<const float*> maps_of(const py::sequence& maps, const char* name, py::ssize_t height, py::ssize_t width) {
    std::vector<const float*> found;
    for (const py::handle& map : maps) found.push_back(data_of<float>(map, name, {height, width}));
    return found;
}

// All that an overview fills.
struct OverviewArrays {
    py::array_t<float> mean, unseen, small[4], depths;
    py::array_t<bool> covered;
    OverviewMaps maps;

    explicit OverviewArrays(const Views& job)
        : mean(empty({job.height, job.width, 3})), unseen(empty({job.height, job.width})), covered({job.height, job.width}) {
        const py::ssize_t rows = (job.height + job.scale - 1) / job.scale, columns = (job.width + job.scale - 1) / job.scale;
        for (auto& each : small) each = empty({job.views, rows, columns});
        small[0] = empty({job.views, rows, columns, 3});
        depths = empty({py::ssize_t(job.depths.size()), rows, columns});
        maps = {mean.mutable_data(), unseen.mutable_data(), covered.mutable_data(), {}, depths.mutable_data()};
        for (int n = 0; n < 4; ++n) maps.small[n] = small[n].mutable_data();
    }

    py::tuple tuple() const {
        return py::make_tuple(mean, unseen, covered, py::make_tuple(small[0], small[1], small[2], small[3]), depths);
    }
};

py::tuple overview_of(const py::array& colours, const py::array& coverage, const py::array& seen, const py::sequence& alphas,
                      const py::sequence& depths, const py::handle& weights, int scale, float covered_alpha, int threads,
                      int level) {
    const auto shape = shape_of(colours, "colours", 4);
    if (shape[0] < 1 || shape[1] < 1 || shape[2] < 1 || scale < 1 || shape[1] > kMostPixels || shape[2] > kMostPixels)
        throw py::value_error("overview: wanted views of 1 to 65535 pixels per side and a scale of at least 1");
    const py::ssize_t views = shape[0], height = shape[1], width = shape[2];
    if (py::ssize_t(py::len(alphas)) != views) throw py::value_error("overview: wanted a coverage for each view");
    // They are only read.
    const RegisteredMaps maps{const_cast<float*>(data_of<float>(colours, "colours", {views, height, width, 3})),
                              const_cast<float*>(data_of<float>(coverage, "coverage", {views, height, width})),
                              const_cast<float*>(data_of<float>(seen, "seen", {views, height, width})), 0, int(height)};
    const Views job{int(width), int(height), int(views), scale, maps, maps_of(alphas, "alpha", height, width),
                    maps_of(depths, "depth", height, width), data_of<float>(weights, "weights", {views}), covered_alpha};
    const OverviewArrays out(job);
    {
        py::gil_scoped_release released;
        ggvs::overview(job, out.maps, threads, level);
    }
    return out.tuple();
}

py::tuple register_and_overview_of(const py::handle& target, const py::handle& depth, const py::sequence& views, float tolerance,
                                   float faint, const py::sequence& depths, const py::handle& weights, int scale,
                                   float covered_alpha, int threads, int level) {
    Registration registration = registration_of(target, depth, views, tolerance, faint);
    const int width = registration.target.width, height = registration.target.height, count = int(registration.views.size());
    if (count < 1 || width < 1 || height < 1 || scale < 1)
        throw py::value_error("overview: wanted views of 1 to 65535 pixels per side and a scale of at least 1");
    const RegisteredArrays registered(registration);
    Views job{width, height, count, scale, registered.maps, {}, maps_of(depths, "depth", height, width),
              data_of<float>(weights, "weights", {count}), covered_alpha};
    for (const RegisteredView& view : registration.views) job.alphas.push_back(view.alpha);
    const OverviewArrays out(job);
    {
        py::gil_scoped_release released;
        ggvs::register_and_overview(registration, job, out.maps, threads, level);
    }
    return py::make_tuple(registered.tuple(), out.tuple());
}

py::array_t<float> network_inputs_of(const py::array& colours, const py::handle& depths, const py::handle& alphas,
                                     const py::object& seen, const py::handle& fused, const py::tuple& rays,
                                     const py::tuple& cameras, float far, float unit, int most_views, int threads) {
    const auto shape = shape_of(colours, "colours", 4);
    const py::ssize_t views = shape[0], height = shape[1], width = shape[2];
    if (views < 1 || views > most_views || most_views > kMostPixels || height < 1 || width < 1)
        throw py::value_error("network_inputs: wanted at least one view, and not more than the network takes");
    const NetworkInputs job{int(width),
                            int(height),
                            int(views),
                            most_views,
                            data_of<float>(colours, "colours", {views, height, width, 3}),
                            data_of<float>(depths, "depths", {views, height, width}),
                            data_of<float>(alphas, "alphas", {views, height, width}),
                            seen.is_none() ? nullptr : data_of<float>(seen, "seen", {views, height, width}),
                            data_of<float>(fused, "fused depth", {height, width}),
                            data_of<float>(rays[0], "slopes across", {width}),
                            data_of<float>(rays[1], "slopes down", {height}),
                            far,
                            unit,
                            data_of<float>(cameras[0], "centres", {views, 3}),
                            data_of<float>(cameras[1], "distances", {views}),
                            data_of<float>(cameras[2], "axes", {views})};
    py::array_t<float> out = empty({network_channels(job), height, width});
    float* data = out.mutable_data();
    py::gil_scoped_release released;
    ggvs::network_inputs(job, data, threads);
    return out;
}

py::tuple read_outputs_of(const py::array& raw, const py::array& logarithms, const py::handle& coverage, const py::handle& seen,
                          int most_views, float sure, int threads, int level) {
    const auto shape = shape_of(raw, "raw", 3);
    const int views = int(shape_of(logarithms, "logarithms", 1)[0]), features = int(shape[0]) - most_views - 4;
    if (views < 1 || views > most_views || features < 0)
        throw py::value_error("read_outputs: wanted at least one view, not more than the network takes, and four outputs more");
    const py::ssize_t height = shape[1], width = shape[2];
    const RawOutputs job{height * width,
                         views,
                         most_views,
                         features,
                         data_of<float>(raw, "raw", shape),
                         data_of<float>(logarithms, "logarithms", {views}),
                         data_of<float>(coverage, "coverage", {views, height, width}),
                         data_of<float>(seen, "seen", {views, height, width}),
                         sure};
    py::array_t<float> small = empty({views + 4 + features, height, width}), shares = empty({views, height, width});
    const ReadOutputs out{small.mutable_data(), shares.mutable_data()};
    {
        py::gil_scoped_release released;
        ggvs::read_outputs(job, out, threads, level);
    }
    return py::make_tuple(small, shares);
}

// (what `pack_filters` makes of filters of 3 x 3 and bias, after)
Layer look_of(const py::handle& object, int before) {
    const py::tuple layer = py::cast<py::tuple>(object);
    return packed_layer(layer[0], layer[1], before, py::cast<int>(layer[2]));
}

// (weights (before, padded), bias (padded), after)
Layer taps_of(const py::handle& object, int before) {
    const py::tuple layer = py::cast<py::tuple>(object);
    const int after = py::cast<int>(layer[2]), padded = groups_of(after) * kGroupOutputs;
    return {before, after, padded, data_of<float>(layer[0], "weights", {before, padded}), data_of<float>(layer[1], "bias", {padded})};
}

py::array_t<float> refine_of(const py::array& picture, const py::handle& spread, const py::handle& shown, const py::handle& depth,
                          const py::array& small, int scale, int first_feature,
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
                   maps,
                   first_feature,
                   int(small.shape(0)) - first_feature,
                   {},
                   {}};
    job.looks[0] = look_of(layers[0], job.features + kEvidence);
    job.looks[1] = look_of(layers[1], job.looks[0].after);
    job.taps = taps_of(layers[2], job.looks[1].after);
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
    m.def("overview", &overview_of, "colours"_a, "coverage"_a, "seen"_a, "alphas"_a, "depths"_a, "weights"_a, "scale"_a,
          "covered_alpha"_a, "threads"_a, "level"_a);
    m.def("register_and_overview", &register_and_overview_of, "target"_a, "depth"_a, "views"_a, "tolerance"_a, "faint"_a,
          "depths"_a, "weights"_a, "scale"_a, "covered_alpha"_a, "threads"_a, "level"_a);
    m.def("network_inputs", &network_inputs_of, "colours"_a, "depths"_a, "alphas"_a, "seen"_a, "fused"_a, "rays"_a, "cameras"_a,
          "far"_a, "unit"_a, "most_views"_a, "threads"_a);
    m.def("compose", &compose_of, "colours"_a, "coverage"_a, "unseen"_a, "background"_a, "small"_a, "scale"_a, "sure"_a,
          "threads"_a, "level"_a);
    m.def("read_outputs", &read_outputs_of, "raw"_a, "logarithms"_a, "coverage"_a, "seen"_a, "most_views"_a, "sure"_a, "threads"_a,
          "level"_a);
    m.def("refine", &refine_of, "picture"_a, "spread"_a, "shown"_a, "depth"_a, "small"_a, "scale"_a,
          "first_feature"_a, "layers"_a, "threads"_a, "level"_a);
}

}  // namespace ggvs
