"""Fall-off of lenses: a planted one comes back, fields that cameras have for themselves do not pass
for one, none is none.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval import kernels
from ggvs_eval.files.images import quantise
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.online.exposure_compensation import (
    ExposureCompensation,
    corner_of,
    fallen_off,
    fit_slope,
    flattened,
    gained_image,
    shared_slope,
    squared_tangents,
)
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions
from helpers.photographs import psnr_db
from helpers.scenes import camera_at, instant, look

TARGET = camera_at(0.2, name="target")
SOURCES = [camera_at(-0.15), camera_at(0.15, 0.2), camera_at(-0.45, -0.1), camera_at(0.45)]
TOLERANCE = 0.05
CORNER = corner_of([TARGET, *SOURCES])


def field(camera, slope: float) -> np.ndarray:
    """What a lens of that slope leaves of each pixel, (H, W, 1)."""
    down, across = squared_tangents(camera)
    return np.exp(slope * (down[:, None] + across))[..., None]


def seen_through(slopes, index: int = 0, gains=(1.0, 1.0, 1.0, 1.0)) -> Instant:
    """An instant whose sources have lenses of these slopes."""
    plain = instant(index, TARGET, SOURCES)
    views = [
        replace(view, image=quantise(view.image / 255.0 * field(view.camera, slope) * gain))
        for view, slope, gain in zip(plain.sources, slopes, gains, strict=True)
    ]
    return replace(plain, sources=tuple(views))


def slope_of(seen: Instant) -> float:
    compensation = ExposureCompensation()
    compensation.gains(seen, TOLERANCE)
    return compensation.slope


@pytest.mark.parametrize("darker", [0.1, 0.2, 0.3])
def test_a_planted_fall_off_comes_back(darker):
    """Corners darker by a tenth to nearly a third, whatever the gains: within a seventh of it,
    never more than there is.
    """
    planted = np.log(1 - darker) / CORNER
    for gains in ((1, 1, 1, 1), (1.05, 0.93, 1.0, 0.97)):
        assert 0.85 * planted > slope_of(seen_through([planted] * 4, gains=gains)) > 1.03 * planted


def test_without_fall_off_nothing_is_touched():
    """Equal cameras, or cameras with gains alone: the slope is exactly 0, and images are what gains
    make of them.
    """
    for gains in ((1, 1, 1, 1), (1.05, 0.93, 1.0, 0.97)):
        seen, compensation = seen_through([0.0] * 4, gains=gains), ExposureCompensation()
        after = compensation.step(seen, TOLERANCE)
        factors = ExposureCompensation().gains(seen, TOLERANCE)
        assert compensation.slope == 0
        for source, view, factor in zip(after.sources, seen.sources, factors, strict=True):
            np.testing.assert_array_equal(source.image, gained_image(view.image, factor))


def test_fields_of_their_own_do_not_pass_for_a_lens():
    """Each camera brighter to one side by up to 4 %, another each: pairs disagree, and nothing is
    concluded.
    """
    seen = seen_through([0.0] * 4)
    tilts = (0.04, -0.03, 0.0, 0.03)
    ramp = np.linspace(-1, 1, TARGET.width)[:, None]
    sources = [
        replace(view, image=quantise(view.image / 255.0 * (1 + tilt * ramp)))
        for view, tilt in zip(seen.sources, tilts, strict=True)
    ]
    assert slope_of(replace(seen, sources=tuple(sources))) == 0


def test_the_picture_is_better_for_it():
    """A target at the side of its sources, behind such a lens itself, is nearer to the truth by
    half a decibel.
    """
    planted = np.log(0.75) / CORNER
    truth = look(TARGET)[0] / 255.0 * field(TARGET, planted)
    seen = seen_through([planted] * 4)
    scores = [
        psnr_db(GeometryGuided(OnlineOptions(compensated=on)).step(seen).image, truth)
        for on in (True, False)
    ]
    assert scores[0] > scores[1] + 0.5


@pytest.mark.parametrize("slope", [-0.4, 0.4])
def test_flattened_and_fallen_off_are_inverse(slope):
    """For one camera the two undo each other but for 8 bit, and nothing is cut off, white corners
    included.
    """
    camera, image = (
        TARGET,
        np.random.default_rng(0)
        .integers(0, 256, (TARGET.height, TARGET.width, 3))
        .astype(np.uint8),
    )
    image[0, 0] = image[36, 48] = 255
    flat = flattened(image, camera, np.ones(3, np.float32), slope, CORNER)
    back = fallen_off(flat.astype(np.float32) / 255, camera, slope, CORNER)
    assert np.abs(back * 255 - image).max() < 1


@pytest.mark.usefixtures("kernel_settings")
def test_threads_give_the_same_bits():
    """One thread or three."""
    seen, images = seen_through([-0.5] * 4), []
    for threads in (1, 3):
        kernels.set_threads(threads)
        images.append(GeometryGuided().step(seen).image)
    np.testing.assert_array_equal(*images)


def test_a_gap_in_time_begins_anew():
    """The slope is the mean of instants; after a gap it is that of the present one alone."""
    compensation, strong, none = ExposureCompensation(), [-0.6] * 4, [0.0] * 4
    slopes = []
    for index, lenses in ((0, strong), (1, none), (3, none)):
        compensation.gains(seen_through(lenses, index), TOLERANCE)
        slopes.append(compensation.slope)
    assert slopes[1] == pytest.approx(slopes[0] / 2)
    assert slopes[2] == 0


@settings(deadline=None)
@given(st.floats(-0.5, 0.5), st.floats(-0.3, 0.3), st.integers(0, 2**32 - 1))
def test_a_slope_is_found_among_outliers(slope, offset, seed):
    """Whatever the offset; a tenth of the look-ups are of other surfaces."""
    random = np.random.default_rng(seed)
    spans = random.uniform(-1, 1, 400)
    ratios = offset + slope * spans + random.normal(0, 0.01, 400)
    ratios[:40] += random.uniform(0.3, 1, 40)
    assert fit_slope(ratios, spans, corner=1.0)[0] == pytest.approx(slope, abs=0.02)


def test_one_pair_is_no_evidence():
    """Two sources cannot tell a lens from their own fields."""
    assert shared_slope([(-0.5, 100.0)], corner=1.0) == 0
    two: list[SourceView] = list(seen_through([-0.5] * 4).sources[:2])
    assert slope_of(replace(seen_through([-0.5] * 4), sources=tuple(two))) == 0
