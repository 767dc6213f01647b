// The refiner's tiles. A tile keeps its window of the inputs and eight rows of what goes into each convolution: about 600 kB,
// whatever the size of the picture. The arithmetic stands in refine_simd.hpp.
#include "refine.hpp"

#include <algorithm>

#include "aligned.hpp"
#include "kernels.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

// With a column on both sides, which the second convolution needs, a tile is 9 packets of 16 across.
constexpr int kTileColumns = 142, kTileRows = 64;
constexpr int kLookMargin = 1, kValueMargin = 2, kWindowMargin = 4;
constexpr int kKeptRows = 2 * kStripRows;  // of what goes into a convolution
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

// What a tile works in; the next one finds what it left.
struct Workspace {
    AlignedFloats window, values, looked, last, taps, evidence, strip;

    Workspace(const Refinement& job, int planes)
        : window(planes * (kTileRows + 2 * kWindowMargin) * kStride), values(kKeptRows * (job.features + kEvidence) * kStride),
          looked(kKeptRows * job.looks[0].padded * kStride), last(kStripRows * job.looks[1].padded * kStride),
          taps(job.taps.padded * kStride), evidence(8 * kStride),
          strip(kStripSources * std::max(job.looks[0].before, job.looks[1].before) * kStripLine) {}
};

class TileRefiner {
public:
    enum Plane { kLogarithm, kKnown, kRed, kGreen, kBlue, kGrey, kPlanes };

    TileRefiner(const Shared& shared, Workspace& workspace, int left, int top)
        : shared_(shared), job_(shared.job), work_(workspace), left_(left), top_(top),
          right_(std::min(left + kTileColumns, job_.width)), bottom_(std::min(top + kTileRows, job_.height)),
          columns_(right_ - left_), window_rows_(bottom_ - top_ + 2 * kWindowMargin), inputs_(job_.features + kEvidence),
          value_left_(std::max(left - kValueMargin, 0)), value_right_(std::min(right_ + kValueMargin, job_.width)),
          next_value_(std::max(top - kValueMargin, 0)),
          features_(job_.small, shared.across, shared.down, job_.first_feature, job_.features, value_left_,
                    value_right_ - value_left_) {}

    // Strips of the first convolution lie a row below those of the second, which looks one row further.
    void run() {
        copy_window();
        make_looked(top_ - kStripRows + 1);
        for (int y = top_; y < bottom_; y += kStripRows) {
            make_looked(y + 1);
            finish(y);
        }
    }

private:
    // Row y of the window, from column left - kWindowMargin on.
    float* window(int plane, int y) { return work_.window.data() + (plane * window_rows_ + y - top_ + kWindowMargin) * kStride; }
    float* values(int y) { return work_.values.data() + (y & (kKeptRows - 1)) * inputs_ * kStride; }
    float* looked(int y) { return work_.looked.data() + (y & (kKeptRows - 1)) * job_.looks[0].padded * kStride; }

    void copy_window() {
        const int first = std::max(left_ - kWindowMargin, 0), count = std::min(right_ + kWindowMargin, job_.width) - first;
        const int at = first - (left_ - kWindowMargin);
        const int64_t pixels = int64_t(job_.width) * job_.height;
        for (int y = top_ - kWindowMargin; y < bottom_ + kWindowMargin; ++y) {
            const int64_t from = int64_t(clamped(y, job_.height)) * job_.width + first;
            shared_.kernels.logarithm_row(job_.depth + from, count, window(kLogarithm, y) + at, window(kKnown, y) + at);
            for (int c = 0; c < 3; ++c) std::copy_n(job_.picture + c * pixels + from, count, window(kRed + c, y) + at);
            for (int plane : {kLogarithm, kRed, kGreen, kBlue})
                repeat_border(window(plane, y), left_, right_, kWindowMargin, job_.width);
            forget_border(window(kKnown, y), y, at, count);
            const float *red = window(kRed, y), *green = window(kGreen, y), *blue = window(kBlue, y);
            float* grey = window(kGrey, y);
            for (int x = 0; x < columns_ + 2 * kWindowMargin; ++x) grey[x] = (red[x] + green[x] + blue[x]) * (1.0f / 3.0f);
        }
    }

    // Beyond the border nothing is known.
    void forget_border(float* known, int y, int at, int count) const {
        if (y < 0 || y >= job_.height) count = 0;
        std::fill(known, known + at, 0.0f);
        std::fill(known + at + count, known + kStride, 0.0f);
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
        EvidenceRow row{{}, {}, {}, columns_ + 2 * kValueMargin, work_.evidence.data(), out + 2 * kStride, kStride};
        for (int n = 0; n < 5; ++n) row.logarithms[n] = window(kLogarithm, y + n - 2), row.known[n] = window(kKnown, y + n - 2);
        for (int n = 0; n < 3; ++n) row.grey[n] = window(kGrey, y + n - 1);
        shared_.kernels.evidence_row(row);
        features_.write(y, out + kEvidence * kStride + at, kStride);
        for (int channel = 0; channel < inputs_; ++channel)
            repeat_border(out + channel * kStride, left_, right_, kValueMargin, job_.width);
    }

    // A strip of a convolution from row y on. Rows beyond the picture repeat its first and last one; so do those that are not made
    // as they only enter rows that are not wanted, where they must not be left to chance: they cancel but for rounding.
    template <class Rows>
    ConvolvedStrip strip(int layer, int y, int count, const Rows& sources) {
        ConvolvedStrip strip{job_.looks[layer], {}, {}, count, kStride, work_.strip.data()};
        for (int n = 0; n < kStripSources; ++n)
            strip.sources[n] = sources(std::clamp(y - 1 + n, std::max(top_ - kValueMargin, 0), job_.height - 1));
        return strip;
    }

    // Rows of the first convolution from y on, from column left - kLookMargin on.
    void make_looked(int y) {
        for (; next_value_ < std::min(y + kStripRows + 1, job_.height); ++next_value_) make_values(next_value_);
        ConvolvedStrip looks = strip(0, y, columns_ + 2 * kLookMargin, [this](int row) { return values(row); });
        for (int n = 0; n < kStripRows; ++n) looks.out[n] = looked(y + n);
        shared_.kernels.look_strip(looks);
        for (int n = 0; n < kStripRows; ++n)
            for (int channel = 0; channel < job_.looks[0].after; ++channel)
                repeat_border(looked(y + n) + channel * kStride, left_, right_, kLookMargin, job_.width);
    }

    void finish(int y) {
        ConvolvedStrip looks = strip(1, y, columns_, [this](int row) { return looked(row); });
        for (int n = 0; n < kStripRows; ++n) looks.out[n] = work_.last.data() + n * job_.looks[1].padded * kStride;
        shared_.kernels.look_strip(looks);
        for (int n = 0; n < std::min(kStripRows, bottom_ - y); ++n) filter(y + n, looks.out[n]);
    }

    void filter(int y, const float* looked_twice) {
        shared_.kernels.convolve_row({job_.taps, looked_twice, work_.taps.data(), columns_, kStride});
        FilteredRow row{work_.taps.data(), {}, columns_, kStride, shared_.out + 3 * (int64_t(y) * job_.width + left_)};
        for (int c = 0; c < 3; ++c) row.picture[c] = window(kRed + c, y) + kWindowMargin;
        shared_.kernels.filter_row(row);
    }

    const Shared& shared_;
    const Refinement& job_;
    Workspace& work_;
    const int left_, top_, right_, bottom_, columns_, window_rows_, inputs_, value_left_, value_right_;
    int next_value_;  // row
    EnlargedRows features_;
};

}  // namespace

void refine(const Refinement& job, float* out, int threads, int level) {
    const Shared shared{job, kernels_of(level), FinePixels(job.width, job.small.width, job.small.scale),
                        FinePixels(job.height, job.small.height, job.small.scale), out};
    const int across = (job.width + kTileColumns - 1) / kTileColumns, down = (job.height + kTileRows - 1) / kTileRows;
    threads = std::max(1, std::min(threads, across * down));
    std::vector<Workspace> workspaces(threads, Workspace(job, TileRefiner::kPlanes));
    parallel_for(across * down, threads, [&](int tile, int worker) {
        TileRefiner(shared, workspaces[worker], tile % across * kTileColumns, tile / across * kTileRows).run();
    });
}

}  // namespace ggvs
