// The U-Net's passes over its maps. Work is cut by rows, whatever the number of threads.
// The arithmetic stands in unet_simd.hpp.
#include "unet.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "aligned.hpp"
#include "crew.hpp"
#include "kernels.hpp"
#include "unet_plan.hpp"

namespace ggvs {
namespace {

constexpr int kBands = 32;  // of rows, enough for many threads

void reflect_columns(float* line, int width) {  // `line` begins at column 0
    line[-1] = line[1];
    line[width] = line[width - 2];
}

// Repeats row y of some channels beyond the border if it is one of those.
void reflect_row(const ReflectedMaps& maps, int y, int first_channel, int channels) {
    const auto copy = [&](int to) {
        std::memcpy(maps.row(to) + first_channel * maps.stride, maps.row(y) + first_channel * maps.stride,
                    sizeof(float) * channels * maps.stride);
    };
    if (y == 1) copy(-1);
    if (y == maps.height - 2) copy(maps.height);
}

class Runner {
public:
    Runner(const UNet& job, float* workspace, int threads, int level)
        : job_(job), plan_(job, workspace), threads_(threads), kernels_(kernels_of(level)), crew_(threads) {}

    void run(float* out) {
        copy_input();
        for (int n = 0; n < kUNetLevels; ++n) {
            run_block(n, n ? plan_.pooled[n] : plan_.input, plan_.between[n], plan_.skip[n]);
            pool(plan_.skip[n], job_.blocks[n][1].convolution.after, plan_.pooled[n + 1]);
        }
        run_block(kUNetLevels, plan_.pooled[kUNetLevels], plan_.between[kUNetLevels], plan_.out[kUNetLevels]);
        for (int n = kUNetLevels - 1; n >= 0; --n) {
            enlarge(plan_.out[n + 1], plan_.skip[n], job_.blocks[n][1].convolution.after);
            run_block(2 * kUNetLevels - n, plan_.skip[n], plan_.between[n], plan_.out[n]);
        }
        finish(out);
    }

private:
    template <class Job>
    void for_rows(int height, const Job& job) {
        const int rows = std::max(1, height / kBands);
        crew_.run((height + rows - 1) / rows, [&](int band, int) {
            for (int y = band * rows; y < std::min((band + 1) * rows, height); ++y) job(y);
        });
    }

    // The border repeated to the margins' width, then reflected.
    void copy_input() {
        const ReflectedMaps& maps = plan_.input;
        for_rows(maps.height, [&](int y) {
            const int from_row = std::clamp(y - plan_.top, 0, job_.height - 1);
            for (int channel = 0; channel < maps.channels; ++channel) {
                const float* from = job_.input + (int64_t(channel) * job_.height + from_row) * job_.width;
                float* line = maps.row(y) + channel * maps.stride + 1;
                std::fill_n(line, plan_.left, from[0]);
                std::memcpy(line + plan_.left, from, sizeof(float) * job_.width);
                std::fill(line + plan_.left + job_.width, line + maps.width, from[job_.width - 1]);
                reflect_columns(line, maps.width);
            }
            reflect_row(maps, y, 0, maps.channels);
        });
    }

    void run_block(int block, const ReflectedMaps& from, const ReflectedMaps& between, const ReflectedMaps& to) {
        convolve(job_.blocks[block][0], from, between);
        convolve(job_.blocks[block][1], between, to);
    }

    // Into the first channels of `to`, normalised.
    void convolve(const UNetLayer& layer, const ReflectedMaps& from, const ReflectedMaps& to) {
        const int64_t sources = int64_t(kStripSources) * layer.convolution.before * kStripLine, row = to.lines * to.stride + kMostLanes;
        AlignedFloats scratch(threads_ * (sources + row));  // a row for those beyond the last one
        std::vector<Moments> moments(to.height);
        crew_.run((to.height + kStripRows - 1) / kStripRows, [&](int strip, int worker) {
            const int first = strip * kStripRows, last = std::min(first + kStripRows, to.height);
            float* memory = scratch.data() + worker * (sources + row);
            convolve_strip(layer, from, to, first, memory, memory + sources);
            for (int y = first; y < last; ++y)
                moments[y] = kernels_.moments_of_row(to.row(y), to.stride, to.width, layer.convolution.after);
        });
        normalise(layer, to, moments);
    }

    // Rows y .. y + kStripRows - 1 of all outputs.
    void convolve_strip(const UNetLayer& layer, const ReflectedMaps& from, const ReflectedMaps& to, int y, float* scratch,
                        float* beyond) const {
        ConvolvedStrip strip{layer.convolution, {}, {}, to.width, to.stride, scratch};
        for (int n = 0; n < kStripSources; ++n) strip.sources[n] = from.row(std::min(y - 1 + n, from.height));
        for (int n = 0; n < kStripRows; ++n) strip.out[n] = y + n < to.height ? to.row(y + n) + 1 : beyond;
        kernels_.convolve_strip(strip);
    }

    void normalise(const UNetLayer& layer, const ReflectedMaps& maps, const std::vector<Moments>& moments) {
        const double count = double(maps.width) * maps.height * layer.convolution.after;
        double sum = 0.0, squares = 0.0;
        for (const Moments& row : moments) sum += row.sum, squares += row.squares;
        const double mean = sum / count, variance = std::max(squares / count - mean * mean, 0.0);
        const double per = 1.0 / std::sqrt(variance + job_.epsilon);
        std::vector<float> gain(layer.convolution.after), shift(layer.convolution.after);
        for (int channel = 0; channel < layer.convolution.after; ++channel) {
            gain[channel] = float(per * layer.gain[channel]);
            shift[channel] = float(layer.shift[channel] - mean * per * layer.gain[channel]);
        }
        for_rows(maps.height, [&](int y) {
            kernels_.normalise_row({maps.row(y), maps.stride, maps.width, layer.convolution.after, gain.data(), shift.data()});
            reflect_row(maps, y, 0, layer.convolution.after);
        });
    }

    // Largest of 3 x 3 values, every second row and column. What is reflected lies in the window already.
    void pool(const ReflectedMaps& from, int channels, const ReflectedMaps& to) {
        for_rows(to.height, [&](int y) {
            std::vector<float> highest(from.stride);
            for (int channel = 0; channel < channels; ++channel) {
                const float* rows[3];
                for (int n = 0; n < 3; ++n) rows[n] = from.row(2 * y + n - 1) + channel * from.stride;
                for (int x = 0; x < from.width + 2; ++x) highest[x] = std::max(std::max(rows[0][x], rows[1][x]), rows[2][x]);
                float* line = to.row(y) + channel * to.stride + 1;
                for (int x = 0; x < to.width; ++x)
                    line[x] = std::max(std::max(highest[2 * x], highest[2 * x + 1]), highest[2 * x + 2]);
                reflect_columns(line, to.width);
            }
            reflect_row(to, y, 0, channels);
        });
    }

    // Twice the size, bilinear, the border repeated, into the channels of `to` from the given one on.
    void enlarge(const ReflectedMaps& from, const ReflectedMaps& to, int first_channel) {
        for_rows(to.height, [&](int y) {
            const float* near = from.row(y / 2);
            const float* far = from.row(std::clamp(y % 2 ? y / 2 + 1 : y / 2 - 1, 0, from.height - 1));
            std::vector<float> mixed(from.width + 2);
            for (int channel = 0; channel < from.channels; ++channel, near += from.stride, far += from.stride) {
                for (int x = 1; x <= from.width; ++x) mixed[x] = 0.75f * near[x] + 0.25f * far[x];
                mixed[0] = mixed[1], mixed[from.width + 1] = mixed[from.width];
                float* line = to.row(y) + (first_channel + channel) * to.stride + 1;
                for (int x = 0; x < from.width; ++x) {
                    line[2 * x] = 0.75f * mixed[x + 1] + 0.25f * mixed[x];
                    line[2 * x + 1] = 0.75f * mixed[x + 1] + 0.25f * mixed[x + 2];
                }
                reflect_columns(line, to.width);
            }
            reflect_row(to, y, first_channel, from.channels);
        });
    }

    // The last layer, 1 x 1, without the margins.
    void finish(float* out) {
        const ReflectedMaps& maps = plan_.out[0];
        const int padded = int(rounded_up(job_.outputs, kGroupOutputs)), before = maps.channels;
        std::vector<float> weights(size_t(before) * padded), bias(padded);
        std::copy_n(job_.last_bias, job_.outputs, bias.begin());
        for (int o = 0; o < job_.outputs; ++o)
            for (int channel = 0; channel < before; ++channel)
                weights[size_t(channel) * padded + o] = job_.last_weights[int64_t(o) * before + channel];
        const Layer layer{before, job_.outputs, padded, weights.data(), bias.data()};
        for_rows(job_.height, [&](int y) {
            std::vector<float> lines(padded * maps.stride);
            kernels_.convolve_row({layer, maps.row(y + plan_.top) + plan_.left + 1, lines.data(), job_.width, maps.stride});
            for (int o = 0; o < job_.outputs; ++o)
                std::memcpy(out + (int64_t(o) * job_.height + y) * job_.width, lines.data() + o * maps.stride,
                            sizeof(float) * job_.width);
        });
    }

    const UNet& job_;
    const Plan plan_;
    const int threads_;
    const Kernels& kernels_;
    Crew crew_;
};

}  // namespace

int64_t unet_workspace(const UNet& job) { return Plan(job).floats; }

void unet(const UNet& job, float* workspace, float* out, int threads, int level) {
    Runner(job, workspace, threads, level).run(out);
}

}  // namespace ggvs
