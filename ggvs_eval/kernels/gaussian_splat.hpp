// The differentiable splat of 3D Gaussians: the data that pass between the driver (gaussian_splat.cpp) and its SIMD parts.
// ggvs_eval/gaussians/torch_splat.py says the same in torch, readably.
#pragma once
#include <cstdint>
#include <vector>

namespace ggvs {

constexpr int kBatch = 16;  // Gaussians that are projected together: the lanes of the widest vector
constexpr int kSide = 4;    // a tile is made of 4 x 4-pixel blocks, 16 lanes in a row
constexpr int kPixels = kSide * kSide;
constexpr int kTile = 32;  // pixels across and down: what a tile keeps stays in the first-level cache
constexpr int kAcross = kTile / kSide, kBlocks = kAcross * kAcross;
constexpr int kMostDegree = 4, kMostTerms = (kMostDegree + 1) * (kMostDegree + 1);  // of the spherical harmonics

constexpr float kLowPass = 0.3f, kLeastAlpha = 1.0f / 255.0f, kMostAlpha = 0.99f, kLeastTransmittance = 1e-4f;

struct CloudArrays {
    int64_t count;
    int degree;
    const float *means, *log_scales, *quaternions, *opacity_logits, *sh;
    const float* offsets;  // (count, 2), pixels, or null
};

struct CloudGradients {
    float *means, *log_scales, *quaternions, *opacity_logits, *sh, *offsets;
};

struct GaussianView {
    float rotation[9], shift[3];              // world to camera
    float centre[3];                          // of the camera, in the world
    float fx, fy, cx, cy;                     // cx and cy already minus 0.5: integer pixel index = centre
    float low_x, high_x, low_y, high_y;       // between which the slopes of the Jacobian are held
    float near;
    int width, height;
};

// A Gaussian in the image. log2 of alpha / opacity at (x, y) is (xx dx + xy dy) dx + yy dy dy.
struct alignas(16) ScreenGaussian {
    float u, v, xx, xy, yy, opacity;
    float red, green, blue, depth;
    float reach_x, reach_y;  // half extents of the box outside of which alpha is below 1/255
};

// Tiles that a Gaussian touches; x0 > x1 where it is not visible.
struct TileBox {
    int32_t x0, x1, y0, y1;
    int64_t size() const { return x0 > x1 ? 0 : int64_t(x1 - x0 + 1) * (y1 - y0 + 1); }
};

// What a tile keeps of its pixels, (kBlocks, kPixels) each: sums of colour and depth, transmittance, and after how many of its
// list's Gaussians a pixel has had its last one.
struct TilePixels {
    float transmittance[kBlocks][kPixels], red[kBlocks][kPixels], green[kBlocks][kPixels], blue[kBlocks][kPixels];
    float depth[kBlocks][kPixels];
    int32_t last[kBlocks][kPixels];
};

// Sums over pixels of the loss's derivatives by a Gaussian's colour and depth, and of p = d loss / d ln alpha by itself and times
// dx, dy, dx^2, dx dy, dy^2.
enum Sum { kRed, kGreen, kBlue, kDepth, kP, kPx, kPy, kPxx, kPxy, kPyy, kSums };

struct GaussianPictures {
    float *colour, *transmittance, *depth;  // (height, width, 3), (height, width) twice
    int32_t* radii;                         // (count)
};

struct PictureGradients {
    const float *colour, *transmittance, *depth;
};

// A forward pass and what its backward pass looks up.
struct GaussianFrame {
    GaussianView view;
    int across, down;  // tiles
    std::vector<ScreenGaussian> gaussians;
    std::vector<TileBox> boxes;
    std::vector<int64_t> slots;     // of each Gaussian: where its sums of tiles start; one more at the end
    std::vector<uint32_t> listed;   // Gaussians of tile after tile, nearest first
    std::vector<int64_t> starts;    // of each tile in `listed`; one more at the end
    std::vector<float> transmittance;  // of each tile's pixels, in blocks
    std::vector<int32_t> last;
};

GaussianFrame render_gaussians(const CloudArrays& cloud, const GaussianView& view, const GaussianPictures& out, int threads,
                               int level);
void gaussian_gradients(const GaussianFrame& frame, const CloudArrays& cloud, const PictureGradients& gradients,
                        const CloudGradients& out, int threads, int level);

}  // namespace ggvs
