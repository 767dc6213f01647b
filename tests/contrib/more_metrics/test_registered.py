"""PSNR of registered pictures: known homographies are found and undone, and what is no motion of
the whole gains nothing.
"""

import cv2
import numpy as np
import pytest
from skimage import data

from ggvs_eval.contrib.more_metrics.registered import psnr_registered
from ggvs_eval.errors import MetricError
from ggvs_eval.geometry.registration import register
from ggvs_eval.metrics.image.psnr import psnr

TRUTH = cv2.resize(data.astronaut(), (320, 240), interpolation=cv2.INTER_AREA)
HEIGHT, WIDTH = TRUTH.shape[:2]
CORNERS = np.array([[0, 0], [WIDTH, 0], [0, HEIGHT], [WIDTH, HEIGHT]], np.float32)
MIDDLE = np.s_[16:-16, 16:-16]


def moved(homography):
    """The picture whose pixel `homography @ x` shows what the truth shows at x."""
    flags = cv2.INTER_LANCZOS4
    return cv2.warpPerspective(
        TRUTH, homography, (WIDTH, HEIGHT), flags=flags, borderMode=cv2.BORDER_REFLECT
    )


def random_homography(seed, most_px):
    shifts_px = np.random.default_rng(seed).uniform(-most_px, most_px, CORNERS.shape)
    return cv2.getPerspectiveTransform(CORNERS, CORNERS + shifts_px.astype(np.float32))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("most_px", [0.5, 6.0])
def test_a_homography_is_undone(seed, most_px):
    """Corners that lie up to 6 px off come back to what two interpolations cost, also in a picture
    of other colours.
    """
    picture = moved(random_homography(seed, most_px))
    darker = np.clip(0.7 * picture + 20, 0, 255).astype(np.uint8)
    for image, reference in (
        (picture, TRUTH),
        (darker, np.clip(0.7 * TRUTH + 20, 0, 255).astype(np.uint8)),
    ):
        undone, is_covered = register(image, reference)
        assert is_covered.mean() > 0.9
        assert psnr(np.rint(undone).astype(np.uint8)[MIDDLE], reference[MIDDLE]) > 38
        assert psnr_registered(image, reference) > psnr(image, reference) + 2


@pytest.mark.parametrize(
    "image",
    [
        TRUTH,
        TRUTH[:, ::-1].copy(),
        np.zeros_like(TRUTH),
        cv2.GaussianBlur(TRUTH, (0, 0), 2),
        np.roll(TRUTH, 90, axis=1),
    ],
    ids=["equal", "mirrored", "black", "blurred", "far"],
)
def test_what_is_no_small_motion_gains_nothing(image):
    """The truth, a mirrored, black or blurred picture, and one that is 90 of 320 px away, have
    their PSNR.
    """
    assert psnr_registered(image, TRUTH) == pytest.approx(psnr(image, TRUTH), abs=0.02)


@pytest.mark.parametrize("sigma", [5, 15])
def test_noise_gains_by_interpolation_alone(sigma):
    """A noisy picture half a pixel off reads at most 1.5 dB higher than one in its place: the noise
    is interpolated.
    """
    noise = np.random.default_rng(1).normal(0, sigma, TRUTH.shape)
    in_place, beside = (
        np.clip(picture + noise, 0, 255).astype(np.uint8)
        for picture in (TRUTH, moved(np.float64([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])))
    )
    gain_db = psnr_registered(beside, TRUTH) - psnr(in_place, TRUTH)
    assert -1.5 < gain_db < 1.5


def test_only_a_mask_counts():
    """Errors further outside a mask than the picture moves neither count nor move it."""
    image, mask = moved(random_homography(0, 3.0)), np.zeros((HEIGHT, WIDTH), bool)
    mask[MIDDLE] = True
    spoilt = np.zeros_like(image)
    spoilt[6:-6, 6:-6] = image[6:-6, 6:-6]
    assert psnr_registered(spoilt, TRUTH, mask) > 30
    assert psnr_registered(spoilt, TRUTH) < psnr_registered(spoilt, TRUTH, mask) - 10


def test_shapes_must_agree():
    """A picture of another size is refused as by every metric."""
    with pytest.raises(MetricError, match="resize"):
        psnr_registered(TRUTH[:100], TRUTH)
