// IV-PSNR of one frame (Dziembowski et al. 2022): the error that remains when each pixel may be matched up to two pixels away, after
// the global colour difference of the frames is taken out.
//
// First every pixel becomes 8-bit YCbCr and the differences of the frames are added up; then tiles that fit the cache look for the
// best of 5 x 5 pixels, in both directions. Differences of 8-bit levels, their squares and 4 dY^2 + dU^2 + dV^2 are integers below
// 2^24, which float32 holds exactly; sums are integers too. The result is therefore the same, bit for bit, with any number of
// threads and on every instruction set.

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

constexpr int kReach = 2;  // of the search, pixels
constexpr int kTileRows = 32, kTileColumns = 256;
constexpr int kPaddedRows = kTileRows + 2 * kReach, kPaddedColumns = kTileColumns + 2 * kReach;
constexpr int kBandRows = 16;  // of a job of the conversion
constexpr int kComponents = 3;
constexpr int kLumaWeight = 4;  // in the choice of the best pixel; chroma counts once
constexpr int kUnnoticed = 3;  // levels of global difference that are taken out at most: 1 % of 255, rounded
constexpr float kOutside = 1e9f;  // cost of a pixel outside the mask, above every real one

using Sums = std::array<int64_t, kComponents>;

struct Image {
    const uint8_t* pixels;
    int height, width;
    bool is_rgb;
};

// Rows of YCbCr; what is at row r, column c of component k lies at [k][r * width + c].
using Planes = std::array<std::vector<uint8_t>, kComponents>;

struct Frames {
    Planes rendered, truth;
    const uint8_t* mask;  // null where all pixels count
    int height, width;
};

// A coefficient with sixteen binary digits after the point.
constexpr int fixed_point(double value) { return static_cast<int>(value * 65536 + (value < 0 ? -0.5 : 0.5)); }

constexpr uint8_t level(int sum, int middle) {
    const int value = ((sum + 32768) >> 16) + middle;
    return static_cast<uint8_t>(value < 255 ? value : 255);
}

// BT.709 without headroom, in the fixed point in which the reference software converts RGB for its YCbCr_BT709.
[[gnu::always_inline]] inline void convert_rows(const Image& image, int first, int last, Planes& planes) {
    constexpr double red = 0.2126, green = 0.7152, blue = 0.0722;
    constexpr double to_blue = 0.5 / (blue - 1), to_red = 0.5 / (red - 1);
    constexpr int y_r = fixed_point(red), y_g = fixed_point(green), y_b = fixed_point(blue), half = fixed_point(0.5);
    constexpr int u_r = fixed_point(to_blue * red), u_g = fixed_point(to_blue * green);
    constexpr int v_g = fixed_point(to_red * green), v_b = fixed_point(to_red * blue);
    const int64_t start = static_cast<int64_t>(first) * image.width, end = static_cast<int64_t>(last) * image.width;
    const uint8_t* pixels = image.pixels;
    uint8_t *luma = planes[0].data(), *cb = planes[1].data(), *cr = planes[2].data();
    if (!image.is_rgb) {
        for (int64_t i = start; i < end; ++i)
            for (int k = 0; k < kComponents; ++k) planes[k][i] = pixels[3 * i + k];
        return;
    }
#pragma GCC ivdep
    for (int64_t i = start; i < end; ++i) {
        const int r = pixels[3 * i], g = pixels[3 * i + 1], b = pixels[3 * i + 2];
        luma[i] = level(y_r * r + y_g * g + y_b * b, 0);
        cb[i] = level(u_r * r + u_g * g + half * b, 128);
        cr[i] = level(half * r + v_g * g + v_b * b, 128);
    }
}

// Over some rows: sums of rendered - truth and of its squares, and the number of pixels that count.
struct Differences {
    Sums sums{}, squares{};
    int64_t count = 0;
};

template <bool is_masked>
[[gnu::always_inline]] inline void add_differences(const Frames& frames, int first, int last, Differences& total) {
    for (int row = first; row < last; ++row) {
        const int64_t start = static_cast<int64_t>(row) * frames.width;
        const uint8_t* mask = is_masked ? frames.mask + start : nullptr;
        for (int k = 0; k < kComponents; ++k) {
            const uint8_t *x = frames.rendered[k].data() + start, *y = frames.truth[k].data() + start;
            int sum = 0;
            int64_t squares = 0;
            for (int i = 0; i < frames.width; ++i) {
                const int difference = (is_masked ? mask[i] != 0 : 1) * (int(x[i]) - int(y[i]));
                sum += difference;
                squares += difference * difference;
            }
            total.sums[k] += sum;
            total.squares[k] += squares;
        }
        total.count += is_masked ? frames.width - std::count(mask, mask + frames.width, 0) : frames.width;
    }
}

struct Tile {
    int row, rows, column, columns;
};

// A tile with its border, as float32; `penalty` is 0 where a pixel counts.
struct Workspace {
    alignas(64) float rendered[kComponents][kPaddedRows][kPaddedColumns];
    alignas(64) float truth[kComponents][kPaddedRows][kPaddedColumns];
    alignas(64) float penalty[kPaddedRows][kPaddedColumns];
    alignas(64) float best[kTileColumns], luma[kTileColumns], blue[kTileColumns];
};

using Plane = float[kPaddedRows][kPaddedColumns];

// A row of a plane minus a level, with the pixels of the border repeated beyond it.
[[gnu::always_inline]] inline void load_row(const uint8_t* row, int width, int column, int count, float level, float* loaded) {
    const int first = std::max(column, 0), last = std::min(column + count, width);
    for (int c = first; c < last; ++c) loaded[c - column] = static_cast<float>(row[c]) - level;
    std::fill(loaded, loaded + (first - column), loaded[first - column]);
    std::fill(loaded + (last - column), loaded + count, loaded[last - column - 1]);
}

[[gnu::always_inline]] inline void load_tile(const Frames& frames, const Sums& shift, const Tile& tile, Workspace& w) {
    const int column = tile.column - kReach, columns = tile.columns + 2 * kReach;
    for (int r = 0; r < tile.rows + 2 * kReach; ++r) {
        const int row = std::min(std::max(tile.row + r - kReach, 0), frames.height - 1);
        const int64_t start = static_cast<int64_t>(row) * frames.width;
        for (int k = 0; k < kComponents; ++k) {
            const float level = static_cast<float>(shift[k]);
            load_row(frames.rendered[k].data() + start, frames.width, column, columns, level, w.rendered[k][r]);
            load_row(frames.truth[k].data() + start, frames.width, column, columns, 0.0f, w.truth[k][r]);
        }
        if (!frames.mask) continue;
        load_row(frames.mask + start, frames.width, column, columns, 0.0f, w.penalty[r]);
        for (int c = 0; c < columns; ++c) w.penalty[r][c] = w.penalty[r][c] == 0.0f ? kOutside : 0.0f;
    }
}

// Adds the squared differences of one row to those of `candidates` that lie nearest in colour; the first of equals counts.
template <bool is_masked>
[[gnu::always_inline]] inline void add_row(const Plane* image, const Plane* candidates, int row, int columns, Workspace& w, Sums& sums) {
    std::fill(w.best, w.best + columns, 2 * kOutside);
    const float *y = image[0][row] + kReach, *u = image[1][row] + kReach, *v = image[2][row] + kReach;
    for (int down = -kReach; down <= kReach; ++down)
        for (int along = 0; along <= 2 * kReach; ++along) {
            const float *other_y = candidates[0][row + down] + along, *other_u = candidates[1][row + down] + along,
                        *other_v = candidates[2][row + down] + along, *penalty = w.penalty[row + down] + along;
#pragma GCC ivdep
            for (int i = 0; i < columns; ++i) {
                const float dy = y[i] - other_y[i], du = u[i] - other_u[i], dv = v[i] - other_v[i];
                const float luma = dy * dy, blue = du * du;
                const float cost = kLumaWeight * luma + blue + dv * dv + (is_masked ? penalty[i] : 0.0f);
                const bool is_better = cost < w.best[i];
                w.best[i] = is_better ? cost : w.best[i];
                w.luma[i] = is_better ? luma : w.luma[i];
                w.blue[i] = is_better ? blue : w.blue[i];
            }
        }
    int luma = 0, blue = 0, red = 0;  // at most 256 pixels of 2^16 each
    for (int i = 0; i < columns; ++i) {
        const int counts = !is_masked || w.penalty[row][kReach + i] == 0.0f;  // a factor, because a branch would be guessed wrong
        const float others = w.best[i] - kLumaWeight * w.luma[i];
        luma += counts * static_cast<int>(w.luma[i]);
        blue += counts * static_cast<int>(w.blue[i]);
        red += counts * static_cast<int>(others - w.blue[i]);
    }
    sums[0] += luma, sums[1] += blue, sums[2] += red;
}

using TileSums = std::array<Sums, 2>;  // rendered to truth, truth to rendered

[[gnu::always_inline]] inline TileSums tile_sums(const Frames& frames, const Sums& shift, const Tile& tile, Workspace& w) {
    TileSums sums{};
    load_tile(frames, shift, tile, w);
    for (int row = kReach; row < tile.rows + kReach; ++row)
        if (frames.mask) {
            add_row<true>(w.rendered, w.truth, row, tile.columns, w, sums[0]);
            add_row<true>(w.truth, w.rendered, row, tile.columns, w, sums[1]);
        } else {
            add_row<false>(w.rendered, w.truth, row, tile.columns, w, sums[0]);
            add_row<false>(w.truth, w.rendered, row, tile.columns, w, sums[1]);
        }
    return sums;
}

using TileFunction = TileSums (*)(const Frames&, const Sums&, const Tile&, Workspace&);
using ConvertFunction = void (*)(const Image&, int, int, Planes&);

struct Functions {
    TileFunction sum_tile;
    ConvertFunction convert;
};

TileSums sum_baseline(const Frames& frames, const Sums& shift, const Tile& tile, Workspace& w) { return tile_sums(frames, shift, tile, w); }
void convert_baseline(const Image& image, int first, int last, Planes& planes) { convert_rows(image, first, last, planes); }

#if defined(__x86_64__)
[[gnu::target("avx2")]] TileSums sum_avx2(const Frames& frames, const Sums& shift, const Tile& tile, Workspace& w) {
    return tile_sums(frames, shift, tile, w);
}
[[gnu::target("avx2")]] void convert_avx2(const Image& image, int first, int last, Planes& planes) {
    convert_rows(image, first, last, planes);
}
#define GGVS_AVX512 "avx512f,avx512vl,avx512bw,avx512dq,prefer-vector-width=512"
[[gnu::target(GGVS_AVX512)]] TileSums sum_avx512(const Frames& frames, const Sums& shift, const Tile& tile, Workspace& w) {
    return tile_sums(frames, shift, tile, w);
}
[[gnu::target(GGVS_AVX512)]] void convert_avx512(const Image& image, int first, int last, Planes& planes) {
    convert_rows(image, first, last, planes);
}
#endif

// `level` as in ggvs_eval.kernels.LEVELS, which has asked the processor.
Functions functions_of(int level) {
#if defined(__x86_64__)
    if (level == 2) return {sum_avx512, convert_avx512};
    if (level == 1) return {sum_avx2, convert_avx2};
#endif
    if (level == 0) return {sum_baseline, convert_baseline};
    throw std::invalid_argument("no such instruction set here");
}

std::vector<Tile> cut_into_tiles(int height, int width) {
    std::vector<Tile> tiles;
    for (int row = 0; row < height; row += kTileRows)
        for (int column = 0; column < width; column += kTileColumns)
            tiles.push_back({row, std::min(kTileRows, height - row), column, std::min(kTileColumns, width - column)});
    return tiles;
}

// The mean difference of the frames, rounded, and clipped to what nobody notices.
Sums global_difference(const Differences& total) {
    Sums difference{};
    for (int k = 0; k < kComponents && total.count; ++k) {
        const double mean = static_cast<double>(total.sums[k]) / static_cast<double>(total.count);
        difference[k] = std::clamp<int64_t>(std::lround(mean), -kUnnoticed, kUnnoticed);
    }
    return difference;
}

struct Measured {
    TileSums sums{};
    Sums shift{};
    Differences plain;
};

Measured measure(const Image& rendered, const Image& truth, const uint8_t* mask, int threads, const Functions& functions) {
    Frames frames{{}, {}, mask, truth.height, truth.width};
    for (Planes* planes : {&frames.rendered, &frames.truth})
        for (auto& plane : *planes) plane.resize(static_cast<size_t>(truth.height) * truth.width);
    const int bands = (truth.height + kBandRows - 1) / kBandRows;
    std::vector<Differences> differences(bands);
    ggvs::parallel_for(bands, threads, [&](int band, int) {
        const int first = band * kBandRows, last = std::min(first + kBandRows, truth.height);
        functions.convert(rendered, first, last, frames.rendered);
        functions.convert(truth, first, last, frames.truth);
        if (mask)
            add_differences<true>(frames, first, last, differences[band]);
        else
            add_differences<false>(frames, first, last, differences[band]);
    });
    Measured result;
    for (const Differences& band : differences) {
        for (int k = 0; k < kComponents; ++k) {
            result.plain.sums[k] += band.sums[k];
            result.plain.squares[k] += band.squares[k];
        }
        result.plain.count += band.count;
    }
    result.shift = global_difference(result.plain);
    const std::vector<Tile> tiles = cut_into_tiles(truth.height, truth.width);
    std::vector<TileSums> sums(tiles.size());
    std::vector<Workspace> workspaces(std::max(1, std::min<int>(threads, static_cast<int>(tiles.size()))));
    ggvs::parallel_for(static_cast<int>(tiles.size()), threads, [&](int t, int worker) {
        sums[t] = functions.sum_tile(frames, result.shift, tiles[t], workspaces[worker]);
    });
    for (const TileSums& tile : sums)
        for (int d = 0; d < 2; ++d)
            for (int k = 0; k < kComponents; ++k) result.sums[d][k] += tile[d][k];
    return result;
}

using Bytes = py::array_t<uint8_t, py::array::c_style>;

py::tuple matched_errors(const Bytes& rendered, const Bytes& truth, const py::object& mask, bool is_rgb, int threads, int level) {
    if (truth.ndim() != 3 || truth.shape(2) != kComponents) throw std::invalid_argument("wanted images of shape (height, width, 3)");
    for (int axis = 0; axis < 3; ++axis)
        if (rendered.ndim() != 3 || rendered.shape(axis) != truth.shape(axis))
            throw std::invalid_argument("wanted two images of one shape");
    const int height = static_cast<int>(truth.shape(0)), width = static_cast<int>(truth.shape(1));
    Bytes chosen;
    if (!mask.is_none()) {
        chosen = mask.cast<Bytes>();
        if (chosen.ndim() != 2 || chosen.shape(0) != height || chosen.shape(1) != width)
            throw std::invalid_argument("wanted a mask of the images' height and width");
    }
    const Functions functions = functions_of(level);
    const Image first{rendered.data(), height, width, is_rgb}, second{truth.data(), height, width, is_rgb};
    const uint8_t* pixels = mask.is_none() ? nullptr : chosen.data();
    Measured result;
    {
        py::gil_scoped_release release;
        result = measure(first, second, pixels, threads, functions);
    }
    py::array_t<int64_t> sums({2, kComponents});
    for (int d = 0; d < 2; ++d)
        for (int k = 0; k < kComponents; ++k) sums.mutable_at(d, k) = result.sums[d][k];
    return py::make_tuple(sums, py::array_t<int64_t>(kComponents, result.plain.squares.data()),
                          py::array_t<int64_t>(kComponents, result.shift.data()), result.plain.count);
}

}  // namespace

PYBIND11_MODULE(_iv_psnr, module) {
    module.doc() = "Errors of a frame after matching within two pixels, for IV-PSNR.";
    module.def("matched_errors", &matched_errors, py::arg("rendered"), py::arg("truth"), py::arg("mask"), py::arg("is_rgb"),
               py::arg("threads"), py::arg("level"),
               "Squared errors (2, 3) of YCbCr, rendered to truth and back; the same (3,) of each pixel and its own place; the global "
               "difference (3,); the number of pixels.");
}
