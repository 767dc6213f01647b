// The refiner's tiles. A tile keeps its window of the inputs and three rows of what goes into each convolution: about 300 kB,
// whatever the size of the picture. The arithmetic stands in refine_simd.hpp.
#include "refine.hpp"

#include <algorithm>

#include "kernels.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

// With a column on both sides, which the second convolution needs, a tile is 9 packets of 16 across.
constexpr int kTileColumns = 142, kTileRows = 64;
constexpr int kLookMargin = 1, kValueMargin = 2, kWindowMargin = 4;
constexpr int64_t kStride = 208;  // of all lines: the widest window, and what the last packets read and write beyond it

int clamped(int n, int size) { return std::min(std::max(n, 0), size - 1); }

// Columns left - margin .. right + margin - 1 of a line that exist repeat the picture's first and last one beyond its border.
void repeat_border(float* line, int left, int right, int margin, int width) {
    const int first = std::max(left - margin, 0) - (left - margin);
    const int last = std::min(right + margin, width) - 1 - (left - margin);
    std::fill(line, line + first, line[first]);
    std::fill(line + last + 1, line + right - left + 2 * margin, line[last]);
}

// What all tiles share.
struct Shared {
    const Refinement& job;
    const Kernels& kernels;
    FinePixels across, down;
    float* out;
};

class TileRefiner {
public:
    TileRefiner(const Shared& shared, int left, int top)
        : shared_(shared), job_(shared.job), left_(left), top_(top), right_(std::min(left + kTileColumns, job_.width)),
          bottom_(std::min(top + kTileRows, job_.height)), columns_(right_ - left_),
          window_rows_(bottom_ - top_ + 2 * kWindowMargin), inputs_(job_.features + kEvidence),
          value_left_(std::max(left - kValueMargin, 0)),
          value_right_(std::min(right_ + kValueMargin, job_.width)),
          features_(job_.small, shared.across, shared.down, job_.first_feature, job_.features, value_left_,
                    value_right_ - value_left_),
          window_(kPlanes * window_rows_ * kStride), values_(3 * inputs_ * kStride), looked_(3 * job_.looks[0].padded * kStride),
          last_(job_.looks[1].padded * kStride), taps_(job_.taps.padded * kStride), scratch_(8 * kStride) {}

    void run() {
        copy_window();
        int value = std::max(top_ - kValueMargin, 0), look = std::max(top_ - kLookMargin, 0);  // the next rows to be made
        for (int y = top_; y < bottom_; ++y) {
            for (; look <= std::min(y + 1, job_.height - 1); ++look) {
                for (; value <= std::min(look + 1, job_.height - 1); ++value) make_values(value);
                make_looked(look);
            }
            finish(y);
        }
    }

private:
    enum Plane { kLogarithm, kKnown, kRed, kGreen, kBlue, kGrey, kPlanes };

    // Row y of the window, from column left - kWindowMargin on.
    float* window(int plane, int y) { return window_.data() + (plane * window_rows_ + y - top_ + kWindowMargin) * kStride; }
    float* values(int y) { return values_.data() + (clamped(y, job_.height) % 3) * inputs_ * kStride; }
    float* looked(int y) { return looked_.data() + (clamped(y, job_.height) % 3) * job_.looks[0].padded * kStride; }

    void copy_window() {
        const int first = std::max(left_ - kWindowMargin, 0), count = std::min(right_ + kWindowMargin, job_.width) - first;
        const int at = first - (left_ - kWindowMargin);
        const int64_t pixels = int64_t(job_.width) * job_.height;
        for (int y = top_ - kWindowMargin; y < bottom_ + kWindowMargin; ++y) {
            const int64_t from = int64_t(clamped(y, job_.height)) * job_.width + first;
            std::copy_n(job_.logarithm + from, count, window(kLogarithm, y) + at);
            for (int c = 0; c < 3; ++c) std::copy_n(job_.picture + c * pixels + from, count, window(kRed + c, y) + at);
            for (int plane : {kLogarithm, kRed, kGreen, kBlue})
                repeat_border(window(plane, y), left_, right_, kWindowMargin, job_.width);
            if (y >= 0 && y < job_.height)  // beyond the border nothing is known
                std::transform(job_.depth + from, job_.depth + from + count, window(kKnown, y) + at,
                               [](float depth) { return depth > 0.0f ? 1.0f : 0.0f; });
            const float *red = window(kRed, y), *green = window(kGreen, y), *blue = window(kBlue, y);
            float* grey = window(kGrey, y);
            for (int x = 0; x < columns_ + 2 * kWindowMargin; ++x) grey[x] = (red[x] + green[x] + blue[x]) * (1.0f / 3.0f);
        }
    }

    // Evidence and features of row y, from column left - kValueMargin on.
    void make_values(int y) {
        float* out = values(y);
        const int at = value_left_ - (left_ - kValueMargin), count = value_right_ - value_left_;
        const int64_t from = int64_t(y) * job_.width + value_left_;
        for (int x = 0; x < count; ++x) {
            out[at + x] = std::min(10.0f * job_.spread[from + x], 1.0f);
            out[kStride + at + x] = std::min(job_.shown[from + x] / 3.0f, 1.0f);
        }
        EvidenceRow row{{}, {}, {}, columns_ + 2 * kValueMargin, scratch_.data(), out + 2 * kStride, kStride};
        for (int n = 0; n < 5; ++n) row.logarithms[n] = window(kLogarithm, y + n - 2), row.known[n] = window(kKnown, y + n - 2);
        for (int n = 0; n < 3; ++n) row.grey[n] = window(kGrey, y + n - 1);
        shared_.kernels.evidence_row(row);
        features_.write(y, out + kEvidence * kStride + at, kStride);
        for (int channel = 0; channel < inputs_; ++channel)
            repeat_border(out + channel * kStride, left_, right_, kValueMargin, job_.width);
    }

    // Row y of the first convolution, from column left - kLookMargin on.
    void make_looked(int y) {
        float* out = looked(y);
        const int count = columns_ + 2 * kLookMargin;
        shared_.kernels.look_row({job_.looks[0], {values(y - 1), values(y), values(y + 1)}, out, count, kStride});
        for (int channel = 0; channel < job_.looks[0].after; ++channel)
            repeat_border(out + channel * kStride, left_, right_, kLookMargin, job_.width);
    }

    void finish(int y) {
        shared_.kernels.look_row({job_.looks[1], {looked(y - 1), looked(y), looked(y + 1)}, last_.data(), columns_, kStride});
        shared_.kernels.taps_row({job_.taps, {last_.data()}, taps_.data(), columns_, kStride});
        FilteredRow row{taps_.data(), {}, columns_, kStride, shared_.out + 3 * (int64_t(y) * job_.width + left_)};
        for (int c = 0; c < 3; ++c) row.picture[c] = window(kRed + c, y) + kWindowMargin;
        shared_.kernels.filter_row(row);
    }

    const Shared& shared_;
    const Refinement& job_;
    const int left_, top_, right_, bottom_, columns_, window_rows_, inputs_, value_left_, value_right_;
    EnlargedRows features_;
    std::vector<float> window_, values_, looked_, last_, taps_, scratch_;
};

}  // namespace

void refine(const Refinement& job, float* out, int threads, int level) {
    const Shared shared{job, kernels_of(level), FinePixels(job.width, job.small.width, job.small.scale),
                        FinePixels(job.height, job.small.height, job.small.scale), out};
    const int across = (job.width + kTileColumns - 1) / kTileColumns, down = (job.height + kTileRows - 1) / kTileRows;
    parallel_for(across * down, threads, [&](int tile, int) {
        TileRefiner(shared, tile % across * kTileColumns, tile / across * kTileRows).run();
    });
}

}  // namespace ggvs
