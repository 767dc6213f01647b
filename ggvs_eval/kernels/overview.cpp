// The overview, band by band: what is read once stays in the cache for all that is made of it.
#include "overview.hpp"

#include <algorithm>
#include <cstring>
#include <vector>

#include "blend.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kCellRows = 2;  // of a band

// A colour and one value more: what any processor computes at once.
using Four = float __attribute__((vector_size(16)));

inline Four four_of(const float* from) {
    Four values;
    std::memcpy(&values, from, sizeof values);
    return values;
}

class Band {
public:
    Band(const Views& job, const OverviewMaps& out) : job_(job), out_(out), shown_(job.width) {}

    void run(int first_cell, int last_cell) {
        for (int cell = first_cell; cell < last_cell; ++cell) {
            for (int y = cell * job_.scale; y < std::min((cell + 1) * job_.scale, job_.height); ++y) {
                blend_row(y);
                survey_row(y);
            }
            for (int k = 0; k < job_.views; ++k) {
                average<3>(job_.colours, k, cell, out_.small[0]);
                average<1>(job_.coverage, k, cell, out_.small[1]);
                average<1>(job_.seen, k, cell, out_.small[2]);
                average<1>(job_.alphas, k, cell, out_.small[3]);
            }
        }
    }

private:
    int64_t at(int k, int y) const { return (int64_t(k) * job_.height + y) * job_.width; }

    // As `weighted_mean` (blend.cpp) has it. But for the last pixel a colour is read, and written, with what follows it.
    void blend_row(int y) {
        float* out = out_.mean + 3 * at(0, y);
        const int last = job_.width - 1;
        for (int x = 0; x < last; ++x) {
            const Four colour = blended(y, x, [](const float* at) { return four_of(at); });
            std::memcpy(out + 3 * x, &colour, sizeof colour);
        }
        const Four colour = blended(y, last, [](const float* at) { return Four{at[0], at[1], at[2], 0.0f}; });
        std::memcpy(out + 3 * last, &colour, 3 * sizeof(float));
    }

    template <class Read>
    Four blended(int y, int x, const Read& read) const {
        Four sum{};
        float total = 0.0f;
        for (int k = 0; k < job_.views; ++k) {
            const int64_t pixel = at(k, y) + x;
            const float weight = job_.weights[k] * job_.coverage[pixel];
            total += weight;
            sum = sum + weight * read(job_.colours + 3 * pixel);
        }
        return sum / std::max(total, kNoWeight);
    }

    void survey_row(int y) {
        float *shown = shown_.data(), *unseen = out_.unseen + at(0, y);
        bool* covered = out_.covered + at(0, y);
        std::fill_n(shown, job_.width, 0.0f);
        std::fill_n(covered, job_.width, false);
        for (int k = 0; k < job_.views; ++k) {
            const float least = job_.covered_alpha;
            const float *seen = job_.seen + at(k, y), *alpha = job_.alphas + at(k, y);
            for (int x = 0; x < job_.width; ++x) shown[x] += seen[x];
            for (int x = 0; x < job_.width; ++x) covered[x] |= alpha[x] > least;
        }
        for (int x = 0; x < job_.width; ++x) unseen[x] = 1.0f - std::min(shown[x], 1.0f);
    }

    // One row of cells of one view.
    template <int kChannels>
    void average(const float* maps, int k, int cell, float* out) const {
        const int columns = (job_.width + job_.scale - 1) / job_.scale, cells = (job_.height + job_.scale - 1) / job_.scale;
        float* to = out + (int64_t(k) * cells + cell) * columns * kChannels;
        int x = 0;
        if (job_.scale == 4) {
            const float* rows[4];
            for (int n = 0; n < 4; ++n) rows[n] = maps + at(k, std::min(4 * cell + n, job_.height - 1)) * kChannels;
            // Colours are read with one value more, which the last cell may not have, and written so but for the last one.
            const int reserve = kChannels == 3 ? 4 : 0;
            for (; 4 * x + 4 + reserve <= job_.width; ++x) average_of_4<kChannels>(rows, x, to + x * kChannels);
        }
        for (; x < columns; ++x)
            for (int c = 0; c < kChannels; ++c) to[x * kChannels + c] = mean<kChannels>(maps + c, k, cell, x);
    }

    // The usual scale, each row of four summed from left to right, as `mean` does.
    template <int kChannels>
    static void average_of_4(const float* const* rows, int x, float* to) {
        if (kChannels == 3) {
            Four sum{};
            for (int n = 0; n < 4; ++n) {
                const float* four = rows[n] + 12 * x;
                sum = sum + (four_of(four) + four_of(four + 3) + four_of(four + 6) + four_of(four + 9));
            }
            sum = sum * (1.0f / 16.0f);
            std::memcpy(to, &sum, sizeof sum);
            return;
        }
        float sum = 0.0f;
        for (int n = 0; n < 4; ++n) sum += rows[n][4 * x] + rows[n][4 * x + 1] + rows[n][4 * x + 2] + rows[n][4 * x + 3];
        *to = sum * (1.0f / 16.0f);
    }

    // Any cell: four values at a time, which is how cv2.resize sums them.
    template <int kChannels>
    float mean(const float* map, int k, int cell, int x) const {
        const int scale = job_.scale, area = scale * scale;
        const auto value = [&](int n) {
            const int row = std::min(cell * scale + n / scale, job_.height - 1);
            return map[(at(k, row) + std::min(x * scale + n % scale, job_.width - 1)) * kChannels];
        };
        float sum = 0.0f;
        int n = 0;
        for (; n + 4 <= area; n += 4) sum += value(n) + value(n + 1) + value(n + 2) + value(n + 3);
        for (; n < area; ++n) sum += value(n);
        return sum * (1.0f / float(area));
    }

    const Views& job_;
    const OverviewMaps& out_;
    std::vector<float> shown_;
};

}  // namespace

void overview(const Views& job, const OverviewMaps& out, int threads) {
    const int cells = (job.height + job.scale - 1) / job.scale;
    parallel_for((cells + kCellRows - 1) / kCellRows, threads, [&](int band, int) {
        Band(job, out).run(band * kCellRows, std::min((band + 1) * kCellRows, cells));
    });
}

}  // namespace ggvs
