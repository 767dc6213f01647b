// Where a ray must look closely. A sample can differ from a whole step of 0.8 tau only within [D - tau, D + tau] of some view;
// here those shells are marked, conservatively, in a grid of 8 x 8-pixel columns and log-depth slabs of the target's frustum.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>

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

int slab_of(SlabScale scale, float z) {
    const float slab = float(float_bits(z) - scale.first_bits) * scale.per_bit;
    return int(std::min(std::max(slab, 0.0f), float(kSlabs - 1)));
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

// Smallest and largest valid depth of each column over some rows. The loops are plain so that any compiler vectorises them.
class RowExtent {
public:
    explicit RowExtent(int width) : low_(width), high_(width) {}

    void clear() {
        std::fill(low_.begin(), low_.end(), kFarAway);
        std::fill(high_.begin(), high_.end(), 0.0f);
    }

    void add(const float* depth) {
        for (size_t x = 0; x < low_.size(); ++x) include(x, depth[x], depth[x] > 0.0f);
    }

    void add(const float* depth, const float* weight) {
        for (size_t x = 0; x < low_.size(); ++x) include(x, depth[x], (depth[x] > 0.0f) & (weight[x] > 0.0f));
    }

    Range over(int first, int last) const {
        Range range{kFarAway, 0.0f};
        for (int x = first; x < last; ++x) range = {std::min(range.low, low_[x]), std::max(range.high, high_[x])};
        return range;
    }

private:
    void include(size_t x, float depth, bool valid) {
        const float low = valid ? depth : kFarAway, high = valid ? depth : 0.0f;
        low_[x] = low < low_[x] ? low : low_[x];
        high_[x] = high > high_[x] ? high : high_[x];
    }

    std::vector<float> low_, high_;
};

using Four = float __attribute__((vector_size(16)));

struct Corners {
    Four x, y, z;
};

Corners corners_at(float depth, const Four* along, const PixelMap& to_target) {
    const Four z = depth * along[2] + to_target.offset[2];
    return {(depth * along[0] + to_target.offset[0]) / z, (depth * along[1] + to_target.offset[1]) / z, z};
}

float least(Four a, Four b) {
    const Four c = a < b ? a : b;
    return std::min(std::min(c[0], c[1]), std::min(c[2], c[3]));
}

float most(Four a, Four b) {
    const Four c = a > b ? a : b;
    return std::max(std::max(c[0], c[1]), std::max(c[2], c[3]));
}

}  // namespace

SlabScale slab_scale(float near, float far) {
    return {float_bits(near), float(kSlabs) / float(float_bits(far) - float_bits(near))};
}

Occupancy::Occupancy(const March& march, int threads)
    : march_(march),
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
    RowExtent block(width), ring(width);
    for (int top = first_row; top < last_row; top += kSourceBlock) {
        const int bottom = std::min(top + kSourceBlock, last_row);
        block.clear(), ring.clear();
        for (int y = top; y < bottom; ++y) block.add(view.depth + int64_t(y) * width, view.weight + int64_t(y) * width);
        for (int y = std::max(top - 1, 0); y < std::min(bottom + 1, view.camera.height); ++y)
            ring.add(view.depth + int64_t(y) * width);
        for (int left = 0; left < width; left += kSourceBlock) {
            const int right = std::min(left + kSourceBlock, width);
            const Range own = block.over(left, right);
            if (own.low > own.high) continue;
            // Interpolation with a pixel of the ring around the block moves a value, but by less than tau.
            const Range near = ring.over(std::max(left - 1, 0), std::min(right + 1, width));
            mark_block(view, map, {left, top, right, bottom}, own, near);
        }
    }
}

// Marks the shells of one block's pixels, layer by layer where they lie far apart.
void Occupancy::mark_block(const FieldView& view, const PixelMap& to_target, Block block, Range own, Range ring) {
    const float tau = march_.tau;
    auto mark = [&](float low, float high) {
        mark_frustum(to_target, block, {std::max(low - tau, ring.low) - tau, std::min(high + tau, ring.high) + tau});
    };
    if (own.high - own.low <= 4.0f * tau) return mark(own.low, own.high);
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
        mark(values[first], values[n - 1]);
        first = n;
    }
}

// Marks the columns and slabs that a piece of a source frustum reaches: it is convex, so its corners bound its image and its
// depth.
void Occupancy::mark_frustum(const PixelMap& to_target, Block block, Range shell) {
    constexpr float kRounding = 0.01f;  // pixels; far above the error of the arithmetic
    const float* m = to_target.matrix;
    const float left = float(block.left), right = float(block.right), top = float(block.top), bottom = float(block.bottom);
    // The four corners at one depth are what any processor computes at once.
    const Four u{left, right, left, right}, v{top, top, bottom, bottom};
    const Four along[3] = {m[0] * u + m[1] * v + m[2], m[3] * u + m[4] * v + m[5], m[6] * u + m[7] * v + m[8]};
    const Corners near = corners_at(std::max(shell.low, 0.0f), along, to_target);
    const Corners far = corners_at(std::max(shell.high, 0.0f), along, to_target);
    float u0 = least(near.x, far.x), u1 = most(near.x, far.x), v0 = least(near.y, far.y), v1 = most(near.y, far.y);
    float z0 = least(near.z, far.z), z1 = most(near.z, far.z);
    const float width = float(march_.target.width), height = float(march_.target.height);
    if (z0 < 0.1f * march_.near) u0 = v0 = 0.0f, u1 = width, v1 = height;  // behind the camera, the image is no bound
    z0 *= 1.0f - 1e-5f, z1 *= 1.0f + 1e-5f;
    if (z1 < march_.near || z0 > march_.far || u1 < -kRounding || v1 < -kRounding || u0 > width || v0 > height) return;
    const float scale = 1.0f / kMarchTile;
    mark_columns(int(std::max(u0 - kRounding, 0.0f) * scale), int(std::min(u1 + kRounding, width - 1.0f) * scale),
                 int(std::max(v0 - kRounding, 0.0f) * scale), int(std::min(v1 + kRounding, height - 1.0f) * scale),
                 slab_of(slabs_, std::max(z0, march_.near)), slab_of(slabs_, std::min(z1, march_.far)));
}

void Occupancy::mark_columns(int x0, int x1, int y0, int y1, int first_slab, int last_slab) {
    uint64_t words[kWords];
    for (int w = 0; w < kWords; ++w) {
        const int low = std::max(first_slab - 64 * w, 0), high = std::min(last_slab - 64 * w, 63);
        words[w] = low <= high ? (~uint64_t(0) << low) & (~uint64_t(0) >> (63 - high)) : 0;
    }
    for (int y = y0; y <= y1; ++y) {
        for (int x = x0; x <= x1; ++x) {
            uint64_t* column = bits_.data() + (size_t(y) * across_ + x) * kWords;
            for (int w = first_slab / 64; w <= last_slab / 64; ++w) {
                // Most bits are there already; a locked write costs far more than a look.
                if ((__atomic_load_n(column + w, __ATOMIC_RELAXED) & words[w]) != words[w])
                    __atomic_fetch_or(column + w, words[w], __ATOMIC_RELAXED);
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
