// The tree is split where the surface area heuristic over 16 bins says. What a ray hits does not depend on the tree: boxes are left
// a little late (Ize 2013), so that none is passed over that holds a hit. Edges are tested as Embree's robust mode does, by
// Pluecker coordinates about the ray's origin: two triangles disagree by the sign alone on the edge that they share, so that no ray
// slips between them.
#include "ray_tree.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

namespace ggvs {
namespace {

using Masks = int32_t __attribute__((vector_size(16)));

constexpr int kBins = 16, kWidth = 4, kNoChild = std::numeric_limits<int32_t>::min(), kStack = 256;
constexpr float kInfinity = std::numeric_limits<float>::infinity(), kLate = 1.0f + 6 * std::numeric_limits<float>::epsilon();

inline Four all(float value) { return Four{value, value, value, value}; }
inline Four smaller(Four a, Four b) { return a < b ? a : b; }  // b where one of them is NaN
inline Four larger(Four a, Four b) { return a > b ? a : b; }

inline int bits(Masks mask) {
#ifdef __SSE2__
    return __builtin_ia32_movmskps(reinterpret_cast<Four>(mask));
#else
    return (mask[0] & 1) | (mask[1] & 2) | (mask[2] & 4) | (mask[3] & 8);
#endif
}

struct Box {
    std::array<float, 3> low{kInfinity, kInfinity, kInfinity}, high{-kInfinity, -kInfinity, -kInfinity};

    void add(const Box& other) {
        for (int axis = 0; axis < 3; ++axis) {
            low[axis] = std::min(low[axis], other.low[axis]);
            high[axis] = std::max(high[axis], other.high[axis]);
        }
    }
    float area() const {
        const float x = high[0] - low[0], y = high[1] - low[1], z = high[2] - low[2];
        return x < 0 ? 0.0f : x * y + y * z + z * x;
    }
    float middle(int axis) const { return low[axis] + high[axis]; }
};

class Builder {
public:
    Builder(const float* vertices, const int32_t* faces, int64_t count, std::vector<BoxNode>& nodes,
            std::vector<TriangleLeaf>& leaves)
        : vertices_(vertices), faces_(faces), boxes_(count), order_(count), nodes_(nodes), leaves_(leaves) {
        for (int64_t face = 0; face < count; ++face)
            for (int corner = 0; corner < 3; ++corner)
                for (int axis = 0; axis < 3; ++axis) {
                    const float value = vertices[3 * faces[3 * face + corner] + axis];
                    boxes_[face].low[axis] = std::min(boxes_[face].low[axis], value);
                    boxes_[face].high[axis] = std::max(boxes_[face].high[axis], value);
                }
        std::iota(order_.begin(), order_.end(), 0);
        node({0, count, bound(0, count)});
    }

private:
    struct Part {
        int64_t first, last;
        Box box;
        int64_t size() const { return last - first; }
    };

    Box bound(int64_t first, int64_t last) const {
        Box box;
        for (int64_t n = first; n < last; ++n) box.add(boxes_[order_[n]]);
        return box;
    }

    // A node of up to four parts: the part of the largest surface is split until there are so many.
    int32_t node(const Part& whole) {
        std::array<Part, kWidth> parts{whole};
        int count = 1;
        while (count < kWidth) {
            int best = -1;
            for (int n = 0; n < count; ++n)
                if (parts[n].size() > kWidth && (best < 0 || parts[n].box.area() > parts[best].box.area())) best = n;
            if (best < 0) break;
            const int64_t middle = split(parts[best]);
            parts[count++] = {middle, parts[best].last, bound(middle, parts[best].last)};
            parts[best] = {parts[best].first, middle, bound(parts[best].first, middle)};
        }
        const int32_t index = int32_t(nodes_.size());
        nodes_.emplace_back();
        for (int n = 0; n < kWidth; ++n) {
            const int32_t child = n >= count ? kNoChild : parts[n].size() > kWidth ? node(parts[n]) : leaf(parts[n]);
            nodes_[index].child[n] = child;
            for (int axis = 0; axis < 3; ++axis) {
                nodes_[index].low[axis][n] = n < count ? parts[n].box.low[axis] : kInfinity;
                nodes_[index].high[axis][n] = n < count ? parts[n].box.high[axis] : -kInfinity;
            }
        }
        return index;
    }

    int32_t leaf(const Part& part) {
        TriangleLeaf triangles;
        for (int n = 0; n < kWidth; ++n) {
            const int32_t face = order_[part.first + (n < part.size() ? n : 0)];
            triangles.face[n] = face;
            for (int corner = 0; corner < 3; ++corner)
                for (int axis = 0; axis < 3; ++axis)
                    triangles.corner[corner][axis][n] = vertices_[3 * faces_[3 * face + corner] + axis];
        }
        leaves_.push_back(triangles);
        return ~int32_t(leaves_.size() - 1);
    }

    // Sort the part into two and return where the second one begins.
    int64_t split(const Part& part) {
        Box middles;
        for (int64_t n = part.first; n < part.last; ++n) {
            const Box& box = boxes_[order_[n]];
            Box point;
            for (int axis = 0; axis < 3; ++axis) point.low[axis] = point.high[axis] = box.middle(axis);
            middles.add(point);
        }
        float least = kInfinity;
        int best_axis = -1, best_bin = 0;
        for (int axis = 0; axis < 3; ++axis) {
            if (!(middles.high[axis] > middles.low[axis])) continue;
            const auto [cost, bin] = best_cut(part, middles, axis);
            if (cost < least) least = cost, best_axis = axis, best_bin = bin;
        }
        const auto begin = order_.begin() + part.first, end = order_.begin() + part.last;
        if (best_axis >= 0) {
            const auto cut = std::partition(
                begin, end, [&](int32_t face) { return bin_of(boxes_[face], middles, best_axis) < best_bin; });
            if (cut != begin && cut != end) return cut - order_.begin();
        }
        return part.first + part.size() / 2;
    }

    // The cheapest plane across an axis: its cost and the first bin behind it.
    std::pair<float, int> best_cut(const Part& part, const Box& middles, int axis) const {
        std::array<Box, kBins> boxes;
        std::array<int64_t, kBins> counts{};
        for (int64_t n = part.first; n < part.last; ++n) {
            const int bin = bin_of(boxes_[order_[n]], middles, axis);
            boxes[bin].add(boxes_[order_[n]]);
            ++counts[bin];
        }
        std::array<float, kBins> behind{};
        Box box;
        int64_t count = 0;
        for (int bin = kBins - 1; bin > 0; --bin) {
            box.add(boxes[bin]);
            count += counts[bin];
            behind[bin] = box.area() * float(count);
        }
        std::pair<float, int> best{kInfinity, 0};
        box = Box();
        count = 0;
        for (int bin = 1; bin < kBins; ++bin) {
            box.add(boxes[bin - 1]);
            count += counts[bin - 1];
            if (count == 0 || count == part.size()) continue;
            const float cost = box.area() * float(count) + behind[bin];
            if (cost < best.first) best = {cost, bin};
        }
        return best;
    }

    static int bin_of(const Box& box, const Box& middles, int axis) {
        const float share = (box.middle(axis) - middles.low[axis]) / (middles.high[axis] - middles.low[axis]);
        return std::min(int(share * kBins), kBins - 1);
    }

    const float* vertices_;
    const int32_t* faces_;
    std::vector<Box> boxes_;
    std::vector<int32_t> order_;
    std::vector<BoxNode>& nodes_;
    std::vector<TriangleLeaf>& leaves_;
};

struct Corner {
    Four x, y, z;
};

inline Corner operator-(const Corner& a, const Corner& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Corner operator+(const Corner& a, const Corner& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Four dot(const Corner& a, const Corner& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Corner cross(const Corner& a, const Corner& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// Hold the nearest hit of a leaf against the nearest one so far.
inline void meet(const TriangleLeaf& leaf, const Corner& origin, const Corner& direction, float near, RayHit& hit) {
    const auto corner = [&](int n) { return Corner{leaf.corner[n][0], leaf.corner[n][1], leaf.corner[n][2]} - origin; };
    const Corner first = corner(0), second = corner(1), third = corner(2);
    const Corner edge_0 = third - first, edge_1 = first - second, edge_2 = second - third;
    const Four u = dot(cross(edge_0, third + first), direction), v = dot(cross(edge_1, first + second), direction),
               w = dot(cross(edge_2, second + third), direction);
    const Four zero{};
    const Masks inside = ((u >= zero) & (v >= zero) & (w >= zero)) | ((u <= zero) & (v <= zero) & (w <= zero));
    if (!bits(inside)) return;
    const Corner normal = cross(edge_0, edge_1);
    const Four slope = dot(normal, direction), distance = dot(first, normal) / slope;
    int met = bits(inside & (slope != zero) & (distance >= all(near)) & (distance <= all(hit.distance)));
    for (; met; met &= met - 1) {
        const int n = __builtin_ctz(met);
        if (distance[n] == hit.distance && hit.face >= 0 && leaf.face[n] >= hit.face) continue;
        if (distance[n] > hit.distance) continue;
        const float sum = u[n] + v[n] + w[n];
        hit = {distance[n], leaf.face[n], u[n] / sum, v[n] / sum};
    }
}

}  // namespace

RayTree::RayTree(const float* vertices, const int32_t* faces, int64_t face_count) {
    if (face_count) Builder(vertices, faces, face_count, nodes_, leaves_);
}

template <bool kAny>
RayHit RayTree::walk(const Ray& ray) const {
    RayHit hit{ray.far, -1, 0.0f, 0.0f};
    if (nodes_.empty()) return hit;
    const Corner origin{all(ray.origin[0]), all(ray.origin[1]), all(ray.origin[2])};
    const Corner direction{all(ray.direction[0]), all(ray.direction[1]), all(ray.direction[2])};
    const Four from[3] = {origin.x, origin.y, origin.z};
    Four inverse[3], late[3];
    bool backwards[3];
    for (int axis = 0; axis < 3; ++axis) {
        inverse[axis] = all(1.0f / ray.direction[axis]);
        late[axis] = inverse[axis] * all(kLate);
        backwards[axis] = std::signbit(ray.direction[axis]);
    }
    struct Waiting {
        float near;
        int32_t node;
    } stack[kStack];
    int height = 0;
    stack[height++] = {ray.near, 0};
    while (height) {
        const Waiting next = stack[--height];
        if (next.near > hit.distance) continue;
        if (next.node < 0) {
            meet(leaves_[~next.node], origin, direction, ray.near, hit);
            if (kAny && hit.face >= 0) return hit;
            continue;
        }
        const BoxNode& node = nodes_[next.node];
        Four enter = all(ray.near), leave = all(hit.distance);
        for (int axis = 0; axis < 3; ++axis) {
            const Four low = backwards[axis] ? node.high[axis] : node.low[axis];
            const Four high = backwards[axis] ? node.low[axis] : node.high[axis];
            // 0 / 0, where a ray runs within a side of a box, is passed over.
            enter = larger((low - from[axis]) * inverse[axis], enter);
            leave = smaller((high - from[axis]) * late[axis], leave);
        }
        const int first = height;
        for (int entered = bits(enter <= leave); entered; entered &= entered - 1) {
            const int n = __builtin_ctz(entered);
            int place = height++;
            for (; place > first && stack[place - 1].near < enter[n]; --place) stack[place] = stack[place - 1];
            stack[place] = {enter[n], node.child[n]};
        }
    }
    return hit;
}

RayHit RayTree::nearest(const Ray& ray) const { return walk<false>(ray); }

bool RayTree::blocks(const Ray& ray) const { return walk<true>(ray).face >= 0; }

}  // namespace ggvs
