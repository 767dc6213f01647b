// Structural similarity (Wang et al. 2004) in one pass over two images: 11 x 11 Gaussian window, sigma 1.5, valid positions only.
//
// The image is cut into tiles of a fixed size that fit the first-level cache. Each tile filters its rows as it meets them, keeps the
// last eleven filtered rows in a ring, filters the ring vertically and adds up the similarity; nothing of the size of the image is
// allocated. A tile's sums do not depend on who computes it and are added in the order of the tiles, so that the result is the same,
// bit for bit, with any number of threads; without fused multiply-adds (setup.py) it is also the same on every instruction set.
//
// With the sum a = x + y and the difference d = x - y of the two images, the formula of the paper reads
//     SSIM = (1 - mean(d)^2 / (mean(x)^2 + mean(y)^2 + C1)) * (1 - var(d) / (var(x) + var(y) + C2)),
// where mean(x)^2 + mean(y)^2 = (mean(a)^2 + mean(d)^2) / 2 and var(x) + var(y) = (var(a) + var(d)) / 2. Four filters instead of five,
// and float32 suffices: no small covariance is the difference of two large numbers, and equal images give exactly 1.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "parallel.hpp"
#include "sources.hpp"

namespace py = pybind11;

namespace {

constexpr int kTaps = 11;
constexpr double kSigma = 1.5;
constexpr int kTileValues = 192;  // values (pixels times channels) in a row of a tile
constexpr int kTileRows = 128;
constexpr int kMaxChannels = 4;
constexpr int kRowValues = kTileValues + (kTaps - 1) * kMaxChannels;  // with the border that the window needs

enum Moment { kSum, kDifference, kSumSquared, kDifferenceSquared, kMoments };

using Weights = std::array<float, kTaps>;
using ChannelSums = std::array<double, kMaxChannels>;

// Two images of one shape; rows lie row_stride values apart, the values of a row are contiguous.
template <typename Value>
struct Images {
    const Value* rendered;
    const Value* truth;
    int64_t rendered_stride, truth_stride;  // in values
    int height, width, channels;
    float data_range;
};

struct Tile {
    int first_row, rows;    // of the output
    int first_value, values;
};

Weights gaussian_weights() {
    std::array<double, kTaps> weights;
    double total = 0;
    for (int k = 0; k < kTaps; ++k) {
        const double distance = k - kTaps / 2;
        weights[k] = std::exp(-0.5 * distance * distance / (kSigma * kSigma));
        total += weights[k];
    }
    Weights normalised;
    for (int k = 0; k < kTaps; ++k) normalised[k] = static_cast<float>(weights[k] / total);
    return normalised;
}

// Everything a tile keeps; one per thread, small enough for the first-level cache.
struct Workspace {
    alignas(64) float row[kMoments][kRowValues];
    alignas(64) float ring[kMoments][kTaps][kTileValues];
    alignas(64) float column_sums[kTileValues];
};

template <typename Value>
[[gnu::always_inline]] inline void load_row(const Images<Value>& images, int row, int first_value, int count, Workspace& w) {
    const Value* x = images.rendered + row * images.rendered_stride + first_value;
    const Value* y = images.truth + row * images.truth_stride + first_value;
    const float centre = images.data_range;  // of the sum; keeps its square small
#pragma GCC ivdep
    for (int i = 0; i < count; ++i) {
        const float a = static_cast<float>(x[i]) + static_cast<float>(y[i]) - centre;
        const float d = static_cast<float>(x[i]) - static_cast<float>(y[i]);
        w.row[kSum][i] = a;
        w.row[kDifference][i] = d;
        w.row[kSumSquared][i] = a * a;
        w.row[kDifferenceSquared][i] = d * d;
    }
}

[[gnu::always_inline]] inline void filter_row(const Weights& weights, int channels, int values, int slot, Workspace& w) {
    for (int m = 0; m < kMoments; ++m) {
        const float* taps[kTaps];  // the row, seen from each tap of the window
        for (int k = 0; k < kTaps; ++k) taps[k] = w.row[m] + k * channels;
        float* filtered = w.ring[m][slot];
#pragma GCC ivdep
        for (int i = 0; i < values; ++i) {
            float sum = 0;
#pragma GCC unroll 11
            for (int k = 0; k < kTaps; ++k) sum += weights[k] * taps[k][i];
            filtered[i] = sum;
        }
    }
}

// `oldest` is the ring slot of the window's first row.
[[gnu::always_inline]] inline void add_similarity(const Weights& weights, int oldest, int values, float data_range, Workspace& w) {
    const float c1 = 0.01f * data_range * 0.01f * data_range;
    const float c2 = 0.03f * data_range * 0.03f * data_range;
    float slot_weights[kTaps];  // the window's weights in the order of the slots
    for (int k = 0; k < kTaps; ++k) slot_weights[(oldest + k) % kTaps] = weights[k];
#pragma GCC ivdep
    for (int i = 0; i < values; ++i) {
        float mean[kMoments] = {0, 0, 0, 0};
#pragma GCC unroll 11
        for (int k = 0; k < kTaps; ++k)
#pragma GCC unroll 4
            for (int m = 0; m < kMoments; ++m) mean[m] += slot_weights[k] * w.ring[m][k][i];
        const float sum_variance = mean[kSumSquared] - mean[kSum] * mean[kSum];
        const float difference_variance = mean[kDifferenceSquared] - mean[kDifference] * mean[kDifference];
        const float sum = mean[kSum] + data_range;
        const float difference_squared = mean[kDifference] * mean[kDifference];
        const float luminance = 1.0f - difference_squared / (0.5f * (sum * sum + difference_squared) + c1);
        const float structure = 1.0f - difference_variance / (0.5f * (sum_variance + difference_variance) + c2);
        w.column_sums[i] += luminance * structure;
    }
}

template <typename Value>
[[gnu::always_inline]] inline ChannelSums tile_sums(const Images<Value>& images, const Weights& weights, const Tile& tile) {
    Workspace w;
    std::fill(w.column_sums, w.column_sums + tile.values, 0.0f);
    const int border = (kTaps - 1) * images.channels;
    for (int row = 0; row < tile.rows + kTaps - 1; ++row) {
        load_row(images, tile.first_row + row, tile.first_value, tile.values + border, w);
        filter_row(weights, images.channels, tile.values, row % kTaps, w);
        if (row >= kTaps - 1) add_similarity(weights, (row + 1) % kTaps, tile.values, images.data_range, w);
    }
    ChannelSums sums{};
    for (int i = 0; i < tile.values; ++i) sums[(tile.first_value + i) % images.channels] += w.column_sums[i];
    return sums;
}

template <typename Value>
using TileFunction = ChannelSums (*)(const Images<Value>&, const Weights&, const Tile&);

template <typename Value>
ChannelSums tile_sums_baseline(const Images<Value>& images, const Weights& weights, const Tile& tile) {
    return tile_sums(images, weights, tile);
}

#if defined(__x86_64__)
template <typename Value>
[[gnu::target("avx2")]] ChannelSums tile_sums_avx2(const Images<Value>& images, const Weights& weights, const Tile& tile) {
    return tile_sums(images, weights, tile);
}

template <typename Value>
[[gnu::target("avx512f,avx512vl,avx512bw,avx512dq,prefer-vector-width=512")]] ChannelSums tile_sums_avx512(
    const Images<Value>& images, const Weights& weights, const Tile& tile) {
    return tile_sums(images, weights, tile);
}
#endif

// `level` as in ggvs_eval.kernels.LEVELS, which has asked the processor.
template <typename Value>
TileFunction<Value> tile_function(int level) {
#if defined(__x86_64__)
    if (level == 2) return tile_sums_avx512<Value>;
    if (level == 1) return tile_sums_avx2<Value>;
#endif
    if (level == 0) return tile_sums_baseline<Value>;
    throw std::invalid_argument("no such instruction set here");
}

std::vector<Tile> cut_into_tiles(int rows, int values) {
    std::vector<Tile> tiles;
    for (int row = 0; row < rows; row += kTileRows)
        for (int value = 0; value < values; value += kTileValues)
            tiles.push_back({row, std::min(kTileRows, rows - row), value, std::min(kTileValues, values - value)});
    return tiles;
}

template <typename Value>
ChannelSums mean_similarity(const Images<Value>& images, int threads, int level) {
    const int rows = images.height - kTaps + 1, columns = images.width - kTaps + 1;
    const std::vector<Tile> tiles = cut_into_tiles(rows, columns * images.channels);
    const Weights weights = gaussian_weights();
    const TileFunction<Value> sum_tile = tile_function<Value>(level);
    std::vector<ChannelSums> sums(tiles.size());
    ggvs::parallel_for(static_cast<int>(tiles.size()), threads, [&](int t, int) { sums[t] = sum_tile(images, weights, tiles[t]); });
    ChannelSums means{};
    for (const ChannelSums& tile : sums)
        for (int c = 0; c < images.channels; ++c) means[c] += tile[c];
    for (double& mean : means) mean /= static_cast<double>(rows) * columns;
    return means;
}

template <typename Value>
Images<Value> view_images(const py::array& rendered, const py::array& truth, float data_range) {
    for (const py::array& image : {rendered, truth}) {
        if (image.ndim() != 3 || image.shape(2) < 1 || image.shape(2) > kMaxChannels)
            throw std::invalid_argument("wanted images of shape (height, width, 1 to 4 channels)");
        if (image.strides(2) != image.itemsize() || image.strides(1) != image.shape(2) * image.itemsize())
            throw std::invalid_argument("wanted rows of contiguous pixels");
    }
    for (int axis = 0; axis < 3; ++axis)
        if (rendered.shape(axis) != truth.shape(axis)) throw std::invalid_argument("wanted two images of one shape");
    if (rendered.shape(0) < kTaps || rendered.shape(1) < kTaps) throw std::invalid_argument("wanted at least 11 x 11 pixels");
    return {static_cast<const Value*>(rendered.data()),
            static_cast<const Value*>(truth.data()),
            static_cast<int64_t>(rendered.strides(0) / rendered.itemsize()),
            static_cast<int64_t>(truth.strides(0) / truth.itemsize()),
            static_cast<int>(rendered.shape(0)),
            static_cast<int>(rendered.shape(1)),
            static_cast<int>(rendered.shape(2)),
            data_range};
}

template <typename Value>
py::array_t<double> measure(const py::array& rendered, const py::array& truth, float data_range, int threads, int level) {
    const Images<Value> images = view_images<Value>(rendered, truth, data_range);
    ChannelSums means;
    {
        py::gil_scoped_release release;
        means = mean_similarity(images, threads, level);
    }
    return py::array_t<double>(images.channels, means.data());
}

py::array_t<double> channel_means(const py::array& rendered, const py::array& truth, int threads, int level) {
    if (py::isinstance<py::array_t<uint8_t>>(rendered) && py::isinstance<py::array_t<uint8_t>>(truth))
        return measure<uint8_t>(rendered, truth, 255.0f, threads, level);
    if (py::isinstance<py::array_t<float>>(rendered) && py::isinstance<py::array_t<float>>(truth))
        return measure<float>(rendered, truth, 1.0f, threads, level);
    throw py::type_error("wanted two uint8 images (0..255) or two float32 images (0..1)");
}

}  // namespace

PYBIND11_MODULE(_ssim, module) {
    module.doc() = "Structural similarity of two images in one pass.";
    module.def("channel_means", &channel_means, py::arg("rendered"), py::arg("truth"), py::arg("threads"),
               py::arg("level"), "Mean SSIM of each channel of two (H, W, C) images, uint8 in 0..255 or float32 in 0..1.");
}
