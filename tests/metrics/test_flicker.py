"""Flicker: signed, zero for the perfect rendering, and not to be won by a frozen or blurred
video.
"""

import numpy as np
import pytest

from ggvs_eval.contrib.study import frame_ladders
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.time.flicker import FlickerMeter, flicker
from helpers.noise_scenes import (
    FLICKER_SEED,
    clean_video,
    frozen,
    noisy,
    panned_video,
    planted,
    shot_noise,
)
from helpers.refusals import refused

FRAMES = 24


def measure(rendered, truth):
    return flicker(zip(rendered, truth, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [1.3, 4.0, shot_noise], ids=["white 1.3", "white 4", "shot"])
def test_the_perfect_rendering_is_best_and_each_defect_has_its_sign(sigma):
    """Against a noisy capture the perfect rendering has about 0 in both numbers; flicker and noise
    are above 0, frozen, blurred and time-averaged ones below, and the error of each is far above
    the perfect one's.
    """
    clean = clean_video(FRAMES)
    captured = noisy(clean, sigma, seed=1)
    perfect = measure(clean, captured)
    found = {name: measure(video, captured) for name, video in planted(clean).items()}
    assert abs(perfect.excess) < 0.4
    assert perfect.error < 0.2
    assert min(measured.error for measured in found.values()) > 1.3
    assert min(abs(measured.excess) for measured in found.values()) > 1.3
    assert all(found[name].excess > 0 for name in ("flicker 1 %", "flicker 2 %", "noise"))
    assert all(
        found[name].excess < -5
        for name in ("frozen", "blurred", "blurred more", "averaged over time")
    )
    assert found["flicker 2 %"].excess > 1.7 * found["flicker 1 %"].excess
    assert found["blurred more"].error > found["blurred"].error
    assert found["late"].error > 5


def test_flicker_of_a_still_scene_is_its_closed_form():
    """Alternating frames that differ by 3 grey levels beside a still, noisy capture: 3 is found; a
    still rendering has 0.
    """
    captured = noisy(np.full((9, 64, 80, 3), 100, np.uint8), 2.0, seed=1)
    levels = np.where(np.arange(9) % 2, 103, 100).astype(np.uint8)
    found = measure(np.broadcast_to(levels[:, None, None, None], captured.shape), captured)
    assert (found.excess, found.error, found.on_static) == pytest.approx((3, 3, 3), rel=0.01)
    assert found.noise == pytest.approx(2 * np.sqrt(2), rel=0.05)
    still = measure(np.full(captured.shape, 90, np.uint8), captured)
    assert (still.excess, still.on_static) == pytest.approx((0, 0), abs=0.15)


def test_light_that_flickers_in_the_scene_is_not_held_against_the_rendering():
    """Where the capture itself flickers by 2 %, the rendering that does so too has less error than
    the steady one.
    """
    clean = clean_video(FRAMES)
    scene = frame_ladders.flicker(clean, 2.0, FLICKER_SEED)
    captured = noisy(scene, 1.3, seed=1)
    faithful, steady = measure(scene, captured), measure(clean, captured)
    assert faithful.error < 0.5 * steady.error
    assert steady.excess < faithful.excess


def test_a_second_recording_is_zero_with_noise_and_flickers_without():
    """Noise of its own counts as flicker in `excess`; `with_noise`, where the perfect rendering is
    below 0, does not count it.
    """
    clean = clean_video(FRAMES)
    captured, again = noisy(clean, 2.0, seed=1), noisy(clean, 2.0, seed=2)
    second, perfect = measure(again, captured), measure(clean, captured)
    assert abs(second.with_noise) < 0.4
    assert second.excess == pytest.approx(2 * np.sqrt(2), rel=0.05)
    assert perfect.with_noise < -2.5


def test_a_constant_and_an_ever_moving_video_have_defined_values():
    """Equal constant videos of odd size have 0 and nothing that moves; where all moves, there is no
    still part and no NaN.
    """
    constant = np.full((3, 97, 131, 3), 80, np.uint8)
    found = measure(constant, constant)
    assert (found.excess, found.error, found.on_static, found.on_moving, found.static_share) == (
        0,
        0,
        0,
        None,
        1,
    )
    moving = panned_video()
    found = measure(moving, moving)
    assert (found.excess, found.error, found.on_static, found.noise, found.static_share) == (
        0,
        0,
        None,
        None,
        0,
    )
    assert measure(frozen(moving), moving).excess < -20


def test_what_cannot_be_compared_is_refused():
    """One instant, none, different sizes, changing sizes and frames below 16 pixels are refused
    with the reason.
    """
    clean = clean_video(2)
    with pytest.raises(MetricError, match="1 frame; needs 2"):
        measure(clean[:1], clean[:1])
    with pytest.raises(MetricError, match="0 frame; needs 2"):
        measure(clean[:0], clean[:0])
    with refused(MetricError, "(239, 304, 3)", "(240, 304, 3)"):
        measure(clean[:, 1:], clean)
    with refused(MetricError, "at least 16"):
        measure(clean[:, :15], clean[:, :15])
    meter = FlickerMeter()
    meter.add(clean[0], clean[0])
    with refused(MetricError, "(240, 304, 3) before", "(239, 304, 3) now"):
        meter.add(clean[1, 1:], clean[1, 1:])
