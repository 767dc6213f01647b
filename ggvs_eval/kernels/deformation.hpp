// A deformation field: features of points from planes in space and time, and layers that turn them into differences of properties.
// The data that pass between the driver (deformation.cpp) and its SIMD parts. ggvs_eval/baselines/fitted/hexplane.py says the same
// in torch, readably.
#pragma once
#include <cstdint>
#include <vector>

namespace ggvs {

constexpr int kTime = 3;        // the axis of time, behind x, y, z
constexpr int kMostPlanes = 6;  // of a level: pairs of the four axes
constexpr int kGroup = 8;       // channels of a node that are looked up together; what is missing to a multiple of it is zero
constexpr int kPoints = 128;    // that pass through the layers together
constexpr int kLanes = 16;      // partial sums of a weight's derivative: the lanes of the widest vector
constexpr int kParts = 8;       // of the points, each with sums of its own: what is added to what does not depend on threads

// Nodes between which points lie, [rows][columns][channels]; one row where the other axis is time, which all points have in common.
struct Plane {
    int first, second;  // axes along columns and rows
    int columns, rows;
    int64_t at;  // of its first node in Field::nodes
};

// A layer as torch keeps it, [outputs][inputs], and the other way round.
struct Layer {
    int inputs, outputs;
    std::vector<float> weights, biases, transposed;
    int64_t sums_at;  // of its first derivative in a part's sums: weights, then biases, kLanes partial sums each
};

struct Field {
    float corner[3], scale[3];  // of the box: a point is at (point - corner) * scale - 1 on the planes
    int channels, groups;       // of a node: those that count, and groups that hold them
    int n_levels, n_planes;     // planes of a level
    std::vector<Plane> planes;  // level by level
    std::vector<float> nodes;
    Layer trunk, hidden;      // `hidden` is that of all heads, one after the other
    std::vector<Layer> last;  // of each head
    int64_t n_sums;           // of a part, those of the planes' nodes first
};

// What the rows of an array are, one per point.
struct Rows {
    float* values;
    int columns;
};

struct FieldGradients {
    float* points;             // (count, 3)
    std::vector<float> nodes;  // as Field::nodes
    std::vector<float> layers; // as a part's sums behind the nodes, one for all lanes
};

// Where a batch passes through the layers, [unit][kPoints] each.
struct Activations {
    std::vector<float> features, trunk, hidden, last, by_features, by_trunk, by_hidden;
    explicit Activations(const Field& field);
};

// Writes the outputs of each head, (count, outputs).
void evaluate_field(const Field& field, const float* points, int64_t count, const std::vector<Rows>& out, int threads, int level);

// Derivatives from those by the outputs of each head. Points by which all of them are zero are passed over.
void field_gradients(const Field& field, const float* points, int64_t count, const std::vector<Rows>& by_out, FieldGradients& out,
                     int threads, int level);

}  // namespace ggvs
