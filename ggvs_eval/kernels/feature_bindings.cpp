// Python bindings of the features.
#include <algorithm>

#include "array_arguments.hpp"
#include "feature_maps.hpp"
#include "memory.hpp"
#include "sources.hpp"

namespace {

namespace py = pybind11;
using namespace py::literals;
using ggvs::data_of, ggvs::describe, ggvs::empty, ggvs::shape_of;

constexpr int kMostChannels = 4096, kMostPixels = 65535, kMostCompared = 1 << 30;

bool are_channels(py::ssize_t count, int step) { return count >= step && count % step == 0 && count <= kMostChannels; }

py::array_t<float> pack_filters(const py::array& filters, int threads) {
    const auto shape = shape_of(filters, "filters", 4);
    if (shape[2] != 3 || shape[3] != 3 || !are_channels(shape[0], ggvs::kPanel) || (shape[1] != ggvs::kColours && !are_channels(shape[1], ggvs::kDepthChunk)))
        throw py::type_error("filters: wanted 3 x 3 of 3 or a multiple of 64 channels to a multiple of 32, got " + describe(filters));
    const float* data = data_of<float>(filters, "filters", shape);
    py::array_t<float> packed(ggvs::packed_size(int(shape[0]), int(shape[1])));
    float* out = packed.mutable_data();
    py::gil_scoped_release released;
    ggvs::pack_weights(data, int(shape[0]), int(shape[1]), out, threads);
    return packed;
}

py::list feature_maps(const py::array& frame, const py::sequence& layers, int threads, int level) {
    const auto shape = shape_of(frame, "frame", 3);
    if (shape[0] > kMostPixels || shape[1] > kMostPixels || (shape[2] != ggvs::kColours && !are_channels(shape[2], ggvs::kDepthChunk)))
        throw py::type_error("frame: wanted 65535 pixels a side at most, 3 or a multiple of 64 channels, got " + describe(frame));
    ggvs::FeatureJob job{data_of<float>(frame, "frame", shape), int(shape[0]), int(shape[1]), int(shape[2]), {}, {}};
    int height = job.height, width = job.width, before = job.channels;
    py::list maps;
    for (const py::handle& item : layers) {
        const py::tuple layer = py::cast<py::tuple>(item);
        if (height < 1 || width < 1) throw py::type_error("frame: wanted a pixel a side at every layer, got " + describe(frame));
        const int after = int(shape_of(py::cast<py::array>(layer[1]), "bias", 1)[0]);
        if (!are_channels(after, ggvs::kPanel))
            throw py::type_error("bias: wanted a multiple of 32 channels, got " + describe(py::cast<py::array>(layer[1])));
        job.layers.push_back({before, after, data_of<float>(layer[0], "weights", {ggvs::packed_size(after, before)}),
                              data_of<float>(layer[1], "bias", {after})});
        job.taps.push_back(nullptr);
        if (py::cast<bool>(layer[2])) {
            py::array_t<float> map = empty({height, width, after});
            job.taps.back() = map.mutable_data();
            maps.append(map);
            height /= 2, width /= 2;
        }
        before = after;
    }
    if (job.layers.empty() || (job.channels == ggvs::kColours && job.taps[0]))
        throw py::type_error("layers: wanted one at least, that of the colours not tapped");
    const auto floats = ggvs::feature_memory(job);
    py::array_t<float> memory[2] = {empty({floats[0]}), empty({floats[1]})};
    const std::array<float*, 2> data{memory[0].mutable_data(), memory[1].mutable_data()};
    {
        py::gil_scoped_release released;
        ggvs::feature_maps(job, data, threads, level);
    }
    return maps;
}

py::array_t<float> compare_features(const py::array& ours, const py::array& theirs, const py::array& weights, int threads, int level) {
    const auto shape = shape_of(theirs, "theirs", 3);
    if (shape[0] > kMostPixels || shape[1] > kMostPixels || shape[0] * shape[1] > kMostCompared || !are_channels(shape[2], 16))
        throw py::type_error("theirs: wanted 2^30 pixels at most and a multiple of 16 channels, got " + describe(theirs));
    py::array_t<float> out({shape[0], shape[1]});
    const ggvs::ComparedPixels all{data_of<float>(ours, "ours", shape), data_of<float>(theirs, "theirs", shape),
                                   data_of<float>(weights, "weights", {shape[2]}), int(shape[0] * shape[1]), int(shape[2]),
                                   out.mutable_data()};
    {
        py::gil_scoped_release released;
        ggvs::compare_features(all, threads, level);
    }
    return out;
}

py::tuple compare_banded(const py::sequence& frames, const py::sequence& layers, const py::sequence& weights, int threads, int level) {
    if (py::len(frames) < 1) throw py::type_error("frames: wanted one at least");
    const auto shape = shape_of(py::cast<py::array>(frames[0]), "frames", 3);
    if (shape[0] > kMostPixels || shape[1] > kMostPixels || shape[0] * shape[1] > kMostCompared || shape[2] != ggvs::kColours)
        throw py::type_error("frames: wanted 2^30 pixels at most, 65535 a side, in 3 channels, got " + describe(py::cast<py::array>(frames[0])));
    ggvs::BandedJob job{int(shape[0]), int(shape[1]), {}, {}, {}, {}, {}};
    for (const py::handle& frame : frames) job.frames.push_back(data_of<float>(py::cast<py::array>(frame), "frames", shape));
    std::vector<py::list> distances(job.frames.size() - 1);
    int height = job.height, width = job.width, before = ggvs::kColours;
    size_t tapped = 0;
    for (const py::handle& item : layers) {
        const py::tuple layer = py::cast<py::tuple>(item);
        const int after = int(shape_of(py::cast<py::array>(layer[1]), "bias", 1)[0]);
        if (!are_channels(after, ggvs::kPanel)) throw py::type_error("bias: wanted a multiple of 32 channels, got " + describe(py::cast<py::array>(layer[1])));
        job.layers.push_back({before, after, data_of<float>(layer[0], "weights", {ggvs::packed_size(after, before)}),
                              data_of<float>(layer[1], "bias", {after})});
        job.weights.push_back(nullptr);
        job.distances.emplace_back();
        before = after;
        if (!py::cast<bool>(layer[2])) continue;
        if (tapped == py::len(weights) || job.layers.size() == 1) throw py::type_error("weights: wanted some of each tapped layer, the first not tapped");
        job.weights.back() = data_of<float>(weights[tapped++], "weights", {after});
        for (py::list& each : distances) {
            py::array_t<float> map({height, width});
            job.distances.back().push_back(map.mutable_data());
            each.append(map);
        }
        height /= 2, width /= 2;
        if (height < 1 || width < 1) throw py::type_error("frames: wanted a pixel a side behind every layer, got " + describe(py::cast<py::array>(frames[0])));
    }
    if (job.layers.empty() || !job.weights.back()) throw py::type_error("layers: wanted some, the last one tapped");
    py::list halved;
    for (size_t f = 0; f < job.frames.size(); ++f) {
        py::array_t<float> map = empty({height, width, before});
        job.halved.push_back(map.mutable_data());
        halved.append(map);
    }
    {
        py::gil_scoped_release released;
        ggvs::compare_banded(job, threads, level);
    }
    py::list compared;
    for (const py::list& each : distances) compared.append(each);
    return py::make_tuple(halved, compared);
}

}  // namespace

PYBIND11_MODULE(_features, module) {
    module.doc() = "Features of frames by 3 x 3 convolutions.";
    module.def("pack_filters", &pack_filters, "filters"_a, "threads"_a, "Filters (after, before, 3, 3) as `feature_maps` takes them.");
    module.def("feature_maps", &feature_maps, "frame"_a, "layers"_a, "threads"_a, "level"_a,
               "The tapped ones of some layers (filters, bias, tap), (H, W, after) each; behind each of them the map is halved.");
    module.def("compare_banded", &compare_banded, "frames"_a, "layers"_a, "weights"_a, "threads"_a, "level"_a,
               "Frames through some layers of `feature_maps` by bands: what each hands on, halved, and of each but the first the distances\n"
               "of its tapped layers from those of the first, as of `compare_features`.");
    module.def("compare_features", &compare_features, "ours"_a, "theirs"_a, "weights"_a, "threads"_a, "level"_a,
               "Weighted squared distances of the directions of two maps of features (H, W, C), (H, W).");
}
