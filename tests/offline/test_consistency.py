"""Depth held against other cameras' depth: who supports, contradicts and abstains, averaging,
filling.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap, is_known
from ggvs_eval.errors import DepthError
from ggvs_eval.pipelines.offline.depth import consistency
from ggvs_eval.pipelines.offline.depth.consistency import check_consistency
from helpers.refusals import refused
from helpers.stereo_scenes import look_from, plane_depth

CAMERA = look_from(0, 0, "camera")
LEFT, RIGHT, BELOW = (
    look_from(-0.4, 0, "left"),
    look_from(0.4, 0, "right"),
    look_from(0, 0.4, "below"),
)
OTHERS = (LEFT, RIGHT, BELOW)
MIDDLE = np.s_[30:120, 40:160]  # seen by all of them
BLOCK = np.s_[60:80, 90:120]
NEAR_Z, FAR_Z = 5.0, 8.0


def sure(depth: np.ndarray, confidence: float = 0.8) -> DepthMap:
    """A depth map of one confidence."""
    depth = depth.astype(np.float32)
    return DepthMap(depth, np.where(depth > 0, np.float32(confidence), np.float32(0)))


def see_planes(cameras: tuple[Camera, ...] = OTHERS) -> list[tuple[Camera, DepthMap]]:
    return [(camera, sure(plane_depth(camera))) for camera in cameras]


def choose(monkeypatch: pytest.MonkeyPatch, **rules: float) -> None:
    """Let other numbers decide what agrees."""
    for name, value in rules.items():
        monkeypatch.setattr(consistency, name, value)


def step_depth(camera: Camera) -> np.ndarray:
    """Exact depth of a strip |x| < 1 at z = 5 before a wall at z = 8, for cameras that look along
    z.
    """
    x = (camera.centre + NEAR_Z * camera.rays())[..., 0]
    return np.where(np.abs(x) < 1, NEAR_Z, FAR_Z)


def test_the_truth_stays():
    """Exact depth of a slanted plane stays, to 1e-5 and at the others' borders 5e-4, and what they
    see is as sure as before.
    """
    truth = plane_depth(CAMERA)
    result = check_consistency(CAMERA, sure(truth), see_planes())
    assert np.abs(result.depth / truth - 1).max() < 5e-4
    assert np.abs(result.depth / truth - 1)[MIDDLE].max() < 1e-5
    assert result.confidence[MIDDLE] == pytest.approx(0.8, abs=1e-6)


def test_what_others_see_through_goes_and_is_filled(monkeypatch):
    """A block in mid-air is dropped; where two others agree on what is behind, it is filled in,
    else it stays unknown.

    The maps that came in stay as they are.
    """
    truth = plane_depth(CAMERA)
    wrong = truth.copy()
    wrong[BLOCK] *= 0.7
    given, others = sure(wrong), see_planes()
    filled = check_consistency(CAMERA, given, others)
    maps = (
        [given, *(theirs for _, theirs in others)],
        [sure(wrong), *(theirs for _, theirs in see_planes())],
    )
    assert all(
        np.array_equal(after.depth, before.depth) for after, before in zip(*maps, strict=True)
    )
    choose(monkeypatch, FILL_SUPPORT=0)
    dropped = check_consistency(CAMERA, sure(wrong), see_planes())
    assert (dropped.depth[BLOCK] == 0).all()
    assert (dropped.confidence[BLOCK] == 0).all()
    assert np.count_nonzero(dropped.depth == 0) == truth[BLOCK].size
    there = filled.depth[BLOCK] > 0
    assert there.mean() > 0.95
    assert np.abs(filled.depth[BLOCK] / truth[BLOCK] - 1)[there].max() < 0.003  # a pixel's slope
    assert filled.confidence[BLOCK][there].max() < 0.8


def test_one_of_two_opinions_fills_nothing():
    """What one of two others sees is no reason to fill a hole; with a single other it is."""
    holed = plane_depth(CAMERA)
    holed[BLOCK] = 0
    blind = RIGHT, sure(np.zeros_like(holed))
    for others, filled in (([*see_planes((LEFT,)), blind], False), (see_planes((LEFT,)), True)):
        result = check_consistency(CAMERA, sure(holed), others)
        assert ((result.depth[BLOCK] > 0).mean() > 0.9) == filled
        assert result.depth[BLOCK].any() == filled


def test_hidden_depth_stays_less_sure():
    """Others that see a nearer surface cannot tell: the depth stays, with half its confidence."""
    deep = plane_depth(CAMERA)
    deep[BLOCK] *= 1.3
    result = check_consistency(CAMERA, sure(deep), see_planes())
    inner = np.s_[64:76, 96:114]
    assert np.array_equal(result.depth[inner], deep[inner].astype(np.float32))
    assert result.confidence[inner] == pytest.approx(0.4)


@pytest.mark.parametrize(
    "others", [[], see_planes((look_from(60, 0, "elsewhere"),))], ids=["nobody", "elsewhere"]
)
def test_nobody_can_judge(others):
    """Without others, or outside all their images, depth stays as it is with half its
    confidence.
    """
    depth_map = sure(plane_depth(CAMERA))
    result = check_consistency(CAMERA, depth_map, others)
    assert np.array_equal(result.depth, depth_map.depth)
    assert result.confidence == pytest.approx(0.4)


def test_average_weighs_by_confidence():
    """An error of 0.4 % beside three exact maps of equal confidence shrinks to a quarter, of a
    third of it to a tenth.
    """
    truth = plane_depth(CAMERA)
    for confidence, left in ((0.9, 0.25), (0.3, 0.1)):
        others = [(camera, sure(plane_depth(camera), 0.9)) for camera in OTHERS]
        result = check_consistency(CAMERA, sure(1.004 * truth, confidence), others)
        assert (result.depth / truth - 1)[MIDDLE] == pytest.approx(0.004 * left, rel=0.15)


def test_agreement_is_measured_in_pixels(monkeypatch):
    """An error that shifts the point by 0.8 px in the others is agreement, one of 1.6 px towards
    the camera is not.
    """
    truth = plane_depth(CAMERA)
    disparity_px = CAMERA.focal_px * 0.4 / truth
    choose(monkeypatch, ERROR_PX=1.0, ERROR_SHARE=0.5, FILL_SUPPORT=0)
    for shift_px, kept in ((0.8, True), (1.6, False)):
        depth = CAMERA.focal_px * 0.4 / (disparity_px + shift_px)
        result = check_consistency(CAMERA, sure(depth), see_planes())
        assert ((result.depth > 0)[MIDDLE] == kept).all()


def test_wide_baselines_are_measured_in_depth(monkeypatch):
    """Where a percent of the depth is many pixels, depths that differ by no more than the share
    agree, and others do not.
    """
    truth = plane_depth(CAMERA)
    for share, wide_share, kept in ((0.01, 0.02, True), (0.01, 0.0, False), (0.03, 0.02, False)):
        choose(monkeypatch, ERROR_PX=0.05, WIDE_SHARE=wide_share, FILL_SUPPORT=0)
        result = check_consistency(CAMERA, sure(truth * (1 - share)), see_planes())
        assert ((result.depth > 0)[MIDDLE] == kept).all()


def test_narrow_baselines_are_measured_in_depth(monkeypatch):
    """Where a pixel is a large share of the depth, depths that differ by more than the share do not
    agree.
    """
    close = look_from(0.02, 0, "close")
    choose(monkeypatch, FILL_SUPPORT=0)
    for share, kept in ((0.03, True), (0.08, False)):
        depth_map = sure(plane_depth(CAMERA) * (1 - share))
        result = check_consistency(CAMERA, depth_map, see_planes((close,)))
        assert ((result.depth > 0)[MIDDLE] == kept).all()


def test_majority(monkeypatch):
    """One who contradicts does not outweigh one who supports, but two do; more support can be asked
    for.
    """
    truth = plane_depth(CAMERA)
    right, behind = [
        [(camera, sure(share * plane_depth(camera))) for camera in OTHERS] for share in (1.0, 1.2)
    ]

    def kept(others, min_support=1):
        choose(monkeypatch, FILL_SUPPORT=0, MIN_SUPPORT=min_support)
        result = check_consistency(CAMERA, sure(truth), others)
        return (result.depth > 0)[MIDDLE].mean()

    assert kept([right[0], behind[1]]) == 1
    assert kept([right[0], behind[1], behind[2]]) == 0
    assert kept([right[0], right[1], behind[2]], min_support=2) == 1
    assert kept([right[0], behind[1]], min_support=2) == 0
    assert kept([right[0]], min_support=2) == 1  # all that see it


def test_guesses_neither_stay_nor_vote():
    """Depth that was filled with hardly any confidence is unknown, in the camera and in the
    others.
    """
    truth = plane_depth(CAMERA)
    guessed = check_consistency(CAMERA, sure(truth, 0.02), [])
    assert not guessed.depth.any()
    assert not guessed.confidence.any()
    others = [(camera, sure(2 * plane_depth(camera), 0.02)) for camera in OTHERS]
    result = check_consistency(CAMERA, sure(truth), others)
    assert np.array_equal(result.depth, truth.astype(np.float32))


def test_edges_survive():
    """A strip before a wall, exact in all views: 99.5 % stays, on its own surface, and nothing is
    invented between the two.
    """
    truth = step_depth(CAMERA)
    others = [(camera, sure(step_depth(camera))) for camera in OTHERS]
    result = check_consistency(CAMERA, sure(truth), others)
    assert (np.abs(result.depth / truth - 1) < 1e-3).mean() > 0.995
    assert not ((result.depth > NEAR_Z + 0.1) & (result.depth < FAR_Z - 0.1)).any()


def test_filling_takes_what_is_in_front():
    """A hole over a strip gets the strip's depth up to its edge, though two others see the wall
    behind it.
    """
    truth = step_depth(CAMERA)
    holed = truth.copy()
    holed[50:100, 40:160] = 0
    others = [(camera, sure(step_depth(camera))) for camera in OTHERS]
    farther = look_from(0.8, 0, "farther right")  # sees the wall alone
    others.append((farther, sure(np.where(step_depth(farther) > NEAR_Z, FAR_Z, 0))))
    filled = check_consistency(CAMERA, sure(holed), others).depth[50:100, 40:160]
    known = filled > 0
    assert np.abs(filled / truth[50:100, 40:160] - 1)[known].max() < 1e-5
    assert known.mean() > 0.99


def test_filling_takes_the_nearest_unless_seen_through():
    """Of two depths that two others each agree on the nearer is filled in, and neither where a
    third sees through it.
    """
    holed = plane_depth(CAMERA)
    holed[BLOCK] = 0
    pairs = [look_from(x, y, f"{x} {y}") for x, y in ((0.4, 0), (-0.4, 0), (0, 0.4), (0, -0.4))]
    near, far = [
        [(camera, sure(share * plane_depth(camera))) for camera in pairs] for share in (0.8, 1.0)
    ]
    alone = check_consistency(CAMERA, sure(holed), near[:2]).depth[BLOCK]
    assert (np.abs(alone / holed.max() - 0.7) < 0.2)[alone > 0].all()
    assert (alone > 0).mean() > 0.9
    both = check_consistency(CAMERA, sure(holed), [*near[:2], *far[2:]]).depth[BLOCK]
    truth = plane_depth(CAMERA)[BLOCK]
    # the near one is seen through by the far two
    assert np.abs(both / truth - 1)[both > 0].max() < 0.003
    assert (both > 0).mean() > 0.9


def test_average_moves_along_the_ray():
    """Half an error remains beside one exact map of a camera turned by half a radian, which sees
    the wall at one depth.
    """
    turned = look_from(-2.0, 0, "turned", 0.5)
    truth = (6 - (CAMERA.centre - turned.centre) @ turned.axis) / (CAMERA.rays() @ turned.axis)
    other = turned, sure(np.full(truth.shape, 6.0))
    result = check_consistency(CAMERA, sure(1.002 * truth), [other])
    evaluated = result.confidence > 0.5
    assert evaluated.mean() > 0.3
    assert (result.depth / truth - 1)[evaluated] == pytest.approx(0.001, rel=0.01)


@settings(max_examples=4, deadline=None)
@given(exponent=st.integers(-8, 8))
def test_units_do_not_matter(exponent):
    """In a world of other units all depths are scaled and nothing else changes, bit for bit for
    powers of two.
    """
    scale = 2.0**exponent
    random = np.random.default_rng(1)

    def scaled(camera):
        pose = camera.world_to_camera.copy()
        pose[:3, 3] *= scale
        return replace(
            camera, world_to_camera=pose, near=camera.near * scale, far=camera.far * scale
        )

    maps = [
        plane_depth(camera) * random.normal(1, 0.03, (camera.height, camera.width))
        for camera in (CAMERA, *OTHERS)
    ]
    plain, other = (
        check_consistency(
            change(CAMERA),
            sure(maps[0] * factor),
            [
                (change(camera), sure(depth * factor))
                for camera, depth in zip(OTHERS, maps[1:], strict=True)
            ],
        )
        for factor, change in ((1.0, lambda camera: camera), (scale, scaled))
    )
    assert np.array_equal(other.depth, plain.depth * np.float32(scale))
    assert np.array_equal(other.confidence, plain.confidence)


def test_maps_of_another_size_are_refused():
    """A map that does not fit its camera raises DepthError naming the camera and both sizes."""
    small = sure(np.ones((10, 20)))
    with refused(DepthError, "camera camera", "150 x 200", "(10, 20)"):
        check_consistency(CAMERA, small, [])
    with refused(DepthError, "camera left", "depth"):
        check_consistency(CAMERA, sure(plane_depth(CAMERA)), [(LEFT, small)])


def on_an_arc(degrees: float, name: str) -> tuple[Camera, np.ndarray]:
    """A camera that looks at a ball in a round room from this side, and its exact depth."""
    angle, size = np.deg2rad(degrees), (160, 120)
    centre = 3 * np.array([np.sin(angle), 0, -np.cos(angle)])
    forward = -centre / 3
    pose = np.eye(4)
    pose[:3, :3] = np.stack([np.cross([0.0, 1.0, 0.0], forward), [0.0, 1.0, 0.0], forward])
    pose[:3, 3] = -pose[:3, :3] @ centre
    camera = Camera(
        name, np.array([[150.0, 0, 80], [0, 150, 60], [0, 0, 1]]), pose, *size, 1.0, 12.0
    )
    rays = camera.rays()
    along, square = rays @ centre, (rays**2).sum(axis=-1)
    ball, room = (along**2 - square * (9 - radius**2) for radius in (1.2, 6.0))
    return camera, np.where(
        ball > 0, -along - np.sqrt(np.maximum(ball, 0)), -along + np.sqrt(room)
    ) / square


@pytest.mark.parametrize("degrees", [90, 100, 120])
def test_views_across_do_not_move_depth(degrees):
    """Two cameras that see one surface across each other: depth is as right as without averaging,
    and never negative.
    """
    (camera, truth), (other, other_truth) = (
        on_an_arc(-degrees / 2, "left"),
        on_an_arc(degrees / 2, "right"),
    )
    maps = []
    for number, exact in enumerate((truth, other_truth)):
        noise = cv2.GaussianBlur(np.random.default_rng(number).normal(size=exact.shape), (0, 0), 4)
        maps.append(sure(exact * (1 + 0.004 * noise / noise.std())))
    averaged = check_consistency(camera, maps[0], [(other, maps[1])]).depth

    errors = [np.abs(depth / truth - 1)[averaged != 0] for depth in (averaged, maps[0].depth)]
    assert (averaged >= 0).all()
    for share in (50, 90, 99):
        assert np.percentile(errors[0], share) <= 1.05 * np.percentile(errors[1], share)


@pytest.mark.parametrize("odd", [-1.2, np.nan, np.inf])
def test_what_is_no_depth_is_unknown(odd):
    """A depth that is negative or not finite neither votes nor stays, however sure it is."""
    for holed in (CAMERA, LEFT):
        maps = {camera: sure(plane_depth(camera)) for camera in (CAMERA, *OTHERS)}
        maps[holed].depth[BLOCK], maps[holed].confidence[BLOCK] = odd, 1
        result = check_consistency(CAMERA, maps.pop(CAMERA), list(maps.items()))
        assert (is_known(result.depth) | (result.depth == 0)).all()
        assert np.abs(result.depth / plane_depth(CAMERA) - 1)[MIDDLE].max() < 0.005
