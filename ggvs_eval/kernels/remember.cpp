// The background memory in one pass over the picture, where steps of their own would read and write it a dozen times.
#include "remember.hpp"

#include <algorithm>
#include <cmath>

#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kBandRows = 8;
constexpr float kMoved = -1.0f;  // depth of what was moving when it was seen last

// The cell that each pixel of a line lies in, as cv2.resize takes the nearest.
std::vector<int> cells_of(int pixels, int cells) {
    const double cell = 1.0 / (double(pixels) / cells);
    std::vector<int> found(pixels);
    for (int n = 0; n < pixels; ++n) found[n] = std::min(int(std::floor(n * cell)), cells - 1);
    return found;
}

// Workspace of a row.
struct Lines {
    std::vector<float> alpha, still;
    std::vector<uint8_t> noted;

    explicit Lines(int width) : alpha(width), still(width), noted(width) {}
};

class Rows {
public:
    Rows(const BackgroundStep& job, float* image, float* past, float* past_depth)
        : job_(job), rules_(job.rules), image_(image), past_(past), past_depth_(past_depth),
          across_(cells_of(job.width, job.cells_across)), down_(cells_of(job.height, job.cells_down)) {}

    void run(int y, Lines& lines) const {
        const int64_t row = int64_t(y) * job_.width;
        std::copy_n(job_.alphas[0] + row, job_.width, lines.alpha.data());
        for (size_t k = 1; k < job_.alphas.size(); ++k)
            for (int x = 0; x < job_.width; ++x) lines.alpha[x] = std::max(lines.alpha[x], job_.alphas[k][row + x]);
        const float* still = job_.still + int64_t(down_[y]) * job_.cells_across;
        for (int x = 0; x < job_.width; ++x) lines.still[x] = still[across_[x]];
        note_depths(row, lines);
        note_colours(row, lines.noted.data());
        for (int x = 0; x < job_.width; ++x)
            if (lines.alpha[x] < rules_.covered_alpha) fill(row + x, lines.alpha[x]);
    }

private:
    // What is seen now is noted where nothing behind it is remembered; what moves is no background, and its depth says so: -1.
    // Products are rounded once, from double, as those of cv2 are.
    void note_depths(int64_t row, Lines& lines) const {
        const float *depth = job_.depth + row, *alpha = lines.alpha.data(), *still = lines.still.data();
        float* past = past_depth_ + row;
        uint8_t* noted = lines.noted.data();
        for (int x = 0; x < job_.width; ++x) {
            const float faded = float(past[x] * rules_.forgetting), behind = float(faded * rules_.behind);
            noted[x] = (depth[x] > 0.0f) & (depth[x] >= behind) & (alpha[x] >= rules_.covered_alpha);
            past[x] = noted[x] ? (still[x] >= rules_.sure_still ? depth[x] : kMoved) : faded;
        }
    }

    void note_colours(int64_t row, const uint8_t* noted) const {
        const uint8_t* const end = noted + job_.width;
        for (const uint8_t* first = std::find(noted, end, 1); first != end;) {
            const uint8_t* const last = std::find(first, end, 0);
            std::copy_n(image_ + 3 * (row + first - noted), 3 * (last - first), past_ + 3 * (row + first - noted));
            first = std::find(last, end, 1);
        }
    }

    // Memory into a hole; a filling that stands for nothing seen is renewed a little, and taken as it is after what moved.
    void fill(int64_t pixel, float alpha) const {
        float *now = image_ + 3 * pixel, *past = past_ + 3 * pixel, *depth = past_depth_ + pixel;
        if (*depth < 0.0f) std::copy_n(now, 3, past), *depth = 0.0f;
        const float span = rules_.covered_alpha - rules_.least_alpha;
        const float weight = std::min(std::max((rules_.covered_alpha - alpha) / span, 0.0f), 1.0f);
        for (int c = 0; c < 3; ++c) {
            if (!std::isfinite(past[c])) past[c] = now[c];
            if (*depth <= 0.0f) past[c] += rules_.renewal * (now[c] - past[c]);
            now[c] += weight * (past[c] - now[c]);
        }
    }

    const BackgroundStep& job_;
    const Remembering& rules_;
    float *image_, *past_, *past_depth_;
    std::vector<int> across_, down_;
};

}  // namespace

void remember(const BackgroundStep& job, float* image, float* past, float* past_depth, int threads) {
    const Rows rows(job, image, past, past_depth);
    parallel_for((job.height + kBandRows - 1) / kBandRows, threads, [&](int band, int) {
        Lines lines(job.width);
        for (int y = band * kBandRows; y < std::min((band + 1) * kBandRows, job.height); ++y) rows.run(y, lines);
    });
}

}  // namespace ggvs
