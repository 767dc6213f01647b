// The overview, band by band: what is read once stays in the cache for all that is made of it. The arithmetic of single pixels
// stands in overview_simd.hpp.
#include "overview.hpp"

#include <algorithm>
#include <cstring>
#include <deque>

#include "aligned.hpp"
#include "enlarge.hpp"
#include "kernels.hpp"
#include "parallel.hpp"
#include "stream.hpp"

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
                const int64_t first = (int64_t(k) * job_.maps.rows - job_.maps.first_row) * job_.width;
                average<3>(job_.maps.colours + 3 * first, k, cell, out_.small[0]);
                average<1>(job_.maps.coverage + first, k, cell, out_.small[1]);
                average<1>(job_.maps.seen + first, k, cell, out_.small[2]);
                average<1>(job_.alphas[k], k, cell, out_.small[3]);
            }
            for (size_t n = 0; n < job_.depths.size(); ++n) pick(job_.depths[n], int(n), cell);
        }
    }

private:
    // One row of cells of one view, whose map is given.
    template <int kChannels>
    void average(const float* map, int k, int cell, float* out) const {
        const int columns = cells(job_.width);
        float* to = out + (int64_t(k) * cells(job_.height) + cell) * columns * kChannels;
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

    // One row of cells of a depth map: the pixel behind the middle of each, or of the one before where that is beyond the border.
    void pick(const float* map, int n, int cell) const {
        const int columns = cells(job_.width);
        const float* from = map + int64_t(middle(cell, job_.height)) * job_.width;
        float* to = out_.depths + (int64_t(n) * cells(job_.height) + cell) * columns;
        for (int x = 0; x < columns; ++x) to[x] = from[middle(x, job_.width)];
    }

    int middle(int cell, int size) const {
        const int at = cell * job_.scale + std::min(job_.scale / 2, size - 1);
        return at < size ? at : at - job_.scale;
    }

    int cells(int size) const { return (size + job_.scale - 1) / job_.scale; }

    // Where a row begins; beyond the last one, that.
    int64_t row(int y) const { return int64_t(std::min(y, job_.height - 1)) * job_.width; }

    const Views& job_;
    const OverviewMaps& out_;
    const Kernels& kernels_;
};

}  // namespace

namespace {

template <class Job>
void for_bands(const Views& job, int threads, const Job& run) {
    const int cells = (job.height + job.scale - 1) / job.scale;
    parallel_for((cells + kCellRows - 1) / kCellRows, threads, [&](int band, int worker) {
        run(band * kCellRows, std::min((band + 1) * kCellRows, cells), worker);
    });
}

// The rows of a band of all views.
class BandMaps {
public:
    BandMaps(int views, int64_t pixels) : floats_(5 * views * pixels) {
        maps = {floats_.data(), floats_.data() + 3 * views * pixels, floats_.data() + 4 * views * pixels, 0, 0};
    }

    void copy_to(const Views& job) const {
        const int64_t count = int64_t(maps.rows) * job.width;
        for (int k = 0; k < job.views; ++k) {
            const int64_t from = k * count, to = (int64_t(k) * job.maps.rows + maps.first_row) * job.width;
            stream_copy(maps.colours + 3 * from, 3 * count, job.maps.colours + 3 * to);
            stream_copy(maps.coverage + from, count, job.maps.coverage + to);
            stream_copy(maps.seen + from, count, job.maps.seen + to);
        }
    }

    RegisteredMaps maps;

private:
    AlignedFloats floats_;
};

}  // namespace

void overview(const Views& job, const OverviewMaps& out, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
    for_bands(job, threads, [&](int first, int last, int) { Band(job, out, kernels).run(first, last); });
}

void register_and_overview(Registration& registration, const Views& job, const OverviewMaps& out, int threads, int level) {
    const Kernels& kernels = kernels_of(level);
    find_pixel_maps(registration);
    threads = std::max(threads, 1);
    std::deque<BandMaps> bands;
    for (int n = 0; n < threads; ++n) bands.emplace_back(job.views, int64_t(kCellRows) * job.scale * job.width);
    for_bands(job, threads, [&](int first, int last, int worker) {
        BandMaps& band = bands[worker];
        band.maps.first_row = first * job.scale, band.maps.rows = std::min(last * job.scale, job.height) - band.maps.first_row;
        for (int k = 0; k < job.views; ++k)  // view by view: the source's rows stay in the cache
            for (int row = 0; row < band.maps.rows; ++row)
                kernels.register_row(registration, k, band.maps.first_row + row, band.maps);
        Views views = job;
        views.maps = band.maps;
        Band(views, out, kernels).run(first, last);
        band.copy_to(job);
    });
}

}  // namespace ggvs
