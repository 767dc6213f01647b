// Python bindings of the U-Net.
#include "unet.hpp"

#include <algorithm>

#include "camera_arguments.hpp"
#include "layer_arguments.hpp"
#include "learned.hpp"

namespace ggvs {
namespace {

using namespace py::literals;

// Filters (after, before, 3, 3), whatever their strides, and bias (after) as the kernels take them: filled up with zeros.
py::tuple pack_filters(const py::array& weights, const py::array& bias) {
    const auto shape = shape_of(weights, "weights", 4);
    const int after = int(shape[0]), before = int(shape[1]), groups = groups_of(after);
    if (!py::isinstance<py::array_t<float>>(weights) || shape[2] != 3 || shape[3] != 3 || after < 1 || before < 1)
        throw py::type_error("weights: wanted float32 filters of 3 x 3, got " + describe(weights));
    Filters filters{before, after, static_cast<const float*>(weights.data()), {}};
    for (int axis = 0; axis < 4; ++axis) filters.strides[axis] = weights.strides(axis) / py::ssize_t(sizeof(float));
    py::array_t<float> packed({groups, kStripSources, before, 3, kGroupOutputs}), padded(groups * kGroupOutputs);
    for (int group = 0; group < groups; ++group) pack_group(filters, group, packed.mutable_data() + group * group_size(before));
    std::fill_n(padded.mutable_data(), padded.size(), 0.0f);
    std::copy_n(data_of<float>(bias, "bias", {after}), after, padded.mutable_data());
    return py::make_tuple(packed, padded);
}

// What `pack_filters` made of a convolution, and the normalisation behind it.
UNetLayer layer_of(const py::handle& object, int before) {
    const py::tuple layer = py::cast<py::tuple>(object);
    const py::array gain = py::cast<py::array>(layer[2]);
    const int after = int(shape_of(gain, "gain", 1)[0]);
    if (after < 1 || after > kMostPixels) throw py::type_error("gain: wanted 1 to 65535 values, got " + describe(gain));
    return {packed_layer(layer[0], layer[1], before, after), data_of<float>(gain, "gain", {after}),
            data_of<float>(layer[3], "shift", {after})};
}

// Two layers of each block, and each block's outputs are what follows takes: the next level, and the skip beside twice as many.
void fill_blocks(UNet& job, const py::sequence& layers) {
    for (int block = 0; block < kUNetBlocks; ++block) {
        const int level = block <= kUNetLevels ? block : 2 * kUNetLevels - block;
        int before = job.channels;
        if (block > kUNetLevels) {
            before = job.blocks[level][1].convolution.after + job.blocks[block - 1][1].convolution.after;
        } else if (block > 0) {
            before = job.blocks[block - 1][1].convolution.after;
        }
        for (int n = 0; n < 2; ++n) {
            job.blocks[block][n] = layer_of(layers[2 * block + n], before);
            before = job.blocks[block][n].convolution.after;
        }
        const int wanted = block == 0 ? job.blocks[0][1].convolution.after : job.blocks[0][1].convolution.after << level;
        if (job.blocks[block][0].convolution.after != wanted || job.blocks[block][1].convolution.after != wanted)
            throw py::type_error("unet: wanted twice as many channels at every further level");
    }
}

py::array_t<float> unet_of(const py::array& channels, const py::sequence& layers, const py::tuple& last, double epsilon,
                           int threads, int level) {
    const auto shape = shape_of(channels, "channels", 3);
    for (const py::ssize_t size : shape)
        if (size < 1 || size > kMostPixels) throw py::type_error("channels: wanted 1 to 65535, got " + describe(channels));
    if (py::len(layers) != 2 * kUNetBlocks) throw py::type_error("unet: wanted 18 layers");
    UNet job{int(shape[2]), int(shape[1]), int(shape[0]), 0, data_of<float>(channels, "channels", shape), {}, nullptr, nullptr,
             epsilon};
    fill_blocks(job, layers);
    const py::array bias = py::cast<py::array>(last[1]);
    job.outputs = int(shape_of(bias, "bias", 1)[0]);
    job.last_bias = data_of<float>(bias, "bias", {job.outputs});
    job.last_weights = data_of<float>(last[0], "weights", {job.outputs, job.blocks[0][1].convolution.after});
    py::array_t<float> out = empty({job.outputs, job.height, job.width});
    constexpr int64_t kLine = 64;  // bytes
    py::array_t<float> memory = empty({unet_workspace(job) + kLine / int64_t(sizeof(float))});
    const uintptr_t begin = reinterpret_cast<uintptr_t>(memory.mutable_data());
    float *workspace = reinterpret_cast<float*>((begin + kLine - 1) / kLine * kLine), *data = out.mutable_data();
    {
        py::gil_scoped_release released;
        unet(job, workspace, data, threads, level);
    }
    return out;
}

}  // namespace

void bind_unet(py::module_& m) {
    m.def("pack_filters", &pack_filters, "weights"_a, "bias"_a);
    m.def("unet", &unet_of, "channels"_a, "layers"_a, "last"_a, "epsilon"_a, "threads"_a, "level"_a);
}

}  // namespace ggvs
