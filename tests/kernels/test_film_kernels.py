"""What films captures: elementary functions, filters and rays, against NumPy, SciPy, OpenCV and
Embree.
"""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ggvs_eval.kernels import portable
from ggvs_eval.kernels._film import RayTree

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("sin", -1e4, 1e4), ("cos", -1e4, 1e4), ("exp", -80.0, 80.0)],
    ids=["sin", "cos", "exp"],
)
def test_elementary_functions_are_numpys_to_the_last_digits(name, low, high, dtype):
    """Within two units in the last place of the dtype, of its largest value or of each one."""
    values = RNG.uniform(low, high, (300, 50)).astype(dtype)
    exact = getattr(np, name)(values.astype(np.float64))

    computed = getattr(portable, name)(values)

    assert (computed.dtype, computed.shape) == (dtype, values.shape)
    np.testing.assert_allclose(
        computed, exact, rtol=2 * np.finfo(dtype).eps, atol=2 * np.finfo(np.float64).eps
    )


def test_powers_are_numpys():
    """One exponent for all, or one each; zero stays zero."""
    bases, exponents = RNG.uniform(0, 5, 1000), RNG.uniform(0.1, 120, 1000)
    np.testing.assert_allclose(portable.power(bases, 1 / 2.4), bases ** (1 / 2.4), rtol=1e-15)
    np.testing.assert_allclose(portable.power(bases, exponents), bases**exponents, rtol=1e-13)
    single = bases.astype(np.float32)
    np.testing.assert_allclose(
        portable.power(single, 2.4), single.astype(np.float64) ** 2.4, rtol=1.2e-7
    )
    assert portable.power(np.zeros(2), 2.4).tolist() == [0.0, 0.0]


def test_a_number_gives_a_number():
    """Functions of one number are one number, as NumPy's are."""
    assert portable.sin(0.5) == pytest.approx(np.sin(0.5), abs=1e-16)
    assert portable.arctan(-3.0) == pytest.approx(np.arctan(-3.0), abs=1e-15)


def test_matrices_are_numpys():
    """Products, transformed vectors, inverses and lengths."""
    left, right, points = (
        RNG.normal(size=(4, 3)),
        RNG.normal(size=(3, 3)),
        RNG.normal(size=(50, 2, 3)),
    )
    np.testing.assert_allclose(portable.product(left, right), left @ right, atol=1e-14)
    np.testing.assert_allclose(portable.transformed(left, points), points @ left.T, atol=1e-14)
    np.testing.assert_allclose(portable.inverse(right), np.linalg.inv(right), rtol=1e-11)
    np.testing.assert_allclose(portable.length(points), np.linalg.norm(points, axis=-1), rtol=1e-15)


def test_rotations_are_scipys():
    """To the matrix and back, for any angle below half a turn; none at all stays none."""
    for vector in [*RNG.normal(size=(20, 3)) * 0.9, np.array([0.0, 0.0, 0.1]), np.zeros(3)]:
        matrix = portable.rotation_by(vector)
        np.testing.assert_allclose(matrix, Rotation.from_rotvec(vector).as_matrix(), atol=1e-14)
        np.testing.assert_allclose(
            portable.rotation_vector(matrix), Rotation.from_matrix(matrix).as_rotvec(), atol=1e-13
        )


def test_filters_are_opencvs():
    """Means of areas, whole and broken, cubic enlargement and the Gaussian, to the rounding of
    single precision.
    """
    image, grid = RNG.random((60, 84, 3), np.float32), RNG.standard_normal((7, 13), np.float32)
    for height, width in ((30, 42), (20, 84), (17, 23), (1, 1)):
        by_opencv = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).reshape(
            height, width, 3
        )
        np.testing.assert_allclose(portable.shrink(image, height, width), by_opencv, atol=2e-6)
    np.testing.assert_allclose(
        portable.enlarge(grid, 50, 71),
        cv2.resize(grid, (71, 50), interpolation=cv2.INTER_CUBIC),
        atol=4e-6,
    )
    for sigma_px in (1.0, 5.0):
        np.testing.assert_allclose(
            portable.blur(image, sigma_px), cv2.GaussianBlur(image, (0, 0), sigma_px), atol=2e-6
        )


def soup(count):
    """Triangles of all sizes in a unit cube, vertices (3 * count, 3) and faces (count, 3)."""
    corners = RNG.random((count, 1, 3)) + RNG.normal(size=(count, 3, 3)) * RNG.uniform(
        0.01, 0.3, (count, 1, 1)
    )
    return corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.int32).reshape(
        -1, 3
    )


def some_rays(count):
    origins, directions = RNG.uniform(-1, 2, (count, 3)), RNG.normal(size=(count, 3))
    directions[:30, 0] = 0.0  # within the sides of boxes
    directions[30:60, 1:] = 0.0
    return origins.astype(np.float32), directions.astype(np.float32)


def nearest_by_hand(vertices, faces, origins, directions):
    """Moeller and Trumbore's test of every ray against every triangle in double precision:
    distances, inf where none is hit.
    """
    first, second, third = vertices[faces].astype(np.float64).swapaxes(0, 1)
    nearest = np.full(len(origins), np.inf)
    for n, (origin, direction) in enumerate(
        zip(origins.astype(np.float64), directions.astype(np.float64), strict=True)
    ):
        across = np.cross(direction, third - first)
        scale = (across * (second - first)).sum(1)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (across * (origin - first)).sum(1) / scale
            along = np.cross(origin - first, second - first)
            v, distance = (along @ direction) / scale, (along * (third - first)).sum(1) / scale
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (distance >= 0)
        nearest[n] = distance[met].min(initial=np.inf)
    return nearest


def test_rays_hit_what_is_nearest():
    """Distances are those of the slow test of every triangle; weights give back the point; a block
    is a hit within reach.
    """
    vertices, faces = soup(300)
    origins, directions = some_rays(800)
    tree, exact = RayTree(vertices, faces), nearest_by_hand(vertices, faces, origins, directions)

    distance, face, weights = tree.cast(origins, directions)

    hit = face >= 0
    # a ray through an edge may be rounded to either side
    assert (hit == np.isfinite(exact)).mean() > 0.998
    both = hit & np.isfinite(exact)
    assert (np.abs(distance[both] / exact[both] - 1) < 1e-4).mean() > 0.998
    points = np.einsum("nk,nkc->nc", weights[hit], vertices[faces[face[hit]]])
    np.testing.assert_allclose(
        points, origins[hit] + distance[hit, None] * directions[hit], atol=2e-4
    )
    for far in (0.2, 1.0):
        np.testing.assert_array_equal(
            tree.blocks(origins, directions, 0.0, far), hit & (distance <= far)
        )


def test_no_ray_slips_between_two_triangles():
    """Rays at the shared edges and corners of a closed ball all hit it, wherever they come from."""
    angle, height = np.meshgrid(
        np.linspace(0, 2 * np.pi, 24, endpoint=False), np.linspace(-1.2, 1.2, 13)
    )
    points = np.stack(
        [np.cos(height) * np.cos(angle), np.cos(height) * np.sin(angle), np.sin(height)], -1
    )
    vertices = points.reshape(-1, 3).astype(np.float32)
    index = np.arange(len(vertices)).reshape(angle.shape)
    a, b, c, d = index[:-1], np.roll(index[:-1], -1, 1), np.roll(index[1:], -1, 1), index[1:]
    faces = (
        np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3).astype(np.int32)
    )
    ends = vertices[faces]
    targets = np.concatenate(
        [ends[:, 0], *(ends[:, 0] * (1 - t) + ends[:, 1] * t for t in (0.25, 0.5, 0.7))]
    )
    targets = targets[np.abs(targets[:, 2]) < 0.9]
    directions = targets.astype(np.float32)

    distance, face, _ = RayTree(vertices, faces).cast(np.zeros((1, 3), np.float32), directions)

    assert (face >= 0).all()
    np.testing.assert_allclose(distance, 1.0, atol=1e-5)


def test_hits_do_not_depend_on_the_order_of_triangles():
    """Of equally near triangles the first one is hit, whatever tree they are sorted into."""
    vertices, faces = soup(200)
    twice = np.concatenate([faces, faces])
    origins, directions = some_rays(500)

    distance, face, weights = RayTree(vertices, faces).cast(origins, directions)
    again = RayTree(vertices, twice).cast(origins, directions)

    for first, second in zip((distance, face, weights), again, strict=True):
        np.testing.assert_array_equal(first, second)


def test_arrays_must_be_as_the_kernel_reads_them():
    """Another dtype or shape, or a face without its vertex, is an error and no copy."""
    vertices, faces = soup(3)
    with pytest.raises(TypeError, match="vertices: wanted float32"):
        RayTree(vertices.astype(np.float64), faces)
    with pytest.raises(ValueError, match="indices of vertices"):
        RayTree(vertices, faces + 1)
    with pytest.raises(TypeError, match="directions: wanted float32"):
        RayTree(vertices, faces).cast(np.zeros((1, 3), np.float32), np.zeros((2, 2), np.float32))
    empty = RayTree(vertices, np.empty((0, 3), np.int32)).cast(
        np.zeros((1, 3), np.float32), np.ones((2, 3), np.float32)
    )
    assert empty[1].tolist() == [-1, -1]
