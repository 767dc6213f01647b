// The temporal depth filter (Eqs. 1-2): plain loops, which any compiler vectorises.
#include "filter.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "area.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kBandCells = 8;
constexpr int64_t kChunk = 16384;  // pixels

// Weighted sum of some rows' differences. Cells average differences rather than images: the order does not matter, and the
// differences of whole rows are summed as integers.
class RowSum {
public:
    explicit RowSum(int values) : whole_(values), sum_(values) {}

    const float* over(const ImagePair& pair, Cell rows) {
        const float most = *std::max_element(rows.shares, rows.shares + (rows.last - rows.first));
        std::fill(whole_.begin(), whole_.end(), 0);
        std::fill(sum_.begin(), sum_.end(), 0.0f);
        for (int y = rows.first; y < rows.last; ++y) {
            const float share = rows.shares[y - rows.first];
            const int64_t row = int64_t(y) * int64_t(whole_.size());
            share == most ? add_whole(pair.now + row, pair.before + row) : add(pair.now + row, pair.before + row, share);
        }
        for (size_t n = 0; n < sum_.size(); ++n) sum_[n] += most * float(whole_[n]);
        return sum_.data();
    }

private:
    void add_whole(const uint8_t* now, const uint8_t* before) {
        int16_t* whole = whole_.data();
        for (size_t n = 0; n < whole_.size(); ++n) whole[n] = int16_t(whole[n] + now[n] - before[n]);
    }

    void add(const uint8_t* now, const uint8_t* before, float share) {
        float* sum = sum_.data();
        for (size_t n = 0; n < sum_.size(); ++n) sum[n] += share * float(int16_t(now[n] - before[n]));
    }

    std::vector<int16_t> whole_;  // up to 128 rows
    std::vector<float> sum_;
};

void note_change(const float* line, Cell columns, float* cell) {
    float sum[3] = {};
    for (int x = columns.first; x < columns.last; ++x)
        for (int c = 0; c < 3; ++c) sum[c] += columns.shares[x - columns.first] * line[3 * x + c];
    for (int c = 0; c < 3; ++c) cell[c] = sum[c] / 255.0f;
}

}  // namespace

void colour_change(const ImagePair& pair, float* out, int threads) {
    const AreaCells across(pair.width, pair.cells_across), down(pair.height, pair.cells_down);
    parallel_for((pair.cells_down + kBandCells - 1) / kBandCells, threads, [&](int band, int) {
        RowSum rows(3 * pair.width);
        for (int y = band * kBandCells; y < std::min((band + 1) * kBandCells, pair.cells_down); ++y) {
            const float* line = rows.over(pair, down[y]);
            float* row = out + int64_t(y) * pair.cells_across * 3;
            for (int x = 0; x < pair.cells_across; ++x) note_change(line, across[x], row + 3 * x);
        }
    });
}

void mix_depth(const DepthPair& pair, float* out, int threads) {
    parallel_for(int((pair.count + kChunk - 1) / kChunk), threads, [&](int chunk, int) {
        const float tolerance = pair.tolerance;
        for (int64_t n = chunk * kChunk; n < std::min((chunk + 1) * kChunk, pair.count); ++n) {
            const float depth = pair.depth[n], history = pair.history[n], mask = pair.mask[n];
            const bool same = std::fabs(depth - history) <= tolerance * depth;
            const float mean = mask * depth + (1.0f - mask) * history;
            const float known = (same & (history > 0.0f)) ? mean : depth;
            const float kept = (depth <= 0.0f) & (mask < 1.0f) ? history : 0.0f;
            out[n] = depth > 0.0f ? known : kept;
        }
    });
}

}  // namespace ggvs
