// The order of the features' layers, their memory and their filters. Work is cut by tiles, whatever the number of threads.
#include "feature_maps.hpp"

#include <algorithm>

#include "feature_levels.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

// A filter's 36 weights.
std::array<double, kTileSums> tile_weights(const float* filter) {
    std::array<double, kTileSource> across[3];
    for (int y = 0; y < 3; ++y) across[y] = sum_weights(filter[3 * y], filter[3 * y + 1], filter[3 * y + 2]);
    std::array<double, kTileSums> weights;
    for (int x = 0; x < kTileSource; ++x) {
        const auto down = sum_weights(across[0][x], across[1][x], across[2][x]);
        for (int y = 0; y < kTileSource; ++y) weights[y * kTileSource + x] = down[y];
    }
    return weights;
}

// Calls act(n, map) for the frame and for what layer n - 1 hands on, which lie in two memories by turns.
template <class Act>
void for_maps(const FeatureJob& job, const std::array<float*, 2>& memory, const Act& act) {
    int height = job.height, width = job.width, channels = job.channels;
    for (size_t n = 0; n <= job.layers.size(); ++n) {
        if (n > 0) channels = job.layers[n - 1].after;
        if (n > 0 && job.taps[n - 1]) height /= 2, width /= 2;
        act(n, PaddedMap(height, width, channels, memory[n % 2]));
    }
}

class Runner {
public:
    Runner(int threads, int level) : threads_(threads), kernels_(feature_kernels(level)), memory_(threads) {}

    void filter_colours(const FeatureLayer& layer, const PaddedMap& from, const MapOut& out) {  // the first rows of from
        const Block block(layer, kRowsMultiple);
        reserve(block);
        parallel_for(out.height, threads_, [&](int y, int worker) {
            for (int x = 0; x < out.width; x += block.rows)
                kernels_.filter_colours(
                    {layer, from, out, block, y, x, std::min(block.rows, out.width - x), memory_[worker].data()});
        });
    }

    // As many rows of from as out has.
    void filter(const FeatureLayer& layer, const PaddedMap& from, const MapOut& out, const MapOut& halved) {
        const int tiles = (out.height + kTile - 1) / kTile * from.tile_columns;
        // The more weights, the more tiles share them on their way through the cache; but a small map is shared by all threads.
        const int most = layer.before + layer.after < kManyChannels ? kRowsMultiple : kMostMultiples * kRowsMultiple;
        const int count = std::clamp((tiles + threads_ - 1) / threads_, 1, most);
        const Block block(layer, (count + kRowsMultiple - 1) / kRowsMultiple * kRowsMultiple);
        reserve(block);
        parallel_for((tiles + count - 1) / count, threads_, [&](int n, int worker) {
            const int first = n * count;
            kernels_.filter_tiles(
                {layer, from, out, halved, block, first, std::min(count, tiles - first), memory_[worker].data()});
        });
    }

private:
    static constexpr int kManyChannels = 384, kMostMultiples = 4;

    void reserve(const Block& block) {
        for (auto& each : memory_)
            if (int64_t(each.size()) < block.memory()) each.resize(block.memory());
    }

    int threads_;
    const FeatureKernels& kernels_;
    std::vector<AlignedFloats> memory_;
};

constexpr int kBand = 32;  // rows of a frame that enter at once, whole tiles also after two halvings

// The rows of a map that the next layer still has to filter, with the one before them; whole tiles of them leave.
class Window {
public:
    // most: rows that are added at once.
    Window(int height, int width, int channels, int most)
        : height_(height), most_(most + kTile), rows_(std::min(most_, height), width, channels) {}

    int64_t floats() const { return rows_.floats(); }
    int most() const { return most_; }

    void begin(float* zeros) { rows_.corner = zeros; }

    const PaddedMap& rows() const { return rows_; }
    // Place of `count` more rows.
    MapOut next(int count) const { return {rows_.pixel(end_ - begin_, 0), rows_.row, count, rows_.width}; }
    int begun() const { return begin_; }
    int left() const { return height_ - end_; }

    // Rows that can be filtered: of tiles that have all their sources.
    int ready() const {
        const int here = end_ - begin_;
        return end_ == height_ ? here : std::max(0, (here - 1) / kTile * kTile);
    }

    void add(int count) {
        end_ += count;
        if (end_ == height_) std::fill(rows_.pixel(end_ - begin_, -1), rows_.corner + floats(), 0.0f);
    }

    void drop(int count) {
        const float* kept = rows_.pixel(count - 1, -1);
        std::copy(kept, const_cast<const float*>(rows_.pixel(end_ - begin_, -1)), rows_.corner);
        begin_ += count;
    }

private:
    int height_, most_, begin_ = 0, end_ = 0;  // rows begin_ to end_ are here, and the one before them
    PaddedMap rows_;
};

// What a frame's maps are on their way through all layers: a window before each of them.
std::vector<Window> windows_of(const BandedJob& job) {
    std::vector<Window> windows;
    int height = job.height, width = job.width, most = kBand;
    for (size_t n = 0; n < job.layers.size(); ++n) {
        windows.emplace_back(height, width, job.layers[n].before, most);
        most = windows.back().most();
        if (job.weights[n]) height /= 2, width /= 2, most /= 2;
    }
    return windows;
}

}  // namespace

PaddedMap::PaddedMap(int height, int width, int channels, float* memory)
    : height(height), width(width), channels(channels), tile_rows((height + kTile - 1) / kTile),
      tile_columns((width + kTile - 1) / kTile), row(int64_t(tile_columns * kTile + 2) * channels), corner(memory) {}

void PaddedMap::clear_border() const {
    std::fill_n(corner, row, 0.0f);
    for (int y = 0; y < height; ++y) {
        std::fill_n(pixel(y, -1), channels, 0.0f);
        std::fill(pixel(y, width), corner + (y + 2) * row, 0.0f);
    }
    std::fill(corner + (height + 1) * row, corner + floats(), 0.0f);
}

int64_t packed_size(int after, int before) { return int64_t(after) * (before == kColours ? kColourTaps : kTileSums * before); }

void pack_weights(const float* filters, int after, int before, float* out, int threads) {
    const int64_t part = int64_t(after) * before;
    parallel_for(after / kPanel, threads, [&](int panel, int) {
        for (int c = 0; c < before; ++c)
            for (int lane = 0; lane < kPanel; ++lane) {
                const float* filter = filters + ((int64_t(panel) * kPanel + lane) * before + c) * 9;
                if (before == kColours) {
                    for (int tap = 0; tap < 9; ++tap) out[(panel * kColourTaps + tap * kColours + c) * kPanel + lane] = filter[tap];
                    continue;
                }
                const auto weights = tile_weights(filter);
                for (int n = 0; n < kTileSums; ++n) out[n * part + (int64_t(panel) * before + c) * kPanel + lane] = float(weights[n]);
            }
    });
}

std::array<int64_t, 2> feature_memory(const FeatureJob& job) {
    std::array<int64_t, 2> most{};
    for_maps(job, {}, [&](size_t n, const PaddedMap& map) { most[n % 2] = std::max(most[n % 2], map.floats()); });
    return most;
}

void compare_features(const ComparedPixels& all, int threads, int level) {
    constexpr int kPixels = 4096;
    const FeatureKernels& kernels = feature_kernels(level);
    parallel_for((all.count + kPixels - 1) / kPixels, threads, [&](int n, int) {
        const int first = n * kPixels;
        const int64_t at = int64_t(first) * all.channels;
        kernels.compare_pixels({all.ours + at, all.theirs + at, all.weights, std::min(kPixels, all.count - first), all.channels,
                                all.out + first});
    });
}

void compare_banded(const BandedJob& job, int threads, int level) {
    Runner runner(threads, level);
    std::vector<std::vector<Window>> windows(job.frames.size(), windows_of(job));
    int64_t row_floats = 0, tap_floats = 0;
    for (size_t n = 0; n < job.layers.size(); ++n) {
        const Window& window = windows[0][n];
        row_floats += window.floats();
        if (job.weights[n]) tap_floats = std::max(tap_floats, int64_t(window.most()) * window.rows().width * job.layers[n].after);
    }
    AlignedFloats memory(int64_t(job.frames.size()) * row_floats), taps(2 * tap_floats);
    float* rows = memory.data();
    for (auto& of_frame : windows)
        for (Window& window : of_frame) window.begin(rows), rows += window.floats();
    const int64_t line = int64_t(job.width) * kColours;
    while (const int more = std::min(kBand, windows[0][0].left())) {
        for (size_t f = 0; f < job.frames.size(); ++f) {
            Window& colours = windows[f][0];
            const MapOut to = colours.next(more);
            for (int y = 0; y < more; ++y) std::copy_n(job.frames[f] + (job.height - colours.left() + y) * line, line, to.data + y * to.row);
            colours.add(more);
        }
        for (size_t n = 0; n < job.layers.size(); ++n) {
            const FeatureLayer& layer = job.layers[n];
            const int count = windows[0][n].ready(), first = windows[0][n].begun(), width = windows[0][n].rows().width;
            for (size_t f = 0; count > 0 && f < job.frames.size(); ++f) {
                Window& from = windows[f][n];
                const bool is_last = n + 1 == job.layers.size();
                const int64_t halved_row = int64_t(width / 2) * layer.after;
                const MapOut next = is_last ? MapOut{job.halved[f] + first / 2 * halved_row, halved_row, count / 2, width / 2}
                                            : windows[f][n + 1].next(job.weights[n] ? count / 2 : count);
                if (layer.before == kColours) {
                    runner.filter_colours(layer, from.rows(), next);
                } else if (!job.weights[n]) {
                    runner.filter(layer, from.rows(), next, MapOut{});
                } else {
                    float* tap = taps.data() + (f > 0) * tap_floats;
                    runner.filter(layer, from.rows(), {tap, int64_t(width) * layer.after, count, width}, next);
                    if (f > 0)
                        compare_features({tap, taps.data(), job.weights[n], count * width, layer.after,
                                          job.distances[n][f - 1] + int64_t(first) * width}, threads, level);
                }
                if (!is_last) windows[f][n + 1].add(next.height);
                from.drop(count);
            }
        }
    }
}

void feature_maps(const FeatureJob& job, const std::array<float*, 2>& memory, int threads, int level) {
    Runner runner(threads, level);
    PaddedMap from(0, 0, 0);
    for_maps(job, memory, [&](size_t n, const PaddedMap& map) {
        map.clear_border();
        if (n == 0) {
            const int64_t line = int64_t(map.width) * map.channels;
            for (int y = 0; y < map.height; ++y) std::copy_n(job.frame + y * line, line, map.pixel(y, 0));
        } else {
            const FeatureLayer& layer = job.layers[n - 1];
            const MapOut next{map.pixel(0, 0), map.row, map.height, map.width};
            const MapOut tap{job.taps[n - 1], int64_t(from.width) * layer.after, from.height, from.width};
            if (layer.before == kColours) {
                runner.filter_colours(layer, from, next);
            } else {
                runner.filter(layer, from, tap.data ? tap : next, tap.data ? next : MapOut{});
            }
        }
        from = map;
    });
}

}  // namespace ggvs
