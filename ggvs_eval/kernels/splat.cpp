// Forward rendering of pixel-sized Gaussians (paper 3.1; 3D Gaussian splatting's forward pass) on the CPU.
//
// Source rows are projected in bands and their Gaussians listed per target tile; then each tile projects its Gaussians again
// (cheaper than keeping them), sorts them by depth and shares them out to its blocks, which blend front to back with all sums in
// registers. Lists follow the order (source, row, column) whatever the number of threads, and the sort is stable: so are the results.
#include "splat.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include "kernels.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kBandRows = 8;

// Pixels side by side in a row that one tile gets.
struct Run {
    uint32_t tile, first, count;  // the first one packed
};

struct Band {
    int source, first_row, rows;
    std::vector<Run> runs;         // sorted by tile: a tenth of the memory that their pixels would take
    std::vector<uint32_t> starts;  // per tile, where its runs start; one more at the end
};

struct Grid {
    int across, down;
};

// Workspace of one thread, kept from tile to tile.
struct Workspace {
    std::vector<uint32_t> pixels;
    std::vector<Ellipse> list;
    std::vector<BlockRange> ranges;
    std::vector<int32_t> depths;       // their bits
    std::vector<uint64_t> keys, swap;  // depth bits, from the least on, << 32 | position in the list
    std::vector<int32_t> counts;
    std::vector<uint32_t> starts, next, chosen;
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

// The tiles of up to 16 neighbouring pixels.
void list_runs(const Projector& projector, const float* depth, int column, int row, int count, Grid grid, const Kernels& kernels,
               std::vector<Run>& runs) {
    TileRanges ranges;
    const uint32_t first = uint32_t(row) << 16 | uint32_t(column);
    if (kernels.tile_ranges(projector, depth, column, row, count, &ranges)) {  // as is usual
        runs.push_back({uint32_t(ranges.y0[0] * grid.across + ranges.x0[0]), first, uint32_t(count)});
        return;
    }
    for (uint32_t lane = 0; lane < uint32_t(count); ++lane) {
        if (ranges.x0[lane] > ranges.x1[lane]) continue;
        for (int y = ranges.y0[lane]; y <= ranges.y1[lane]; ++y) {
            for (int x = ranges.x0[lane]; x <= ranges.x1[lane]; ++x) {
                const uint32_t tile = uint32_t(y * grid.across + x);
                if (!runs.empty() && runs.back().tile == tile && runs.back().first + runs.back().count == first + lane) {
                    ++runs.back().count;
                } else {
                    runs.push_back({tile, first + lane, 1});
                }
            }
        }
    }
}

// Lists the band's runs per tile: a counting sort, which keeps their order within a tile.
void fill_band(Band& band, const SplatSource& source, const Projector& projector, Grid grid, const Kernels& kernels) {
    const int width = source.camera.width;
    std::vector<Run> runs;
    runs.reserve(size_t(band.rows) * width / 4);
    for (int row = band.first_row; row < band.first_row + band.rows; ++row)
        for (int column = 0; column < width; column += kLanes)
            list_runs(projector, source.depth + int64_t(row) * width + column, column, row, std::min(kLanes, width - column), grid,
                      kernels, runs);
    band.starts.assign(grid.across * grid.down + 1, 0);
    for (const Run& run : runs) ++band.starts[run.tile + 1];
    for (size_t tile = 1; tile < band.starts.size(); ++tile) band.starts[tile] += band.starts[tile - 1];
    std::vector<uint32_t> next(band.starts.begin(), band.starts.end() - 1);
    band.runs.resize(runs.size());
    for (const Run& run : runs) band.runs[next[run.tile]++] = run;
}

// Numbers of the Gaussians in the lower halves of `keys`, front to back: a stable least-significant-digit radix sort by the bits of
// their depths, which sort like positive floats themselves; only the digits that differ within the tile are visited.
void sort_by_depth(const std::vector<int32_t>& depths, size_t count, std::vector<uint64_t>& keys, std::vector<uint64_t>& swap) {
    constexpr int kDigit = 11, kMost = 3;
    constexpr uint32_t kMask = (1 << kDigit) - 1;
    int32_t low = INT32_MAX, high = 0;
    for (size_t n = 0; n < count; ++n) low = std::min(low, depths[n]), high = std::max(high, depths[n]);
    int digits = 0;
    for (uint32_t rest = count == 0 ? 0 : uint32_t(high - low); rest > 0; rest >>= kDigit) ++digits;
    uint32_t starts[kMost][kMask + 1];
    std::memset(starts, 0, digits * sizeof starts[0]);
    keys.resize(count), swap.resize(count);
    for (size_t n = 0; n < count; ++n) {
        const uint32_t depth = uint32_t(depths[n] - low);
        keys[n] = uint64_t(depth) << 32 | n;
        for (int digit = 0; digit < digits; ++digit) ++starts[digit][depth >> (digit * kDigit) & kMask];
    }
    for (int digit = 0; digit < digits; ++digit) {
        uint32_t sum = 0;
        for (uint32_t& start : starts[digit]) sum += std::exchange(start, sum);
        for (const uint64_t key : keys) swap[starts[digit][key >> (32 + digit * kDigit) & kMask]++] = key;
        keys.swap(swap);
    }
}

// Lists the Gaussians of every block, front to back: counts first, then fills.
void share_out(Workspace& work, int down) {
    // A Gaussian adds 1 to a rectangle of counts: that is four changes, to be summed up along rows and columns.
    constexpr int kStride = kBlocksAcross + 1;
    work.counts.assign(kStride * (down + 1), 0);
    int32_t* counts = work.counts.data();
    for (const BlockRange range : work.ranges) {
        int32_t *above = counts + range.y0 * kStride, *below = counts + (range.y1 + 1) * kStride;
        ++above[range.x0], --above[range.x1 + 1], --below[range.x0], ++below[range.x1 + 1];
    }
    const int blocks = kBlocksAcross * down;
    work.starts.resize(blocks + 1), work.next.resize(blocks);
    uint32_t sum = 0;
    for (int y = 0; y < down; ++y) {
        int32_t *row = counts + y * kStride, along = 0;
        for (int x = 0; x < kBlocksAcross; ++x) {
            along += row[x];
            row[x] = along + (y ? row[x - kStride] : 0);
            work.starts[y * kBlocksAcross + x] = work.next[y * kBlocksAcross + x] = sum;
            sum += (row[x] + kTogether) / kTogether * kTogether;  // at least one place more than is counted
        }
    }
    work.starts[blocks] = sum;
    work.chosen.resize(sum);
    const BlockRange* ranges = work.ranges.data();
    uint32_t *chosen = work.chosen.data(), *next = work.next.data();
    for (const uint64_t key : work.keys) {
        const uint32_t gaussian = uint32_t(key);
        const BlockRange range = ranges[gaussian];
        // Two columns and two rows are usual, one is not rare: a place that does not count costs less than a wrong guess.
        const uint32_t wide = range.x1 > range.x0;
        for (int y = range.y0; y <= range.y1; y += 2) {
            const uint32_t tall = y < range.y1;
            uint32_t *above = next + y * kBlocksAcross, *below = above + tall * kBlocksAcross;
            chosen[above[range.x0]++] = gaussian;
            chosen[above[range.x1]] = gaussian, above[range.x1] += wide;
            chosen[below[range.x0]] = gaussian, below[range.x0] += tall;
            chosen[below[range.x1]] = gaussian, below[range.x1] += wide & tall;
            for (int x = range.x0 + 1; x < range.x1; ++x) {
                chosen[above[x]++] = gaussian;
                if (tall) chosen[below[x]++] = gaussian;
            }
        }
    }
    const uint32_t nothing = uint32_t(work.keys.size());  // touches no pixel
    for (int block = 0; block < blocks; ++block) std::fill(chosen + next[block], chosen + work.starts[block + 1], nothing);
}

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
        for (const Band& band : bands)
            for (uint32_t n = band.starts[tile]; n < band.starts[tile + 1]; ++n) count += band.runs[n].count;
        const size_t room = count + kLanes;  // for whole vectors
        work.list.resize(room), work.ranges.resize(room), work.depths.resize(room);
        work.pixels.resize(count);
        uint32_t* const pixels = work.pixels.data();
        size_t filled = 0;
        for (const Band& band : bands) {
            const size_t begin = filled;
            for (uint32_t n = band.starts[tile]; n < band.starts[tile + 1]; ++n)
                for (uint32_t pixel = 0; pixel < band.runs[n].count; ++pixel) pixels[filled++] = band.runs[n].first + pixel;
            if (filled == begin) continue;
            kernels.ellipses(projectors[band.source], sources[band.source], channels, pixels + begin, int(filled - begin), left, top,
                             {work.list.data() + begin, work.ranges.data() + begin, work.depths.data() + begin});
        }
        work.list[count] = {0.0f, 0.0f, 2.0f, 0.0f, 0.0f, 0.0f, {}};  // touches no pixel
        work.ranges.resize(count);
    }

    void run(int tile, Workspace& work) const {
        const int left = tile % grid.across * kTileWidth, top = tile / grid.across * kTileHeight;
        collect(tile, left, top, work);
        const size_t count = work.ranges.size();
        sort_by_depth(work.depths, count, work.keys, work.swap);
        share_out(work, kTileHeight / kernels.block_rows);
        const int64_t width = target.camera.width;
        const int rows = kernels.block_rows, right = std::min(left + kTileWidth, target.camera.width);
        for (int y = top; y < std::min(top + kTileHeight, target.camera.height); y += rows) {
            for (int x = left; x < right; x += kBlock) {
                const int block = (y - top) / rows * kBlocksAcross + (x - left) / kBlock;
                const int first = work.starts[block], listed = work.starts[block + 1] - first;
                kernels.splat_block({work.list.data(), work.chosen.data() + first, listed, x - left, y - top,
                                     std::min(kBlock, right - x), std::min(rows, target.camera.height - y), y * width + x, width},
                                    channels, normalised, out);
            }
        }
    }
};

}  // namespace

void splat(std::vector<SplatSource>& sources, int channels, const SplatTarget& target, float scale, bool normalised,
           SplatImages out, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
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
