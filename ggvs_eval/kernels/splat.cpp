// Forward rendering of pixel-sized Gaussians (paper 3.1; 3D Gaussian splatting's forward pass) on the CPU.
//
// Source rows are projected in bands and their Gaussians listed per target tile; then each tile projects its Gaussians again
// (cheaper than keeping them), sorts them by depth and shares them out to smaller and smaller parts, at last to its blocks, which
// blend front to back with all sums in registers. Lists follow the order (source, row, column) whatever the number of threads, and
// the sort is stable: so are the results.
#include "splat.hpp"

#include <algorithm>
#include <cstdint>
#include <memory>
#include <numeric>
#include <utility>

#include "kernels.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kBandRows = 8, kListsOfTile = 4 * 4;

// Those of 16 pixels side by side in a row that one tile gets.
struct Run {
    uint32_t tile, first, lanes;  // the first of the 16 as row << 16 | column; a bit for each of them
};

struct Band {
    int source, first_row, rows;
    std::vector<Run> runs;         // sorted by tile: a tenth of the memory that their pixels would take
    std::vector<uint32_t> starts;  // per tile, where its runs start; one more at the end
};

struct Grid {
    int across, down;
};

// Memory that grows and is never set to zero, which would take its time: pages that no list reaches are not even fetched.
template <class T>
class Room {
public:
    T* of(size_t count) {
        if (count > size_) data_.reset(new T[size_ = count + count / 4]);
        return data_.get();
    }

private:
    std::unique_ptr<T[]> data_;
    size_t size_ = 0;
};

// Workspace of one thread, kept from tile to tile.
struct Workspace {
    Room<uint32_t> pixels;
    Room<Ellipse> list;
    Room<int32_t> columns, rows, depths, numbers, words;
    DepthRange depth_range;
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
    kernels.tile_ranges(projector, depth, column, row, count, &ranges);
    const int x0 = *std::min_element(ranges.x0, ranges.x0 + kLanes), x1 = *std::max_element(ranges.x1, ranges.x1 + kLanes);
    const int y0 = *std::min_element(ranges.y0, ranges.y0 + kLanes), y1 = *std::max_element(ranges.y1, ranges.y1 + kLanes);
    for (int y = y0; y <= y1; ++y)
        for (int x = x0; x <= x1; ++x)
            if (const uint32_t lanes = kernels.lanes_in_tile(ranges, x, y))
                runs.push_back({uint32_t(y * grid.across + x), uint32_t(row) << 16 | uint32_t(column), lanes});
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

// A tile's Gaussians front to back, and behind them room for two vectors: a stable least-significant-digit radix sort by the bits of
// their depths, which sort like positive floats themselves. Two digits are enough for most tiles. Each is counted in the order that
// the one before made: neighbours in the source have much the same depth, and would wait for each other's counter.
int32_t* sorted_by_depth(Workspace& work, size_t count) {
    constexpr int kMostBits = 12;
    const int32_t* depths = work.depths.of(count);
    const int32_t least = work.depth_range.least;
    int differing = 1;  // bits
    while (count > 0 && (work.depth_range.most - least) >> differing > 0) ++differing;
    const int digits = (differing + kMostBits - 1) / kMostBits, bits = (differing + digits - 1) / digits;
    const size_t room = count + 2 * kLanes;
    int32_t *from = work.numbers.of(2 * room), *to = from + room;
    std::iota(from, from + count, 0);
    for (int shift = 0; shift < digits * bits; shift += bits, std::swap(from, to)) {
        const auto digit = [&](int32_t gaussian) { return uint32_t(depths[gaussian] - least) >> shift & ((1u << bits) - 1); };
        uint32_t places[1 << kMostBits], sum = 0;
        std::fill_n(places, 1 << bits, 0);
        for (size_t n = 0; n < count; ++n) ++places[digit(from[n])];
        for (int value = 0; value < 1 << bits; ++value) sum += std::exchange(places[value], sum);
        for (size_t n = 0; n < count; ++n) to[places[digit(from[n])]++] = from[n];
    }
    return from;
}

// All that happens in one tile.
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

    // Ellipses of all that may touch the tile, and behind them of one that touches nothing; how many there are before it.
    size_t collect(int tile, int left, int top, Workspace& work) const {
        size_t runs = 0;
        for (const Band& band : bands) runs += band.starts[tile + 1] - band.starts[tile];
        const size_t room = (runs + 1) * kLanes;  // for whole vectors
        uint32_t* const pixels = work.pixels.of(room);
        Ellipse* const list = work.list.of(room);
        int32_t *const columns = work.columns.of(room), *const rows = work.rows.of(room), *const depths = work.depths.of(room);
        size_t count = 0;
        work.depth_range = {};
        for (const Band& band : bands) {
            const size_t begin = count;
            for (uint32_t n = band.starts[tile]; n < band.starts[tile + 1]; ++n) {
                const Run& run = band.runs[n];
                for (uint32_t lane = 0; lane < kLanes; ++lane) pixels[count] = run.first + lane, count += run.lanes >> lane & 1;
            }
            if (count > begin)
                kernels.ellipses(projectors[band.source], sources[band.source], channels, pixels + begin, int(count - begin), left,
                                 top, {list + begin, columns + begin, rows + begin, depths + begin, &work.depth_range});
        }
        list[count] = {0.0f, 0.0f, 2.0f, 0.0f, 0.0f, 0.0f, {}};  // far outside of the unit circle
        columns[count] = rows[count] = 0;
        return count;
    }

    void run(int tile, Workspace& work) const {
        const int left = tile % grid.across * kTile, top = tile / grid.across * kTile;
        const size_t count = collect(tile, left, top, work), room = count + 2 * kLanes;
        int32_t* const sorted = sorted_by_depth(work, count);
        std::fill_n(sorted + count, kLanes, int32_t(count));
        SplatTile parts{work.list.of(count), work.rows.of(count), work.columns.of(count), sorted, int32_t(count), left, top, {}, {},
                        {}, {}};
        int32_t* words = work.words.of(size_t(kListsOfTile) * 3 * room);
        const auto make_room = [&](TileList& list) {
            for (int32_t*& word : list.words) word = words, words += room;
        };
        for (auto* lists : {&parts.strips, &parts.cells, &parts.columns, &parts.blocks})
            for (TileList& list : *lists) make_room(list);
        kernels.splat_tile(parts, channels, {target.camera.width, target.camera.height, normalised, out});
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
