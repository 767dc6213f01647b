// Pinhole cameras as the kernels need them: lines of pixels and depths mapped from one image into another.
#pragma once

namespace ggvs {

// Zero skew; the centre of pixel (i, j) lies at (i + 0.5, j + 0.5).
struct Pinhole {
    double fx, fy, cx, cy;
    int width, height;
};

// (u, v, depth) of one camera to the homogeneous image point of another: depth * matrix * (u, v, 1) + offset.
struct PixelMap {
    float matrix[9];  // row major
    float offset[3];
};

// With `to_pixels` the result is (u z, v z, z) in the second image, else the point in the second camera's frame.
// `first_to_second` is the rigid 4x4 transform between the two camera frames, row major.
PixelMap pixel_map(const Pinhole& first, const double* first_to_second, const Pinhole& second, bool to_pixels);

}  // namespace ggvs
