// Python bindings of what films captures, with the same bits on every processor: rays, elementary functions. The GIL is released
// while they compute; one thread does it, as captures are filmed by one process per core.
#include <limits>

#include "array_arguments.hpp"
#include "elementary.hpp"
#include "ray_tree.hpp"
#include "sources.hpp"

namespace py = pybind11;
using namespace py::literals;

namespace {

using ggvs::data_of, ggvs::shape_of;

ggvs::RayTree tree_of(const py::array& vertices, const py::array& faces) {
    const auto points = shape_of(vertices, "vertices", 2), triangles = shape_of(faces, "faces", 2);
    const float* vertex = data_of<float>(vertices, "vertices", {points[0], 3});
    const int32_t* corner = data_of<int32_t>(faces, "faces", {triangles[0], 3});
    for (py::ssize_t n = 0; n < 3 * triangles[0]; ++n)
        if (corner[n] < 0 || corner[n] >= points[0]) throw py::value_error("faces: wanted indices of vertices");
    py::gil_scoped_release released;
    return ggvs::RayTree(vertex, corner, triangles[0]);
}

// Rays of one origin, (1, 3), or of one each, (N, 3).
class Rays {
public:
    Rays(const py::array& origins, const py::array& directions, float near, float far) : near_(near), far_(far) {
        count = shape_of(directions, "directions", 2)[0];
        const py::ssize_t starts = shape_of(origins, "origins", 2)[0];
        step_ = starts == 1 ? 0 : 3;
        origin_ = data_of<float>(origins, "origins", {starts == 1 ? 1 : count, 3});
        direction_ = data_of<float>(directions, "directions", {count, 3});
    }

    ggvs::Ray operator[](py::ssize_t n) const {
        const float *from = origin_ + step_ * n, *towards = direction_ + 3 * n;
        return {{from[0], from[1], from[2]}, {towards[0], towards[1], towards[2]}, near_, far_};
    }

    py::ssize_t count;

private:
    const float *origin_, *direction_;
    py::ssize_t step_;
    float near_, far_;
};

py::tuple cast(const ggvs::RayTree& tree, const py::array& origins, const py::array& directions) {
    const Rays rays(origins, directions, 0.0f, std::numeric_limits<float>::infinity());
    py::array_t<float> distance(rays.count), weights({rays.count, py::ssize_t(3)});
    py::array_t<int32_t> face(rays.count);
    float *distance_out = distance.mutable_data(), *weight = weights.mutable_data();
    int32_t* face_out = face.mutable_data();
    {
        py::gil_scoped_release released;
        for (py::ssize_t n = 0; n < rays.count; ++n) {
            const ggvs::RayHit hit = tree.nearest(rays[n]);
            distance_out[n] = hit.distance;
            face_out[n] = hit.face;
            weight[3 * n] = 1.0f - (hit.second + hit.third);
            weight[3 * n + 1] = hit.second;
            weight[3 * n + 2] = hit.third;
        }
    }
    return py::make_tuple(distance, face, weights);
}

py::array_t<bool> blocks(const ggvs::RayTree& tree, const py::array& origins, const py::array& directions, float near, float far) {
    const Rays rays(origins, directions, near, far);
    py::array_t<bool> blocked(rays.count);
    bool* out = blocked.mutable_data();
    py::gil_scoped_release released;
    for (py::ssize_t n = 0; n < rays.count; ++n) out[n] = tree.blocks(rays[n]);
    return blocked;
}

// A function of every element of an array of any shape, in its dtype.
template <class T, double (*function)(double)>
py::array_t<T> each(const py::array_t<T, py::array::c_style>& values) {
    py::array_t<T> results(std::vector<py::ssize_t>(values.shape(), values.shape() + values.ndim()));
    const T* from = values.data();
    T* to = results.mutable_data();
    const py::ssize_t count = values.size();
    py::gil_scoped_release released;
    for (py::ssize_t n = 0; n < count; ++n) to[n] = T(function(double(from[n])));
    return results;
}

template <double (*function)(double)>
void bind(py::module_& module, const char* name) {
    module.def(name, &each<float, function>, py::arg("values").noconvert());
    module.def(name, &each<double, function>, "values"_a);
}

// Powers of the elements of an array, by one exponent each or one for all.
template <class T>
py::array_t<T> powers(const py::array_t<T, py::array::c_style>& bases, const py::array_t<double, py::array::c_style>& exponents) {
    if (exponents.size() != 1 && exponents.size() != bases.size()) throw py::value_error("exponents: wanted one, or one each");
    py::array_t<T> results(std::vector<py::ssize_t>(bases.shape(), bases.shape() + bases.ndim()));
    const T* from = bases.data();
    const double* exponent = exponents.data();
    T* to = results.mutable_data();
    const py::ssize_t count = bases.size(), step = exponents.size() == 1 ? 0 : 1;
    py::gil_scoped_release released;
    for (py::ssize_t n = 0; n < count; ++n) to[n] = T(ggvs::power<sizeof(T) == 4>(double(from[n]), exponent[n * step]));
    return results;
}

}  // namespace

PYBIND11_MODULE(_film, module) {
    module.doc() = "What films captures, with the same bits on every processor; ggvs_eval.kernels.portable is the face of it.";
    bind<&ggvs::sine>(module, "sin");
    bind<&ggvs::cosine>(module, "cos");
    bind<&ggvs::exponential<>>(module, "exp");
    module.def("power", &powers<float>, py::arg("bases").noconvert(), "exponents"_a);
    module.def("power", &powers<double>, "bases"_a, "exponents"_a);
    py::class_<ggvs::RayTree>(module, "RayTree")
        .def(py::init(&tree_of), "vertices"_a, "faces"_a)
        .def("cast", &cast, "origins"_a, "directions"_a, "Nearest hits: distance (N,), face (N,), corner weights (N, 3).")
        .def("blocks", &blocks, "origins"_a, "directions"_a, "near"_a, "far"_a,
             "Whether a triangle lies between two multiples of each direction, (N,).");
}
