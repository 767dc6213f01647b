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
    std::vector<int32_t> columns, rows, depths, lists;
    std::vector<uint64_t> keys, swap;  // depth bits, from the least on, << 32 | position in the list
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

    size_t collect(int tile, int left, int top, Workspace& work) const {
        size_t count = 0;
        for (const Band& band : bands)
            for (uint32_t n = band.starts[tile]; n < band.starts[tile + 1]; ++n) count += band.runs[n].count;
        const size_t room = count + kLanes;  // for whole vectors
        work.list.resize(room);
        for (std::vector<int32_t>* words : {&work.columns, &work.rows, &work.depths}) words->resize(room);
        work.pixels.resize(count);
        uint32_t* const pixels = work.pixels.data();
        size_t filled = 0;
        for (const Band& band : bands) {
            const size_t begin = filled;
            for (uint32_t n = band.starts[tile]; n < band.starts[tile + 1]; ++n)
                for (uint32_t pixel = 0; pixel < band.runs[n].count; ++pixel) pixels[filled++] = band.runs[n].first + pixel;
            if (filled == begin) continue;
            kernels.ellipses(projectors[band.source], sources[band.source], channels, pixels + begin, int(filled - begin), left, top,
                             {work.list.data() + begin, work.columns.data() + begin, work.rows.data() + begin,
                              work.depths.data() + begin});
        }
        work.list[count] = {0.0f, 0.0f, 2.0f, 0.0f, 0.0f, 0.0f, {}};  // touches no pixel
        return count;
    }

    void run(int tile, Workspace& work) const {
        const int left = tile % grid.across * kTile, top = tile / grid.across * kTile;
        const size_t count = collect(tile, left, top, work), room = count + 2 * kLanes;
        sort_by_depth(work.depths, count, work.keys, work.swap);
        SplatTile sorted{work.list.data(), int32_t(count), left, top, {}};
        work.lists.resize(std::size(sorted.lists) * 3 * room);
        int32_t* words = work.lists.data();
        for (TileList& list : sorted.lists)
            for (int32_t*& word : list.words) word = words, words += room;
        sorted.lists[0].count = int(count);
        for (size_t n = 0; n < count; ++n) {
            const uint32_t gaussian = uint32_t(work.keys[n]);
            sorted.lists[0].words[kGaussians][n] = int32_t(gaussian);
            sorted.lists[0].words[kRows][n] = work.rows[gaussian];
            sorted.lists[0].words[kColumns][n] = work.columns[gaussian];
        }
        std::fill_n(sorted.lists[0].words[kColumns] + count, kLanes, 0);
        kernels.splat_tile(sorted, channels, {target.camera.width, target.camera.height, normalised, out});
    }
};

}  // namespace

void splat(std::vector<SplatSource>& sources, int channels, const SplatTarget& target, float scale, bool normalised,
           SplatImages out, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
    std::vector<Projector> projectors;
    for (const SplatSource& source : sources) projectors.push_back(make_projector(source, target, scale));
    const Grid grid{(target.camera.width + kTile - 1) / kTile, (target.camera.height + kTile - 1) / kTile};
    std::vector<Band> bands = make_bands(sources);
    parallel_for(int(bands.size()), threads,
                 [&](int n, int) { fill_band(bands[n], sources[bands[n].source], projectors[bands[n].source], grid, kernels); });
    const TileJob job{sources, projectors, bands, target, channels, normalised, grid, kernels, out};
    std::vector<Workspace> workspaces(std::max(1, threads));
    parallel_for(grid.across * grid.down, threads, [&](int tile, int worker) { job.run(tile, workspaces[worker]); });
}

}  // namespace ggvs
