// Python bindings of the plane sweep, of semi-global matching and of what moves edges of depth. Whatever comes, no kernel reads or
// writes beyond its arrays; the GIL is released while one runs.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <memory>
#include <string>
#include <tuple>
#include <vector>

#include "array_arguments.hpp"
#include "block_match.hpp"
#include "edge_enlarge.hpp"
#include "plane_sweep.hpp"
#include "sgm.hpp"
#include "sources.hpp"
#include "subpixel.hpp"
#include "weighted_median.hpp"

namespace py = pybind11;
using namespace py::literals;
using ggvs::data_of;
using ggvs::shape_of;

namespace {

constexpr int kMaxSide = 65535;

void require(bool condition, const char* message) {
    if (!condition) throw py::value_error(message);
}

void check_size(py::ssize_t height, py::ssize_t width, const char* message) {
    require(height >= 1 && width >= 1 && height <= kMaxSide && width <= kMaxSide, message);
}

void check_planes(py::ssize_t planes) {
    require(planes >= ggvs::kPathPlanes && planes <= ggvs::kMaxPlanes && planes % ggvs::kPathPlanes == 0,
            "planes: wanted a multiple of 32, at most 256");
}

// (image, first, last, visible or None, motion)
ggvs::SweepPartner read_partner(const py::tuple& values, py::ssize_t height, py::ssize_t width) {
    require(values.size() == 5, "partner: wanted (image, first, last, visible or None, motion)");
    const auto size = shape_of(py::cast<py::array>(values[0]), "image", 2);
    require(std::min(size[0], size[1]) >= 2 && std::max(size[0], size[1]) <= kMaxSide,
            "image: wanted 2 x 2 to 65535 x 65535 pixels");
    ggvs::SweepPartner partner{};
    partner.height = int(size[0]), partner.width = int(size[1]);
    partner.image = data_of<float>(values[0], "image", size);
    partner.first = data_of<float>(values[1], "first", {size[0]});
    partner.last = data_of<float>(values[2], "last", {size[0]});
    partner.visible = values[3].is_none() ? nullptr : data_of<uint8_t>(values[3], "visible", {height, width});
    const float* motion = data_of<float>(values[4], "motion", {7});
    std::copy(motion, motion + 2, partner.start);
    std::copy(motion + 2, motion + 4, partner.slope);
    std::copy(motion + 4, motion + 6, partner.origin);
    partner.along = motion[6];
    return partner;
}

// (radius, colour_scale, distance_scale, noise)
ggvs::SweepWindow read_window(const std::tuple<int, float, float, float>& values) {
    const auto [radius, colour_scale, distance_scale, noise] = values;
    require(radius >= 1 && radius <= ggvs::kMaxRadius, "window: wanted a radius of 1 to 3 pixels");
    require(colour_scale > 0 && distance_scale > 0 && noise > 0, "window: wanted positive scales and noise");
    return {radius, colour_scale, distance_scale, noise};
}

py::array_t<uint8_t> sweep_planes(const py::array& reference, const py::array& guide, const std::vector<py::tuple>& partners,
                                  const std::tuple<int, float, float, float>& window, float hidden_weight,
                                  const std::tuple<float, float, int>& planes, const py::array& ranges, int threads, int level) {
    const auto size = shape_of(reference, "reference", 2);
    check_size(size[0], size[1], "reference: wanted 1 x 1 to 65535 x 65535 pixels");
    require(!partners.empty() && partners.size() <= ggvs::kMaxPartners, "partners: wanted 1 to 16");
    const auto [first, step, count] = planes;
    check_planes(count);
    ggvs::SweepTask task{data_of<float>(reference, "reference", size),
                         data_of<uint8_t>(guide, "guide", {size[0], size[1], 3}),
                         int(size[0]),
                         int(size[1]),
                         read_window(window),
                         hidden_weight,
                         first,
                         step,
                         count,
                         {}};
    for (const py::tuple& partner : partners) task.partners.push_back(read_partner(partner, size[0], size[1]));
    const py::ssize_t down = (size[0] + ggvs::kTileRows - 1) / ggvs::kTileRows;
    const py::ssize_t across = (size[1] + ggvs::kTileColumns - 1) / ggvs::kTileColumns;
    const int32_t* range_data = data_of<int32_t>(ranges, "ranges", {down, across, 2});
    py::array_t<uint8_t> costs({size[0], size[1], py::ssize_t(count)});
    uint8_t* out = costs.mutable_data();
    {
        py::gil_scoped_release released;
        ggvs::sweep_planes(task, range_data, out, threads, level);
    }
    return costs;
}

py::tuple aggregate(const py::array& costs, const py::array& guide, int small_step, const py::array& large_steps, int threads,
                    int level) {
    const auto size = shape_of(costs, "costs", 3);
    check_size(size[0], size[1], "costs: wanted 1 x 1 to 65535 x 65535 pixels");
    check_planes(size[2]);
    const ggvs::SgmTask task{data_of<uint8_t>(costs, "costs", size),
                             data_of<uint8_t>(guide, "guide", {size[0], size[1]}),
                             int(size[0]),
                             int(size[1]),
                             int(size[2]),
                             small_step,
                             data_of<uint8_t>(large_steps, "large_steps", {256})};
    const int largest = *std::max_element(task.large_steps, task.large_steps + 256);
    require(small_step >= 0 && small_step + largest <= ggvs::kLargestPenalties, "steps: wanted at most 128 together");
    py::array_t<float> surface({size[0], size[1]}), margin({size[0], size[1]});
    const ggvs::SgmResult result{surface.mutable_data(), margin.mutable_data()};
    {
        py::gil_scoped_release released;
        const int64_t volume = int64_t(task.height) * task.width * task.planes;
        const std::unique_ptr<uint8_t[]> means(new uint8_t[volume]);  // not set to zero, which would take its time
        ggvs::aggregate(task, means.get(), result, threads, level);
    }
    return py::make_tuple(surface, margin);
}

py::array_t<int16_t> match_blocks(const py::array& left, const py::array& right, int count, int radius, int small_step,
                                  int large_step, int threads, int level) {
    const auto size = shape_of(left, "left", 2);
    check_size(size[0], size[1], "left: wanted 1 x 1 to 65535 x 65535 pixels");
    require(count >= ggvs::kDisparityStep && count % ggvs::kDisparityStep == 0 && count < size[1],
            "count: wanted a multiple of 16 that is less than the width");
    require(radius >= 0 && radius <= kMaxSide && small_step >= 0 && small_step <= large_step, "steps: wanted the larger one second");
    const int64_t block = (2 * int64_t(radius) + 1) * (2 * int64_t(radius) + 1);
    require(3 * (block * ggvs::kLargestDifference + large_step) < ggvs::kLargestTotal, "block, steps: wanted three paths that cost less than 32767 together");
    const ggvs::BlockTask task{data_of<uint8_t>(left, "left", size),
                               data_of<uint8_t>(right, "right", size),
                               int(size[0]),
                               int(size[1]),
                               count,
                               radius,
                               small_step,
                               large_step};
    py::array_t<int16_t> disparity({size[0], size[1]});
    int16_t* out = disparity.mutable_data();
    {
        py::gil_scoped_release released;
        ggvs::match_blocks(task, out, threads, level);
    }
    return disparity;
}

// All of a task but what its callers add.
ggvs::SubpixelTask read_matches(const py::array& left, const py::array& right, const py::array& disparity) {
    const auto size = shape_of(left, "left", 2);
    check_size(size[0], size[1], "left: wanted 1 x 1 to 65535 x 65535 pixels");
    ggvs::SubpixelTask task{};
    task.left = data_of<uint8_t>(left, "left", size), task.right = data_of<uint8_t>(right, "right", size);
    task.disparity = data_of<float>(disparity, "disparity", size);
    task.height = int(size[0]), task.width = int(size[1]);
    return task;
}

py::array_t<float> sample_matches(const py::array& right, const py::array& disparity) {
    const ggvs::SubpixelTask task = read_matches(right, right, disparity);
    py::array_t<float> matched({task.height, task.width});
    float* out = matched.mutable_data();
    {
        py::gil_scoped_release released;
        ggvs::sample_matches(task, out);
    }
    return matched;
}

py::array_t<float> refine_matches(const py::array& left, const py::array& right, const py::array& slope,
                                  const py::array& disparity, float gain, int window, int iterations, float largest_step,
                                  float noise) {
    ggvs::SubpixelTask task = read_matches(left, right, disparity);
    task.slope = data_of<float>(slope, "slope", {task.height, task.width});
    require(window >= 1 && window <= kMaxSide && noise > 0, "window: wanted 1 to 65535 pixels, and noise above 0");
    task.gain = gain, task.window = window, task.largest_step = largest_step, task.noise = noise;
    py::array_t<float> refined({task.height, task.width});
    float* out = refined.mutable_data();
    {
        py::gil_scoped_release released;
        ggvs::refine_matches(task, iterations, out);
    }
    return refined;
}

py::array_t<float> weighted_median(const py::array& surface, const py::array& guide, int planes, int radius, float colour_scale,
                                   float tolerance, int threads) {
    const auto size = shape_of(surface, "surface", 2);
    check_size(size[0], size[1], "surface: wanted 1 x 1 to 65535 x 65535 pixels");
    require(planes >= 1 && planes <= ggvs::kMaxPlanes, "planes: wanted 1 to 256");
    require(radius >= 0 && radius <= kMaxSide && colour_scale > 0 && tolerance >= 0,
            "median: wanted a radius of 0 to 65535 pixels, a positive colour scale and a tolerance of at least 0");
    const ggvs::MedianTask task{data_of<float>(surface, "surface", size),
                                data_of<uint8_t>(guide, "guide", {size[0], size[1], 3}),
                                int(size[0]),
                                int(size[1]),
                                planes,
                                radius,
                                colour_scale,
                                tolerance};
    py::array_t<float> filtered({size[0], size[1]});
    float* out = filtered.mutable_data();
    {
        py::gil_scoped_release released;
        ggvs::weighted_median(task, out, threads);
    }
    return filtered;
}

py::tuple enlarge_to_edges(const py::array& depth, const py::array& confidence, const py::array& small_image,
                           const py::array& image, const py::array& smooth, float same_surface, int threads) {
    const auto small = shape_of(depth, "depth", 2), size = shape_of(smooth, "smooth", 2);
    check_size(small[0], small[1], "depth: wanted 1 x 1 to 65535 x 65535 pixels");
    check_size(size[0], size[1], "smooth: wanted 1 x 1 to 65535 x 65535 pixels");
    const ggvs::EdgeTask task{data_of<float>(depth, "depth", small),
                              data_of<float>(confidence, "confidence", small),
                              data_of<uint8_t>(small_image, "small_image", {small[0], small[1], 3}),
                              data_of<uint8_t>(image, "image", {size[0], size[1], 3}),
                              data_of<float>(smooth, "smooth", size),
                              int(size[0]),
                              int(size[1]),
                              int(small[0]),
                              int(small[1]),
                              same_surface};
    py::array_t<float> depths({size[0], size[1]}), confidences({size[0], size[1]});
    float *deep = depths.mutable_data(), *sure = confidences.mutable_data();
    {
        py::gil_scoped_release released;
        ggvs::enlarge_to_edges(task, deep, sure, threads);
    }
    return py::make_tuple(depths, confidences);
}

}  // namespace

PYBIND11_MODULE(_stereo, module) {
    module.doc() = "Plane sweep over several partners, semi-global matching and edges of depth maps.";
    module.attr("TILE_SIZE") = py::make_tuple(ggvs::kTileColumns, ggvs::kTileRows);
    module.attr("COST_LIMIT") = ggvs::kCostLimit;
    module.def("sweep_planes", &sweep_planes, "reference"_a, "guide"_a, "partners"_a, "window"_a, "hidden_weight"_a, "planes"_a,
               "ranges"_a, "threads"_a, "level"_a, "Costs of planes of constant depth, (H, W, planes) uint8.");
    module.def("aggregate", &aggregate, "costs"_a, "guide"_a, "small_step"_a, "large_steps"_a, "threads"_a, "level"_a,
               "Semi-global matching: the surface in planes and its margin, (H, W) each.");
    module.def("match_blocks", &match_blocks, "left"_a, "right"_a, "count"_a, "radius"_a, "small_step"_a, "large_step"_a,
               "threads"_a, "level"_a, "Semi-global block matching: disparity in sixteenths of a pixel, (H, W) int16.");
    module.def("sample_matches", &sample_matches, "right"_a, "disparity"_a, "Grey values at the matches of pixels, (H, W).");
    module.def("refine_matches", &refine_matches, "left"_a, "right"_a, "slope"_a, "disparity"_a, "gain"_a, "window"_a,
               "iterations"_a, "largest_step"_a, "noise"_a, "Disparity by least squares on the images, (H, W).");
    module.def("weighted_median", &weighted_median, "surface"_a, "guide"_a, "planes"_a, "radius"_a, "colour_scale"_a,
               "tolerance"_a, "threads"_a, "A surface with its edges moved to those of the guide, (H, W).");
    module.def("enlarge_to_edges", &enlarge_to_edges, "depth"_a, "confidence"_a, "small_image"_a, "image"_a, "smooth"_a,
               "same_surface"_a, "threads"_a, "Depth and confidence at the size of an image, ending at its edges, (H, W) each.");
}
