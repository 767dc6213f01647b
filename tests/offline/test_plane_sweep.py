"""Depth by the plane sweep: closed forms, what must not matter, partners that see little or
nothing, and the way to the store.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from ggvs_eval import kernels
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import DepthError
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthEstimator, DepthOptions
from ggvs_eval.pipelines.offline.depth.depth_stream import DepthStream
from ggvs_eval.pipelines.offline.plane_sweep.plane_sweep import (
    PlaneSweep,
    PlaneSweepEstimator,
    SweepLevel,
)
from ggvs_eval.pipelines.offline.plane_sweep.planes import plan_planes
from ggvs_eval.pipelines.offline.plane_sweep.views import find_hidden, turn_partner
from helpers.refusals import refused
from helpers.stereo_scenes import PLANE, look_from, paint, plane_depth, random_texture, see_plane

CAMERA = look_from(0, 0, "camera")
PARTNERS = [
    look_from(x, y, f"{x:+.1f}{y:+.1f}", turn=0.06)
    for x, y in ((0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5))
]
INNER = np.s_[12:-12, 12:-12]


@pytest.fixture(autouse=True)
def _threads_restored():
    before, before_cv2 = kernels.get_threads(), cv2.getNumThreads()
    yield
    kernels.set_threads(before)
    cv2.setNumThreads(before_cv2)


def sweep(plane=PLANE, partners=PARTNERS, gain=1.0, **options):
    """Raw depth of a plane and its confidence."""
    estimator = PlaneSweepEstimator(CAMERA, partners, PlaneSweep(**options))
    return estimator.estimate(
        see_plane(CAMERA, plane), [see_plane(partner, plane, gain) for partner in partners]
    )


def errors_px(depth, plane=PLANE):
    """Errors away from the border, as the parallax of partners half a unit away, pixels."""
    return 0.5 * CAMERA.focal_px * np.abs(1 / depth - 1 / plane_depth(CAMERA, plane))[INNER]


@pytest.mark.parametrize(
    "plane",
    [np.array([0.0, 0.0, 6.3]), PLANE, np.array([0.0, 0.6, 6.0])],
    ids=["facing", "slanted", "floor"],
)
def test_planes_are_found(plane):
    """A textured plane, facing the camera or not, is found to 0.1 px nearly everywhere, and nearly
    every partner confirms it.
    """
    found = sweep(plane)
    assert np.quantile(errors_px(found.depth, plane), 0.99) < 0.1
    assert np.median(found.confidence[INNER]) > 0.8
    assert found.depth.shape == found.confidence.shape == (CAMERA.height, CAMERA.width)
    assert found.depth.dtype == found.confidence.dtype == np.float32


def test_refinement_finds_the_fraction_of_a_plane():
    """From a surface that is 0.4 planes off, one step leaves a fifth of the error, and from the
    truth it does not go far.
    """
    level = SweepLevel(CAMERA, PARTNERS, PlaneSweep())
    fit = level.fit(level.load(see_plane(CAMERA), [see_plane(partner) for partner in PARTNERS]))
    truth = (1 / plane_depth(CAMERA)).astype(np.float32)
    for off in (-0.4, 0.0, 0.4):
        refined = fit.refine(truth + np.float32(off * level.planes.step), level.planes.step)
        assert np.median(np.abs(refined - truth)[INNER]) < 0.08 * level.planes.step


def card_before_wall():
    """Images of the camera and its partners, and the exact depth: a square card before a wall."""
    near, images = 4.8, []
    for camera in (CAMERA, *PARTNERS):
        wall = plane_depth(camera)
        facing = plane_depth(camera, np.array([0, 0, near]))
        points = camera.unproject(camera.pixel_centres(), facing)
        card = (np.abs(points[..., :2]) < 0.7).all(axis=-1)
        depth = np.where(card, facing, wall)
        texture = random_texture(4)
        images.append(
            np.where(
                card[..., None],
                paint(camera, facing, texture) // 2 + 120,
                paint(camera, wall, random_texture()),
            )
        )
        if camera is CAMERA:
            truth = depth
    return [image.astype(np.uint8) for image in images], truth


def test_an_edge_is_where_it_is_in_the_image():
    """Card and wall are right up to three pixels from the card's edge: what a partner cannot see,
    the one opposite does.
    """
    images, truth = card_before_wall()
    found = PlaneSweepEstimator(CAMERA, PARTNERS, PlaneSweep()).estimate(images[0], images[1:])
    step = cv2.dilate(truth, np.ones((7, 7))) / cv2.erode(truth, np.ones((7, 7))) > 1.05
    wrong = np.abs(found.depth / truth - 1) > 0.02
    assert wrong[INNER][~step[INNER]].mean() < 0.01
    assert wrong[INNER][step[INNER]].mean() < 0.4


def test_without_texture_nobody_is_sure():
    """Grey noise without any texture has less than half the confidence that counts."""
    random = np.random.default_rng(0)
    images = [
        np.clip(128 + random.normal(0, 2, (150, 200, 3)), 0, 255).astype(np.uint8) for _ in range(5)
    ]
    found = PlaneSweepEstimator(CAMERA, PARTNERS, PlaneSweep()).estimate(images[0], images[1:])
    assert np.median(found.confidence) < 0.15
    assert np.isfinite(found.depth).all()
    assert (found.depth > 0).all()


def test_what_the_surface_hides_is_known():
    """Of the wall, only what lies right of the card is hidden from the partner on the left, and a
    rim of one pixel.
    """
    _, truth = card_before_wall()
    planes = plan_planes(CAMERA, PARTNERS, 0.5, 192)
    view = turn_partner(CAMERA, PARTNERS[1], planes, 2)
    hidden = find_hidden(view, (1 / truth).astype(np.float32), 1.5)
    card = np.isclose(truth, 4.8)
    columns = np.flatnonzero(card.any(axis=0))
    parallax = 0.5 * CAMERA.K[0, 0] * (1 / 4.8 - 1 / truth[75, columns[-1] + 1])
    assert hidden[70:80, columns[-1] + 1 : columns[-1] + int(parallax) - 1].all()
    assert not hidden[card].any()
    rim = cv2.dilate(card.astype(np.uint8), np.ones((3, 3))) > 0
    left = slice(None, columns[-1])
    assert not (hidden & ~rim)[:, left].any()


def test_equal_bits_for_any_number_of_threads():
    """Depth and confidence are equal to the bit for 1, 2 and 5 threads, OpenCV's too."""
    results = set()
    for threads in (1, 2, 5):
        kernels.set_threads(threads)
        cv2.setNumThreads(threads)
        found = sweep()
        results.add((found.depth.tobytes(), found.confidence.tobytes()))
    assert len(results) == 1


def test_nothing_is_kept_between_instants():
    """Another instant in between, forgotten or not, changes nothing."""
    estimator = PlaneSweepEstimator(CAMERA, PARTNERS, PlaneSweep())
    images = [see_plane(camera) for camera in (CAMERA, *PARTNERS)]
    others = [see_plane(camera, PLANE + np.array([0, 0, 1])) for camera in (CAMERA, *PARTNERS)]
    first, _, second = (estimator.estimate(each[0], each[1:]) for each in (images, others, images))
    estimator.forget()
    assert np.array_equal(first.depth, second.depth)
    assert np.array_equal(first.depth, estimator.estimate(images[0], images[1:]).depth)


def test_partners_that_see_nothing_take_no_part():
    """A partner that looks away changes no depth and lowers the confidence; where nobody sees
    anything nothing is found.
    """
    away = replace(look_from(0.3, 0, "away"), world_to_camera=np.diag([-1.0, 1.0, -1.0, 1.0]))
    alone, together = sweep(), sweep(partners=[*PARTNERS, away])
    assert np.array_equal(alone.depth, together.depth)
    np.testing.assert_allclose(together.confidence, alone.confidence * 0.8, rtol=1e-5)
    nothing = sweep(partners=[away])
    assert not nothing.depth.any()
    assert not nothing.confidence.any()


def test_small_images():
    """Images down to one pixel give depth within the camera's range, or none."""
    for width, height in ((1, 1), (3, 2), (17, 5), (64, 16)):
        cameras = [camera.resized(width, height) for camera in (CAMERA, *PARTNERS)]
        images = [np.full((height, width, 3), 90, np.uint8) for _ in cameras]
        found = PlaneSweepEstimator(cameras[0], cameras[1:], PlaneSweep()).estimate(
            images[0], images[1:]
        )
        assert found.depth.shape == (height, width)
        assert (
            (found.depth == 0)
            | ((found.depth > 0.5 * CAMERA.near) & (found.depth < 10 * CAMERA.far))
        ).all()


def test_depth_stays_positive_however_far():
    """With a range of 1 to 100 and little parallax, planes are far apart; no step leads behind
    infinity.
    """
    cameras = [
        replace(camera, near=1.0, far=100.0) for camera in (CAMERA, look_from(0.1, 0, "narrow"))
    ]
    images = [
        np.random.default_rng(seed).integers(0, 256, (150, 200, 3)).astype(np.uint8)
        for seed in (1, 2)
    ]
    found = PlaneSweepEstimator(cameras[0], cameras[1:], PlaneSweep(refinements=3)).estimate(
        images[0], images[1:]
    )
    assert ((found.depth > 0.9) & (found.depth < 501)).all()


def test_planes_reach_from_far_to_near():
    """Planes lie evenly in inverse depth and hold the camera's range; a step is as wide as was
    wished, while there are enough.
    """
    planes = plan_planes(CAMERA, PARTNERS, 0.5, 192)
    steps = np.diff(planes.inverse_depths())
    np.testing.assert_allclose(steps, planes.step)
    assert (
        planes.inverse_depths()[0] < 1 / CAMERA.far < 1 / CAMERA.near <= planes.inverse_depths()[-1]
    )
    assert planes.count % 32 == 0
    parallax = 0.5 * CAMERA.focal_px * (1 / CAMERA.near - 1 / CAMERA.far)
    assert parallax / (planes.count - 3) < 0.52
    assert plan_planes(CAMERA, PARTNERS, 0.01, 192).count == 192


def test_the_pipeline_takes_it():
    """`sweep` on the command line is the plane sweep, which the estimator of the pipeline then
    uses, checks and finishes.
    """
    options = DepthRunOptions("sweep").options()
    assert options.matcher == PlaneSweep()
    assert options.describe()["matcher_name"] == PlaneSweep().name
    estimator = DepthEstimator(CAMERA, PARTNERS, options)
    images = [see_plane(partner) for partner in PARTNERS]
    found = estimator.estimate(see_plane(CAMERA), images)
    assert np.quantile(errors_px(found.depth), 0.99) < 0.1
    with refused(DepthError, "4 partner", "got 3"):
        estimator.estimate(see_plane(CAMERA), images[1:])


@pytest.mark.slow
def test_windows_of_a_stream():
    """Where only a part of the picture changes, only its window is swept again; its depth
    is right.
    """
    reuse = DepthOptions(matcher=PlaneSweep(), keyframe_every=4)
    camera, partners = (
        CAMERA.resized(600, 450),
        [partner.resized(600, 450) for partner in PARTNERS[:2]],
    )
    stream = DepthStream(camera, partners, reuse)
    images = [see_plane(each) for each in (camera, *partners)]
    stream.step(0, images[0], images[1:])
    images[0][200:230, 300:330] //= 2
    changed = stream.step(1, images[0], images[1:])
    assert (
        np.quantile(np.abs(changed.depth / plane_depth(camera) - 1)[180:190, 280:350], 0.9) < 0.005
    )
