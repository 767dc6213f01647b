// Layers over batches of points, forward and backward; included once per instruction set, after its vectors and the planes.
// A lane is a point.
#include <cstdint>

namespace ggvs::GGVS_LEVEL {

constexpr int kSpan = kWidth == 16 ? 4 : 2;  // vectors, or columns of a matrix, that one block of registers holds

// out[o][p] = bias[o] + sum over i of weights[o][i] in[i][p], of `kRows` outputs.
template <int kRows>
GGVS_INLINE void affine_rows(const float* weights, const float* biases, int inputs, const float* in, float* out) {
    for (int p = 0; p < kPoints; p += kSpan * kWidth) {
        F sums[kRows][kSpan];
        for (int row = 0; row < kRows; ++row)
            for (int n = 0; n < kSpan; ++n) sums[row][n] = all(biases ? biases[row] : 0.0f);
        for (int i = 0; i < inputs; ++i) {
            F values[kSpan];
            for (int n = 0; n < kSpan; ++n) values[n] = load(in + int64_t(i) * kPoints + p + n * kWidth);
            for (int row = 0; row < kRows; ++row) {
                const F weight = all(weights[int64_t(row) * inputs + i]);
                for (int n = 0; n < kSpan; ++n) sums[row][n] = multiply_add(weight, values[n], sums[row][n]);
            }
        }
        for (int row = 0; row < kRows; ++row)
            for (int n = 0; n < kSpan; ++n) store(out + row * kPoints + p + n * kWidth, sums[row][n]);
    }
}

static void affine(const float* weights, const float* biases, int inputs, int outputs, const float* in, float* out) {
    int o = 0;
    const auto bias = [&](int at) { return biases ? biases + at : nullptr; };
    for (; o + 4 <= outputs; o += 4) affine_rows<4>(weights + int64_t(o) * inputs, bias(o), inputs, in, out + o * kPoints);
    for (; o < outputs; ++o) affine_rows<1>(weights + int64_t(o) * inputs, bias(o), inputs, in, out + o * kPoints);
}

static void apply(const Layer& layer, const float* in, float* out) {
    affine(layer.weights.data(), layer.biases.data(), layer.inputs, layer.outputs, in, out);
}

// sums[o][i] += by[o][p] in[i][p] over p, in kLanes partial sums, of a block of outputs and inputs.
template <int kRows, int kColumns>
GGVS_INLINE void add_products(const float* by, const float* in, int inputs, float* sums) {
    for (int lane = 0; lane < kLanes; lane += kWidth) {
        F totals[kRows][kColumns];
        for (int row = 0; row < kRows; ++row)
            for (int n = 0; n < kColumns; ++n) totals[row][n] = load(sums + (int64_t(row) * inputs + n) * kLanes + lane);
        for (int p = lane; p < kPoints; p += kLanes) {
            F values[kColumns];
            for (int n = 0; n < kColumns; ++n) values[n] = load(in + n * kPoints + p);
            for (int row = 0; row < kRows; ++row) {
                const F given = load(by + row * kPoints + p);
                for (int n = 0; n < kColumns; ++n) totals[row][n] = multiply_add(given, values[n], totals[row][n]);
            }
        }
        for (int row = 0; row < kRows; ++row)
            for (int n = 0; n < kColumns; ++n) store(sums + (int64_t(row) * inputs + n) * kLanes + lane, totals[row][n]);
    }
}

template <int kRows>
GGVS_INLINE void add_rows(const float* by, const float* in, int inputs, float* sums) {
    int i = 0;
    for (; i + kSpan <= inputs; i += kSpan) add_products<kRows, kSpan>(by, in + i * kPoints, inputs, sums + i * kLanes);
    for (; i < inputs; ++i) add_products<kRows, 1>(by, in + i * kPoints, inputs, sums + i * kLanes);
}

// Adds the derivatives by a layer's weights and biases to `sums`, from those by its outputs and from its inputs.
static void add_gradients(const Layer& layer, const float* by, const float* in, float* sums) {
    int o = 0;
    const int64_t row = int64_t(layer.inputs) * kLanes;
    for (; o + 4 <= layer.outputs; o += 4) add_rows<4>(by + o * kPoints, in, layer.inputs, sums + o * row);
    for (; o < layer.outputs; ++o) add_rows<1>(by + o * kPoints, in, layer.inputs, sums + o * row);
    float* biases = sums + layer.outputs * row;
    for (o = 0; o < layer.outputs; ++o)
        for (int p = 0; p < kPoints; p += kWidth) {
            float* total = biases + o * kLanes + p % kLanes;
            store(total, load(total) + load(by + o * kPoints + p));
        }
}

GGVS_INLINE void rectify(float* values, int64_t count) {
    for (int64_t n = 0; n < count; ++n) values[n] = values[n] < 0.0f ? 0.0f : values[n];
}

// What passes a rectifier backwards, from what has passed it forwards.
GGVS_INLINE void mask(float* by, const float* rectified, int64_t count) {
    for (int64_t n = 0; n < count; ++n) by[n] = rectified[n] <= 0.0f ? 0.0f : by[n];
}

GGVS_INLINE void pass_layers(const Field& field, Activations& at) {
    apply(field.trunk, at.features.data(), at.trunk.data());
    rectify(at.trunk.data(), at.trunk.size());
    apply(field.hidden, at.trunk.data(), at.hidden.data());
    rectify(at.hidden.data(), at.hidden.size());
}

static void evaluate_batch(const Field& field, const float* points, int64_t first, int count, const std::vector<Rows>& out,
                           Activations& at) {
    for (int p = 0; p < count; ++p) look_up(field, points + 3 * (first + p), at.features.data() + p);
    pass_layers(field, at);
    const float* in = at.hidden.data();
    for (size_t head = 0; head < field.last.size(); in += int64_t(field.last[head++].inputs) * kPoints) {
        apply(field.last[head], in, at.last.data());
        const int columns = out[head].columns;
        float* rows = out[head].values + first * columns;
        for (int p = 0; p < count; ++p)
            for (int o = 0; o < columns; ++o) rows[p * columns + o] = at.last[o * kPoints + p];
    }
}

static void batch_gradients(const Field& field, const float* points, const int64_t* rows, int count,
                            const std::vector<Rows>& by_out, float* sums, float* by_points, Activations& at) {
    for (int p = 0; p < count; ++p) look_up(field, points + 3 * rows[p], at.features.data() + p);
    pass_layers(field, at);
    const float* in = at.hidden.data();
    float* by_in = at.by_hidden.data();
    for (size_t head = 0; head < field.last.size(); ++head) {
        const Layer& layer = field.last[head];
        std::fill(at.last.begin(), at.last.end(), 0.0f);  // lanes without a point pass nothing back
        for (int p = 0; p < count; ++p)
            for (int o = 0; o < layer.outputs; ++o) at.last[o * kPoints + p] = by_out[head].values[rows[p] * layer.outputs + o];
        add_gradients(layer, at.last.data(), in, sums + layer.sums_at);
        affine(layer.transposed.data(), nullptr, layer.outputs, layer.inputs, at.last.data(), by_in);
        in += int64_t(layer.inputs) * kPoints, by_in += int64_t(layer.inputs) * kPoints;
    }
    mask(at.by_hidden.data(), at.hidden.data(), at.hidden.size());
    add_gradients(field.hidden, at.by_hidden.data(), at.trunk.data(), sums + field.hidden.sums_at);
    affine(field.hidden.transposed.data(), nullptr, field.hidden.outputs, field.hidden.inputs, at.by_hidden.data(),
           at.by_trunk.data());
    mask(at.by_trunk.data(), at.trunk.data(), at.trunk.size());
    add_gradients(field.trunk, at.by_trunk.data(), at.features.data(), sums + field.trunk.sums_at);
    affine(field.trunk.transposed.data(), nullptr, field.trunk.outputs, field.trunk.inputs, at.by_trunk.data(),
           at.by_features.data());
    for (int p = 0; p < count; ++p)
        look_up_gradients(field, points + 3 * rows[p], at.by_features.data() + p, sums, by_points + 3 * rows[p]);
}

}  // namespace ggvs::GGVS_LEVEL
