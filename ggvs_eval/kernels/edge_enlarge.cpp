// Colours are compared row by row, each candidate over the whole row, which the compiler does in packets.
#include "edge_enlarge.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <vector>

#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kBandRows = 16;

// Grey level of a difference of colours, as OpenCV rounds it.
int grey(const uint8_t* one, const uint8_t* other) {
    const int red = std::abs(one[0] - other[0]), green = std::abs(one[1] - other[1]), blue = std::abs(one[2] - other[2]);
    return (9798 * red + 19235 * green + 3735 * blue + (1 << 14)) >> 15;
}

// The small pixel that each pixel of a side is nearest to, and the next one.
struct NearestTwo {
    std::vector<int> places[2];

    NearestTwo(int size, int small_size) {
        const double share = double(small_size) / size;
        for (int n = 0; n < size; ++n) {
            const double place = (n + 0.5) * share - 0.5, nearest = std::nearbyint(place);
            const int first = int(nearest), second = first + (place < nearest ? -1 : 1);
            places[0].push_back(std::clamp(first, 0, small_size - 1)), places[1].push_back(std::clamp(second, 0, small_size - 1));
        }
    }
};

class Rows {
public:
    Rows(const EdgeTask& task, const NearestTwo& down, const NearestTwo& across)
        : task_(task), down_(down), across_(across), best_(task.width), pixel_(task.width) {}

    void run(int y, float* depth, float* confidence) {
        std::fill(best_.begin(), best_.end(), 256);
        const uint8_t* image = task_.image + int64_t(3) * y * task_.width;
        for (const auto& rows : down_.places)
            for (const auto& columns : across_.places) compare(image, int64_t(rows[y]) * task_.small_width, columns);
        const float* smooth = task_.smooth + int64_t(y) * task_.width;
        for (int x = 0; x < task_.width; ++x) {
            const float alike = task_.depth[pixel_[x]];
            depth[x] = std::abs(smooth[x] - alike) < task_.same_surface * alike ? smooth[x] : alike;
            confidence[x] = task_.confidence[pixel_[x]];
        }
    }

private:
    void compare(const uint8_t* image, int64_t row, const std::vector<int>& columns) {
        for (int x = 0; x < task_.width; ++x) {
            const int64_t pixel = row + columns[x];
            const int difference = grey(image + 3 * x, task_.small_image + 3 * pixel);
            const bool closer = difference < best_[x];
            best_[x] = closer ? difference : best_[x];
            pixel_[x] = closer ? pixel : pixel_[x];
        }
    }

    const EdgeTask& task_;
    const NearestTwo &down_, &across_;
    std::vector<int> best_;
    std::vector<int64_t> pixel_;  // the small one that is most alike
};

}  // namespace

void enlarge_to_edges(const EdgeTask& task, float* depth, float* confidence, int threads) {
    const NearestTwo down(task.height, task.small_height), across(task.width, task.small_width);
    parallel_for((task.height + kBandRows - 1) / kBandRows, threads, [&](int band, int) {
        Rows rows(task, down, across);
        for (int y = band * kBandRows; y < std::min((band + 1) * kBandRows, task.height); ++y)
            rows.run(y, depth + int64_t(y) * task.width, confidence + int64_t(y) * task.width);
    });
}

}  // namespace ggvs
