// The network's channels row by row: plain loops over lines, which any compiler vectorises.
#include "network_inputs.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "parallel.hpp"

namespace ggvs {
namespace {

constexpr int kBandRows = 8;
constexpr float kLeastLength = 1e-12f;  // of the job's unit

// Three lines of a row: a field of vectors.
struct Vectors {
    std::vector<float> lines[3];

    explicit Vectors(int count) {
        for (auto& line : lines) line.resize(count);
    }
};

class Row {
public:
    explicit Row(const NetworkInputs& job)
        : job_(job), per_(std::ldexp(1.0f, -std::ilogb(job.unit))), above_(job.width + 2), here_(job.width + 2), below_(job.width + 2), normals_(job.width), back_(job.width) {}

    void run(int y, float* out) {
        y_ = y, next_ = out + int64_t(y) * job_.width;
        fill_points(std::max(y - 1, 0), above_);
        fill_points(y, here_);
        fill_points(std::min(y + 1, job_.height - 1), below_);
        fill_normals();
        fill_back();
        write();
    }

private:
    int64_t at(int k, int y) const { return (int64_t(k) * job_.height + y) * job_.width; }

    // The surface's points of row y in the target's frame, the first and the last repeated, in units near the job's: a power of
    // two, which rounds nothing.
    void fill_points(int y, Vectors& points) const {
        const float *depth = job_.fused + at(0, y), down = job_.down[y];
        float *x = points.lines[0].data() + 1, *rows = points.lines[1].data() + 1, *z = points.lines[2].data() + 1;
        for (int n = 0; n < job_.width; ++n) {
            z[n] = (depth[n] > 0.0f ? depth[n] : job_.far) * per_;
            x[n] = z[n] * job_.across[n];
            rows[n] = z[n] * down;
        }
        for (auto& line : points.lines) line.front() = line[1], line.back() = line[job_.width];
    }

    // Unit normals towards the camera from central differences, 0 where the pixel or one of its neighbours is unknown.
    void fill_normals() {
        const float* known[3] = {job_.fused + at(0, std::max(y_ - 1, 0)), job_.fused + at(0, y_),
                                 job_.fused + at(0, std::min(y_ + 1, job_.height - 1))};
        for (int x = 0; x < job_.width; ++x) {
            float a[3], b[3];  // along the column and along the row
            for (int c = 0; c < 3; ++c) {
                a[c] = below_.lines[c][x + 1] - above_.lines[c][x + 1];
                b[c] = here_.lines[c][x + 2] - here_.lines[c][x];
            }
            const float n[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
            const float length = std::max(std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), kLeastLength);
            const float unit[3] = {n[0] / length, n[1] / length, n[2] / length};
            const float away = unit[0] * here_.lines[0][x + 1] + unit[1] * here_.lines[1][x + 1] + unit[2] * here_.lines[2][x + 1];
            const int left = std::max(x - 1, 0), right = std::min(x + 1, job_.width - 1);
            const bool whole = (known[1][x] > 0.0f) & (known[1][left] > 0.0f) & (known[1][right] > 0.0f) &
                               (known[0][x] > 0.0f) & (known[2][x] > 0.0f);
            const float facing = whole ? float((away < 0.0f) - (away > 0.0f)) : 0.0f;
            for (int c = 0; c < 3; ++c) normals_.lines[c][x] = unit[c] * facing;
        }
    }

    // Directions from the surface to the target's camera.
    void fill_back() {
        const float *px = here_.lines[0].data() + 1, *py = here_.lines[1].data() + 1, *pz = here_.lines[2].data() + 1;
        float *bx = back_.lines[0].data(), *by = back_.lines[1].data(), *bz = back_.lines[2].data();
        for (int x = 0; x < job_.width; ++x) {
            const float length = std::max(std::sqrt(px[x] * px[x] + py[x] * py[x] + pz[x] * pz[x]), kLeastLength);
            bx[x] = -px[x] / length, by[x] = -py[x] / length, bz[x] = -pz[x] / length;
        }
    }

    // Cosines between the direction to a camera and two other fields.
    void write_cosines(int k, float* to_normal, float* to_back) const {
        const float *centre = job_.centres + 3 * k;
        const float *px = here_.lines[0].data() + 1, *py = here_.lines[1].data() + 1, *pz = here_.lines[2].data() + 1;
        const float *nx = normals_.lines[0].data(), *ny = normals_.lines[1].data(), *nz = normals_.lines[2].data();
        const float *bx = back_.lines[0].data(), *by = back_.lines[1].data(), *bz = back_.lines[2].data();
        const float cx = centre[0] * per_, cy = centre[1] * per_, cz = centre[2] * per_;
        for (int n = 0; n < job_.width; ++n) {
            const float dx = cx - px[n], dy = cy - py[n], dz = cz - pz[n];
            const float length = std::max(std::sqrt(dx * dx + dy * dy + dz * dz), kLeastLength);
            const float x = dx / length, y = dy / length, z = dz / length;
            to_normal[n] = x * nx[n] + y * ny[n] + z * nz[n];
            to_back[n] = x * bx[n] + y * by[n] + z * bz[n];
        }
    }

    float* line() {
        float* to = next_;
        next_ += int64_t(job_.height) * job_.width;
        return to;
    }

    // One line per view, zeros for those that are not there.
    template <class Fill>
    void group(const Fill& fill) {
        for (int k = 0; k < job_.most_views; ++k) {
            float* to = line();
            if (k < job_.views) {
                fill(k, to);
            } else {
                std::fill_n(to, job_.width, 0.0f);
            }
        }
    }

    void write_inverse(const float* depth, float* to) const {
        for (int x = 0; x < job_.width; ++x) to[x] = depth[x] > 0.0f ? job_.unit / depth[x] : 0.0f;
    }

    void write() {
        for (int n = 0; n < 3 * job_.most_views; ++n) {
            float* to = line();
            if (n >= 3 * job_.views) {
                std::fill_n(to, job_.width, 0.0f);
                continue;
            }
            const float* from = job_.colours + 3 * at(n / 3, y_) + n % 3;
            for (int x = 0; x < job_.width; ++x) to[x] = from[3 * x];
        }
        const auto copied = [&](const float* maps) {
            group([&](int k, float* to) { std::copy_n(maps + at(k, y_), job_.width, to); });
        };
        const auto constant = [&](const float* values) {
            group([&](int k, float* to) { std::fill_n(to, job_.width, values[k]); });
        };
        group([&](int k, float* to) { write_inverse(job_.depths + at(k, y_), to); });
        copied(job_.alphas);
        write_inverse(job_.fused + at(0, y_), line());
        float* to_back = next_ + int64_t(job_.most_views) * job_.height * job_.width;
        group([&](int k, float* to) { write_cosines(k, to, to_back + int64_t(k) * job_.height * job_.width); });
        group([](int, float*) {});  // the cosines to the direction back are written already, the absent ones follow here
        constant(job_.distances);
        constant(job_.axes);
        if (job_.seen) copied(job_.seen);
    }

    const NetworkInputs& job_;
    const float per_;
    Vectors above_, here_, below_, normals_, back_;
    int y_ = 0;
    float* next_ = nullptr;
};

}  // namespace

int network_channels(const NetworkInputs& job) { return (job.seen ? 10 : 9) * job.most_views + 1; }

void network_inputs(const NetworkInputs& job, float* out, int threads) {
    parallel_for((job.height + kBandRows - 1) / kBandRows, threads, [&](int band, int) {
        Row row(job);
        for (int y = band * kBandRows; y < std::min((band + 1) * kBandRows, job.height); ++y) row.run(y, out);
    });
}

}  // namespace ggvs
