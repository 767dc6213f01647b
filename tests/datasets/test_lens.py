"""Lenses: OpenCV's own models, pinhole images without blank pixels, and frames that come back
straight.
"""

import pickle
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ggvs_eval.arrays import Image8
from ggvs_eval.datasets.undistort import UndistortedFrames
from ggvs_eval.errors import CameraError
from ggvs_eval.lens import Lens
from helpers.lens_pictures import pixel_grid, psnr, straight, through_lens, undistorted_points
from helpers.refusals import refused

WIDTH, HEIGHT = 96, 64
K = np.array([[80.0, 0.0, 50.0], [0.0, 81.0, 30.5], [0.0, 0.0, 1.0]])
BARREL = (-0.2, 0.04, 0.001, -0.002, 0.003)
PINCUSHION = (0.15, 0.02, 0.001, -0.001)
RATIONAL = (-0.1, 0.05, 0.002, 0.001, 0.01, 0.05, 0.02, 0.001)
FISHEYE = (0.03, -0.01, 0.004, -0.001)


def make_lens(coefficients=BARREL, model="opencv", matrix=K) -> Lens:
    return Lens(matrix, model, coefficients, WIDTH, HEIGHT)


@dataclass(frozen=True)
class PatternFrames:
    """What a lens makes of the pattern: two frames, the second darker, rendered by formula."""

    lens: Lens
    digest: str = "pattern"
    n_frames: int = 2

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        for frame in range(start, stop):
            yield through_lens(self.lens, 1 / (1 + frame))


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("opencv", BARREL), ("opencv", PINCUSHION), ("opencv", RATIONAL), ("fisheye", FISHEYE)],
    ids=["barrel", "pincushion", "rational", "fisheye"],
)
def test_distortion_is_the_inverse_of_opencv(model, coefficients):
    """Points that are distorted and brought back by OpenCV are where they were, and were elsewhere
    in between.
    """
    lens = make_lens(coefficients, model)
    uv = pixel_grid(WIDTH, HEIGHT)
    distorted = lens.distort(uv, K)
    assert np.abs(distorted - uv).max() > 1.0
    np.testing.assert_allclose(undistorted_points(lens, distorted), uv, atol=1e-4)


def test_distortion_by_hand():
    """One coefficient, one point: the radius grows by 1 + k1 r^2."""
    lens = make_lens((0.5, 0.0, 0.0, 0.0))
    uv = K[:2, 2] + np.array([80.0 * 0.4, 81.0 * 0.3])
    np.testing.assert_allclose(
        lens.distort(uv, K), K[:2, 2] + np.array([80.0 * 0.4, 81.0 * 0.3]) * (1 + 0.5 * 0.25)
    )


def test_barrel_keeps_the_lens_matrix():
    """Barrel distortion leaves no blank pixel, so that K stays."""
    assert np.array_equal(make_lens(BARREL).undistorted_K(), K)


@pytest.mark.parametrize("model", ["opencv", "fisheye"])
def test_pincushion_is_zoomed_just_enough(model):
    """Pincushion distortion is zoomed in until the pinhole image lies in the distorted one and
    touches its border.
    """
    lens = make_lens(PINCUSHION if model == "opencv" else (0.6, 0.1, 0.0, 0.0), model)
    zoomed = lens.undistorted_K()
    assert zoomed[0, 0] / K[0, 0] == pytest.approx(zoomed[1, 1] / K[1, 1])
    assert zoomed[0, 0] > 1.01 * K[0, 0]
    assert np.array_equal(zoomed[:, 2], K[:, 2])
    along_u, along_v = np.linspace(0, WIDTH, 500), np.linspace(0, HEIGHT, 500)
    sides = [np.stack([along_u, np.full(500, v)], -1) for v in (0, HEIGHT)]
    sides += [np.stack([np.full(500, u), along_v], -1) for u in (0, WIDTH)]
    u, v = lens.distort(np.concatenate(sides), zoomed).T
    margin = min(u.min(), v.min(), WIDTH - u.max(), HEIGHT - v.max())
    assert -0.02 < margin < 0.05


def test_no_part_of_the_picture_appears_twice():
    """A model that folds back within the image is zoomed to where it does not; the fold lies at r =
    1 / sqrt(3 * 0.3).
    """
    wide = np.array([[40.0, 0.0, 48.0], [0.0, 40.0, 32.0], [0.0, 0.0, 1.0]])
    zoomed = make_lens((-0.3, 0.0, 0.0, 0.0), matrix=wide).undistorted_K()
    corner = np.hypot(48.0 / zoomed[0, 0], 32.0 / zoomed[1, 1])
    assert 0.9 / np.sqrt(0.9) < corner <= 1.05 / np.sqrt(0.9)


def test_hopeless_coefficients_are_refused():
    """Coefficients that leave blank pixels whatever the zoom are refused with the mend."""
    with refused(CameraError, "blank pixels", "4 times", "calibrate"):
        make_lens((900.0, 0.0, 0.0, 0.0)).undistorted_K()


def test_resized_lens_distorts_likewise():
    """At twice the width and three times the height, every point lies at twice and three times its
    coordinates.
    """
    lens, uv, scale = make_lens(), pixel_grid(WIDTH, HEIGHT), np.array([2.0, 3.0])
    large, K_large = lens.resized(2 * WIDTH, 3 * HEIGHT), np.diag([2.0, 3.0, 1.0]) @ K
    assert (large.width, large.height) == (2 * WIDTH, 3 * HEIGHT)
    np.testing.assert_allclose(large.K, K_large)
    np.testing.assert_allclose(
        large.distort(scale * uv, K_large), scale * lens.distort(uv, K), atol=1e-9
    )


@pytest.mark.parametrize(
    ("model", "coefficients", "message"),
    [
        ("opencv", (0.1, 0.2), "wants 4 or 5 or 8 or 12 or 14 finite coefficients"),
        ("opencv", (0.1, float("nan"), 0.0, 0.0), "finite coefficients"),
        ("fisheye", (0.1, 0.2, 0.3, 0.4, 0.5), "the fisheye model wants 4 finite"),
    ],
)
def test_coefficients_that_are_none(model, coefficients, message):
    """Another count than the model has, or NaN, is refused."""
    with pytest.raises(CameraError, match=message):
        make_lens(coefficients, model)


@pytest.mark.parametrize(
    ("row", "column", "value"),
    [
        (0, 0, 0.0),
        (1, 1, -80.0),
        (0, 1, 3.0),
        (2, 0, 50.0),
        (2, 2, 2.0),
        (0, 2, float("nan")),
        (1, 0, 0.1),
    ],
    ids=["no focal length", "negative", "skew", "transposed", "scaled", "NaN", "lower"],
)
def test_a_matrix_that_is_no_K(row, column, value):
    """What is not fx 0 cx / 0 fy cy / 0 0 1 is refused, with what was found."""
    matrix = K.copy()
    matrix[row, column] = value
    with refused(CameraError, "K ", "fx 0 cx / 0 fy cy / 0 0 1", "zero skew"):
        make_lens(matrix=matrix)


def test_a_lens_has_a_size():
    """An image without width is refused."""
    with refused(CameraError, "size", "0 x 64"):
        replace(make_lens(), width=0)


def test_only_zero_coefficients_make_a_pinhole():
    """An equidistant fisheye lens bends lines with all its coefficients at zero."""
    assert make_lens((0.0,) * 5).is_pinhole
    assert not make_lens((0.0,) * 4, "fisheye").is_pinhole
    assert not make_lens().is_pinhole


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("opencv", BARREL), ("opencv", PINCUSHION), ("fisheye", FISHEYE)],
    ids=["barrel", "pin", "fisheye"],
)
def test_frames_come_back_straight(model, coefficients):
    """A picture rendered through the lens by formula is undistorted to the picture by formula, up
    to the resampling.
    """
    lens = make_lens(coefficients, model)
    target = lens.undistorted_K()
    source = UndistortedFrames(PatternFrames(lens), lens, target)
    assert (source.n_frames, source.size) == (2, (WIDTH, HEIGHT))
    first, second = source.frames(0, 2)
    truth = straight(lens, target)
    error = np.abs(first - truth)
    assert (first.shape, first.dtype) == ((HEIGHT, WIDTH, 3), np.uint8)
    assert psnr(first, truth) > 44
    assert np.percentile(error, 99) < 4
    assert np.abs(second - truth / 2)[5:-5, 5:-5].mean() < 0.6
    # Half a pixel beside the truth would be seen.
    beside = target - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    assert np.abs(first - straight(lens, beside)).mean() > 5 * error.mean()


def test_the_edge_is_not_mixed_with_black():
    """A white picture stays white up to its last pixel where the lens saw all of it, and is black
    where it saw nothing.
    """
    white = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)

    class White(PatternFrames):
        def frames(self, start, stop):
            yield from [white] * (stop - start)

    lens = make_lens(PINCUSHION)
    (seen,) = UndistortedFrames(White(lens), lens, lens.undistorted_K()).frames(0, 1)
    assert seen.min() == 255
    (partly,) = UndistortedFrames(White(lens), lens, K).frames(0, 1)
    assert set(np.unique(partly)) == {0, 255}
    assert partly[[0, 0, -1, -1], [0, -1, 0, -1]].max() == 0


def test_digest_follows_source_lens_and_target():
    """Other frames, other coefficients, another model or another K give another digest; equal ones
    the same.
    """
    lens = make_lens(FISHEYE)
    frames = PatternFrames(lens)
    variants = [
        UndistortedFrames(frames, lens, K),
        UndistortedFrames(replace(frames, digest="other"), lens, K),
        UndistortedFrames(frames, make_lens(PINCUSHION), K),
        UndistortedFrames(frames, make_lens(FISHEYE, "fisheye"), K),
        UndistortedFrames(frames, lens, K + np.diag([1.0, 0, 0])),
    ]
    assert len({variant.digest for variant in variants}) == 5
    assert UndistortedFrames(frames, make_lens(FISHEYE), K.copy()).digest == variants[0].digest


def test_frames_travel_between_processes():
    """The source can be pickled, also after use, and does not carry its maps along."""
    lens = make_lens()
    source = UndistortedFrames(PatternFrames(lens), lens, K)
    used = next(source.frames(1, 2))
    content = pickle.dumps(source)
    assert len(content) < 4000
    assert np.array_equal(next(pickle.loads(content).frames(1, 2)), used)
