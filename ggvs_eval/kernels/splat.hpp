// Forward rendering of pixel-sized Gaussians: the data that pass between the driver (splat.cpp) and its SIMD parts
// (splat_simd.hpp).
#pragma once
#include <cstdint>
#include <vector>

#include "camera.hpp"

namespace ggvs {

constexpr int kMaxFeatures = 4;
constexpr int kTile = 64;  // pixels across and down of the target that are sorted together
constexpr int kBlock = 4;  // a tile is made of blocks 4 pixels wide that fill one vector, 4 x 4 at most
constexpr int kLanes = kBlock * kBlock;
constexpr float kMinAlpha = 1.0f / 255.0f;

// The features are floats, or an 8-bit colour and perhaps one float more: then no image of floats is ever made.
struct SplatSource {
    Pinhole camera;
    const double* to_target;  // source camera -> target camera, rigid 4x4
    const float* depth;       // (height, width), 0 = invalid
    const float* features;    // (height, width, channels), or null
    const uint8_t* colours;   // (height, width, 3), where features is null
    const float* extra;       // (height, width), where features is null and there are four channels
};

struct SplatTarget {
    Pinhole camera;
    float near;
};

struct SplatImages {
    float* features;  // (height, width, channels)
    float* alpha;     // (height, width)
    float* depth;     // (height, width)
};

// What one source's Gaussians need to become ellipses in the target image.
struct Projector {
    PixelMap map;        // to the target camera's frame
    float sigma;         // standard deviation per unit of source depth: scale / focal length
    float fx, fy;        // target
    float cx, cy;        // target, already minus 0.5: integer pixel index = centre
    float max_x, max_y;  // clamp of the ray slope in the Jacobian, 1.3 tan(fov / 2)
    float near;
    float last_x, last_y;  // largest pixel indices of the target
};

// A Gaussian in one tile's coordinates, in a cache line of its own. (xx i + xy j + x, yy j + y) takes pixel (i, j) to where the
// ellipse on which alpha falls to 1/255 is the unit circle.
struct alignas(64) Ellipse {
    float xx, xy, x, yy, y, depth;
    float features[kMaxFeatures];
};

// Bits of the least and the most depth.
struct DepthRange {
    int32_t least = INT32_MAX, most = 0;
};

// What is written of some Gaussians of a tile; there is room for whole vectors. Which parts of the tile a Gaussian may touch: a bit
// for every four columns of pixels, and one for every two rows.
struct Ellipses {
    Ellipse* list;
    int32_t *columns, *rows;
    int32_t* depths;    // their bits
    DepthRange* range;  // is widened by them
};

// Some of a tile's Gaussians, front to back: their numbers, and which rows and columns they may touch, with room for whole vectors.
enum TileWord { kGaussians, kRows, kColumns };
struct TileList {
    int32_t* words[3];
    int count;
};

struct SplatTile {
    const Ellipse* ellipses;
    const int32_t *rows_of, *columns_of;  // the ellipses
    const int32_t* sorted;          // numbers of the ellipses front to back, with room for whole vectors
    int32_t nothing;                // comes behind the ellipses and touches no pixel: their number
    int left, top;                  // in the picture
    TileList strips[4], cells[4], columns[4], blocks[4];  // room for the lists of smaller and smaller parts
};

struct SplatPicture {
    int width, height;
    bool normalised;
    SplatImages out;
};

// Tile ranges of up to 16 neighbouring Gaussians; x0 and y0 are huge and x1 and y1 negative where one is invalid or invisible.
struct TileRanges {
    int32_t x0[kLanes], x1[kLanes], y0[kLanes], y1[kLanes];
};

void splat(std::vector<SplatSource>& sources, int channels, const SplatTarget& target, float scale, bool normalised,
           SplatImages out, int threads, int level);

}  // namespace ggvs
