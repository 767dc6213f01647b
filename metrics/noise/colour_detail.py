"""Colour detail that coding in 4:2:0 has taken away, put back as strongly as the detail of brightness next to it."""

import cv2
import numpy as np

from ggvs_eval.metrics.noise.blocks import Field

LUMA = np.array([[0.2126, 0.7152, 0.0722]], np.float32)  # of BT.709
WINDOW_PX = 9  # of half size, over which strengths are compared
LEAST_VARIANCE = 0.5  # grey levels squared; with less detail of brightness there is nothing to go by
STEEPEST = 3.0


def with_colour_detail(frame: Field) -> Field:
    """Guess the colours of a frame before they were stored at half size.

    Args:
        frame: decoded colours, (H, W, 3), grey levels of 255.

    Returns:
        The frame of the same brightness whose colours have detail of single pixels again, same shape.

    Reading:
        No decoder can give this detail back; only its strength is wanted, because it decides what a frame loses when it is coded
        again. In the octave below, which 4:2:0 keeps, the strength of colour beside that of brightness is measured in each
        neighbourhood, with its sign, after brightness has gone through the same halving; that ratio is taken to hold one octave
        up, where brightness is known.
    """
    height, width = frame.shape[:2]
    luma = cv2.transform(frame, LUMA)
    as_colour = _halved_and_back(luma)
    half_luma, half_colour = (_half(plane) for plane in (as_colour, frame - luma[..., None]))
    luma_detail, colour_detail = (plane - _halved_and_back(plane) for plane in (half_luma, half_colour))
    ratio = _strength(colour_detail, luma_detail[..., None])
    steep = cv2.resize(np.clip(ratio, -STEEPEST, STEEPEST), (width, height), interpolation=cv2.INTER_LINEAR)
    detailed = frame + steep * (luma - as_colour)[..., None]
    return np.asarray(detailed + (luma - cv2.transform(detailed, LUMA))[..., None], dtype=np.float32)


def _strength(colour: Field, luma: Field) -> Field:
    """Ratio of the local deviations, with the sign of the covariance, (h, w, 3)."""
    window = (WINDOW_PX, WINDOW_PX)
    of_luma, of_colour, together = (cv2.blur(product, window) for product in (luma * luma, colour * colour, colour * luma))
    ratio = np.sqrt(of_colour / (of_luma[..., None] + LEAST_VARIANCE))
    return np.asarray(np.sign(together) * ratio, dtype=np.float32)


def _half(plane: Field) -> Field:
    height, width = plane.shape[:2]
    return np.asarray(cv2.resize(plane, (width // 2, height // 2), interpolation=cv2.INTER_AREA), dtype=np.float32)


def _halved_and_back(plane: Field) -> Field:
    """Halve and enlarge a plane, (H, W) or (H, W, C): bicubic both ways, smoothed before it is sampled."""
    from PIL.Image import Resampling, fromarray

    if plane.ndim == 3:
        return np.stack([_halved_and_back(plane[..., c]) for c in range(plane.shape[2])], axis=-1)
    height, width = plane.shape
    small = fromarray(np.ascontiguousarray(plane)).resize(((width + 1) // 2, (height + 1) // 2), Resampling.BICUBIC)
    return np.asarray(small.resize((width, height), Resampling.BICUBIC), dtype=np.float32)
