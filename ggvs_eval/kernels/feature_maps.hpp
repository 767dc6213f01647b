// Features of a frame: 3 x 3 convolutions, each with its ReLU, and halvings by maxima between them (VGG16 without its classifier).
// The arithmetic stands in feature_maps_simd.hpp.
//
// Maps lie in memory with a pixel's channels side by side. A convolution filters tiles of 4 x 4 pixels by minimal filtering in both
// directions (minimal_filtering.hpp): 36 products of matrices, (tiles, before) with (before, after), where filtering as
// usual takes 144.
#pragma once
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "aligned.hpp"
#include "minimal_filtering.hpp"

namespace ggvs {

constexpr int kTile = kFilteredValues, kTileSource = kFilteredSums, kTileSums = kTileSource * kTileSource;
constexpr int kPanel = 32;       // outputs whose weights lie side by side
constexpr int kDepthChunk = 64;  // inputs of a tile that lie side by side
constexpr int kRowsMultiple = 42;  // of the rows that any instruction set sums at once
constexpr int kBlockPad = 16;    // floats between the 36 matrices, or they would fall on the same lines of the cache
constexpr float kLeastLength = 1e-10f;  // of a vector of features, added to it
constexpr int kColours = 3, kColourTaps = 9 * kColours;

// A convolution; weights as `pack_weights` makes them: (kTileSums, after / kPanel, before, kPanel), of the first layer, which looks
// at colours, (after / kPanel, kColourTaps, kPanel).
struct FeatureLayer {
    int before, after;
    const float *weights, *bias;
};

// A map that is filtered next, with zeros around it: a pixel before it, and behind it up to whole tiles.
struct PaddedMap {
    int height, width, channels, tile_rows, tile_columns;
    int64_t row;  // floats
    float* corner;

    PaddedMap(int height, int width, int channels, float* memory = nullptr);
    int64_t floats() const { return (tile_rows * kTile + 2) * row; }
    float* pixel(int y, int x) const { return corner + (y + 1) * row + int64_t(x + 1) * channels; }
    void clear_border() const;
};

// Pixel (y, x) is at data + y * row + x * channels. None where data is null.
struct MapOut {
    float* data;
    int64_t row;
    int height, width;
};

// Rows of a matrix of inputs, kDepthChunk side by side, and of their products with the weights; the next matrix is so many floats
// further.
struct Block {
    int rows;  // a multiple of kRowsMultiple
    int64_t source_step, sums_step;

    Block(const FeatureLayer& layer, int rows)
        : rows(rows), source_step(int64_t(rows) * chunks(layer.before) * kDepthChunk + kBlockPad),
          sums_step(int64_t(rows) * layer.after + kBlockPad) {}
    static int chunks(int before) { return (before + kDepthChunk - 1) / kDepthChunk; }
    int64_t memory() const { return kTileSums * (source_step + sums_step); }  // floats
};

// Tiles `first` to `first + count`, in the order of rows, of a convolution.
struct TileJob {
    const FeatureLayer& layer;
    const PaddedMap& source;
    MapOut out, halved;
    Block block;
    int first, count;
    float* memory;
};

// Pixels `first` to `first + count` of row y of the first layer.
struct ColourJob {
    const FeatureLayer& layer;
    const PaddedMap& source;
    MapOut out;
    Block block;
    int y, first, count;
    float* memory;
};

// Filters (after, before, 3, 3), C-contiguous, as the kernels take them.
void pack_weights(const float* filters, int after, int before, float* out, int threads);

// Floats of the packed filters.
int64_t packed_size(int after, int before);

// Features of pixels of two frames, (count, channels) each, a multiple of 16 channels, and what the difference in each counts.
struct ComparedPixels {
    const float *ours, *theirs, *weights;
    int count, channels;
    float* out;  // (count)
};

// A frame (height, width, 3), or features of one, and the layers that it goes through. Those that are tapped are written,
// (height', width', after) each; behind each of them the map is halved.
struct FeatureJob {
    const float* frame;
    int height, width, channels;
    std::vector<FeatureLayer> layers;
    std::vector<float*> taps;  // null where a layer is not tapped
};

// Floats that `feature_maps` needs for the maps between the layers: those of even ones and of odd ones.
std::array<int64_t, 2> feature_memory(const FeatureJob& job);

// Frames of one size that go through the first layers together, by bands of rows, so that no map of these layers is ever whole.
// Every layer that is tapped is compared with that of the first frame; the last one is.
struct BandedJob {
    int height, width;
    std::vector<const float*> frames;  // (height, width, 3) each
    std::vector<FeatureLayer> layers;
    std::vector<const float*> weights;               // of the differences: (after) of a tapped layer, null elsewhere
    std::vector<std::vector<float*>> distances;      // of each layer that is tapped, and each frame but the first: (height', width')
    std::vector<float*> halved;                      // of each frame: what the last layer hands on, (height', width', after)
};

// Its memory goes back to the system: kept ones would add up to more than a whole map.
void compare_banded(const BandedJob& job, int threads, int level);

// Weighted squared distances of the features' directions.
void compare_features(const ComparedPixels& all, int threads, int level);

void feature_maps(const FeatureJob& job, const std::array<float*, 2>& memory, int threads, int level);

}  // namespace ggvs
