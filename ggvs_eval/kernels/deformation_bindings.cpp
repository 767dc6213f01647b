// Python bindings of the deformation field.
#include <pybind11/stl.h>

#include <algorithm>

#include "array_arguments.hpp"
#include "deformation.hpp"
#include "memory.hpp"
#include "sources.hpp"

namespace {

namespace py = pybind11;
using namespace py::literals;
using ggvs::data_of;

constexpr int kOfTrunk = 2, kOfHead = 4;  // arrays: weights and biases, of two layers

// Between which nodes of a plane's rows the time lies, as torch's grid_sample finds them; and the share of the later one.
struct TimeSpot {
    int low, high;
    float share;
};

TimeSpot time_spot(float time, int rows) {
    const float at = std::clamp((time + 1.0f) * 0.5f * float(rows - 1), 0.0f, float(rows - 1));
    const int low = std::clamp(int(at), 0, std::max(0, rows - 2));
    return {low, std::min(low + 1, rows - 1), at - float(low)};
}

// The planes with their nodes' channels side by side; those of time as they are at one.
void take_planes(ggvs::Field& field, const py::tuple& planes, const std::vector<std::pair<int, int>>& axes, float time) {
    if (axes.empty() || axes.size() > ggvs::kMostPlanes || planes.empty() || planes.size() % axes.size())
        throw py::type_error("planes: wanted one to six pairs of axes and as many planes for each level");
    field.n_planes = int(axes.size()), field.n_levels = int(planes.size() / axes.size());
    field.channels = int(ggvs::shape_of(py::cast<py::array>(planes[0]), "planes", 4)[1]);
    field.groups = (field.channels + ggvs::kGroup - 1) / ggvs::kGroup;
    for (size_t n = 0; n < planes.size(); ++n) {
        const auto [first, second] = axes[n % axes.size()];
        if (first < 0 || first >= second || second > ggvs::kTime) throw py::type_error("axes: wanted pairs of 0 to 3, ascending");
        const auto shape = ggvs::shape_of(py::cast<py::array>(planes[n]), "planes", 4);
        const float* values = data_of<float>(planes[n], "planes", {1, field.channels, shape[2], shape[3]});
        if (!shape[2] || !shape[3]) throw py::type_error("planes: wanted at least one node");
        const int columns = int(shape[3]), rows = int(shape[2]);
        const bool is_line = second == ggvs::kTime;
        const TimeSpot spot = is_line ? time_spot(time, rows) : TimeSpot{0, 0, 0.0f};
        const int64_t stride = int64_t(ggvs::kGroup) * field.groups, at = int64_t(field.nodes.size());
        field.planes.push_back({first, second, columns, is_line ? 1 : rows, at});
        field.nodes.resize(at + stride * columns * field.planes.back().rows);
        for (int c = 0; c < field.channels; ++c)
            for (int row = 0; row < field.planes.back().rows; ++row)
                for (int column = 0; column < columns; ++column) {
                    const float* node = values + (int64_t(c) * rows + (is_line ? spot.low : row)) * columns + column;
                    const float later = is_line ? node[int64_t(spot.high - spot.low) * columns] : *node;
                    field.nodes[at + (int64_t(row) * columns + column) * stride + c] =
                        is_line ? *node + (later - *node) * spot.share : *node;  // exact where time changes nothing
                }
    }
}

void append(ggvs::Layer& layer, const py::handle& weights, const py::handle& biases, int inputs) {
    const auto shape = ggvs::shape_of(py::cast<py::array>(weights), "weights", 2);
    const float* w = data_of<float>(weights, "weights", {shape[0], inputs});
    const float* b = data_of<float>(biases, "biases", {shape[0]});
    layer.inputs = inputs, layer.outputs += int(shape[0]);
    layer.weights.insert(layer.weights.end(), w, w + shape[0] * inputs);
    layer.biases.insert(layer.biases.end(), b, b + shape[0]);
}

void finish(ggvs::Layer& layer, int64_t& n_sums) {
    layer.transposed.resize(layer.weights.size());
    for (int o = 0; o < layer.outputs; ++o)
        for (int i = 0; i < layer.inputs; ++i)
            layer.transposed[size_t(i) * layer.outputs + o] = layer.weights[size_t(o) * layer.inputs + i];
    layer.sums_at = n_sums;
    n_sums += ggvs::kLanes * int64_t(layer.weights.size() + layer.biases.size());
}

// Layers: weights and biases of the trunk, then for each head those of its hidden and of its last layer.
void take_layers(ggvs::Field& field, const py::tuple& layers) {
    if (layers.size() < kOfTrunk + kOfHead || (layers.size() - kOfTrunk) % kOfHead)
        throw py::type_error("layers: wanted two arrays, and four for each head");
    append(field.trunk, layers[0], layers[1], field.n_levels * field.channels);
    for (size_t at = kOfTrunk; at < layers.size(); at += kOfHead) {
        const int before = field.hidden.outputs;
        append(field.hidden, layers[at], layers[at + 1], field.trunk.outputs);
        append(field.last.emplace_back(), layers[at + 2], layers[at + 3], field.hidden.outputs - before);
    }
    field.n_sums = int64_t(field.nodes.size());
    finish(field.trunk, field.n_sums);
    finish(field.hidden, field.n_sums);
    for (ggvs::Layer& layer : field.last) finish(layer, field.n_sums);
}

ggvs::Field field_of(const py::handle& box, float time, const py::tuple& planes, const std::vector<std::pair<int, int>>& axes,
                     const py::tuple& layers) {
    ggvs::Field field{};
    const float* corners = data_of<float>(box, "box", {2, 3});
    for (int axis = 0; axis < 3; ++axis) {
        field.corner[axis] = corners[axis];
        field.scale[axis] = 2.0f / (corners[3 + axis] - corners[axis]);
    }
    take_planes(field, planes, axes, time);
    take_layers(field, layers);
    return field;
}

py::tuple evaluate(const py::array& points, const py::handle& box, float time, const py::tuple& planes,
                   const std::vector<std::pair<int, int>>& axes, const py::tuple& layers, int threads, int level) {
    const py::ssize_t count = ggvs::shape_of(points, "points", 2)[0];
    const float* places = data_of<float>(points, "points", {count, 3});
    const ggvs::Field field = field_of(box, time, planes, axes, layers);
    py::tuple outputs(field.last.size());
    std::vector<ggvs::Rows> rows;
    for (size_t head = 0; head < field.last.size(); ++head) {
        py::array_t<float> output = ggvs::empty({count, field.last[head].outputs});
        rows.push_back({output.mutable_data(), field.last[head].outputs});
        outputs[head] = std::move(output);
    }
    {
        py::gil_scoped_release released;
        ggvs::evaluate_field(field, places, count, rows, threads, level);
    }
    return outputs;
}

// Derivatives by a plane as torch keeps it; those of a time are shared by the two rows that it lies between.
py::array_t<float> plane_gradient(const ggvs::Field& field, size_t n, const py::handle& plane, float time, const float* sums) {
    const auto shape = ggvs::shape_of(py::cast<py::array>(plane), "planes", 4);
    py::array_t<float> gradient = ggvs::empty({1, shape[1], shape[2], shape[3]});
    float* values = gradient.mutable_data();
    const ggvs::Plane& of = field.planes[n];
    const int64_t stride = int64_t(ggvs::kGroup) * field.groups, columns = of.columns, rows = shape[2];
    const bool is_line = of.second == ggvs::kTime;
    const TimeSpot spot = is_line ? time_spot(time, int(rows)) : TimeSpot{0, 0, 0.0f};
    for (int c = 0; c < field.channels; ++c)
        for (int64_t row = 0; row < rows; ++row) {
            // Both where there is one row alone.
            const float share = (row == spot.low ? 1.0f - spot.share : 0.0f) + (row == spot.high ? spot.share : 0.0f);
            for (int64_t column = 0; column < columns; ++column) {
                const float* node = sums + of.at + ((is_line ? 0 : row) * columns + column) * stride + c;
                values[(c * rows + row) * columns + column] = is_line ? share * *node : *node;
            }
        }
    return gradient;
}

py::list layer_gradients(const ggvs::Field& field, const std::vector<float>& sums) {
    py::list gradients;
    const int64_t n_nodes = int64_t(field.nodes.size());
    const auto take = [&](const ggvs::Layer& layer, int first, int count) {
        const float* weights = sums.data() + (layer.sums_at - n_nodes) / ggvs::kLanes;
        const float* biases = weights + layer.weights.size();
        py::array_t<float> by_weights = ggvs::empty({count, layer.inputs}), by_biases = ggvs::empty({count});
        std::copy_n(weights + int64_t(first) * layer.inputs, int64_t(count) * layer.inputs, by_weights.mutable_data());
        std::copy_n(biases + first, count, by_biases.mutable_data());
        gradients.append(std::move(by_weights));
        gradients.append(std::move(by_biases));
    };
    take(field.trunk, 0, field.trunk.outputs);
    int first = 0;
    for (const ggvs::Layer& layer : field.last) {
        take(field.hidden, first, layer.inputs);
        take(layer, 0, layer.outputs);
        first += layer.inputs;
    }
    return gradients;
}

py::tuple gradients(const py::array& points, const py::handle& box, float time, const py::tuple& planes,
                    const std::vector<std::pair<int, int>>& axes, const py::tuple& layers, const py::tuple& by_outputs, int threads,
                    int level) {
    const py::ssize_t count = ggvs::shape_of(points, "points", 2)[0];
    const float* places = data_of<float>(points, "points", {count, 3});
    const ggvs::Field field = field_of(box, time, planes, axes, layers);
    if (by_outputs.size() != field.last.size()) throw py::type_error("by_outputs: wanted an array for each head");
    std::vector<ggvs::Rows> rows;
    for (size_t head = 0; head < field.last.size(); ++head) {
        const int columns = field.last[head].outputs;
        rows.push_back({const_cast<float*>(data_of<float>(by_outputs[head], "by_outputs", {count, columns})), columns});
    }
    py::array_t<float> by_points = ggvs::empty({count, 3});
    ggvs::FieldGradients out{by_points.mutable_data(), {}, {}};
    {
        py::gil_scoped_release released;
        ggvs::field_gradients(field, places, count, rows, out, threads, level);
    }
    py::list by_planes;
    for (size_t n = 0; n < planes.size(); ++n) by_planes.append(plane_gradient(field, n, planes[n], time, out.nodes.data()));
    return py::make_tuple(by_points, py::tuple(by_planes), py::tuple(layer_gradients(field, out.layers)));
}

}  // namespace

PYBIND11_MODULE(_deformation, module) {
    module.doc() = "The deformation field of 4DGS; ggvs_eval.baselines.fitted.compiled_field is the face of it.";
    module.def("evaluate", &evaluate, "points"_a, "box"_a, "time"_a, "planes"_a, "axes"_a, "layers"_a, "threads"_a, "level"_a,
               "Outputs of each head, (N, outputs).");
    module.def("gradients", &gradients, "points"_a, "box"_a, "time"_a, "planes"_a, "axes"_a, "layers"_a, "by_outputs"_a,
               "threads"_a, "level"_a, "Derivatives by the points, by each plane and by each array of the layers.");
}
