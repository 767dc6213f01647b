// The driver of IBRNet's pooling: packets of samples, one after another, in memory that stays in the cache.
#include "ray_pooling.hpp"

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <new>

#include "kernels.hpp"

namespace ggvs {
namespace {

constexpr size_t kAlignment = 64;

struct Free {
    void operator()(void* memory) const { std::free(memory); }
};

}  // namespace

int64_t packet_floats(int views) {
    // Of each view what it shows, its features, direction, colour weight and visibility; and six layers' worth beside.
    return int64_t(kRayPacket) * (views * (kRaySeen + kRayFeatures + 10) + 2 * kRaySeen + 4 * kMostRayWidth);
}

void pool_views(const RayPooling& job, const RaySamples& out, int level) {
    const Kernels& kernels = kernels_of(level);
    const size_t bytes = sizeof(float) * packet_floats(int(job.views.size()));
    const std::unique_ptr<void, Free> memory(std::aligned_alloc(kAlignment, (bytes + kAlignment - 1) / kAlignment * kAlignment));
    if (!memory) throw std::bad_alloc();
    const int64_t count = job.n_rays * job.n_samples;
    for (int64_t first = 0; first < count; first += kRayPacket)
        kernels.pool_samples(job, first, int(std::min<int64_t>(kRayPacket, count - first)), out, memory.get());
}

}  // namespace ggvs
