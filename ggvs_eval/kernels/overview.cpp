// The overview, band by band: what is read once stays in the cache for all that is made of it. The arithmetic of single pixels
// stands in overview_simd.hpp.
#include "overview.hpp"

#include <algorithm>
#include <cstring>

#include "enlarge.hpp"
#include "kernels.hpp"
#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kCellRows = 2;  // of a band

class Band {
public:
    Band(const Views& job, const OverviewMaps& out, const Kernels& kernels) : job_(job), out_(out), kernels_(kernels) {}

    void run(int first_cell, int last_cell) {
        for (int cell = first_cell; cell < last_cell; ++cell) {
            for (int y = cell * job_.scale; y < std::min((cell + 1) * job_.scale, job_.height); ++y)
                kernels_.overview_row(job_, out_, y);
            for (int k = 0; k < job_.views; ++k) {
                const int64_t first = int64_t(k) * job_.height * job_.width;
                average<3>(job_.colours + 3 * first, k, cell, out_.small[0]);
                average<1>(job_.coverage + first, k, cell, out_.small[1]);
                average<1>(job_.seen + first, k, cell, out_.small[2]);
                average<1>(job_.alphas[k], k, cell, out_.small[3]);
            }
        }
    }

private:
    // One row of cells of one view, whose map is given.
    template <int kChannels>
    void average(const float* map, int k, int cell, float* out) const {
        const int columns = (job_.width + job_.scale - 1) / job_.scale, cells = (job_.height + job_.scale - 1) / job_.scale;
        float* to = out + (int64_t(k) * cells + cell) * columns * kChannels;
        int x = 0;
        if (job_.scale == 4) {
            const float* rows[4];
            for (int n = 0; n < 4; ++n) rows[n] = map + row(4 * cell + n) * kChannels;
            // Colours are read with one value more, which the last cell may not have, and written so but for the last one.
            const int reserve = kChannels == 3 ? 4 : 0;
            for (; 4 * x + 4 + reserve <= job_.width; ++x) average_of_4<kChannels>(rows, x, to + x * kChannels);
        }
        for (; x < columns; ++x)
            for (int c = 0; c < kChannels; ++c) to[x * kChannels + c] = mean<kChannels>(map + c, cell, x);
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
    float mean(const float* map, int cell, int x) const {
        const int scale = job_.scale, area = scale * scale;
        const auto value = [&](int n) {
            return map[(row(cell * scale + n / scale) + std::min(x * scale + n % scale, job_.width - 1)) * kChannels];
        };
        float sum = 0.0f;
        int n = 0;
        for (; n + 4 <= area; n += 4) sum += value(n) + value(n + 1) + value(n + 2) + value(n + 3);
        for (; n < area; ++n) sum += value(n);
        return sum * (1.0f / float(area));
    }

    // Where a row begins; beyond the last one, that.
    int64_t row(int y) const { return int64_t(std::min(y, job_.height - 1)) * job_.width; }

    const Views& job_;
    const OverviewMaps& out_;
    const Kernels& kernels_;
};

}  // namespace

void overview(const Views& job, const OverviewMaps& out, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
    const int cells = (job.height + job.scale - 1) / job.scale;
    parallel_for((cells + kCellRows - 1) / kCellRows, threads, [&](int band, int) {
        Band(job, out, kernels).run(band * kCellRows, std::min((band + 1) * kCellRows, cells));
    });
}

}  // namespace ggvs
