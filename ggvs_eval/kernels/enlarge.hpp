// Small maps bilinearly enlarged, row by row, for the kernels that use them at full size.
#pragma once
#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

namespace ggvs {

// What any processor computes at once.
using Four = float __attribute__((vector_size(16)));

inline Four four_of(const float* from) {
    Four values;
    std::memcpy(&values, from, sizeof values);
    return values;
}

// Maps of a view with `scale` times fewer pixels across and down; pixels beyond the last whole block are cut off.
struct SmallMaps {
    const float* values;  // (channels, height, width)
    int width, height, scale;
};

// Where the centres of fine pixels lie between those of pixels `scale` times as large, which may be a fraction; the border is
// repeated.
struct FinePixels {
    std::vector<int> first, second;
    std::vector<float> share;  // of the second

    FinePixels(int fine, int coarse, double scale) {
        for (int n = 0; n < fine; ++n) {
            const double at = std::max((n + 0.5) / scale - 0.5, 0.0);
            first.push_back(std::min(int(at), coarse - 1)), second.push_back(std::min(int(at) + 1, coarse - 1));
            share.push_back(float(at - int(at)));
        }
    }
};

// Columns left .. left + count - 1 of some channels, at one row of the full size at a time, rows in ascending order.
class EnlargedRows {
public:
    EnlargedRows(const SmallMaps& maps, const FinePixels& across, const FinePixels& down, int first_channel, int channels,
                 int left, int count)
        : maps_(maps), across_(across), down_(down), first_channel_(first_channel), channels_(channels), left_(left),
          count_(count), lines_(size_t(2) * channels * count) {}

    // Row y of every channel, one line of `stride` floats after another.
    void write(int y, float* out, int64_t stride) {
        const float share = down_.share[y], rest = 1.0f - share;
        const float *above = enlarged(down_.first[y]), *below = enlarged(down_.second[y]);
        for (int c = 0; c < channels_; ++c, above += count_, below += count_, out += stride)
            for (int x = 0; x < count_; ++x) out[x] = rest * above[x] + share * below[x];
    }

private:
    // A small row enlarged across; two neighbours are kept, as most rows of the full size lie between the same two.
    const float* enlarged(int row) {
        float* line = lines_.data() + size_t(row & 1) * channels_ * count_;
        if (held_[row & 1] == row) return line;
        held_[row & 1] = row;
        const int *first = across_.first.data() + left_, *second = across_.second.data() + left_;
        const float* share = across_.share.data() + left_;
        for (int c = 0; c < channels_; ++c) {
            const float* from = maps_.values + (int64_t(first_channel_ + c) * maps_.height + row) * maps_.width;
            float* to = line + int64_t(c) * count_;
            for (int x = 0; x < count_; ++x) {
                const float left = from[first[x]], right = from[second[x]];
                if (x + 4 > count_ || first[x + 3] != first[x]) {
                    to[x] = (1.0f - share[x]) * left + share[x] * right;
                    continue;
                }
                const Four shares = four_of(share + x), mixed = (1.0f - shares) * left + shares * right;
                std::memcpy(to + x, &mixed, sizeof mixed);
                x += 3;
            }
        }
        return line;
    }

    const SmallMaps& maps_;
    const FinePixels &across_, &down_;
    int first_channel_, channels_, left_, count_;
    std::vector<float> lines_;
    int held_[2] = {-1, -1};
};

}  // namespace ggvs
