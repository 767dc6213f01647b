"""Neighbouring frames of a sequence looked up through their depth: whether depth, poses and colour fit each other."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.geometry.warp import warp
from ggvs_eval.pipelines.offline.sensor.registration import read_depth

# Baselines of this share of the depth turn a percent of scale into half a pixel, and still see the same surfaces.
BASELINE, LARGEST_BASELINE, LEAST_BASELINE, LEAST_COSINE = 0.08, 0.2, 0.02, 0.85
TOLERANCE = 0.03  # of the depth: two frames see the same surface
DETAIL_SIGMA_PX, LARGEST_ERROR = 6.0, 0.15
LEAST_SEEN = 0.05


@dataclass(frozen=True)
class FramePair:
    """Two frames of a sequence, by their index."""

    target: int
    source: int


def choose_pairs(capture: Capture, chosen: Sequence[int]) -> list[FramePair]:
    """For each chosen frame the later one whose baseline suits best; frames without one are left out."""
    pairs = []
    for index in chosen:
        camera = capture.cameras[index]
        depth = np.sqrt(camera.near * camera.far)
        shares = [float(np.linalg.norm(other.centre - camera.centre)) / depth for other in capture.cameras[index + 1 :]]
        facing = [float(other.axis @ camera.axis) > LEAST_COSINE for other in capture.cameras[index + 1 :]]
        fit = [(abs(share - BASELINE), place) for place, share in enumerate(shares)
               if facing[place] and LEAST_BASELINE < share < LARGEST_BASELINE]  # fmt: skip
        if fit:
            pairs.append(FramePair(index, index + 1 + min(fit)[1]))
    return pairs


@dataclass(frozen=True, eq=False)
class View:
    """One frame of a sequence.

    Attributes:
        image: RGB in [0, 1], (H, W, 3) float32.
        detail: the image less its blur; exposures of frames differ, their detail does not.
        depth: z, world units, 0 = unknown, (H, W).
    """

    camera: Camera
    image: Map
    detail: Map
    depth: Map


def load_pair(capture: Capture, pair: FramePair) -> tuple[View, View]:
    """Target and source of a pair."""
    target, source = (_view(capture, index) for index in (pair.target, pair.source))
    return target, source


def warp_errors(pair: tuple[View, View], scales: NDArray[np.float64]) -> list[float]:
    """Mean absolute difference of detail between a frame and its neighbour warped onto it, at each scale of both depths.

    Large differences count as 0.15 of the value range, and so do pairs of which too little is seen.
    """
    target, source = pair
    errors = []
    for scale in scales:
        colour, visibility = _warped(target, source, source.detail, float(scale))
        error = np.minimum(np.abs(colour - target.detail), LARGEST_ERROR)[visibility]
        errors.append(float(error.mean()) if visibility.mean() > LEAST_SEEN else LARGEST_ERROR)
    return errors


def warp_psnr_db(capture: Capture, pairs: Sequence[FramePair]) -> float:
    """Mean PSNR of frames against their warped neighbours where both see the surface; NaN without pairs."""
    values = []
    for target, source in (load_pair(capture, pair) for pair in pairs):
        colour, visibility = _warped(target, source, source.image, 1.0)
        if visibility.mean() > LEAST_SEEN:
            values.append(-10 * np.log10(max(float(((colour - target.image)[visibility] ** 2).mean()), 1e-10)))
    return float(np.mean(values)) if values else float("nan")


def _warped(target: View, source: View, image: Map, scale: float) -> tuple[Map, NDArray[np.bool_]]:
    """The source's image as the target sees it, (H, W, 3), and where both see the same surface, (H, W)."""
    factor = np.float32(scale)
    depths = target.depth[target.depth > 0]
    tolerance = TOLERANCE * float(np.median(depths)) if depths.size else 1.0
    warped = warp(target.camera, target.depth * factor, source.camera, image, source.depth * factor, tolerance)
    return warped.colour, warped.visibility > 0.5


def _view(capture: Capture, index: int) -> View:
    camera = capture.cameras[index]
    image = capture.frame(camera.name, 0).astype(np.float32) / np.float32(255)
    detail = image - cv2.GaussianBlur(image, (0, 0), DETAIL_SIGMA_PX)
    return View(camera, image, np.asarray(detail, np.float32), read_depth(capture, index))
