"""Identity of a rendered picture: the captured one that it shows, of which camera, mirrored or not."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from ggvs_eval.arrays import Array32
from ggvs_eval.pipelines.inspection.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.view_frames import FrameReader, ViewFrames, shrink, spread

INSTANTS = 4
MIRRORS = {"as it is": (), "left and right swapped": (1,), "upside down": (0,), "turned by 180 degrees": (0, 1)}
# Structure left unexplained, 1 - correlation, relative to the view's own upright picture. Blur, ghosts and casts spoil both
# hypotheses alike; honest renders of 18 dB had 1.7 or more here, pictures of the wrong camera 0.6 or less.
CERTAIN_RATIO, LIKELY_RATIO = 0.6, 0.8
LEAST_CORRELATION = 0.4


@dataclass(frozen=True)
class CameraPictures:
    """Captured frames of one camera.

    Attributes:
        read: frame number -> frame at full size.
        outlines: frame number -> `structure` of the frame at small size; keeps the last few.
    """

    read: FrameReader
    outlines: Callable[[int], Array32]


def remember(read: FrameReader) -> CameraPictures:
    """A camera whose pictures are compared with every view at the same few instants."""
    return CameraPictures(read, lru_cache(maxsize=INSTANTS)(lambda index: structure(shrink(read(index)))))


def find_identity(name: str, view: ViewFrames, cameras: Mapping[str, CameraPictures]) -> tuple[list[Finding], ViewFrames]:
    """Compare with every camera's picture and its mirror images.

    Args:
        cameras: captured frames of all cameras, the view's own among them.

    Returns:
        What was found, and the view with it mended.
    """
    instants = spread(view.frames, INSTANTS)
    upright = [structure(shrink(view.rendered(index))) for index in instants]
    scores: dict[tuple[str, str], list[float]] = {}
    for camera, pictures in cameras.items():
        truths = [pictures.outlines(index) for index in instants]
        for mirror, axes in MIRRORS.items():
            pairs = ((np.flip(ours, axes), theirs) for ours, theirs in zip(upright, truths, strict=True))
            scores[camera, mirror] = [correlation(ours, theirs) for ours, theirs in pairs]
    return _evaluate(name, view, cameras, scores)


def structure(image: Array32) -> Array32:
    """Return the outlines of a picture: mean of the channels, band-passed, (h, w); no cast or tone curve undoes them."""
    grey = image.mean(axis=-1, dtype=np.float32)
    wide_px = max(grey.shape) / 20
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), wide_px / 12) - cv2.GaussianBlur(grey, (0, 0), wide_px), dtype=np.float32)


def correlation(first: Array32, second: Array32) -> float:
    """Normalised correlation of two arrays of one shape; 0 where they differ in shape or nothing varies."""
    if first.shape != second.shape:
        return 0.0
    one, other = first - first.mean(), second - second.mean()
    energy = float(np.sqrt((one * one).sum(dtype=np.float64) * (other * other).sum(dtype=np.float64)))
    return float((one * other).sum(dtype=np.float64)) / energy if energy > 0 else 0.0


def _evaluate(
    name: str, view: ViewFrames, cameras: Mapping[str, CameraPictures], scores: Mapping[tuple[str, str], list[float]]
) -> tuple[list[Finding], ViewFrames]:
    own = np.array(scores[name, "as it is"])
    camera, mirror = max(scores, key=lambda key: float(np.mean(scores[key])))
    best = np.array(scores[camera, mirror])
    ratios = (1 - best) / np.maximum(1 - own, 1e-6)
    # Every instant has to agree: one that does not is a picture of its own.
    ratio = float(ratios.max())
    if (camera, mirror) == (name, "as it is") or ratio > LIKELY_RATIO or best.min() < LEAST_CORRELATION:
        return [], view
    verdict = verdict_of(ratio < CERTAIN_RATIO)
    values = {"correlation": float(best.mean()), "own_correlation": float(own.mean()), "instants": float(len(own))}
    shown = f"structure correlates {best.mean():.2f}, as it should be {own.mean():.2f}, at all {len(own)} instants"
    findings: list[Finding] = []
    if camera != name:
        advice = f"check names and order of the cameras: render {name}, or score these as {camera}"
        findings.append(Finding(name, "wrong camera", verdict, f"shows {camera}: {shown}", values, advice))
        view = view.with_truth(cameras[camera].read)
    if axes := MIRRORS[mirror]:
        advice = "flip the frames before they are written, or correct the sign of the camera's axes"
        findings.append(Finding(name, "mirrored", verdict, f"{mirror}: {shown}", values, advice))
        view = view.with_rendered(lambda image: np.ascontiguousarray(np.flip(image, axes)))
    return findings, view
