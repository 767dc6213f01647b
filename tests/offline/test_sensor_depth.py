"""Depth from a sensor: mixed pixels, speckles, holes, enlarging, confidence, and a real
sequence.
"""

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ggvs_eval.camera import Camera
from ggvs_eval.datasets.rgbd import DepthFrames
from ggvs_eval.depth_store import DepthStore, describe_depth
from ggvs_eval.errors import DepthError
from ggvs_eval.pipelines.offline.sensor import sensor_depth
from ggvs_eval.pipelines.offline.sensor.sensor_depth import (
    SensorDepthEstimator,
    drop_mixed_pixels,
    drop_speckles,
    filter_sensor_depth,
    surface_confidence,
)
from ggvs_eval.pipelines.offline.sensor.sensor_grid import SensorGrid, close_edges, close_holes
from ggvs_eval.pipelines.offline.stereo.fusion import drop_flying_pixels
from helpers.refusals import refused

WIDTH, HEIGHT, FOCAL = 80, 60, 150.0
NEAR_Z, FAR_Z = 2.0, 4.0
STEP = 0.03


@pytest.fixture
def unsmoothed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The filter without its last step, so that depth comes back with its own bits."""
    monkeypatch.setattr(sensor_depth, "smooth_surfaces", lambda depth, *_: depth)


def make_camera(width: int = WIDTH, height: int = HEIGHT) -> Camera:
    K = np.array([[FOCAL, 0, 41.3], [0, 1.02 * FOCAL, 28.6], [0, 0, 1]])
    return Camera("camera", K, np.eye(4), WIDTH, HEIGHT, 0.5, 8.0).resized(width, height)


def plane(
    camera: Camera, across: float = 0.3, down: float = -0.2, distance: float = 3.0
) -> np.ndarray:
    """Depth of z = across x + down y + distance, (H, W)."""
    rays = camera.rays()
    return (distance / (1 - across * rays[..., 0] - down * rays[..., 1])).astype(np.float32)


def grey(camera: Camera) -> np.ndarray:
    return np.full((camera.height, camera.width, 3), 128, np.uint8)


def strip(camera: Camera, left: int, right: int) -> tuple[np.ndarray, np.ndarray]:
    """Exact depth and image of a dark strip at z = 2, columns left..right-1, before a bright wall
    at z = 4.
    """
    columns = np.broadcast_to(np.arange(camera.width), (camera.height, camera.width))
    on_strip = (columns >= left) & (columns < right)
    image = np.repeat(np.where(on_strip, 40, 210)[..., None], 3, axis=-1).astype(np.uint8)
    return np.where(on_strip, np.float32(NEAR_Z), np.float32(FAR_Z)), image


def repeat(depth: np.ndarray, times: int) -> np.ndarray:
    return np.repeat(np.repeat(depth, times, axis=0), times, axis=1)


@pytest.mark.usefixtures("unsmoothed")
def test_mixed_pixels_become_strip_or_wall():
    """A column of depths between strip and wall on each edge is gone; each of its pixels has the
    depth that its colour says.
    """
    camera = make_camera()
    truth, image = strip(camera, 30, 50)
    measured = truth.copy()
    random = np.random.default_rng(0)
    for column in (30, 50):  # one on the strip's side of its edge, one on the wall's
        measured[:, column] = random.uniform(2.3, 3.6, camera.height)
    result = filter_sensor_depth(measured, image, camera)
    assert np.array_equal(result.depth, truth)


@pytest.mark.usefixtures("unsmoothed")
def test_mixed_pixels_do_not_take_slopes():
    """A plane that rays meet up to 78 degrees off its normal has no mixed pixels, at this and at a
    quarter of the resolution.
    """
    for width, height in ((WIDTH, HEIGHT), (WIDTH // 4, HEIGHT // 4)):
        camera = make_camera(width, height)
        steep = plane(camera, 2.0, 0, 2.0)
        steep = np.where((steep > camera.near) & (steep < camera.far), steep, np.float32(0))
        result = filter_sensor_depth(steep, grey(camera), camera)
        assert np.count_nonzero(result.depth) > 0.97 * np.count_nonzero(steep)


def test_two_between_strip_and_wall():
    """Mixed pixels two deep go as well, though two neighbours on the edge agree with each."""
    depth, _ = strip(make_camera(), 30, 50)
    depth[:, 30], depth[:, 31] = 3.3, 2.7
    kept = drop_mixed_pixels(depth, STEP)
    assert (kept[:, 30:32] == 0).all()
    assert (kept[:, :30] > 0).all()
    assert (kept[:, 32:] > 0).all()


def test_lone_pixels_go():
    """A pixel before or behind everything around it is dropped."""
    depth = np.full((9, 9), 4, np.float32)
    for lone in (3.0, 5.0):
        depth[4, 4] = lone
        assert np.argwhere(drop_mixed_pixels(depth, STEP) == 0).tolist() == [[4, 4]]


def test_speckles_go():
    """A patch of 16 pixels in the air is dropped where 20 are wanted and kept where 16 are."""
    depth = np.full((40, 50), 4, np.float32)
    depth[10:14, 20:24] = 2
    expected = depth.copy()
    expected[10:14, 20:24] = 0
    assert np.array_equal(drop_speckles(depth, 20, STEP), expected)
    assert np.array_equal(drop_speckles(depth, 16, STEP), depth)
    assert not drop_speckles(np.zeros((4, 5), np.float32), 20, STEP).any()


@pytest.mark.usefixtures("unsmoothed")
def test_only_the_cameras_range_counts():
    """Depth before near, behind far, infinite or not a number is unknown; where nothing is known,
    all of it.
    """
    camera = make_camera()
    depth = plane(camera)
    for column, value in zip((10, 25, 40, 55, 70), (0.4, 8.1, np.inf, np.nan, -1.0), strict=True):
        depth[20:40, column : column + 8] = value
    result = filter_sensor_depth(depth, grey(camera), camera)
    unknown = ~((depth >= camera.near) & (depth <= camera.far))
    assert not result.depth[unknown].any()
    assert not result.confidence[unknown].any()
    assert np.array_equal(result.depth[~unknown], depth[~unknown])
    assert not filter_sensor_depth(np.zeros_like(depth), grey(camera), camera).depth.any()


def test_narrow_holes_in_a_plane_are_closed_exactly():
    """Holes up to three pixels wide in a slanted plane are filled to 1e-6; wider ones stay, and so
    do those at the border.
    """
    truth = plane(make_camera())
    depth = truth.copy()
    depth[10, 10:13] = depth[20:23, 30:70] = depth[:, 5] = depth[40:44, 40:44] = depth[:, :2] = 0
    closed = close_holes(depth, 3, STEP)
    open_ = np.zeros(depth.shape, bool)
    open_[40:44, 40:44] = open_[:, :2] = True
    assert np.array_equal(closed == 0, open_)
    assert np.abs(closed / truth - 1)[~open_].max() < 1e-6
    assert np.array_equal(close_holes(depth, 0, STEP), depth)


def test_holes_between_surfaces_follow_colour():
    """A hole over an edge of strip and wall is left by the plane filling, then filled as the
    colours say.
    """
    truth, image = strip(make_camera(), 30, 50)
    depth = truth.copy()
    depth[:, 48:52] = depth[10:13, 60:63] = 0
    assert (close_holes(depth, 4, STEP)[:, 48:52] == 0).all()
    assert np.array_equal(close_edges(depth, image, 4), truth)


def test_equal_colours_give_the_background():
    """Where both ends look alike the farther is taken, and a hole that is too wide stays."""
    depth = np.array([[2, 0, 0, 4, 0, 0, 0, 3]], np.float32)
    image = np.zeros((1, 8, 3), np.uint8)
    assert np.array_equal(close_edges(depth, image, 2), [[2, 4, 4, 4, 0, 0, 0, 3]])


@pytest.mark.parametrize("times", [2, 3])
def test_repeated_pixels_are_seen_through(times):
    """The sensor's pixels come back out of a map in which each is repeated, and so does what flies
    among them.
    """
    random = np.random.default_rng(times)
    small = (plane(make_camera(40, 30)) * random.normal(1, 0.001, (30, 40))).astype(np.float32)
    small[12, 17] *= 1.3
    small[:, 0] = 0
    large = repeat(small, times)
    grid = SensorGrid.find(large)
    assert grid.columns.pitch == grid.rows.pitch == times
    assert grid.reduce(large)[12, -40 + 17 + 0] == small[12, 17]
    # a block of equal pixels supports itself
    assert np.array_equal(drop_flying_pixels(large, STEP), large)
    camera = make_camera(40 * times, 30 * times)
    result = filter_sensor_depth(large, grey(camera), camera)
    around = result.depth[10 * times : 15 * times, 15 * times : 20 * times]
    assert (
        np.abs(around / plane(camera)[10 * times : 15 * times, 15 * times : 20 * times] - 1).max()
        < 0.02
    )


def test_wide_gaps_of_a_coarse_sensor_stay():
    """A band of 20 columns that the sensor does not know stays, though all its columns are equal;
    one of 4 is closed.
    """
    small = (
        plane(make_camera(40, 30)) * np.random.default_rng(7).normal(1, 1e-4, (30, 40))
    ).astype(np.float32)
    small[:, 10:20] = small[:, 30:32] = 0
    result = filter_sensor_depth(repeat(small, 2), grey(make_camera()), make_camera())
    assert np.array_equal(
        (result.depth == 0).all(axis=0), (np.arange(80) >= 20) & (np.arange(80) < 40)
    )


def test_confidence_of_a_coarse_sensor_reaches_as_far():
    """Of a sensor with half the resolution, confidence grows over twice as many of the camera's
    pixels.
    """
    small, _ = strip(make_camera(40, 30), 15, 25)
    small *= np.random.default_rng(8).normal(1, 1e-4, small.shape).astype(np.float32)
    profile = filter_sensor_depth(repeat(small, 2), grey(make_camera()), make_camera()).confidence[
        20
    ]
    assert profile[36] > 1.1 * profile[34] > 1.1 * profile[32]  # the edge is at column 30


def test_unevenly_repeated_columns_are_not_coarse():
    """Columns that are equal here and there are the scene's, not a sensor's."""
    depth = (
        np.repeat(np.arange(1, 9, dtype=np.float32), (1, 1, 1, 4, 1, 2, 1, 1))[None]
        + np.arange(6)[:, None]
    )
    assert len(SensorGrid.find(depth.astype(np.float32)).columns.first) == 12


def test_flat_maps_are_not_coarse():
    """A map of one depth, and one whose columns happen to be equal, keep their own pixels."""
    truth, _ = strip(make_camera(), 30, 50)
    for depth in (np.full((6, 9), 3, np.float32), np.zeros((6, 9), np.float32), truth):
        grid = SensorGrid.find(depth)
        assert np.array_equal(grid.columns.first, np.arange(depth.shape[1]))
        assert np.array_equal(grid.reduce(depth), depth)


def test_columns_of_a_scannet_sensor_are_found(tmp_path):
    """Where two intrinsics map the sensor's columns unevenly, each is found once, at the place that
    it shows.
    """
    random = np.random.default_rng(4)
    cv2.imwrite(str(tmp_path / "0.png"), random.integers(1000, 1100, (24, 32)).astype(np.uint16))
    K = np.array([[70.0, 0, 40.0], [0, 70.0, 30.0], [0, 0, 1]])
    K_depth = np.array([[28.6, 0, 15.7], [0, 28.6, 12.1], [0, 0, 1]])
    (depth,) = DepthFrames(tmp_path / "0.png", 0.001, 80, 60, K, K_depth).depths(0, 1)
    columns = SensorGrid.find(depth).columns
    known = columns.first[depth.any(axis=0)[columns.first]]
    assert len(known) == 32
    centres = (np.arange(32) + 0.5 - 15.7) / 28.6 * 70 + 40
    inner = slice(1, -1)  # the outermost are cut off
    found = columns.centre[depth.any(axis=0)[columns.first]]
    assert np.abs(found[inner] - centres[inner]).max() <= 0.75


def test_enlarging_keeps_planes_and_edges():
    """From a third of the size, a plane comes back to 1e-5 and an edge to the pixel where the image
    has it.
    """
    small_camera, camera = make_camera(40, 30), make_camera(120, 90)
    small = plane(small_camera, 1.0)
    grid = SensorGrid.find(small)
    enlarged = grid.enlarge(small, grey(camera), STEP)
    assert np.abs(enlarged / plane(camera, 1.0) - 1)[2:-2, 2:-2].max() < 1e-5
    for left in (44, 45, 46):  # between the middles of the sensor's columns 14 and 15
        truth, image = strip(camera, left, 90)
        depth = strip(small_camera, 15, 30)[0]
        assert np.abs(grid.enlarge(depth, image, STEP) - truth).max() < 1e-5


def test_enlarging_does_not_fill():
    """A pixel is unknown exactly where the nearest of the sensor's is."""
    small = plane(make_camera(40, 30))
    small[10:20, 10:20] = 0
    enlarged = SensorGrid.find(small).enlarge(small, grey(make_camera(80, 60)), STEP)
    assert np.array_equal(enlarged == 0, repeat(small, 2) == 0)


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.0])
def test_confidence_is_the_cosine(angle):
    """In the middle of a plane, confidence is the cosine between ray and normal, over one plus the
    squared share of far.
    """
    camera = make_camera()
    depth = plane(camera, np.tan(angle), 0, 2.0)
    depth[(depth < camera.near) | (depth > camera.far)] = 0
    normal = np.array([np.tan(angle), 0, -1]) * np.cos(angle)
    rays = camera.rays()
    cosine = np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1)
    expected = cosine / (1 + (depth / camera.far) ** 2)
    confidence = surface_confidence(depth, camera, 0.0, 0.2)
    middle = np.s_[10:50, 20:60]
    assert confidence[middle] == pytest.approx(expected[middle], abs=0.01)


def test_confidence_falls_towards_edges():
    """Beside an edge confidence is least, it grows for three pixels and then no more; unknown depth
    has none.
    """
    camera = make_camera()
    depth, _ = strip(camera, 30, 50)
    depth[:, :5] = 0
    profile = surface_confidence(depth, camera, 3.0, STEP)[30]
    assert (np.diff(profile[49:45:-1]) > 0).all()
    assert profile[45] == pytest.approx(profile[41], rel=0.01)
    assert (profile[:5] == 0).all()
    assert 0 < profile[5] < profile[8]
    assert profile.max() <= 1


def test_filled_pixels_are_less_sure():
    """A closed hole has a fifth of the confidence it had if it was measured."""
    camera = make_camera()
    whole, holed = plane(camera), plane(camera)
    holed[30, 40:42] = 0
    sure, filled = (
        filter_sensor_depth(depth, grey(camera), camera).confidence for depth in (whole, holed)
    )
    assert filled[30, 40:42] == pytest.approx(0.2 * sure[30, 40:42], rel=1e-3)


@pytest.mark.usefixtures("unsmoothed")
@settings(
    max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(exponent=st.integers(-8, 8), seed=st.integers(0, 100))
def test_units_do_not_matter(exponent, seed):
    """In a world of other units depth is scaled and confidence as it was."""
    scale = np.float32(2.0**exponent)
    random = np.random.default_rng(seed)
    camera = make_camera()
    large = Camera(
        "camera",
        camera.K,
        np.eye(4),
        WIDTH,
        HEIGHT,
        camera.near * float(scale),
        camera.far * float(scale),
    )
    depth = np.where(random.random((HEIGHT, WIDTH)) < 0.9, plane(camera), 6).astype(np.float32)
    image = random.integers(0, 255, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    plain = filter_sensor_depth(depth, image, camera)
    scaled = filter_sensor_depth(depth * scale, image, large)
    assert np.array_equal(plain.depth > 0, scaled.depth > 0)
    assert np.allclose(scaled.depth, plain.depth * scale, rtol=1e-6)
    assert np.allclose(scaled.confidence, plain.confidence, atol=1e-5)


class Measured:
    """A sensor's depth in memory."""

    def __init__(self, *maps: np.ndarray, digest: str = "abc") -> None:
        self.maps, self.n_frames, self.digest = maps, len(maps), digest

    def depths(self, start, stop):
        yield from self.maps[start:stop]


@pytest.mark.usefixtures("unsmoothed")
def test_estimator_reads_its_frame():
    """Depth of a frame is that frame's, filtered; one that was not measured is named with what
    there is.
    """
    camera = make_camera()
    source = Measured(plane(camera), plane(camera, distance=4.0))
    estimator = SensorDepthEstimator(camera, source)
    for frame in (1, 0):
        assert np.array_equal(estimator.at(frame, grey(camera)).depth, source.maps[frame])
    with refused(DepthError, "camera camera", "frame 2", "2 frames"):
        estimator.at(2, grey(camera))


def test_key_depends_on_the_measurements():
    """Another content of the sensor's files gives another key of the depth store."""
    camera = make_camera()

    def key(digest):
        described = SensorDepthEstimator(camera, Measured(digest=digest)).describe()
        return DepthStore.key(describe_depth(camera, [], {"camera": "frames"}, described))

    assert key("abc") == key("abc") != key("abd")


def test_wrong_inputs_are_refused():
    """Steps of the sensor instead of depth, and an image of another size, raise DepthError that
    says what was wanted.
    """
    camera = make_camera()
    with refused(DepthError, "camera camera", "uint16 (60, 80)", "scale"):
        filter_sensor_depth(np.ones((HEIGHT, WIDTH), np.uint16), grey(camera), camera)
    with refused(DepthError, "camera camera", "(60, 80, 3)", "uint8 (30, 80, 3)"):
        filter_sensor_depth(plane(camera), grey(camera)[:30], camera)
