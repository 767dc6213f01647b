// A pass over the image from top to bottom for each iteration; of the terms only as many rows as a window has are kept.
#include "subpixel.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "simd_portable.hpp"

namespace ggvs {
namespace {

using namespace baseline;

constexpr int kTerms = 5;  // whether valid, slope, difference, their product, the slope's square
constexpr float kFarthest = 1e6f;

// What stands for an index beyond the ends: 2 1 | 0 1 2 ... n - 1 | n - 2.
int reflected(int index, int count) {
    if (count == 1) return 0;
    while (index < 0 || index >= count) index = index < 0 ? -index : 2 * count - 2 - index;
    return index;
}

// Where a pixel's match lies: between two columns, at a share of the way.
struct Place {
    int first, second;
    double share;

    Place(int x, float disparity, int width) {
        float at = float(x) - disparity;
        at = at > -kFarthest ? (at < kFarthest ? at : kFarthest) : -kFarthest;
        const int below = int(at) - (at < float(int(at)));
        share = at - float(below);
        first = std::min(std::max(below, 0), width - 1), second = std::min(std::max(below + 1, 0), width - 1);
    }
    // Exact in double precision, so rounded once.
    template <class T>
    float between(const T* row) const {
        return float(double(row[first]) + share * double(row[second] - row[first]));
    }
};

class Pass {
public:
    Pass(const SubpixelTask& task, const float* from, float* to)
        : task_(task),
          from_(from),
          to_(to),
          before_(task.window / 2),
          padded_(task.width + task.window),
          terms_(padded_ * kTerms),
          rows_(task.window * row_size()),
          sums_(row_size(), 0.0),
          means_(row_size() + kWidth),
          places_(task.width + kWidth),
          given_(task.width + kWidth) {}

    void run() {
        for (int n = 0; n < task_.window - 1; ++n) {
            const double* entering = enter(n);
            for (int64_t at = 0; at < row_size(); ++at) sums_[at] += entering[at];
        }
        for (int y = 0; y < task_.height; ++y) {
            average(enter(y + task_.window - 1), row(y));
            move(y);
        }
    }

private:
    int64_t row_size() const { return int64_t(task_.width) * kTerms; }
    double* row(int n) { return rows_.data() + n % task_.window * row_size(); }

    // Sums along a row of its terms; rows count from that of the first window.
    const double* enter(int n) {
        fill_terms(reflected(n - before_, task_.height));
        double* sums = row(n);
        double running[kTerms] = {};
        for (int t = 0; t < kTerms; ++t) {
            float* terms = &terms_[t * padded_];
            for (int x = 0; x < before_; ++x) terms[x] = terms[before_ + reflected(x - before_, task_.width)];
            for (int x = before_ + task_.width; x < padded_; ++x) terms[x] = terms[before_ + reflected(x - before_, task_.width)];
            for (int x = 0; x < task_.window; ++x) running[t] += double(terms[x]);
            sums[int64_t(t) * task_.width] = running[t];
        }
        for (int x = 1; x < task_.width; ++x) {
            for (int t = 0; t < kTerms; ++t) {  // all at once: each alone would wait for its own sum
                const float* leaving = &terms_[t * padded_ + x - 1];
                sums[int64_t(t) * task_.width + x] = running[t] += double(leaving[task_.window]) - double(leaving[0]);
            }
        }
        return sums;
    }

    void average(const double* __restrict entering, const double* __restrict leaving) {
        const double scale = 1.0 / (double(task_.window) * task_.window);
        double* __restrict sums = sums_.data();
        float* __restrict means = means_.data();
        for (int64_t at = 0; at < row_size(); ++at) {
            const double sum = sums[at] + entering[at];
            means[at] = float(sum * scale);
            sums[at] = sum - leaving[at];
        }
    }

    void fill_terms(int y) {
        const int64_t first = int64_t(y) * task_.width;
        float* __restrict terms[kTerms];
        for (int t = 0; t < kTerms; ++t) terms[t] = &terms_[t * padded_ + before_];
        for (int x = 0; x < task_.width; ++x) {
            const Place place(x, from_[first + x], task_.width);
            terms[1][x] = place.between(task_.slope + first), terms[2][x] = place.between(task_.right + first);
        }
        for (int x = 0; x < task_.width; ++x) {
            const float valid = task_.disparity[first + x] > 0.0f ? 1.0f : 0.0f;
            const float slope = task_.gain * terms[1][x], difference = float(task_.left[first + x]) - task_.gain * terms[2][x];
            terms[0][x] = valid, terms[1][x] = slope * valid, terms[2][x] = difference * valid;
            terms[3][x] = slope * difference * valid, terms[4][x] = slope * slope * valid;
        }
    }

    // The step that explains the differences of a window but for a constant.
    void move(int y) {
        const int width = task_.width;
        const int64_t first = int64_t(y) * width;
        const float* means = means_.data();
        std::copy_n(from_ + first, width, places_.data());
        std::copy_n(task_.disparity + first, width, given_.data());
        const F limit = all(task_.largest_step), noise = all(task_.noise), none = all(0.0f);
        for (int x = 0; x < width; x += kWidth) {
            const F share = max(load(means + x), all(1e-6f));
            const auto mean = [&](int term) { return load(means + term * width + x) / share; };
            const F slope = mean(1), difference = mean(2), covariance = mean(3) - slope * difference;
            const F variance = max(mean(4) - slope * slope, none);
            const F step = max(min(-covariance / (variance + noise), limit), -limit);
            store(&places_[x], keep(less(none, load(&given_[x])), load(&places_[x]) + step));
        }
        std::copy_n(places_.data(), width, to_ + first);
    }

    const SubpixelTask task_;
    const float* from_;
    float* to_;
    int before_, padded_;
    std::vector<float> terms_;   // (terms, width + window) of one row, with what lies beyond its ends
    std::vector<double> rows_;   // (window, terms, width), sums along the rows
    std::vector<double> sums_;   // (terms, width), of all of these but one
    std::vector<float> means_;   // (terms, width)
    std::vector<float> places_, given_;  // (width), disparities before a step, and at first
};

}  // namespace

void sample_matches(const SubpixelTask& task, float* matched) {
    for (int y = 0; y < task.height; ++y) {
        const int64_t first = int64_t(y) * task.width;
        for (int x = 0; x < task.width; ++x)
            matched[first + x] = Place(x, task.disparity[first + x], task.width).between(task.right + first);
    }
}

void refine_matches(const SubpixelTask& task, int iterations, float* refined) {
    const int64_t pixels = int64_t(task.height) * task.width;
    std::vector<float> before;
    std::copy_n(task.disparity, iterations > 0 ? 0 : pixels, refined);
    for (int iteration = 0; iteration < iterations; ++iteration) {
        if (iteration > 0) before.assign(refined, refined + pixels);
        Pass(task, iteration > 0 ? before.data() : task.disparity, refined).run();
    }
    for (int64_t at = 0; at < pixels; ++at) refined[at] = refined[at] > 0.0f ? refined[at] : 0.0f;
}

}  // namespace ggvs
