"""Content of the depth page for each camera, and its record in ``index.json`` next to the page.

Pictures are the image, depth, confidence, and the image resynthesised; numbers how much was
measured, how far the scene is, and how well a map makes other images again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.colour_maps import confidence_colours, depth_colours, difference_colours, with_checks
from ggvs_eval.depth_store import CONFIDENCE_STEPS, DepthJob, DepthMap
from ggvs_eval.files.atomic import write_bytes
from ggvs_eval.files.images import quantise, resize
from ggvs_eval.geometry.rectification import rectify
from ggvs_eval.geometry.splat import COVERED_ALPHA, splat_depth
from ggvs_eval.geometry.warp import warp
from ggvs_eval.reports.depth_page.pairs import PairErrors, pair_picture

# of the median depth: a point this much deeper behind another pixel is hidden by it
SAME_SURFACE = 0.03
FEWEST_PIXELS = 100  # that both cameras see, to compare their colours
WIDTH_PX = 480  # of a picture; with QUALITY it keeps the page of 12 cameras below 10 MB
QUALITY = 75


@dataclass(frozen=True)
class DepthStatistics:
    """Statistics of a depth map. Shares are of all pixels.

    Attributes:
        measured: share of pixels with a measured depth.
        filled: share of pixels whose depth was filled in from others.
        empty: share of pixels without depth.
        confidence: median of the measured pixels, in [0, 1]; 0 if there are none.
        near: depth that 1 % of the measured pixels fall below, world units; 0 if there are none.
        median: median depth of the measured pixels.
        far: depth that 1 % of the measured pixels exceed.
    """

    frame: int
    measured: float
    filled: float
    empty: float
    confidence: float
    near: float
    median: float
    far: float


def measured_pixels(depth_map: DepthMap, filled_confidence: float) -> NDArray[np.bool_]:
    """Return the pixels with a measured depth, (H, W).

    Reading:
        The store keeps no mark of filled pixels, only their low confidence. A measured pixel whose
        confidence is as low counts as filled; it is trusted no more than one.
    """
    filled = np.rint(filled_confidence * CONFIDENCE_STEPS) / CONFIDENCE_STEPS
    return (depth_map.depth > 0) & (depth_map.confidence > filled + 0.5 / CONFIDENCE_STEPS)


def describe_map(frame: int, depth_map: DepthMap, filled_confidence: float) -> DepthStatistics:
    """Count the pixels of a depth map; parameters as for `measured_pixels`."""
    is_measured, has_depth = measured_pixels(depth_map, filled_confidence), depth_map.depth > 0
    depths, shares = (
        depth_map.depth[is_measured],
        (is_measured.mean(), (has_depth & ~is_measured).mean(), (~has_depth).mean()),
    )
    near, median, far = np.percentile(depths, (1, 50, 99)) if depths.size else (0.0, 0.0, 0.0)
    confidence = np.median(depth_map.confidence[is_measured]) if depths.size else 0.0
    return DepthStatistics(
        frame, *(float(value) for value in (*shares, confidence, near, median, far))
    )


@dataclass(frozen=True, eq=False)
class Resynthesis:
    """An image made again.

    Attributes:
        image: from the other camera's pixels, RGB uint8 (H, W, 3), its exposure fitted to this
            camera's.
        is_seen: pixels that the other camera sees as well, if the depth is right, (H, W).
        difference: from the true image, mean of the three channels, of 255 levels, (H, W); 0 if
            nothing is seen.
        gain: factor on red, green and blue that the exposure was fitted by.
    """

    image: Image8
    is_seen: NDArray[np.bool_]
    difference: Map
    gain: tuple[float, float, float]

    @property
    def covered(self) -> float:
        """Share of the pixels that both cameras see."""
        return float(self.is_seen.mean())

    @property
    def error(self) -> float:
        """Mean difference over them, of 255 levels; 0 if there are none."""
        return float(self.difference[self.is_seen].mean()) if self.is_seen.any() else 0.0


def resynthesise(
    camera: Camera, depth: Map, image: Image8, partner: Camera, partner_image: Image8
) -> Resynthesis:
    """Look up each pixel of a camera in another camera's image, by its depth.

    Args:
        depth: (H, W), world units, 0 = invalid.
        image: what it saw, RGB uint8 (H, W, 3).

    Reading:
        What the other camera cannot see is found by this very depth map, seen from there, not by
        the other's own: then only one depth map is held at a time. The gain is the median ratio of
        the images, so that exposure does not pass for wrong depth.
    """
    has_depth = depth > 0
    tolerance = (
        SAME_SURFACE * float(np.median(depth[has_depth]))
        if has_depth.any()
        else SAME_SURFACE * camera.near
    )
    view = splat_depth(camera, depth, partner, near=0.1 * min(camera.near, partner.near))
    seen_from_there = np.where(view.alpha > COVERED_ALPHA, view.depth, np.float32(0))
    partner_colours = partner_image.astype(np.float32) / np.float32(255)
    warped = warp(camera, depth, partner, partner_colours, seen_from_there, tolerance, bicubic=True)
    is_seen = has_depth & (warped.visibility > 0.5)
    gain = _gain(image[is_seen], warped.colour[is_seen] * 255)
    colour = warped.colour * np.asarray(gain, np.float32)
    difference = np.abs(np.clip(colour, 0, 1) * 255 - image).mean(axis=-1, dtype=np.float32)
    return Resynthesis(
        image=quantise(colour),
        is_seen=is_seen,
        difference=np.where(is_seen, difference, np.float32(0)),
        gain=gain,
    )


def _gain(truth: NDArray[np.uint8], warped: NDArray[np.float32]) -> tuple[float, float, float]:
    """Return the median ratio of the pixels (N, 3) per channel; dark pixels show only noise."""
    bright = (truth > 16) & (warped > 16)
    ratios = [truth[:, c][bright[:, c]] / warped[:, c][bright[:, c]] for c in range(3)]
    red, green, blue = (
        float(np.median(ratio)) if ratio.size >= FEWEST_PIXELS else 1.0 for ratio in ratios
    )
    return red, green, blue


@dataclass(frozen=True)
class Picture:
    """A JPEG file.

    Attributes:
        width: pixels.
        height: pixels.
    """

    file: str
    width: int
    height: int


@dataclass(frozen=True)
class PicturesAgain:
    """An image made again from another camera's.

    Attributes:
        image: the image made again.
        difference: how it differs from the true one, as colours.
        error: mean difference where both cameras see the scene, of 255 levels.
        covered: share of the pixels that both see.
        gain: factors on red, green and blue between the two exposures.
    """

    image: Picture
    difference: Picture
    error: float
    covered: float
    gain: tuple[float, float, float]


@dataclass(frozen=True)
class InstantPictures:
    """A camera at one instant.

    Attributes:
        again: the image made again, None if the camera was matched with no other.
    """

    frame: int
    image: Picture
    depth: Picture
    confidence: Picture
    again: PicturesAgain | None


@dataclass(frozen=True)
class PictureOfPair:
    """A camera and one of its partners, rectified.

    Attributes:
        beside: True if the camera is on the left and the partner on the right, False if it is above
            it.
    """

    partner: str
    picture: Picture
    beside: bool


def write_instant(
    folder: Path,
    stem: str,
    frame: int,
    camera: Camera,
    image: Image8,
    depth_map: DepthMap,
    depth_range: tuple[float, float],
    filled_confidence: float,
    partner: tuple[Camera, Image8] | None,
) -> InstantPictures:
    """Write the pictures of a camera at one instant.

    Args:
        image: what it saw, RGB uint8 (H, W, 3).
        depth_range: nearest and farthest depth of the colours, world units.
        partner: the camera to make the image again from, with what that one saw at the same
            instant.
    """
    start = f"{stem}_{frame:06d}"
    depth, confidence = _sampled(depth_map.depth), _sampled(depth_map.confidence)
    is_filled = (depth > 0) & ~_sampled_mask(measured_pixels(depth_map, filled_confidence))
    return InstantPictures(
        frame=frame,
        image=_write(folder / f"{start}_image.jpg", _shrunk(image)),
        depth=_write(folder / f"{start}_depth.jpg", depth_colours(depth, *depth_range)),
        confidence=_write(
            folder / f"{start}_confidence.jpg", confidence_colours(confidence, depth > 0, is_filled)
        ),
        again=None
        if partner is None
        else _write_again(folder, start, resynthesise(camera, depth_map.depth, image, *partner)),
    )


def _write_again(folder: Path, start: str, again: Resynthesis) -> PicturesAgain:
    is_seen = _sampled_mask(again.is_seen)
    return PicturesAgain(
        image=_write(folder / f"{start}_again.jpg", with_checks(_shrunk(again.image), is_seen)),
        difference=_write(
            folder / f"{start}_difference.jpg",
            difference_colours(_sampled(again.difference), is_seen),
        ),
        error=again.error,
        covered=again.covered,
        gain=again.gain,
    )


def write_pairs(
    folder: Path,
    stem: str,
    camera: Camera,
    image: Image8,
    partners: Sequence[tuple[Camera, Image8]],
    matches: Mapping[str, Array],
) -> tuple[PictureOfPair, ...]:
    """Write a picture of a camera with each of its partners.

    Args:
        image: what it saw, RGB uint8 (H, W, 3).
        partners: the cameras it is matched with and what they saw.
        matches: partner -> matched pixels of camera and partner, (M, 2, 2).
    """
    pictures = []
    for number, (partner, partner_image) in enumerate(partners):
        picture, beside = pair_picture(
            rectify(camera, partner), camera, partner, image, partner_image, matches[partner.name]
        )
        file = _write(folder / f"{stem}_pair{number}.jpg", picture)
        pictures.append(PictureOfPair(partner.name, file, beside))
    return tuple(pictures)


def _shrunk(image: Image8) -> Image8:
    height, width = image.shape[:2]
    return (
        resize(image, WIDTH_PX, max(1, round(height * WIDTH_PX / width)), "area")
        if width > WIDTH_PX
        else image
    )


def _sampled(values: Map) -> Map:
    """Return a map at the size of a picture, by its nearest pixels: a mean of two depths is the
    depth of nothing.
    """
    height, width = values.shape
    size = (
        (WIDTH_PX, max(1, round(height * WIDTH_PX / width)))
        if width > WIDTH_PX
        else (width, height)
    )
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_NEAREST_EXACT))


def _sampled_mask(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return _sampled(mask.astype(np.float32)) > 0


def _write(path: Path, image: Image8) -> Picture:
    _, encoded = cv2.imencode(
        ".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
    )
    write_bytes(path, encoded.tobytes())
    return Picture(path.name, image.shape[1], image.shape[0])


@dataclass(frozen=True)
class StoredDepth:
    """Depth maps of one job that are looked at.

    Attributes:
        job: the camera and the partners it was matched with.
        frames: instants to show, ascending; the features of the first one show the calibration.
    """

    job: DepthJob
    frames: tuple[int, ...]


@dataclass(frozen=True)
class CameraPictures:
    """All pictures of one camera.

    Attributes:
        partners: of the job that is pictured; where a camera has several, the one that measured
            least.
        depth_range: nearest and farthest depth of the colours, world units.
        again_from: the camera that images are made again from, the nearest partner; empty if there
            is none.
        pairs: one per partner that the camera can be rectified with.
    """

    partners: tuple[str, ...]
    depth_range: tuple[float, float]
    again_from: str
    instants: tuple[InstantPictures, ...]
    pairs: tuple[PictureOfPair, ...]


@dataclass(frozen=True)
class CameraRecord:
    """One source camera.

    Attributes:
        jobs: every job that computed its depth, with what came out at each instant.
    """

    name: str
    jobs: tuple[tuple[StoredDepth, tuple[DepthStatistics, ...]], ...]
    pictures: CameraPictures

    def label(self, stored: StoredDepth) -> str:
        """Return the camera's name, with the partners where it has several jobs."""
        return (
            self.name
            if len(self.jobs) == 1
            else f"{self.name} with {', '.join(stored.job.partner_names)}"
        )


@dataclass(frozen=True)
class DepthRecord:
    """Everything on the page.

    Attributes:
        units_origin: where that number comes from.
        cameras: source cameras in the order of the capture.
        pairs: every pair of a camera and a partner, measured at the first instant.
        unmatched: cameras of the capture that no camera is matched with.
    """

    scene: str
    units_per_metre: float
    units_origin: str
    cameras: tuple[CameraRecord, ...]
    pairs: tuple[PairErrors, ...]
    unmatched: tuple[str, ...]
