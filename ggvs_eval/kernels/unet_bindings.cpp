// Python bindings of the U-Net.
#include "unet.hpp"

#include "camera_arguments.hpp"
#include "learned.hpp"

namespace ggvs {
namespace {

using namespace py::literals;

// A float32 array of this shape, whatever its strides.
py::array strided(const py::handle& object, const char* name, const std::vector<py::ssize_t>& shape) {
    const py::array array = py::cast<py::array>(object);
    const bool fits = py::isinstance<py::array_t<float>>(array) && array.ndim() == py::ssize_t(shape.size()) &&
                      std::equal(shape.begin(), shape.end(), array.shape());
    if (!fits) throw py::type_error(std::string(name) + ": wanted float32 that fits the other layers, got " + describe(array));
    return array;
}

UNetLayer layer_of(const py::handle& object, int before) {
    const py::tuple layer = py::cast<py::tuple>(object);
    const py::array bias = py::cast<py::array>(layer[1]);
    const int after = int(shape_of(bias, "bias", 1)[0]);
    if (after < 1 || after > kMostPixels) throw py::type_error("bias: wanted 1 to 65535 values, got " + describe(bias));
    const py::array weights = strided(layer[0], "weights", {after, before, 3, 3});
    UNetLayer made{{before, after, static_cast<const float*>(weights.data()), {}}, data_of<float>(bias, "bias", {after}),
                   data_of<float>(layer[2], "gain", {after}), data_of<float>(layer[3], "shift", {after})};
    for (int axis = 0; axis < 4; ++axis) made.filters.strides[axis] = weights.strides(axis) / py::ssize_t(sizeof(float));
    return made;
}

// Two layers of each block, and each block's outputs are what follows takes: the next level, and the skip beside twice as many.
void fill_blocks(UNet& job, const py::sequence& layers) {
    for (int block = 0; block < kUNetBlocks; ++block) {
        const int level = block <= kUNetLevels ? block : 2 * kUNetLevels - block;
        int before = job.channels;
        if (block > kUNetLevels) {
            before = job.blocks[level][1].filters.after + job.blocks[block - 1][1].filters.after;
        } else if (block > 0) {
            before = job.blocks[block - 1][1].filters.after;
        }
        for (int n = 0; n < 2; ++n) {
            job.blocks[block][n] = layer_of(layers[2 * block + n], before);
            before = job.blocks[block][n].filters.after;
        }
        const int wanted = block == 0 ? job.blocks[0][1].filters.after : job.blocks[0][1].filters.after << level;
        if (job.blocks[block][0].filters.after != wanted || job.blocks[block][1].filters.after != wanted)
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
    job.last_weights = data_of<float>(last[0], "weights", {job.outputs, job.blocks[0][1].filters.after});
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
    m.def("unet", &unet_of, "channels"_a, "layers"_a, "last"_a, "epsilon"_a, "threads"_a, "level"_a);
}

}  // namespace ggvs
