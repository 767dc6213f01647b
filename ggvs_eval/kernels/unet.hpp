// The U-Net of the blending network: convolutions over reflected borders, one normalisation group, pooling, enlarging, skips.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "convolve.hpp"

namespace ggvs {

constexpr int kUNetLevels = 4, kUNetBlocks = 2 * kUNetLevels + 1;

// Maps as rows (height + 2, lines, stride): a row holds one line per channel, from column -1 on. Row and column -1 repeat 1,
// those beyond the last one the last but one.
struct ReflectedMaps {
    int width, height, channels;
    int lines;        // of a row, at least `channels`: convolutions write whole groups of outputs
    int64_t stride;   // of lines: room for what the last packet reads and writes beyond
    float* data;

    float* row(int y) const { return data + (y + 1) * lines * stride; }
};

// One 3 x 3 convolution and the normalisation behind it.
struct UNetLayer {
    Layer convolution;          // packed
    const float *gain, *shift;  // (after)
};

struct UNet {
    int width, height, channels, outputs;
    const float* input;  // (channels, height, width)
    std::array<std::array<UNetLayer, 2>, kUNetBlocks> blocks;  // down, bottleneck, up
    const float *last_weights, *last_bias;  // (outputs, first width), (outputs)
    double epsilon;                         // of the normalisation
};

// Sums of a row's values, and of their squares, over all its channels.
struct Moments {
    double sum, squares;
};

// A row's values times gain plus shift of their channel, not below 0, in place.
struct NormalisedRow {
    float* row;  // from column -1 on
    int64_t stride;
    int width, channels;
    const float *gain, *shift;
};

// How many floats of memory `unet` wants, beginning on a multiple of 64 bytes.
int64_t unet_workspace(const UNet& job);

// (outputs, height, width)
void unet(const UNet& job, float* workspace, float* out, int threads, int level);

}  // namespace ggvs
