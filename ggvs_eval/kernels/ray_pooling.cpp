// The driver of IBRNet's ray network: ray by ray, in memory that stays in the cache.
#include "ray_pooling.hpp"

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <new>
#include <utility>

#include "kernels.hpp"

namespace ggvs {
namespace {

constexpr size_t kAlignment = 64;
constexpr int kChannels = 3 + 1 + 1 + 3 * kRayOut;  // of RaySamples

struct Free {
    void operator()(void* memory) const { std::free(memory); }
};
using Memory = std::unique_ptr<float, Free>;

Memory floats(size_t count) {
    const size_t bytes = (count * sizeof(float) + kAlignment - 1) / kAlignment * kAlignment;
    Memory memory(static_cast<float*>(std::aligned_alloc(kAlignment, bytes)));
    if (!memory) throw std::bad_alloc();
    std::fill_n(memory.get(), bytes / sizeof(float), 0.0f);
    return memory;
}

// Of each view what it shows, its features, colour, direction, weight, mask and visibility; and layers' worth beside.
size_t packet_floats(size_t views) {
    return kRayPacket * (views * (kRaySeen + kRayFeatures + 10) + 2 * kRaySeen + 4 * kMostRayWidth);
}

}  // namespace

void pool_views(const RayPooling& job, const RayColours& out, int level) {
    const Kernels& kernels = kernels_of(level);
    const int stride = (job.n_samples + kRayPacket - 1) / kRayPacket * kRayPacket;
    const Memory packet = floats(packet_floats(job.views.size())), lines = floats(size_t(kChannels) * stride);
    float* at = lines.get();
    const auto take = [&](int channels) { return std::exchange(at, at + channels * stride); };
    const RaySamples samples{take(3), take(kRayOut), take(1), take(1), take(kRayOut), take(kRayOut), stride};
    for (int64_t ray = 0; ray < job.n_rays; ++ray) {
        kernels.pool_ray(job, ray, samples, packet.get());
        kernels.attend_ray(job, samples, packet.get());
        float *colours = out.colours + 3 * ray * job.n_samples, *density = out.density + ray * job.n_samples;
        for (int sample = 0; sample < job.n_samples; ++sample) {
            for (int c = 0; c < 3; ++c) colours[3 * sample + c] = samples.colours[c * stride + sample];
            density[sample] = samples.density[sample];
        }
    }
}

}  // namespace ggvs
