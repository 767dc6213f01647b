"""Filling along the edges of colours: against OpenCV's smoother and a dense solution, its laws, and
where it is used.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.depth_store import DepthMap
from ggvs_eval.pipelines.offline.depth.colour_fill import (
    CONFIDENCE,
    beside_jumps,
    fill_by_colour,
    smooth_by_colour,
)


def test_opencv_smooths_the_same():
    """Rows 0, 2, 4 of cv2.ximgproc.createFastGlobalSmootherFilter(image, 9, 20, 0.25,
    3).filter(values), opencv-contrib 5.0.
    """
    random = np.random.default_rng(7)
    image = random.integers(0, 60, (5, 6, 3), dtype=np.uint8)
    values = random.random((5, 6), dtype=np.float32)
    theirs = [
        [0.6014376, 0.547599, 0.64736545, 0.61844456, 0.5784417, 0.5452588],
        [0.61087626, 0.55507106, 0.57844794, 0.57490426, 0.55441064, 0.42349392],
        [0.49208972, 0.41385022, 0.49416763, 0.4986749, 0.47854072, 0.45358932],
    ]

    ours = smooth_by_colour(values[..., None], image, strength=9.0, levels=20.0)[..., 0]

    np.testing.assert_allclose(ours[::2], theirs, rtol=1e-6)


def test_a_line_is_the_solution_of_its_normal_equations():
    """One round of a single row, against a dense solution of (1 + lambda L) u = f in double
    precision.
    """
    random = np.random.default_rng(1)
    image, values = (
        random.integers(0, 256, (1, 9, 3), dtype=np.uint8),
        random.random((1, 9, 2), dtype=np.float32),
    )
    links = 5.0 * np.exp(-np.linalg.norm(np.diff(image[0].astype(float), axis=0), axis=1) / 40.0)
    laplacian = np.diag(np.r_[links, 0] + np.r_[0, links]) - np.diag(links, 1) - np.diag(links, -1)

    line = smooth_by_colour(values, image, strength=5.0, levels=40.0, rounds=1)

    np.testing.assert_allclose(
        line[0], np.linalg.solve(np.eye(9) + laplacian, values[0].astype(float)), rtol=1e-5
    )


def two_walls(height: int = 40, width: int = 60, edge: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """Depth and image of a dark wall at 2 beside a bright one at 4."""
    near = np.broadcast_to(np.arange(width) < edge, (height, width))
    return np.where(near, np.float32(2), np.float32(4)), np.repeat(
        np.where(near, 60, 190)[..., None], 3, -1
    ).astype(np.uint8)


def test_a_hole_across_an_edge_takes_each_side_from_its_own():
    """The edge of the colours becomes that of depth; a fill from the farther side would lose the
    near wall.
    """
    depth, image = two_walls()
    holed = depth.copy()
    holed[12:30, 18:44] = 0

    filled = fill_by_colour(DepthMap(holed, np.ones_like(depth)), image)

    kept = (holed > 0) & ~beside_jumps(holed)
    np.testing.assert_allclose(filled.depth, depth, rtol=1e-3)
    np.testing.assert_array_equal(filled.depth[kept], depth[kept])
    np.testing.assert_array_equal(
        filled.confidence, np.where(kept, np.float32(1), np.float32(CONFIDENCE))
    )


def test_an_edge_of_depth_moves_to_that_of_colours():
    """Depth of a sensor that sees the edge two pixels beside is put right."""
    depth, image = two_walls()
    shifted, _ = two_walls(edge=32)

    mended = fill_by_colour(DepthMap(shifted, np.ones_like(depth)), image).depth

    np.testing.assert_allclose(mended, depth, rtol=1e-2)


def test_jumps_are_neighbours_that_differ():
    """Two pixels on each side of a step of 6 % are near to it, none of a step of 4 %, and none of a
    hole.
    """
    columns = np.broadcast_to(np.arange(12), (5, 12))
    steep, gentle = (
        np.where(columns < 6, np.float32(1), np.float32(step)) for step in (1.06, 1.04)
    )

    assert set(columns[beside_jumps(steep)]) == {3, 4, 5, 6, 7, 8}
    assert not beside_jumps(gentle).any()
    assert not beside_jumps(np.where(columns < 6, np.float32(1), np.float32(0))).any()


def test_what_is_sure_counts_more():
    """Between two depths of one colour the surer one wins."""
    depth = np.zeros((9, 9), np.float32)
    depth[:, 0], depth[:, -1] = 2, 4
    confidence = np.where(depth == 2, np.float32(1), np.float32(0.05)) * (depth > 0)

    filled = fill_by_colour(DepthMap(depth, confidence), np.full((9, 9, 3), 90, np.uint8))

    assert (filled.depth[:, 1:-1] < 2.3).all()


@pytest.mark.parametrize(
    "depth",
    [
        np.zeros((4, 5), np.float32),  # nothing is known
        np.ones((4, 5), np.float32),  # nothing is unknown
    ],
)
def test_nothing_to_fill(depth):
    """The map comes back as it is."""
    depth_map = DepthMap(depth, depth)
    assert fill_by_colour(depth_map, np.zeros((4, 5, 3), np.uint8)) is depth_map


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    scale=st.sampled_from([0.01, 3.0, 1000.0]),
    share=st.floats(0.05, 0.95),
)
def test_units_and_mirrors_change_nothing(seed, scale, share):
    """Depth in other units, or of mirrored images, is filled alike; what is filled lies between
    what was measured.
    """
    random = np.random.default_rng(seed)
    depth = np.where(random.random((13, 17)) < share, random.uniform(1, 5, (13, 17)), 0).astype(
        np.float32
    )
    image, confidence = (
        random.integers(0, 256, (13, 17, 3), dtype=np.uint8),
        random.random((13, 17), dtype=np.float32),
    )

    filled = fill_by_colour(DepthMap(depth, confidence), image).depth
    scaled = fill_by_colour(DepthMap(depth * np.float32(scale), confidence), image).depth
    mirrored = fill_by_colour(DepthMap(depth[:, ::-1], confidence[:, ::-1]), image[:, ::-1]).depth[
        :, ::-1
    ]

    np.testing.assert_allclose(scaled, filled * scale, rtol=1e-3)
    np.testing.assert_allclose(mirrored, filled, rtol=1e-3)
    if depth.any():
        reached, known = filled[(depth == 0) & (filled > 0)], depth[depth > 0]
        assert ((reached >= known.min() * (1 - 1e-4)) & (reached <= known.max() * (1 + 1e-4))).all()
