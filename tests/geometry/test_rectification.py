"""Rectification: rows agree, disparity is depth, whatever side the partner is on."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.errors import DepthError
from ggvs_eval.geometry.rectification import (
    at_matches,
    depth_from_disparity,
    nearest_disparity,
    rectify,
)
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthEstimator, DepthOptions
from helpers.stereo_scenes import FAR, NEAR, look_from, plane_depth, see_plane

REFERENCE = look_from(0, 0, "reference")
PARTNERS = {
    "right": look_from(0.5, 0, "right"),
    "left": look_from(-0.5, 0, "left"),
    "below": look_from(0, 0.5, "below"),
    "above": look_from(0, -0.5, "above"),
    "oblique": look_from(0.4, 0.3, "oblique"),
    "converging right": look_from(0.8, 0, "converging right", -0.12),
    "converging above": look_from(0, -0.8, "converging above", -0.12),
}
BY_SIDE = pytest.mark.parametrize("side", PARTNERS)


@BY_SIDE
def test_equal_points_lie_on_equal_rows(side):
    """A canvas pixel and its match at any disparity are projections of one point, whose depth is
    depth_scale / disparity.
    """
    pair, partner = rectify(REFERENCE, PARTNERS[side]), PARTNERS[side]
    random = np.random.default_rng(1)
    rows, columns = np.nonzero(pair.left_inside)
    some = random.integers(0, len(rows), 500)
    rows, columns = rows[some], columns[some]
    disparities = random.integers(pair.d_min, pair.d_max + 1, 500)
    uv = pair.left_map[rows, columns]  # (500, 2)
    scale = cv2.remap(
        pair.depth_scale, uv[None], None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )[0]
    matches = columns - disparities
    on_canvas = matches >= 0
    points = REFERENCE.unproject(uv + 0.5, scale / disparities)
    projected, _ = partner.project(points)
    error = np.linalg.norm(projected - 0.5 - pair.right_map[rows, matches], axis=-1)[on_canvas]
    assert on_canvas.mean() > 0.5
    assert error.max() < 0.1


@BY_SIDE
def test_canvas_keeps_the_image(side):
    """Every reference pixel whose point the partner sees somewhere between near and far has a place
    on the canvas.
    """
    pair, partner = rectify(REFERENCE, PARTNERS[side]), PARTNERS[side]
    seen = np.zeros((REFERENCE.height, REFERENCE.width), bool)
    for depth in np.linspace(NEAR, FAR, 8):
        uv, _ = partner.project(
            REFERENCE.unproject(REFERENCE.pixel_centres(), np.full(seen.shape, depth))
        )
        seen |= ((uv > 1) & (uv < np.array(partner.size) - 1)).all(axis=-1)
    places = pair.canvas_map[seen]
    assert (places >= 0).all()
    assert (places <= np.array(pair.size) - 1).all()


def test_disparity_range_holds_near_and_far():
    """No point between near and far has a disparity outside d_min .. d_max."""
    pair = rectify(REFERENCE, PARTNERS["converging right"])
    assert pair.d_min <= (pair.depth_scale / FAR).min()
    assert pair.d_max >= (pair.depth_scale / NEAR).max()


def test_no_depth_between_two_surfaces():
    """At a step of disparity each pixel gets the depth of one side, none in between."""
    pair = rectify(REFERENCE, PARTNERS["right"])
    disparity = np.full(pair.left_inside.shape, pair.d_min + 2, np.float32)
    disparity[:, pair.size[0] // 2 :] = pair.d_max - 2
    depth, _, sampled = depth_from_disparity(pair, disparity, np.ones_like(disparity))
    assert set(np.unique(sampled[depth > 0])) == {
        np.float32(pair.d_min + 2),
        np.float32(pair.d_max - 2),
    }


def test_pairs_without_parallax_are_refused():
    """Two cameras in one place, or one behind the other, raise DepthError naming both."""
    pose = REFERENCE.world_to_camera.copy()
    pose[2, 3] = 1.0
    behind = replace(REFERENCE, name="twin", world_to_camera=pose)
    for partner in (look_from(0, 0, "twin"), behind):
        with pytest.raises(DepthError, match=r"reference.*twin.*parallax"):
            rectify(REFERENCE, partner)


def test_nearest_surfaces_that_leave_the_images_are_no_reason_to_refuse():
    """Cameras 28 degrees apart whose nearest surfaces move by more than they overlap see the plane
    behind them all the same.
    """
    reference, partner = replace(REFERENCE, near=1.0), look_from(3.0, 0, "far", 0.49)
    assert nearest_disparity(reference, partner) > 1
    pair = rectify(reference, partner)
    assert pair.d_max <= pair.size[0]
    depth = plane_depth(reference)
    uv, _ = partner.project(reference.unproject(reference.pixel_centres(), depth))
    seen = ((uv > 1) & (uv < np.array(partner.size) - 1)).all(axis=-1)
    assert seen.mean() > 0.5
    estimated = DepthEstimator(reference, [partner], DepthOptions()).estimate(
        see_plane(reference), [see_plane(partner)]
    )
    known = seen & (estimated.confidence > 0.1)
    assert known.sum() > 0.7 * seen.sum()
    assert np.median(np.abs(estimated.depth[known] / depth[known] - 1)) < 0.003


def test_opposite_cameras_are_refused():
    """Cameras that look too far apart raise DepthError that says to choose another."""
    with pytest.raises(DepthError, match="choose another"):
        rectify(REFERENCE, look_from(0.5, 0, "turned", 1.4))


def message_of(check, *pair) -> str:
    """What a check says of a pair; nothing where it accepts it."""
    try:
        check(*pair)
    except DepthError as error:
        return str(error)
    return ""


@settings(deadline=None)
@given(*(st.floats(-limit, limit) for limit in (2.0, 1.0, 1.0)), st.floats(0.2, 3.0))
def test_what_can_be_rectified_is_known_from_the_corners(x, y, turn, near):
    """Pairs side by side and askew, of near and far surfaces, are accepted and refused as by
    `rectify`, word for word.
    """
    reference = replace(REFERENCE.resized(40, 30), near=near)
    partner = look_from(x, y, "partner", turn).resized(40, 30)
    assert message_of(nearest_disparity, reference, partner) == message_of(
        rectify, reference, partner
    )


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from((np.float32, np.uint8)))
def test_values_at_matches_are_those_of_the_rounded_column(seed, kind):
    """Pixel by pixel: column minus disparity, halves to the even column, zero outside; whatever
    lies in memory backwards too.
    """
    rng = np.random.default_rng(seed)
    right = rng.integers(1, 255, (5, 40)).astype(kind)
    disparity = (rng.integers(-20, 120, right.shape) / 2).astype(np.float32)
    expected = np.zeros_like(right)
    for row, column in np.ndindex(right.shape):
        at = round(float(column - disparity[row, column]))
        if 0 <= at < right.shape[1]:
            expected[row, column] = right[row, at]
    assert np.array_equal(at_matches(right, disparity), expected)
    backwards = at_matches(right[:, ::-1].copy()[:, ::-1], disparity)
    assert backwards.dtype == kind
    assert np.array_equal(backwards, expected)
