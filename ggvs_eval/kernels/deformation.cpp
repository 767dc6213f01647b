// The deformation field over all points: batches on threads, and sums whose order no thread changes.
#include "deformation.hpp"

#include <algorithm>
#include <stdexcept>

#include "deformation_levels.hpp"
#include "parallel.hpp"

namespace ggvs {

const FieldKernels& field_kernels(int level) {
#if defined(__x86_64__)
    if (level == kAvx512) return kAvx512Field;
    if (level == kAvx2) return kAvx2Field;
#endif
    if (level == kBaseline) return kBaselineField;
    throw std::invalid_argument("no such instruction set here");
}

Activations::Activations(const Field& field)
    : features(size_t(field.trunk.inputs) * kPoints),
      trunk(size_t(field.trunk.outputs) * kPoints),
      hidden(size_t(field.hidden.outputs) * kPoints),
      by_features(features.size()),
      by_trunk(trunk.size()),
      by_hidden(hidden.size()) {
    int most = 0;
    for (const Layer& layer : field.last) most = std::max(most, layer.outputs);
    last.resize(size_t(most) * kPoints);
}

void evaluate_field(const Field& field, const float* points, int64_t count, const std::vector<Rows>& out, int threads, int level) {
    const FieldKernels& kernels = field_kernels(level);
    std::vector<Activations> at(std::max(1, threads), Activations(field));
    parallel_for(int((count + kPoints - 1) / kPoints), threads, [&](int batch, int worker) {
        const int64_t first = int64_t(batch) * kPoints;
        kernels.evaluate(field, points, first, int(std::min<int64_t>(kPoints, count - first)), out, at[worker]);
    });
}

namespace {

bool is_asked(const std::vector<Rows>& by_out, int64_t row) {
    for (const Rows& by : by_out)
        for (int o = 0; o < by.columns; ++o)
            if (by.values[row * by.columns + o] != 0.0f) return true;
    return false;
}

// The sum of kLanes partial sums, in an order that every instruction set has.
float total_of(const float* lanes) {
    float sums[kLanes / 2];
    for (int n = 0; n < kLanes / 2; ++n) sums[n] = lanes[n] + lanes[n + kLanes / 2];
    for (int half = kLanes / 4; half; half /= 2)
        for (int n = 0; n < half; ++n) sums[n] += sums[n + half];
    return sums[0];
}

}  // namespace

void field_gradients(const Field& field, const float* points, int64_t count, const std::vector<Rows>& by_out, FieldGradients& out,
                     int threads, int level) {
    const FieldKernels& kernels = field_kernels(level);
    std::fill_n(out.points, 3 * count, 0.0f);
    std::vector<std::vector<float>> sums(kParts);
    parallel_for(kParts, threads, [&](int part, int) {
        sums[part].assign(field.n_sums, 0.0f);
        Activations at(field);
        int64_t rows[kPoints];
        int held = 0;
        const auto pass = [&] {
            if (held) kernels.gradients(field, points, rows, held, by_out, sums[part].data(), out.points, at);
            held = 0;
        };
        for (int64_t row = count * part / kParts; row < count * (part + 1) / kParts; ++row) {
            if (!is_asked(by_out, row)) continue;
            rows[held++] = row;
            if (held == kPoints) pass();
        }
        pass();
    });
    const int64_t n_nodes = int64_t(field.nodes.size()), n_layers = (field.n_sums - n_nodes) / kLanes;
    out.nodes.resize(n_nodes), out.layers.resize(n_layers);
    parallel_for(kParts, threads, [&](int piece, int) {
        for (int64_t n = n_nodes * piece / kParts; n < n_nodes * (piece + 1) / kParts; ++n) {
            float total = 0.0f;
            for (int part = 0; part < kParts; ++part) total += sums[part][n];
            out.nodes[n] = total;
        }
        for (int64_t n = n_layers * piece / kParts; n < n_layers * (piece + 1) / kParts; ++n) {
            float total = 0.0f;
            for (int part = 0; part < kParts; ++part) total += total_of(sums[part].data() + n_nodes + n * kLanes);
            out.layers[n] = total;
        }
    });
}

}  // namespace ggvs
