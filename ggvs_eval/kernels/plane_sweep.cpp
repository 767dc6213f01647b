// The plane sweep's tiles, each computed by one thread.
#include "plane_sweep.hpp"

#include <algorithm>
#include <memory>

#include "parallel.hpp"
#include "stereo_levels.hpp"

namespace ggvs {
namespace {

std::vector<Tile> cut_into_tiles(const SweepTask& task, const int32_t* ranges) {
    std::vector<Tile> tiles;
    for (int row = 0; row < task.height; row += kTileRows) {
        for (int column = 0; column < task.width; column += kTileColumns) {
            const int32_t* range = ranges + 2 * tiles.size();
            tiles.push_back({row, column, std::min(kTileRows, task.height - row), std::min(kTileColumns, task.width - column),
                             std::max(range[0], 0), std::min(range[1], task.planes)});
        }
    }
    return tiles;
}

std::unique_ptr<SweepWorkspace> make_workspace(const SweepTask& task) {
    int widest = 0;
    for (const SweepPartner& partner : task.partners) widest = std::max(widest, partner.width);
    auto space = std::make_unique<SweepWorkspace>();
    space->blended.resize(widest + 32);
    return space;
}

}  // namespace

void sweep_planes(const SweepTask& task, const int32_t* ranges, uint8_t* costs, int threads, int level) {
    const std::vector<Tile> tiles = cut_into_tiles(task, ranges);
    const StereoKernels& kernels = stereo_kernels(level);
    std::vector<std::unique_ptr<SweepWorkspace>> spaces(std::max(threads, 1));  // each made by the thread that uses it
    parallel_for(int(tiles.size()), threads, [&](int t, int worker) {
        if (!spaces[worker]) spaces[worker] = make_workspace(task);
        kernels.sweep_tile(task, tiles[t], costs, *spaces[worker]);
    });
}

}  // namespace ggvs
