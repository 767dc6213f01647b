// Python bindings of the kernels that work on images: filter, weighted means, look-up, holes, background memory.
#include "images.hpp"

#include <limits>

#include "blend.hpp"
#include "camera_arguments.hpp"
#include "contested.hpp"
#include "filter.hpp"
#include "push_pull.hpp"
#include "recur.hpp"
#include "remember.hpp"
#include "shade.hpp"

namespace ggvs {
namespace {

using namespace py::literals;
using Size = std::pair<int, int>;

constexpr int kMostRows = 128;  // of one cell, see filter.cpp

py::array_t<float> colour_change_of(const py::array& now, const py::handle& before, Size cells, int threads) {
    const auto [height, width] = size_of(now, "now");
    const auto [down, across] = cells;
    if (down < 1 || across < 1 || down > height || across > width || height > int64_t(kMostRows) * down)
        throw py::value_error("colour_change: cells must cover 1 to 128 rows and at least one column");
    const ImagePair pair{data_of<uint8_t>(now, "now", {height, width, 3}), data_of<uint8_t>(before, "before", {height, width, 3}),
                         width, height, across, down};
    py::array_t<float> out = empty({down, across, 3});
    float* data = out.mutable_data();
    py::gil_scoped_release released;
    ggvs::colour_change(pair, data, threads);
    return out;
}

py::array_t<float> mix_depth_of(const py::array& depth, const py::handle& history, const py::handle& mask, float tolerance,
                             int threads) {
    const auto [height, width] = size_of(depth, "depth");
    const DepthPair pair{data_of<float>(depth, "depth", {height, width}), data_of<float>(history, "history", {height, width}),
                         data_of<float>(mask, "mask", {height, width}), int64_t(height) * width, tolerance};
    py::array_t<float> out = empty({height, width});
    float* data = out.mutable_data();
    py::gil_scoped_release released;
    ggvs::mix_depth(pair, data, threads);
    return out;
}

// Floats from pixel to pixel, of an image (H, W, C) whose channels lie side by side and whose pixels lie evenly.
int pixel_stride(const py::array& image, const char* name) {
    const py::ssize_t item = sizeof(float);
    const bool even = image.ndim() == 3 && py::isinstance<py::array_t<float>>(image) && image.strides(2) == item &&
                      image.strides(1) % item == 0 && image.strides(1) >= image.shape(2) * item &&
                      image.strides(1) <= std::numeric_limits<int>::max() &&
                      image.strides(0) == image.shape(1) * image.strides(1);
    if (!even) throw py::type_error(std::string(name) + ": wanted float32 (H, W, C), pixels evenly spaced, got " + describe(image));
    return int(image.strides(1) / item);
}

py::array_t<float> weighted_mean_of(const py::sequence& views, Size size, int threads) {
    const auto [height, width] = size;
    std::vector<WeightedView> list;
    for (const py::handle& item : views) {
        const py::tuple view = py::cast<py::tuple>(item);
        const py::array colour = py::cast<py::array>(view[0]);
        const int stride = pixel_stride(colour, "colour");
        if (colour.shape(0) != height || colour.shape(1) != width || colour.shape(2) < 3)
            throw py::type_error("colour: wanted at least three channels and the size of the weights, got " + describe(colour));
        list.push_back({static_cast<const float*>(colour.data()), stride, data_of<float>(view[1], "weight", {height, width}),
                        py::cast<float>(view[2])});
    }
    py::array_t<float> out = empty({height, width, 3});
    float* data = out.mutable_data();
    py::gil_scoped_release released;
    ggvs::weighted_mean(list, int64_t(height) * width, data, threads);
    return out;
}

py::array_t<float> largest_feature_of(const py::sequence& views, int channel, Size size, float least_alpha, float otherwise,
                                   int threads) {
    const auto [height, width] = size;
    std::vector<CoveredFeature> list;
    for (const py::handle& item : views) {
        const py::tuple view = py::cast<py::tuple>(item);
        const py::array features = py::cast<py::array>(view[0]);
        const int stride = pixel_stride(features, "features");
        if (features.shape(0) != height || features.shape(1) != width || channel < 0 || channel >= features.shape(2))
            throw py::type_error("features: wanted channel " + std::to_string(channel) + " and the size of alpha, got " +
                                 describe(features));
        list.push_back({static_cast<const float*>(features.data()) + channel, stride,
                        data_of<float>(view[1], "alpha", {height, width})});
    }
    py::array_t<float> out = empty({height, width});
    float* data = out.mutable_data();
    py::gil_scoped_release released;
    ggvs::largest_feature(list, int64_t(height) * width, least_alpha, otherwise, data, threads);
    return out;
}

py::array_t<float> look_up_of(const py::handle& target, const py::handle& depth, const py::sequence& views,
                           const py::handle& background, float tolerance, int threads, int level) {
    const Pinhole to = pinhole_of(target);
    LookUp job{to, image_of(depth, "depth", to), data_of<float>(background, "background", {to.height, to.width, 3}),
               tolerance, {}};
    for (const py::handle& item : views) {
        const py::tuple view = py::cast<py::tuple>(item);
        job.views.push_back(look_up_view(view, py::cast<float>(view[5])));
    }
    py::array_t<float> out = empty({to.height, to.width, 3});
    float* data = out.mutable_data();
    py::gil_scoped_release released;
    ggvs::look_up(job, data, threads, level);
    return out;
}

py::array_t<float> settle_depth_of(const py::handle& target, const py::handle& fused, const py::sequence& views, float tolerance,
                                float least_alpha, float least_share, float ratio, int threads) {
    const Pinhole to = pinhole_of(target);
    Contest contest{to, image_of(fused, "fused", to), tolerance, least_alpha, least_share, ratio, {}};
    if (py::len(views) > kMostWitnesses) throw py::value_error("settle_depth: more than 64 views");
    for (const py::handle& item : views) {
        const py::tuple view = py::cast<py::tuple>(item);
        const Pinhole from = pinhole_of(view[0]);
        if (from.width < 2 || from.height < 2) throw py::value_error("settle_depth: wanted images of at least 2 x 2 pixels");
        contest.views.push_back({from, data_of<double>(view[1], "from_target", {4, 4}),
                                 data_of<uint8_t>(view[2], "image", {from.height, from.width, 3}), image_of(view[3], "alpha", to),
                                 image_of(view[4], "splatted depth", to), py::cast<float>(view[5]), {}});
    }
    py::array_t<float> out = empty({to.height, to.width});
    float* data = out.mutable_data();
    py::gil_scoped_release released;
    ggvs::settle_depth(contest, data, threads);
    return out;
}

py::array_t<uint8_t> shade_of(const py::array& image, const py::handle& gain, const py::handle& down, const py::handle& across,
                              int threads) {
    const auto [height, width] = size_of(image, "image");
    const Shading job{data_of<uint8_t>(image, "image", {height, width, 3}), data_of<float>(gain, "gain", {3}),
                      data_of<float>(down, "down", {height}), data_of<float>(across, "across", {width}), width, height};
    py::array_t<uint8_t> out({height, width, 3});
    uint8_t* data = out.mutable_data();
    py::gil_scoped_release released;
    ggvs::shade(job, data, threads);
    return out;
}

// A float32 array of this shape to be written into.
float* writable(const py::array& array, const char* name, const std::vector<py::ssize_t>& shape) {
    data_of<float>(array, name, shape);
    return static_cast<float*>(py::array(array).mutable_data());
}

void push_pull_of(const py::array& colour, const py::handle& known, const py::array& out, int threads) {
    const auto [height, width] = size_of(colour, "colour");
    const HoledImage image{data_of<float>(colour, "colour", {height, width, 3}),
                           reinterpret_cast<const uint8_t*>(data_of<bool>(known, "known", {height, width})), width, height};
    float* data = writable(out, "out", {height, width, 3});
    py::gil_scoped_release released;
    ggvs::push_pull(image, data, threads);
}

void remember_of(const py::array& depth, const py::array& still, const py::sequence& alphas, const py::tuple& rules,
                 const py::array& image, const py::array& past, const py::array& past_depth, int threads) {
    const auto [height, width] = size_of(depth, "depth");
    const auto [down, across] = size_of(still, "still");
    if (down < 1 || across < 1 || py::len(alphas) < 1 || py::len(rules) != 6)
        throw py::value_error("remember: wanted cells, at least one view and six rules");
    const auto rule = [&](int n) { return py::cast<double>(rules[n]); };
    BackgroundStep job{width, height, across, down, data_of<float>(depth, "depth", {height, width}),
                       data_of<float>(still, "still", {down, across}), {},
                       {rule(0), rule(1), float(rule(2)), float(rule(3)), float(rule(4)), float(rule(5))}};
    for (const py::handle& alpha : alphas) job.alphas.push_back(data_of<float>(alpha, "alpha", {height, width}));
    float *shown = writable(image, "image", {height, width, 3}), *colours = writable(past, "past", {height, width, 3});
    float* depths = writable(past_depth, "past depth", {height, width});
    py::gil_scoped_release released;
    ggvs::remember(job, shown, colours, depths, threads);
}

py::array_t<float> recur_of(const py::array& now, const py::handle& past, const py::array& cells, int threads) {
    const auto [height, width] = size_of(now, "now");
    const auto shape = shape_of(cells, "cells", 3);
    if (shape[0] != 4 || shape[1] < 1 || shape[2] < 1 || shape[1] > height || shape[2] > width)
        throw py::type_error("cells: wanted four maps, not larger than the image, got " + describe(cells));
    const Recurrence job{width,
                         height,
                         int(shape[2]),
                         int(shape[1]),
                         data_of<float>(now, "now", {height, width, 3}),
                         data_of<float>(past, "past", {height, width, 3}),
                         data_of<float>(cells, "cells", shape)};
    py::array_t<float> out = empty({height, width, 3});
    float* data = out.mutable_data();
    py::gil_scoped_release released;
    ggvs::recur(job, data, threads);
    return out;
}

}  // namespace

void bind_images(py::module_& m) {
    m.def("colour_change", &colour_change_of, "now"_a, "before"_a, "cells"_a, "threads"_a);
    m.def("mix_depth", &mix_depth_of, "depth"_a, "history"_a, "mask"_a, "tolerance"_a, "threads"_a);
    m.def("weighted_mean", &weighted_mean_of, "views"_a, "size"_a, "threads"_a);
    m.def("largest_feature", &largest_feature_of, "views"_a, "channel"_a, "size"_a, "least_alpha"_a, "otherwise"_a, "threads"_a);
    m.def("look_up", &look_up_of, "target"_a, "depth"_a, "views"_a, "background"_a, "tolerance"_a, "threads"_a, "level"_a);
    m.def("settle_depth", &settle_depth_of, "target"_a, "fused"_a, "views"_a, "tolerance"_a, "least_alpha"_a, "least_share"_a,
          "ratio"_a, "threads"_a);
    m.def("shade", &shade_of, "image"_a, "gain"_a, "down"_a, "across"_a, "threads"_a);
    m.def("remember", &remember_of, "depth"_a, "still"_a, "alphas"_a, "rules"_a, "image"_a, "past"_a, "past_depth"_a, "threads"_a);
    m.def("recur", &recur_of, "now"_a, "past"_a, "cells"_a, "threads"_a);
    m.def("push_pull", &push_pull_of, "colour"_a, "known"_a, "out"_a, "threads"_a);
}

}  // namespace ggvs
