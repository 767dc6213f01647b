// Holes filled from ever coarser averages of what is known (push-pull).
#include "push_pull.hpp"

#include <algorithm>
#include <cstring>
#include <memory>
#include <vector>

#include "area.hpp"
#include "crew.hpp"
#include "enlarge.hpp"

namespace ggvs {
namespace {

constexpr int kBandRows = 16;

// One level of the pyramid; K is uint8_t at the bottom, where pixels are known or not, and float above: how far they are.
template <class K>
struct Level {
    const float* colour;
    const K* known;
    int width, height;
};

template <class Job>
void for_rows(int height, Crew& crew, const Job& job) {
    crew.run((height + kBandRows - 1) / kBandRows, [&](int band, int) {
        for (int y = band * kBandRows; y < std::min((band + 1) * kBandRows, height); ++y) job(y);
    });
}

template <class K>
bool all_known(const Level<K>& level) {
    return std::all_of(level.known, level.known + int64_t(level.width) * level.height, [](K known) { return known > K(0); });
}

// Mean of what is known in the cell, and four times its share: one known pixel of four is enough.
template <class K>
void average(const Level<K>& level, Cell columns, Cell rows, float* colour, float* known) {
    float sum[3] = {}, weight = 0.0f;
    for (int y = rows.first; y < rows.last; ++y) {
        for (int x = columns.first; x < columns.last; ++x) {
            const int64_t pixel = int64_t(y) * level.width + x;
            if (!(level.known[pixel] > K(0))) continue;
            const float share = rows.shares[y - rows.first] * columns.shares[x - columns.first] * float(level.known[pixel]);
            weight += share;
            for (int c = 0; c < 3; ++c) sum[c] += share * level.colour[3 * pixel + c];
        }
    }
    for (int c = 0; c < 3; ++c) colour[c] = sum[c] / std::max(weight, 1e-6f);
    *known = std::min(4.0f * weight, 1.0f);
}

// A row of cells of exactly two by two pixels, most of which are known whole; the same sums as `average`.
template <class K>
void average_pairs(const Level<K>& level, const AreaCells& columns, const AreaCells& rows, int y, int width, float* colour,
                   float* known) {
    const K *above = level.known + int64_t(2) * y * level.width, *below = above + level.width;
    const float *upper = level.colour + int64_t(6) * y * level.width, *lower = upper + 3 * level.width;
    for (int x = 0; x < width; ++x) {
        const int left = 2 * x;
        const bool whole = above[left] == K(1) && above[left + 1] == K(1) && below[left] == K(1) && below[left + 1] == K(1);
        if (!whole || x + 1 == width) {  // colours are read with one value more, which the last pixel may not have
            average(level, columns[x], rows[y], colour + 3 * x, known + x);
            continue;
        }
        const float *first = upper + 3 * left, *second = lower + 3 * left;
        const Four sum = 0.25f * four_of(first) + 0.25f * four_of(first + 3) + 0.25f * four_of(second) + 0.25f * four_of(second + 3);
        std::memcpy(colour + 3 * x, &sum, 3 * sizeof(float));
        known[x] = 1.0f;
    }
}

// Where the centres of fine pixels lie between those of coarse ones, the border repeated.
struct Between {
    std::vector<int> first, second;
    std::vector<float> share;  // of the second

    Between(int fine, int coarse) {
        for (int n = 0; n < fine; ++n) {
            const double at = std::clamp((n + 0.5) * coarse / fine - 0.5, 0.0, double(coarse - 1));
            first.push_back(int(at)), second.push_back(std::min(int(at) + 1, coarse - 1));
            share.push_back(float(at - int(at)));
        }
    }
};

// The row's unknown pixels take the interpolated coarse colour as far as they are unknown.
template <class K>
void pull_row(const Level<K>& level, int y, const Between& across, const Between& down, const float* coarse, int coarse_width,
              float* out) {
    const float* upper = coarse + int64_t(down.first[y]) * coarse_width * 3;
    const float* lower = coarse + int64_t(down.second[y]) * coarse_width * 3;
    const int64_t row = int64_t(y) * level.width;
    if (out != level.colour) std::memcpy(out + 3 * row, level.colour + 3 * row, sizeof(float) * 3 * level.width);
    for (int x = 0; x < level.width; ++x) {
        if (level.known[row + x] >= K(1)) continue;
        const int left = 3 * across.first[x], right = 3 * across.second[x];
        const float known = float(level.known[row + x]), fx = across.share[x], fy = down.share[y];
        for (int c = 0; c < 3; ++c) {
            const float above = upper[left + c] + fx * (upper[right + c] - upper[left + c]);
            const float below = lower[left + c] + fx * (lower[right + c] - lower[left + c]);
            const float filled = above + fy * (below - above);
            // What is unknown may hold anything, so that it must not even be multiplied by 0.
            out[3 * (row + x) + c] = known > 0.0f ? filled + known * (level.colour[3 * (row + x) + c] - filled) : filled;
        }
    }
}

template <class K>
void fill(const Level<K>& level, float* out, Crew& crew) {
    const int64_t pixels = int64_t(level.width) * level.height;
    if (std::min(level.width, level.height) < 2 || all_known(level)) {
        if (out != level.colour) std::memcpy(out, level.colour, sizeof(float) * 3 * pixels);
        return;
    }
    const int width = (level.width + 1) / 2, height = (level.height + 1) / 2;
    const auto map = [&](int channels) { return std::unique_ptr<float[]>(new float[size_t(width) * height * channels]); };
    const auto colour = map(3), known = map(1);  // every value is written: to clear them first would take as long
    const AreaCells columns(level.width, width), rows(level.height, height);
    const bool in_pairs = level.width == 2 * width && level.height == 2 * height;
    for_rows(height, crew, [&](int y) {
        const int64_t row = int64_t(y) * width;
        if (in_pairs) return average_pairs(level, columns, rows, y, width, colour.get() + 3 * row, known.get() + row);
        for (int x = 0; x < width; ++x)
            average(level, columns[x], rows[y], colour.get() + 3 * (row + x), known.get() + row + x);
    });
    fill(Level<float>{colour.get(), known.get(), width, height}, colour.get(), crew);
    const Between across(level.width, width), down(level.height, height);
    for_rows(level.height, crew, [&](int y) { pull_row(level, y, across, down, colour.get(), width, out); });
}

}  // namespace

void push_pull(const HoledImage& image, float* out, int threads) {
    Crew crew(threads);
    fill(Level<uint8_t>{image.colour, image.known, image.width, image.height}, out, crew);
}

}  // namespace ggvs
