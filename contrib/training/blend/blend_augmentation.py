"""Augmentation by the flaws of real rigs, drawn anew for every crop: exposures, colours, blur, slight misregistration."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.contrib.training.samples.blend_samples import RawViews


@dataclass(frozen=True)
class Augmentation:
    """Strengths of the augmentation of crops.

    Attributes:
        gain: standard deviation of the logarithm of one gain for sources and truth alike, per channel.
        view_gain: of one gain per view, ...
        view_gain_share: ... in this share of the crops.
        blur_px: largest standard deviation of a blur of one view, ...
        blur_share: ... in this share of the crops.
        shift_px: standard deviation by which each view is displaced, as wrong depth or a wrong pose would, ...
        shift_share: ... in this share of the crops.
    """

    gain: float = 0.1
    view_gain: float = 0.02
    view_gain_share: float = 0.3
    blur_px: float = 1.2
    blur_share: float = 0.15
    shift_px: float = 0.7
    shift_share: float = 0.25


def augment(views: RawViews, truth: Map, rng: np.random.Generator, options: Augmentation) -> tuple[RawViews, Map]:
    """A crop as other cameras could have seen it.

    Args:
        truth: what the target's camera saw, (H, W, 3) in [0, 1].

    Returns:
        The changed views, and the truth with the common gain.
    """
    count = len(views.sources)
    common = np.exp(rng.normal(0, options.gain, 3))
    each = np.exp(rng.normal(0, options.view_gain, (count, 1))) if rng.random() < options.view_gain_share else np.ones((count, 1))
    gains = (common * each).astype(np.float32)[:, None, None]  # (K, 1, 1, 3)
    changed = replace(views, splats=np.clip(views.splats * gains, 0, 1), warps=np.clip(views.warps * gains, 0, 1))
    if rng.random() < options.shift_share:
        changed = displaced(changed, rng.normal(0, options.shift_px, (count, 2)))
    if rng.random() < options.blur_share:
        changed = _blurred(changed, int(rng.integers(count)), float(rng.uniform(0.3, options.blur_px)))
    return changed, np.clip(truth * common.astype(np.float32), 0, 1)


def displaced(views: RawViews, shifts_px: NDArray[np.float64]) -> RawViews:
    """Each view moved in the target view by (right, down) pixels, (K, 2); the border is repeated."""

    def moved(maps: Map) -> Map:
        return np.stack([_moved(each, *shift) for each, shift in zip(maps, shifts_px, strict=True)])

    return replace(
        views,
        splats=moved(views.splats),
        warps=moved(views.warps),
        alphas=moved(views.alphas),
        visibilities=moved(views.visibilities),
        depths=moved(views.depths),
    )


def _moved(image: Map, right: float, down: float) -> Map:
    matrix = np.array([[1, 0, right], [0, 1, down]], np.float64)
    size = image.shape[1::-1]
    nearest = image.ndim == 2  # depth and coverage: what lies between two surfaces is neither
    flags = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
    return np.asarray(cv2.warpAffine(image, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE), np.float32)


def _blurred(views: RawViews, which: int, sigma_px: float) -> RawViews:
    splats, warps = views.splats.copy(), views.warps.copy()
    for colours in (splats, warps):
        colours[which] = cv2.GaussianBlur(colours[which], (0, 0), sigma_px)
    return replace(views, splats=splats, warps=warps)
