"""Colour between cameras: planted gains are found, the free one is fixed, and the picture is better
for it.
"""

from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.files.images import quantise
from ggvs_eval.geometry.per_pixel import view_weights
from ggvs_eval.method import Instant
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.online.exposure_compensation import (
    GAUGE_POWER,
    ExposureCompensation,
    gained_image,
)
from helpers.photographs import psnr_db
from helpers.scenes import camera_at, instant, look

TARGET = camera_at(0.0, name="target")
SOURCES = [camera_at(-0.15), camera_at(0.15), camera_at(-0.45), camera_at(0.45)]
GAINS = np.array(
    [[1.06, 1.03, 1.0], [0.95, 0.97, 0.99], [1.02, 0.98, 1.04], [0.94, 1.05, 1.0]], np.float32
)
TOLERANCE = 0.05


def planted(index: int, sources=SOURCES, gains=GAINS) -> Instant:
    """An instant whose sources have gains of their own."""
    plain = instant(index, TARGET, sources)
    views = [
        replace(view, image=quantise(view.image / np.float32(255) * gain))
        for view, gain in zip(plain.sources, gains, strict=True)
    ]
    return replace(plain, sources=tuple(views))


def estimated(compensation: ExposureCompensation, seen: Instant) -> np.ndarray:
    return compensation.gains(seen, TOLERANCE)


def anchored(gains: np.ndarray, sources=SOURCES) -> np.ndarray:
    """The factors that undo gains, their free factor fixed by the distance-weighted mean of the
    logarithms.
    """
    weights = view_weights(TARGET, sources).astype(float) ** GAUGE_POWER
    logarithms = np.log(gains)
    return np.exp(weights @ logarithms / weights.sum() - logarithms)


def test_planted_gains_are_found():
    """Gains of up to 6 % per channel come back within half a percent, but for their common
    factor.
    """
    np.testing.assert_allclose(
        estimated(ExposureCompensation(), planted(0)), anchored(GAINS), atol=0.005
    )


@pytest.mark.parametrize("gain", [1.0, 0.9])
def test_the_common_gain_stays(gain):
    """A gain that all sources share cannot be told from brightness and is left alone: every factor
    is 1.
    """
    np.testing.assert_allclose(
        estimated(ExposureCompensation(), planted(0, gains=np.full_like(GAINS, gain))),
        1,
        atol=0.002,
    )


def test_the_order_of_sources_does_not_matter():
    """The same cameras in another order get the same factors, at first and from memory."""
    order, compensation, other = [2, 0, 3, 1], ExposureCompensation(), ExposureCompensation()
    for index in range(2):
        first = estimated(compensation, planted(index))
        second = estimated(other, planted(index, [SOURCES[k] for k in order], GAINS[order]))

    np.testing.assert_allclose(second, first[order], atol=1e-6)


def test_sources_may_come_and_go():
    """With another number of sources the factors are those of the ones that are there."""
    compensation = ExposureCompensation()
    estimated(compensation, planted(0))

    fewer = estimated(compensation, planted(1, SOURCES[1:], GAINS[1:]))

    assert fewer.shape == (3, 3)
    np.testing.assert_allclose(fewer, anchored(GAINS[1:], SOURCES[1:]), atol=0.005)


def test_ratios_are_remembered():
    """When a gain jumps, a memory of ten instants follows by a third at the third instant; without
    one it follows at once.
    """
    jumped, calm, quick = GAINS.copy(), ExposureCompensation(), ExposureCompensation(memory=1)
    jumped[0] *= 1.1
    for compensation in (calm, quick):
        for index in range(2):
            before = estimated(compensation, planted(index))
    after = [estimated(compensation, planted(2, gains=jumped)) for compensation in (calm, quick)]

    shifts = [np.log(each[0] / each[3]) - np.log(before[0] / before[3]) for each in after]
    np.testing.assert_allclose(shifts[0], -np.log(1.1) / 3, atol=0.005)
    np.testing.assert_allclose(shifts[1], -np.log(1.1), atol=0.005)


def test_nothing_in_common_changes_nothing():
    """Where no depth is known, or sources disagree about it, every factor is 1."""
    seen = planted(0)
    for factors in ([0, 0, 0, 0], [1, 2, 3, 4]):
        sources = [
            replace(view, depth=view.depth * factor)
            for view, factor in zip(seen.sources, factors, strict=True)
        ]
        np.testing.assert_array_equal(
            estimated(ExposureCompensation(), replace(seen, sources=tuple(sources))), 1
        )


def test_what_is_clipped_does_not_count():
    """White says nothing of a gain: a picture that is half white gives the gains of the
    other half.
    """
    seen = planted(0)
    white = [view.image.copy() for view in seen.sources]
    for image in white:
        image[:36] = 255
    half = replace(
        seen,
        sources=tuple(
            replace(view, image=image) for view, image in zip(seen.sources, white, strict=True)
        ),
    )

    np.testing.assert_allclose(estimated(ExposureCompensation(), half), anchored(GAINS), atol=0.01)


def test_images_stay_in_8_bit():
    """Channels are multiplied, rounded and clipped; gains of 1 change no pixel of any source."""
    image = np.array([[[100, 200, 250]]], np.uint8)
    plain = planted(0, SOURCES[:1], GAINS[:1])

    np.testing.assert_array_equal(
        gained_image(image, np.array([1.1, 0.5, 1.2], np.float32)), [[[110, 100, 255]]]
    )
    np.testing.assert_array_equal(
        ExposureCompensation().step(plain, TOLERANCE).sources[0].image, plain.sources[0].image
    )


@pytest.mark.parametrize("count", [1, 2])
def test_one_source_is_left_alone(count):
    """A single source has nobody to agree with; two meet at their weighted mean."""
    gains = estimated(ExposureCompensation(), planted(0, SOURCES[:count], GAINS[:count]))

    np.testing.assert_allclose(gains, anchored(GAINS[:count], SOURCES[:count]), atol=0.005)


def seen_in_part(index: int, rows: int) -> Instant:
    """Two cameras, the second at .85 of the exposure; depth is known in so many rows."""
    seen = planted(index, SOURCES[:2], np.array([[1.0] * 3, [0.85] * 3], np.float32))
    known = np.arange(SOURCES[0].height)[:, None] < rows
    return replace(
        seen, sources=tuple(replace(view, depth=view.depth * known) for view in seen.sources)
    )


def test_a_pair_that_shares_too_little_is_remembered():
    """Enough common looks at every other instant: the ratio of the exposures stays within 1 % of 1
    / .85.
    """
    compensation, wide, narrow = ExposureCompensation(), 72, 4
    found = [
        estimated(compensation, seen_in_part(index, narrow if index % 2 else wide))
        for index in range(8)
    ]

    np.testing.assert_allclose([each[1] / each[0] for each in found], 1 / 0.85, rtol=0.01)


def test_what_is_remembered_fades():
    """Once nothing is shared any more a ratio goes back to 1, by no more than 1.5 % an instant;
    without a memory at once.
    """
    compensation, none = ExposureCompensation(), ExposureCompensation(memory=1)
    ratios = []
    for index in range(120):
        found = estimated(compensation, seen_in_part(index, 72 if index == 0 else 0))
        ratios.append(float((found[1] / found[0]).mean()))
    estimated(none, seen_in_part(0, 72))

    assert np.abs(np.diff(np.log(ratios))).max() < 0.015
    assert ratios[-1] == pytest.approx(1, abs=0.01)
    np.testing.assert_array_equal(estimated(none, seen_in_part(1, 0)), 1)


def black(seen: Instant, number: int, level: int = 0) -> Instant:
    """The instant with one source of one colour."""
    sources = list(seen.sources)
    sources[number] = replace(sources[number], image=np.full_like(sources[number].image, level))
    return replace(seen, sources=tuple(sources))


@pytest.mark.parametrize("method", ["ours", "ours-geometric"])
@pytest.mark.parametrize(("number", "level"), [(0, 0), (1, 0), (0, 255)])
def test_a_black_source_is_left_out(method, number, level):
    """A source that is black or white for an instant costs that instant 3 dB at most, and the
    instants behind it nothing.
    """
    made, truth = find_method(method).make(), look(TARGET)[0]
    plain = [instant(index, TARGET, SOURCES) for index in range(3)]
    scores = [
        psnr_db(made.step(black(each, number, level) if each.index == 1 else each).image, truth)
        for each in plain
    ]

    assert scores[1] > scores[0] - 3
    assert scores[2] > scores[0] - 0.1


def test_sources_that_agree_stay():
    """Gains of cameras, two sources of which nobody can say which is wrong, and a dark room leave
    out none.
    """
    dark = planted(0, gains=np.full_like(GAINS, 0.06))
    for seen in (planted(0), black(planted(0, SOURCES[:2], GAINS[:2]), 0), dark):
        assert len(ExposureCompensation().step(seen, TOLERANCE).sources) == len(seen.sources)
