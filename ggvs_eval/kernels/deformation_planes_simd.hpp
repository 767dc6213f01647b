// Features of one point from planes, and what they pass back; included once per instruction set, after its vectors.
// Vectors of eight channels are the compiler's own here, so that every level adds in the same order; no FMA.
#include <cstdint>

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"  // nothing of this is called from elsewhere
#endif

namespace ggvs::GGVS_LEVEL {

typedef float Channels __attribute__((vector_size(4 * kGroup), aligned(4)));

GGVS_INLINE Channels channels_at(const float* p) {
    Channels x;
    __builtin_memcpy(&x, p, sizeof x);
    return x;
}

GGVS_INLINE void add_at(float* p, const Channels& x) {
    const Channels sum = channels_at(p) + x;
    __builtin_memcpy(p, &sum, sizeof sum);
}

GGVS_INLINE float sum_of(const Channels& x) { return ((x[0] + x[4]) + (x[2] + x[6])) + ((x[1] + x[5]) + (x[3] + x[7])); }

// Between which two nodes of an axis a point lies, how far, and how fast that changes over the axis; 0 at and beyond the border.
struct Spot {
    int low, high;
    float share, slope;
};

GGVS_INLINE Spot spot_of(float where, int nodes) {
    const float last = float(nodes - 1);
    float at = ((where + 1.0f) * 0.5f) * last;
    const bool inside = at > 0.0f && at < last;
    at = at > 0.0f ? (at < last ? at : last) : 0.0f;
    const int low = nodes > 1 ? (int(at) < nodes - 2 ? int(at) : nodes - 2) : 0;
    return {low, nodes > 1 ? low + 1 : 0, at - float(low), inside ? 0.5f * last : 0.0f};
}

// The nodes around a point, in Field::nodes; a line has the first two alone.
struct Corners {
    int64_t at[4];
    Spot column, row;
};

GGVS_INLINE Corners corners_of(const Field& field, const Plane& plane, const float* where) {
    const int64_t stride = int64_t(kGroup) * field.groups;
    Corners corners;
    corners.column = spot_of(where[plane.first], plane.columns);
    const int64_t low = plane.at + corners.column.low * stride, high = plane.at + corners.column.high * stride;
    if (plane.second == kTime) {
        corners.at[0] = low, corners.at[1] = high;
        return corners;
    }
    corners.row = spot_of(where[plane.second], plane.rows);
    const int64_t top = corners.row.low * plane.columns * stride, bottom = corners.row.high * plane.columns * stride;
    corners.at[0] = low + top, corners.at[1] = high + top, corners.at[2] = low + bottom, corners.at[3] = high + bottom;
    return corners;
}

GGVS_INLINE Channels sample(const Plane& plane, const Corners& corners, const float* nodes) {
    const float right = corners.column.share, left = 1.0f - right;
    const Channels upper = channels_at(nodes + corners.at[0]) * left + channels_at(nodes + corners.at[1]) * right;
    if (plane.second == kTime) return upper;
    const Channels lower = channels_at(nodes + corners.at[2]) * left + channels_at(nodes + corners.at[3]) * right;
    return upper * (1.0f - corners.row.share) + lower * corners.row.share;
}

GGVS_INLINE void place_of(const Field& field, const float* point, float* where) {
    for (int axis = 0; axis < 3; ++axis) where[axis] = (point[axis] - field.corner[axis]) * field.scale[axis] - 1.0f;
}

// Writes the features of a point to out[0], out[kPoints], ...
GGVS_INLINE void look_up(const Field& field, const float* point, float* out) {
    float where[3];
    place_of(field, point, where);
    for (int level = 0; level < field.n_levels; ++level) {
        const Plane* planes = field.planes.data() + level * field.n_planes;
        Corners corners[kMostPlanes];
        for (int n = 0; n < field.n_planes; ++n) corners[n] = corners_of(field, planes[n], where);
        for (int group = 0; group < field.groups; ++group) {
            const float* nodes = field.nodes.data() + kGroup * group;
            Channels product = sample(planes[0], corners[0], nodes);
            for (int n = 1; n < field.n_planes; ++n) product *= sample(planes[n], corners[n], nodes);
            const int count = std::min(kGroup, field.channels - kGroup * group);
            float* features = out + int64_t(level * field.channels + kGroup * group) * kPoints;
            for (int c = 0; c < count; ++c) features[c * kPoints] = product[c];
        }
    }
}

// Adds the derivatives by the nodes of one plane, from those by its sample.
GGVS_INLINE void spread(const Plane& plane, const Corners& corners, const Channels& by_sample, float* sums) {
    const float right = corners.column.share, left = 1.0f - right;
    if (plane.second == kTime) {
        add_at(sums + corners.at[0], by_sample * left);
        add_at(sums + corners.at[1], by_sample * right);
        return;
    }
    const Channels upper = by_sample * (1.0f - corners.row.share), lower = by_sample * corners.row.share;
    add_at(sums + corners.at[0], upper * left);
    add_at(sums + corners.at[1], upper * right);
    add_at(sums + corners.at[2], lower * left);
    add_at(sums + corners.at[3], lower * right);
}

// Adds the derivatives by the place of the point along the plane's axes, channel by channel.
GGVS_INLINE void add_slopes(const Plane& plane, const Corners& corners, const Channels& by_sample, const float* nodes, Channels* by_where) {
    const Channels across = channels_at(nodes + corners.at[1]) - channels_at(nodes + corners.at[0]);
    if (plane.second == kTime) {
        by_where[plane.first] += by_sample * across * corners.column.slope;
        return;
    }
    const Channels below = channels_at(nodes + corners.at[3]) - channels_at(nodes + corners.at[2]);
    const Channels left = channels_at(nodes + corners.at[2]) - channels_at(nodes + corners.at[0]);
    const Channels right = channels_at(nodes + corners.at[3]) - channels_at(nodes + corners.at[1]);
    const float x = corners.column.share, y = corners.row.share;
    by_where[plane.first] += by_sample * (across * (1.0f - y) + below * y) * corners.column.slope;
    by_where[plane.second] += by_sample * (left * (1.0f - x) + right * x) * corners.row.slope;
}

// Adds the derivatives by the planes' nodes and writes those by the point, from those by its features: by[0], by[kPoints], ...
GGVS_INLINE void look_up_gradients(const Field& field, const float* point, const float* by, float* sums, float* by_point) {
    float where[3];
    place_of(field, point, where);
    Channels by_where[3] = {};
    for (int level = 0; level < field.n_levels; ++level) {
        const Plane* planes = field.planes.data() + level * field.n_planes;
        Corners corners[kMostPlanes];
        for (int n = 0; n < field.n_planes; ++n) corners[n] = corners_of(field, planes[n], where);
        for (int group = 0; group < field.groups; ++group) {
            const float* nodes = field.nodes.data() + kGroup * group;
            const int count = std::min(kGroup, field.channels - kGroup * group);
            const float* features = by + int64_t(level * field.channels + kGroup * group) * kPoints;
            Channels samples[kMostPlanes], before[kMostPlanes], given = {};
            for (int c = 0; c < count; ++c) given[c] = features[c * kPoints];
            for (int n = 0; n < field.n_planes; ++n) {
                before[n] = given;  // times the samples of all planes before this one
                samples[n] = sample(planes[n], corners[n], nodes);
                given *= samples[n];
            }
            Channels after = Channels{} + 1.0f;
            for (int n = field.n_planes - 1; n >= 0; --n) {
                const Channels by_sample = before[n] * after;
                spread(planes[n], corners[n], by_sample, sums + kGroup * group);
                add_slopes(planes[n], corners[n], by_sample, nodes, by_where);
                after *= samples[n];
            }
        }
    }
    for (int axis = 0; axis < 3; ++axis) by_point[axis] = sum_of(by_where[axis]) * field.scale[axis];
}

}  // namespace ggvs::GGVS_LEVEL
