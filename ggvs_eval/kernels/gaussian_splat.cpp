// The differentiable splat of 3D Gaussians on the CPU.
//
// Forward: Gaussians are projected in batches, sorted by depth once for all tiles, listed per tile, and each tile blends its list
// front to back. Backward: each tile goes through its list back to front and leaves, for each Gaussian on it, sums over its pixels
// in a slot of that Gaussian and tile; then each Gaussian adds up its slots in the order of tiles. So no sum depends on the number
// of threads.
#include "gaussian_splat.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <utility>

#include "gaussian_levels.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kBatchesPerJob = 64;

// Calls work(first) for the first Gaussian of every batch.
template <class Work>
void for_batches(int64_t count, int threads, const Work& work) {
    constexpr int64_t kGaussiansPerJob = int64_t(kBatchesPerJob) * kBatch;
    parallel_for(int((count + kGaussiansPerJob - 1) / kGaussiansPerJob), threads, [&](int job, int) {
        const int64_t end = std::min(count, (job + 1) * kGaussiansPerJob);
        for (int64_t first = job * kGaussiansPerJob; first < end; first += kBatch) work(first);
    });
}

// Visible Gaussians, nearest first: a stable radix sort, so that equal depths keep the order of the cloud.
std::vector<uint32_t> by_depth(const std::vector<ScreenGaussian>& gaussians, const std::vector<TileBox>& boxes) {
    constexpr int kDigit = 11;
    std::vector<uint64_t> keys, swap;  // depth bits << 32 | number
    keys.reserve(boxes.size());
    for (size_t n = 0; n < boxes.size(); ++n) {
        if (boxes[n].size() == 0) continue;
        uint32_t depth_bits;  // of a positive float: they sort like the float itself
        std::memcpy(&depth_bits, &gaussians[n].depth, sizeof depth_bits);
        keys.push_back(uint64_t(depth_bits) << 32 | n);
    }
    swap.resize(keys.size());
    for (int shift = 32; shift < 64; shift += kDigit) {
        size_t starts[1 << kDigit] = {};
        auto digit = [&](uint64_t key) { return (key >> shift) & ((1 << kDigit) - 1); };
        for (uint64_t key : keys) ++starts[digit(key)];
        size_t sum = 0;
        for (size_t& start : starts) sum += std::exchange(start, sum);
        for (uint64_t key : keys) swap[starts[digit(key)]++] = key;
        keys.swap(swap);
    }
    return {keys.begin(), keys.end()};  // the lower halves
}

// Lists Gaussians tile by tile: a counting sort, which keeps their order within a tile.
void list_tiles(GaussianFrame& frame) {
    const size_t count = frame.boxes.size();
    frame.slots.assign(count + 1, 0);
    frame.starts.assign(size_t(frame.across) * frame.down + 1, 0);
    auto each_tile = [&](const TileBox& box, auto work) {
        for (int y = box.y0; y <= box.y1; ++y)
            for (int x = box.x0; x <= box.x1; ++x) work(size_t(y) * frame.across + x);
    };
    for (size_t n = 0; n < count; ++n) {
        const TileBox& box = frame.boxes[n];
        frame.slots[n + 1] = frame.slots[n] + box.size();
        if (box.size()) each_tile(box, [&](size_t tile) { ++frame.starts[tile + 1]; });
    }
    for (size_t tile = 1; tile < frame.starts.size(); ++tile) frame.starts[tile] += frame.starts[tile - 1];
    std::vector<int64_t> next(frame.starts.begin(), frame.starts.end() - 1);
    frame.listed.resize(frame.slots[count]);
    for (uint32_t n : by_depth(frame.gaussians, frame.boxes))
        each_tile(frame.boxes[n], [&](size_t tile) { frame.listed[next[tile]++] = n; });
}

// One tile's place in the image, and in the frame's lists.
struct Tile {
    int left, top, right, bottom, count;
    const uint32_t* listed;
};

Tile tile_of(const GaussianFrame& frame, int tile) {
    const int left = tile % frame.across * kTile, top = tile / frame.across * kTile;
    return {left, top, std::min(left + kTile, frame.view.width), std::min(top + kTile, frame.view.height),
            int(frame.starts[tile + 1] - frame.starts[tile]), frame.listed.data() + frame.starts[tile]};
}

// Calls work(pixel of the image, block, pixel of the block) for all of a tile's pixels inside the image.
template <class Work>
void each_pixel(const GaussianFrame& frame, const Tile& tile, const Work& work) {
    for (int y = tile.top; y < tile.bottom; ++y) {
        for (int x = tile.left; x < tile.right; ++x) {
            const int row = y - tile.top, column = x - tile.left;
            work(int64_t(y) * frame.view.width + x, row / kSide * kAcross + column / kSide, row % kSide * kSide + column % kSide);
        }
    }
}

void blend_tile(GaussianFrame& frame, int number, const GaussianKernels& kernels, TilePixels& pixels,
                const GaussianPictures& out) {
    const Tile tile = tile_of(frame, number);
    std::memset(&pixels, 0, sizeof pixels);
    std::fill_n(pixels.transmittance[0], kBlocks * kPixels, -1.0f);  // outside of the image: stopped
    each_pixel(frame, tile, [&](int64_t, int block, int lane) { pixels.transmittance[block][lane] = 1.0f; });
    kernels.blend_tile(frame.gaussians.data(), tile.listed, tile.count, tile.left, tile.top, pixels);
    for (float* t = pixels.transmittance[0]; t != pixels.transmittance[0] + kBlocks * kPixels; ++t) *t = std::fabs(*t);
    each_pixel(frame, tile, [&](int64_t pixel, int block, int lane) {
        out.colour[3 * pixel] = pixels.red[block][lane], out.colour[3 * pixel + 1] = pixels.green[block][lane];
        out.colour[3 * pixel + 2] = pixels.blue[block][lane], out.depth[pixel] = pixels.depth[block][lane];
        out.transmittance[pixel] = pixels.transmittance[block][lane];
    });
    const size_t at = size_t(number) * kBlocks * kPixels;
    std::memcpy(frame.transmittance.data() + at, pixels.transmittance, sizeof pixels.transmittance);
    std::memcpy(frame.last.data() + at, pixels.last, sizeof pixels.last);
}

// Where a Gaussian's sums of one tile go.
int64_t slot_of(const GaussianFrame& frame, uint32_t gaussian, int tile) {
    const TileBox& box = frame.boxes[gaussian];
    const int x = tile % frame.across, y = tile / frame.across;
    return frame.slots[gaussian] + int64_t(y - box.y0) * (box.x1 - box.x0 + 1) + (x - box.x0);
}

struct BackwardMemory {
    TilePixels pixels;
    float behind[kBlocks][kPixels];
    std::vector<float> sums;  // (Gaussians of the list, kSums)
};

void tile_gradients(const GaussianFrame& frame, int number, const GaussianKernels& kernels, BackwardMemory& memory,
                    const PictureGradients& gradients, float (*slots)[kSums]) {
    const Tile tile = tile_of(frame, number);
    if (tile.count == 0) return;
    TilePixels& pixels = memory.pixels;
    const size_t at = size_t(number) * kBlocks * kPixels;
    std::memset(&pixels, 0, sizeof pixels);
    std::memset(memory.behind, 0, sizeof memory.behind);
    std::memcpy(pixels.transmittance, frame.transmittance.data() + at, sizeof pixels.transmittance);
    std::memcpy(pixels.last, frame.last.data() + at, sizeof pixels.last);
    each_pixel(frame, tile, [&](int64_t pixel, int block, int lane) {
        pixels.red[block][lane] = gradients.colour[3 * pixel], pixels.green[block][lane] = gradients.colour[3 * pixel + 1];
        pixels.blue[block][lane] = gradients.colour[3 * pixel + 2], pixels.depth[block][lane] = gradients.depth[pixel];
        memory.behind[block][lane] = gradients.transmittance[pixel];
    });
    memory.sums.resize(size_t(tile.count) * kSums);
    auto* sums = reinterpret_cast<float(*)[kSums]>(memory.sums.data());
    kernels.blend_gradients(frame.gaussians.data(), tile.listed, tile.count, tile.left, tile.top, pixels, memory.behind[0], sums);
    for (int n = 0; n < tile.count; ++n) std::memcpy(slots[slot_of(frame, tile.listed[n], number)], sums[n], sizeof sums[n]);
}

}  // namespace

GaussianFrame render_gaussians(const CloudArrays& cloud, const GaussianView& view, const GaussianPictures& out, int threads,
                               int level) {
    const GaussianKernels& kernels = gaussian_kernels(level);
    GaussianFrame frame;
    frame.view = view;
    frame.across = (view.width + kTile - 1) / kTile, frame.down = (view.height + kTile - 1) / kTile;
    frame.gaussians.resize(cloud.count), frame.boxes.resize(cloud.count);
    for_batches(cloud.count, threads, [&](int64_t first) {
        kernels.project(view, cloud, first, frame.gaussians.data(), frame.boxes.data(), out.radii);
    });
    list_tiles(frame);
    const int tiles = frame.across * frame.down;
    frame.transmittance.resize(size_t(tiles) * kBlocks * kPixels), frame.last.resize(size_t(tiles) * kBlocks * kPixels);
    std::vector<TilePixels> memory(std::max(1, threads));
    parallel_for(tiles, threads, [&](int tile, int worker) { blend_tile(frame, tile, kernels, memory[worker], out); });
    return frame;
}

void gaussian_gradients(const GaussianFrame& frame, const CloudArrays& cloud, const PictureGradients& gradients,
                        const CloudGradients& out, int threads, int level) {
    const GaussianKernels& kernels = gaussian_kernels(level);
    const std::unique_ptr<float[]> memory_of_slots(new float[frame.listed.size() * kSums]);  // not set to zero, which would take its time
    auto* slots = reinterpret_cast<float(*)[kSums]>(memory_of_slots.get());
    std::vector<BackwardMemory> memory(std::max(1, threads));
    parallel_for(frame.across * frame.down, threads, [&](int tile, int worker) {
        tile_gradients(frame, tile, kernels, memory[worker], gradients, slots);
    });
    for_batches(cloud.count, threads, [&](int64_t first) {
        alignas(64) float sums[kSums][kBatch] = {};
        for (int lane = 0; lane < kBatch && first + lane < cloud.count; ++lane)
            for (int64_t slot = frame.slots[first + lane]; slot < frame.slots[first + lane + 1]; ++slot)
                for (int n = 0; n < kSums; ++n) sums[n][lane] += slots[slot][n];
        kernels.project_gradients(frame.view, cloud, first, sums, frame.boxes.data(), out);
    });
}

}  // namespace ggvs
