"""The pictures of one camera's depth: image, depth, confidence, and the image resynthesised."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.colour_maps import confidence_colours, depth_colours, difference_colours, with_checks
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.files.atomic import write_bytes
from ggvs_eval.files.images import resize
from ggvs_eval.geometry.rectification import rectify
from ggvs_eval.reports.depth_page.pairs import pair_picture
from ggvs_eval.reports.depth_page.statistics import Resynthesis, measured_pixels, resynthesise

WIDTH_PX = 480  # of a picture; with QUALITY it keeps the page of 12 cameras below 10 MB
QUALITY = 75


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
        again: the image made again, None where the camera was matched with no other.
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
        beside: True where the camera is on the left and the partner on the right, False where it is above it.
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
    other: tuple[Camera, Image8] | None,
) -> InstantPictures:
    """Write the pictures of a camera at one instant.

    Args:
        image: what it saw, RGB uint8 (H, W, 3).
        depth_range: nearest and farthest depth of the colours, world units.
        other: the camera to make the image again from, with what that one saw at the same instant.
    """
    start = f"{stem}_{frame:06d}"
    depth, confidence = _sampled(depth_map.depth), _sampled(depth_map.confidence)
    is_filled = (depth > 0) & ~_sampled_mask(measured_pixels(depth_map, filled_confidence))
    return InstantPictures(
        frame=frame,
        image=_write(folder / f"{start}_image.jpg", _shrunk(image)),
        depth=_write(folder / f"{start}_depth.jpg", depth_colours(depth, *depth_range)),
        confidence=_write(folder / f"{start}_confidence.jpg", confidence_colours(confidence, depth > 0, is_filled)),
        again=None if other is None else _write_again(folder, start, resynthesise(camera, depth_map.depth, image, *other)),
    )


def _write_again(folder: Path, start: str, made: Resynthesis) -> PicturesAgain:
    is_seen = _sampled_mask(made.is_seen)
    return PicturesAgain(
        image=_write(folder / f"{start}_again.jpg", with_checks(_shrunk(made.image), is_seen)),
        difference=_write(folder / f"{start}_difference.jpg", difference_colours(_sampled(made.difference), is_seen)),
        error=made.error,
        covered=made.covered,
        gain=made.gain,
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
    written = []
    for number, (partner, partner_image) in enumerate(partners):
        picture, beside = pair_picture(rectify(camera, partner), camera, partner, image, partner_image, matches[partner.name])
        file = _write(folder / f"{stem}_pair{number}.jpg", picture)
        written.append(PictureOfPair(partner.name, file, beside))
    return tuple(written)


def _shrunk(image: Image8) -> Image8:
    height, width = image.shape[:2]
    return resize(image, WIDTH_PX, max(1, round(height * WIDTH_PX / width)), "area") if width > WIDTH_PX else image


def _sampled(values: Map) -> Map:
    """A map at the size of a picture, by its nearest pixels: a mean of two depths is the depth of nothing."""
    height, width = values.shape
    size = (WIDTH_PX, max(1, round(height * WIDTH_PX / width))) if width > WIDTH_PX else (width, height)
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_NEAREST_EXACT))


def _sampled_mask(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    return _sampled(mask.astype(np.float32)) > 0


def _write(path: Path, image: Image8) -> Picture:
    _, encoded = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    write_bytes(path, encoded.tobytes())
    return Picture(path.name, image.shape[1], image.shape[0])
