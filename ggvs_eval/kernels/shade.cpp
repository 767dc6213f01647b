#include "shade.hpp"

#include <algorithm>
#include <vector>

#include "parallel.hpp"

namespace ggvs {

void shade(const Shading& job, uint8_t* out, int threads) {
    const int values = 3 * job.width;
    std::vector<float> across(values);  // of each value of a row
    for (int x = 0; x < values; ++x) across[x] = job.across[x / 3] * job.gain[x % 3];
    parallel_for(job.height, threads, [&](int y, int) {
        const uint8_t* row = job.image + int64_t(y) * values;
        uint8_t* to = out + int64_t(y) * values;
        for (int x = 0; x < values; ++x) {
            const float value = float(row[x]) * (across[x] * job.down[y]);
            to[x] = uint8_t(int(std::min(std::max(value, 0.0f), 255.0f) + 0.5f));
        }
    });
}

}  // namespace ggvs
