// Rays and triangles: a tree of boxes, four children wide. Nothing here depends on the processor: four floats at a time are what any
// of them computes at once, nothing is contracted, no reciprocal is approximated, and of equally near triangles the first one is hit.
#pragma once
#include <cstdint>
#include <vector>

namespace ggvs {

using Four = float __attribute__((vector_size(16)));

// Four boxes, SoA. A child is the index of a node, or the complement of the index of a leaf; kNoChild where there is none.
struct BoxNode {
    Four low[3], high[3];
    int32_t child[4];
};

// Up to four triangles, SoA; those that are missing repeat the first one.
struct TriangleLeaf {
    Four corner[3][3];  // corner, axis
    int32_t face[4];
};

struct Ray {
    float origin[3], direction[3];
    float near, far;  // multiples of the direction
};

// Where a ray hits first: the multiple of its direction, the triangle (-1: none), and the weights of its second and third corner.
struct RayHit {
    float distance;
    int32_t face;
    float second, third;
};

class RayTree {
public:
    // Vertices (V, 3) and faces (F, 3), indices that lie within the vertices.
    RayTree(const float* vertices, const int32_t* faces, int64_t face_count);

    RayHit nearest(const Ray& ray) const;
    bool blocks(const Ray& ray) const;

private:
    template <bool kAny>
    RayHit walk(const Ray& ray) const;

    std::vector<BoxNode> nodes_;
    std::vector<TriangleLeaf> leaves_;
};

}  // namespace ggvs
