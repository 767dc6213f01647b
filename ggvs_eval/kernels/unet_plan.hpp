// Where the maps of one run of the U-Net lie in its workspace.
#pragma once
#include <algorithm>
#include <initializer_list>

#include "unet.hpp"

namespace ggvs {

constexpr int kMostLanes = 16;
constexpr int kSizeMultiple = 1 << kUNetLevels, kLeastSize = 2 * kSizeMultiple;  // as in blend_network.py

inline int64_t rounded_up(int64_t n, int64_t multiple) { return (n + multiple - 1) / multiple * multiple; }

// An odd number of cache lines, so that the lines of many channels do not share a few places of the cache.
inline int64_t line_stride(int width) {
    const int64_t packets = rounded_up(width + 2 + kMostLanes, kMostLanes) / kMostLanes;
    return (packets | 1) * kMostLanes;
}

inline ReflectedMaps maps_of(int width, int height, int channels, int most_after) {
    const int lines = std::max(channels, int(rounded_up(most_after, kGroupOutputs)));
    return {width, height, channels, lines, line_stride(width), nullptr};
}

inline int64_t floats_of(const ReflectedMaps& maps) { return (maps.height + 2) * maps.lines * maps.stride; }

// All maps of one run. Input and widest skip share their memory, as do the maps between the convolutions of all blocks.
struct Plan {
    int left, top;  // margins that bring the size to whole cells of the coarsest level
    ReflectedMaps input, between[kUNetLevels + 1], pooled[kUNetLevels + 1], skip[kUNetLevels], out[kUNetLevels + 1];
    int64_t floats = 0;

    explicit Plan(const UNet& job, float* memory = nullptr) {
        const int width = padded(job.width, &left), height = padded(job.height, &top);
        input = maps_of(width, height, job.channels, 0);
        for (int n = 0; n <= kUNetLevels; ++n) {
            const int after = job.blocks[n][0].convolution.after, w = width >> n, h = height >> n;
            between[n] = out[n] = maps_of(w, h, after, after);
            pooled[n] = maps_of(w, h, job.blocks[n][0].convolution.before, 0);
            if (n < kUNetLevels) skip[n] = maps_of(w, h, 3 * after, after);
        }
        place({&input, &skip[0]}, memory);
        place({&between[0], &between[1], &between[2], &between[3], &between[4]}, memory);
        // Every other level's outputs are read while this one's are written.
        place({&out[0], &out[2], &out[4], &pooled[1], &pooled[3]}, memory);
        place({&out[1], &out[3], &pooled[2], &pooled[4]}, memory);
        for (int n = 1; n < kUNetLevels; ++n) place({&skip[n]}, memory);
    }

private:
    static int padded(int size, int* before) {
        const int missing = std::max(kLeastSize - size, (kSizeMultiple - size % kSizeMultiple) % kSizeMultiple);
        *before = missing / 2;
        return size + missing;
    }

    void place(std::initializer_list<ReflectedMaps*> sharing, float* memory) {
        int64_t most = 0;
        for (ReflectedMaps* maps : sharing) {
            maps->data = memory ? memory + floats : nullptr;
            most = std::max(most, floats_of(*maps));
        }
        floats += rounded_up(most, kMostLanes);
    }
};

}  // namespace ggvs
