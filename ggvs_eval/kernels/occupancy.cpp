// Where a ray must look closely. A sample can differ from a whole step of 0.8 tau only within [D - tau, D + tau] of some view;
// here those shells are marked, conservatively, in a grid of 8 x 8-pixel columns and log-depth slabs of the target's frustum.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>

#include "kernels.hpp"
#include "parallel.hpp"
#include "tsdf.hpp"

namespace ggvs {
namespace {

constexpr int kWords = kSlabs / 64;
constexpr int kSourceBlock = 4;
constexpr int kBandRows = 32;

int32_t float_bits(float x) {
    int32_t bits;
    std::memcpy(&bits, &x, sizeof bits);
    return bits;
}

float bits_float(int32_t bits) {
    float x;
    std::memcpy(&x, &bits, sizeof x);
    return x;
}

// The first slab from `slab` on that is occupied, or that is not; kSlabs if there is none.
int next_slab(const uint64_t* words, int slab, bool occupied) {
    while (slab < kSlabs) {
        const uint64_t word = (occupied ? words[slab / 64] : ~words[slab / 64]) >> (slab % 64);
        if (word) return slab + __builtin_ctzll(word);
        slab = (slab / 64 + 1) * 64;
    }
    return kSlabs;
}

// The smallest and the largest valid depth of some pixel columns.
Range over(const Extent& extent, int first, int last) {
    Range range{kFarAway, 0.0f};
    for (int x = first; x < last; ++x) range = {std::min(range.low, extent.low[x]), std::max(range.high, extent.high[x])};
    return range;
}

void clear(const Extent& extent) {
    std::fill_n(extent.low, extent.width, kFarAway);
    std::fill_n(extent.high, extent.width, 0.0f);
}

}  // namespace

SlabScale slab_scale(float near, float far) {
    return {float_bits(near), float(kSlabs) / float(float_bits(far) - float_bits(near))};
}

Occupancy::Occupancy(const March& march, const Kernels& kernels, int threads)
    : march_(march),
      kernels_(kernels),
      across_((march.target.width + kMarchTile - 1) / kMarchTile),
      down_((march.target.height + kMarchTile - 1) / kMarchTile),
      slabs_(slab_scale(march.near, march.far)),
      bits_(size_t(across_) * down_ * kWords) {
    std::vector<std::pair<const FieldView*, int>> bands;
    for (const FieldView& view : march.views)
        for (int row = 0; row < view.camera.height; row += kBandRows) bands.emplace_back(&view, row);
    parallel_for(int(bands.size()), threads, [&](int n, int) {
        const FieldView& view = *bands[n].first;
        mark_view(view, bands[n].second, std::min(bands[n].second + kBandRows, view.camera.height));
    });
}

void Occupancy::mark_view(const FieldView& view, int first_row, int last_row) {
    double to_target[16] = {};  // inverse of a rigid transform
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) {
            to_target[4 * r + c] = view.from_target[4 * c + r];
            to_target[4 * r + 3] -= view.from_target[4 * c + r] * view.from_target[4 * c + 3];
        }
    }
    const PixelMap map = pixel_map(view.camera, to_target, march_.target, true);
    const int width = view.camera.width;
    std::vector<float> memory(size_t(4) * width);
    const Extent block{memory.data(), memory.data() + width, width};
    const Extent ring{block.high + width, block.high + 2 * width, width};
    Shells shells;
    for (int top = first_row; top < last_row; top += kSourceBlock) {
        const int bottom = std::min(top + kSourceBlock, last_row);
        clear(block), clear(ring);
        for (int y = std::max(top - 1, 0); y < std::min(bottom + 1, view.camera.height); ++y) {
            const int64_t row = int64_t(y) * width;
            kernels_.add_to_extent(ring, view.depth + row, nullptr);
            if (y >= top && y < bottom) kernels_.add_to_extent(block, view.depth + row, view.weight + row);
        }
        for (int left = 0; left < width; left += kSourceBlock) {
            const int right = std::min(left + kSourceBlock, width);
            const Range own = over(block, left, right);
            if (own.low > own.high) continue;
            // Interpolation with a pixel of the ring around the block moves a value, but by less than tau.
            const Range near = over(ring, std::max(left - 1, 0), std::min(right + 1, width));
            add_block(view, map, {left, top, right, bottom}, own, near, shells);
        }
    }
    mark(map, shells);
}

// Adds the shell of one block's pixels, or several, layer by layer, where they lie far apart.
void Occupancy::add_block(const FieldView& view, const PixelMap& to_target, Block block, Range own, Range ring, Shells& shells) {
    const float tau = march_.tau;
    const auto add = [&](float low, float high) {
        if (shells.count == Shells::kMost) mark(to_target, shells);
        const int n = shells.count++;
        shells.left[n] = float(block.left), shells.right[n] = float(block.right);
        shells.top[n] = float(block.top), shells.bottom[n] = float(block.bottom);
        shells.low[n] = std::max(low - tau, ring.low) - tau, shells.high[n] = std::min(high + tau, ring.high) + tau;
    };
    if (own.high - own.low <= 4.0f * tau) return add(own.low, own.high);
    float values[kSourceBlock * kSourceBlock];
    int count = 0;
    for (int y = block.top; y < block.bottom; ++y) {
        for (int x = block.left; x < block.right; ++x) {
            const int64_t pixel = int64_t(y) * view.camera.width + x;
            if (view.depth[pixel] > 0.0f && view.weight[pixel] > 0.0f) values[count++] = view.depth[pixel];
        }
    }
    std::sort(values, values + count);
    for (int first = 0, n = 1; n <= count; ++n) {
        if (n < count && values[n] - values[n - 1] <= 2.0f * tau) continue;
        add(values[first], values[n - 1]);
        first = n;
    }
}

// Marks what the shells reach, and forgets them.
void Occupancy::mark(const PixelMap& to_target, Shells& shells) {
    kernels_.reach_of_shells(march_.target, to_target, march_.near, march_.far, shells);
    for (int n = 0; n < shells.count; ++n) mark_shell(shells, n);
    shells.count = 0;
}

void Occupancy::mark_shell(const Shells& shells, int n) {
    for (int word = shells.first_slab[n] / 64; 64 * word <= shells.last_slab[n]; ++word) {
        const int low = std::max(shells.first_slab[n] - 64 * word, 0), high = std::min(shells.last_slab[n] - 64 * word, 63);
        const uint64_t slabs = (~uint64_t(0) << low) & (~uint64_t(0) >> (63 - high));
        for (int y = shells.first_row[n]; y <= shells.last_row[n]; ++y) {
            for (int x = shells.first_column[n]; x <= shells.last_column[n]; ++x) {
                uint64_t* marks = bits_.data() + (size_t(y) * across_ + x) * kWords + word;
                // Most bits are there already; a locked write costs far more than a look.
                if ((__atomic_load_n(marks, __ATOMIC_RELAXED) & slabs) != slabs) __atomic_fetch_or(marks, slabs, __ATOMIC_RELAXED);
            }
        }
    }
}

MarchColumn Occupancy::column(int left, int top) const {
    MarchColumn column;
    column.left = left, column.top = top, column.slabs = slabs_;
    const uint64_t* words = bits_.data() + (size_t(top / kMarchTile) * across_ + left / kMarchTile) * kWords;
    for (int slab = 0; slab < kSlabs;) {
        const int first = next_slab(words, slab, true), behind = next_slab(words, first, false);
        // Rounded towards the camera: to stop early costs a sample, to stop late would lose one.
        const float depth = bits_float(slabs_.first_bits + int32_t(first / slabs_.per_bit * 0.99999f));
        std::fill(column.next_depth + slab, column.next_depth + behind, first < kSlabs ? depth : kFarAway);
        slab = behind;
    }
    return column;
}

}  // namespace ggvs
