// Several views made one image: the drivers and what is bound by memory. The look-up's arithmetic stands in blend_simd.hpp.
#include "blend.hpp"

#include <algorithm>
#include <limits>

#include "kernels.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kBandRows = 8;
constexpr int64_t kChunk = 8192;  // pixels
constexpr float kNone = std::numeric_limits<float>::lowest();  // no view covers the pixel

template <class Job>
void for_chunks(int64_t pixels, int threads, const Job& job) {
    parallel_for(int((pixels + kChunk - 1) / kChunk), threads,
                 [&](int chunk, int) { job(chunk * kChunk, std::min((chunk + 1) * kChunk, pixels)); });
}

// Adds a view to the sums; with the stride known the compiler keeps a pixel in registers.
template <int kStride>
void add_view(const WeightedView& view, int64_t first, int64_t last, float* sum, float* total) {
    const int stride = kStride ? kStride : view.stride;
    for (int64_t n = first; n < last; ++n) {
        const float weight = view.factor * view.weight[n];
        const float* colour = view.colour + n * stride;
        total[n - first] += weight;
        for (int c = 0; c < 3; ++c) sum[3 * (n - first) + c] += weight * colour[c];
    }
}

// Raises `largest` to a view's feature where it covers the pixels; with the stride known the compiler reads several at once.
template <int kStride>
void raise_to(const CoveredFeature& view, int64_t first, int64_t last, float least_alpha, float* largest) {
    const int stride = kStride ? kStride : view.stride;
    for (int64_t n = first; n < last; ++n) {
        const float feature = view.alpha[n] >= least_alpha ? view.feature[n * stride] : kNone;
        largest[n] = feature > largest[n] ? feature : largest[n];
    }
}

}  // namespace

void weighted_mean(const std::vector<WeightedView>& views, int64_t pixels, float* out, int threads) {
    for_chunks(pixels, threads, [&](int64_t first, int64_t last) {
        float total[kChunk];
        std::fill_n(total, last - first, 0.0f);
        float* sum = out + 3 * first;
        std::fill_n(sum, 3 * (last - first), 0.0f);
        for (const WeightedView& view : views) {
            const auto add = view.stride == 3 ? add_view<3> : view.stride == 4 ? add_view<4> : add_view<0>;
            add(view, first, last, sum, total);
        }
        for (int64_t n = 0; n < last - first; ++n)
            for (int c = 0; c < 3; ++c) sum[3 * n + c] /= std::max(total[n], kNoWeight);
    });
}

void largest_feature(const std::vector<CoveredFeature>& views, int64_t pixels, float least_alpha, float otherwise, float* out,
                     int threads) {
    for_chunks(pixels, threads, [&](int64_t first, int64_t last) {
        std::fill(out + first, out + last, kNone);
        for (const CoveredFeature& view : views)
            (view.stride == 4 ? raise_to<4> : raise_to<0>)(view, first, last, least_alpha, out);
        for (int64_t n = first; n < last; ++n) out[n] = out[n] == kNone ? otherwise : out[n];
    });
}

void look_up(LookUp& job, float* out, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
    for (LookUpView& view : job.views) view.map = pixel_map(job.target, view.from_target, view.camera, true);
    const int height = job.target.height;
    parallel_for((height + kBandRows - 1) / kBandRows, threads, [&](int band, int) {
        for (int y = band * kBandRows; y < std::min((band + 1) * kBandRows, height); ++y) kernels.look_up_row(job, y, out);
    });
}

}  // namespace ggvs
