// Forward rendering of pixel-sized Gaussians (paper 3.1; 3D Gaussian splatting's forward pass) on the CPU.
//
// Source rows are projected in bands and their Gaussians listed per target tile; then each tile projects its Gaussians again
// (cheaper than keeping them), sorts them by depth and blends front to back into accumulators that stay in the cache. Lists
// follow the order (source, row, column) whatever the number of threads, and the sort is stable: so are the results.
#include "splat.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "kernels.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kBandRows = 8;

struct Band {
    int source, first_row, rows;
    std::vector<uint32_t> pixels;  // sorted by tile
    std::vector<uint32_t> starts;  // per tile, where its pixels start; one more at the end
};

struct Grid {
    int across, down;
};

// Workspace of one thread, kept from tile to tile.
struct Workspace {
    std::vector<Ellipse> list;
    std::vector<uint64_t> keys, swap;  // depth bits << 32 | position in the list
    std::vector<uint32_t> ordered;
    std::vector<float> blocks;
};

Projector make_projector(const SplatSource& source, const SplatTarget& target, float scale) {
    const Pinhole& camera = target.camera;
    Projector p;
    p.map = pixel_map(source.camera, source.to_target, camera, false);
    p.sigma = float(scale / (0.5 * (source.camera.fx + source.camera.fy)));
    p.fx = float(camera.fx), p.fy = float(camera.fy);
    p.cx = float(camera.cx - 0.5), p.cy = float(camera.cy - 0.5);
    p.max_x = float(1.3 * camera.width / (2.0 * camera.fx)), p.max_y = float(1.3 * camera.height / (2.0 * camera.fy));
    p.near = target.near;
    p.last_x = float(camera.width - 1), p.last_y = float(camera.height - 1);
    return p;
}

std::vector<Band> make_bands(const std::vector<SplatSource>& sources) {
    std::vector<Band> bands;
    for (int s = 0; s < int(sources.size()); ++s)
        for (int row = 0; row < sources[s].camera.height; row += kBandRows)
            bands.push_back({s, row, std::min(kBandRows, sources[s].camera.height - row), {}, {}});
    return bands;
}

// Lists the band's pixels per tile: a counting sort, which keeps their order within a tile.
void fill_band(Band& band, const SplatSource& source, const Projector& projector, Grid grid, const Kernels& kernels) {
    const int width = source.camera.width;
    std::vector<uint32_t> tiles, pixels;
    tiles.reserve(size_t(band.rows) * width * 5 / 4);
    pixels.reserve(size_t(band.rows) * width * 5 / 4);
    band.starts.assign(grid.across * grid.down + 1, 0);
    for (int row = band.first_row; row < band.first_row + band.rows; ++row) {
        for (int column = 0; column < width; column += kLanes) {
            TileRanges ranges;
            const int count = std::min(kLanes, width - column);
            kernels.tile_ranges(projector, source.depth + int64_t(row) * width + column, column, row, count, &ranges);
            for (int lane = 0; lane < count; ++lane) {
                if (ranges.x0[lane] > ranges.x1[lane]) continue;
                for (int y = ranges.y0[lane]; y <= ranges.y1[lane]; ++y) {
                    for (int x = ranges.x0[lane]; x <= ranges.x1[lane]; ++x) {
                        tiles.push_back(y * grid.across + x);
                        pixels.push_back(uint32_t(row) << 16 | uint32_t(column + lane));
                        ++band.starts[tiles.back() + 1];
                    }
                }
            }
        }
    }
    for (size_t tile = 1; tile < band.starts.size(); ++tile) band.starts[tile] += band.starts[tile - 1];
    std::vector<uint32_t> next(band.starts.begin(), band.starts.end() - 1);
    band.pixels.resize(pixels.size());
    for (size_t n = 0; n < pixels.size(); ++n) band.pixels[next[tiles[n]]++] = pixels[n];
}

// Stable least-significant-digit radix sort by the upper half; only the digits that differ within the tile are visited.
void sort_by_depth(std::vector<uint64_t>& keys, std::vector<uint64_t>& swap) {
    constexpr int kDigit = 11;
    uint32_t low = ~0u, high = 0;
    for (uint64_t key : keys) low = std::min(low, uint32_t(key >> 32)), high = std::max(high, uint32_t(key >> 32));
    swap.resize(keys.size());
    for (uint32_t rest = keys.empty() ? 0 : high - low, shift = 32; rest > 0; rest >>= kDigit, shift += kDigit) {
        uint32_t starts[1 << kDigit] = {};
        auto digit = [&](uint64_t key) { return ((key - (uint64_t(low) << 32)) >> shift) & ((1 << kDigit) - 1); };
        for (uint64_t key : keys) ++starts[digit(key)];
        uint32_t sum = 0;
        for (uint32_t& start : starts) sum += std::exchange(start, sum);
        for (uint64_t key : keys) swap[starts[digit(key)]++] = key;
        keys.swap(swap);
    }
}

// The features of some pixels of a block's row, channels side by side.
template <int kChannels>
void write_features(const float* from, int columns, float* out) {
    for (int lane = 0; lane < columns; ++lane)
        for (int c = 0; c < kChannels; ++c) out[lane * kChannels + c] = from[c * kLanes + lane];
}

template <int kChannels>
void write_tile(const float* blocks, int left, int top, const Pinhole& camera, SplatImages out) {
    constexpr int kFloats = (2 + kChannels) * kLanes;
    const int bottom = std::min(top + kTileHeight, camera.height), right = std::min(left + kTileWidth, camera.width);
    for (int y = top; y < bottom; ++y) {
        const float* row = blocks + (y - top) / kBlock * (kTileWidth / kBlock) * kFloats + (y - top) % kBlock * kBlock;
        for (int x = left; x < right; x += kBlock, row += kFloats) {
            const int64_t pixel = int64_t(y) * camera.width + x;
            const int columns = std::min(kBlock, right - x);
            std::memcpy(out.alpha + pixel, row, columns * sizeof(float));
            std::memcpy(out.depth + pixel, row + kLanes, columns * sizeof(float));
            float* features = out.features + pixel * kChannels;
            // The usual whole row of a block has a length the compiler knows.
            if (columns == kBlock) {
                write_features<kChannels>(row + 2 * kLanes, kBlock, features);
            } else {
                write_features<kChannels>(row + 2 * kLanes, columns, features);
            }
        }
    }
}

using WriteTile = void (*)(const float* blocks, int left, int top, const Pinhole& camera, SplatImages out);
constexpr WriteTile kWriteTile[kMaxFeatures] = {write_tile<1>, write_tile<2>, write_tile<3>, write_tile<4>};

// All that happens in one tile, steps 2 to 8.
struct TileJob {
    const std::vector<SplatSource>& sources;
    const std::vector<Projector>& projectors;
    const std::vector<Band>& bands;
    const SplatTarget& target;
    int channels;
    bool normalised;
    Grid grid;
    const Kernels& kernels;
    SplatImages out;

    void collect(int tile, int left, int top, Workspace& work) const {
        size_t count = 0;
        for (const Band& band : bands) count += band.starts[tile + 1] - band.starts[tile];
        work.list.resize(count);
        size_t filled = 0;
        for (const Band& band : bands) {
            const int here = int(band.starts[tile + 1] - band.starts[tile]);
            if (here == 0) continue;
            kernels.ellipses(projectors[band.source], sources[band.source], channels, band.pixels.data() + band.starts[tile],
                             here, left, top, work.list.data() + filled);
            filled += here;
        }
    }

    void run(int tile, Workspace& work) const {
        const int left = tile % grid.across * kTileWidth, top = tile / grid.across * kTileHeight;
        collect(tile, left, top, work);
        const size_t count = work.list.size();
        work.keys.resize(count);
        for (size_t n = 0; n < count; ++n) {
            uint32_t depth_bits;  // of a positive float: they sort like the float itself
            std::memcpy(&depth_bits, &work.list[n].depth, sizeof depth_bits);
            work.keys[n] = uint64_t(depth_bits) << 32 | n;
        }
        sort_by_depth(work.keys, work.swap);
        work.ordered.resize(count);
        for (size_t n = 0; n < count; ++n) work.ordered[n] = uint32_t(work.keys[n]);

        const int floats = (2 + channels) * kLanes;
        work.blocks.assign(size_t(kTileBlocks) * floats, 0.0f);
        for (int block = 0; block < kTileBlocks; ++block) std::fill_n(work.blocks.begin() + size_t(block) * floats, kLanes, 1.0f);
        kernels.blend_tile(work.list.data(), work.ordered.data(), int(count), channels, work.blocks.data());
        kernels.finish_blocks(work.blocks.data(), channels, normalised);
        kWriteTile[channels - 1](work.blocks.data(), left, top, target.camera, out);
    }
};

}  // namespace

void splat(std::vector<SplatSource>& sources, int channels, const SplatTarget& target, float scale, bool normalised,
           SplatImages out, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
    float shares[256];
    for (int colour = 0; colour < 256; ++colour) shares[colour] = float(colour) / 255.0f;
    for (SplatSource& source : sources) source.shares = shares;
    std::vector<Projector> projectors;
    for (const SplatSource& source : sources) projectors.push_back(make_projector(source, target, scale));
    const Grid grid{(target.camera.width + kTileWidth - 1) / kTileWidth, (target.camera.height + kTileHeight - 1) / kTileHeight};
    std::vector<Band> bands = make_bands(sources);
    parallel_for(int(bands.size()), threads,
                 [&](int n, int) { fill_band(bands[n], sources[bands[n].source], projectors[bands[n].source], grid, kernels); });
    const TileJob job{sources, projectors, bands, target, channels, normalised, grid, kernels, out};
    std::vector<Workspace> workspaces(std::max(1, threads));
    parallel_for(grid.across * grid.down, threads, [&](int tile, int worker) { job.run(tile, workspaces[worker]); });
}

}  // namespace ggvs
