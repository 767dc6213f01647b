"""Depth that a sensor measured and depth that stereo finds, of the same camera: held against each
other, and both used.
"""

import hashlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from ggvs_eval import built_in
from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import DepthError
from ggvs_eval.geometry.rectification import can_rectify
from ggvs_eval.pipelines.offline.depth.camera_depth import (
    FILLED_CONFIDENCE,
    DepthEstimator,
    DepthOptions,
)
from ggvs_eval.pipelines.offline.depth.colour_fill import fill_by_colour
from ggvs_eval.pipelines.offline.depth.consistency import LEAST_CONFIDENCE
from ggvs_eval.plugins import Registry
from ggvs_eval.progress import track

SENSORS: Registry[Any] = Registry("sensors", built_in.SENSORS)
COMPARED = 6  # cameras
# differences are averaged over the one; their mean over the other is exposure or shading
WINDOW_PX, LOCAL_PX = 7, 31


def partners_of_sensed(
    camera: Camera, cameras: Sequence[Camera], options: DepthOptions, excluded: Collection[str] = ()
) -> list[Camera]:
    """`DepthOptions.choose_partners` of a camera that has a sensor: none for which near surfaces
    leave the other's image.

    Their search takes long, four fifths of all in hololens_rgbd, and finds nothing that the sensor
    does not know: views of its first half have the same PSNR without them.
    """
    return [
        partner
        for partner in options.choose_partners(camera, cameras, excluded)
        if can_rectify(camera, partner, nearest=1.0)
    ]


def fill_by_sensor(depth_map: DepthMap, sensor_map: DepthMap, image: Image8) -> DepthMap:
    """Replace what stereo did not find by what a sensor measured, filled along colours.

    It is the guess of later checks too.

    Reading:
        Stereo fits the pictures, and a sensor needs no texture; docs/depth.md has what either has
        alone and both have together. Choosing per pixel what explains the other sources better has
        at most 31.04, 30.20 and 21.44 dB, where both have 31.18, 30.43 and 21.41 (three views each
        of rooms with misplaced depth, with blurred pictures, and of a real sequence).
    """
    guess = fill_by_colour(sensor_map, image).depth
    guess = np.where(guess > 0, guess, depth_map.depth)
    unknown = depth_map.confidence < LEAST_CONFIDENCE
    confidence = np.where(unknown, np.float32(FILLED_CONFIDENCE), depth_map.confidence)
    return DepthMap(np.where(unknown, guess, depth_map.depth), confidence, guess)


def unexplained(
    capture: Capture, names: tuple[str, ...], options: DepthOptions, frame: int
) -> tuple[float, float] | None:
    """Return how much of the pictures the depth of sensors and that of stereo leave unexplained,
    levels of 255.

    Every second of the cameras that stereo could be matched with judges it instead: a camera's
    picture is compared with theirs where its depth projects to, at pixels that both know; of each
    the two judges that fit best count, as others may not see it.

    Args:
        names: of cameras; some of those with a sensor are asked.
        frame: the instant.

    Returns:
        Geometric means over the asked cameras; None where none has partners and judges. Kept for
        the next question.
    """
    return _unexplained(ByContent.of(capture), names, options, frame)


@dataclass(frozen=True)
class ByContent:
    """A capture that is identified by its content, for what is kept of it."""

    digest: str
    capture: Capture = field(compare=False)

    @classmethod
    def of(cls, capture: Capture) -> "ByContent":
        """Return a capture by its pictures, its depth and its cameras."""
        total = hashlib.sha256()
        for camera in capture.cameras:
            source = capture.extras_of(camera.name).depth
            total.update(
                repr(
                    [capture.digest(camera.name), source and source.digest, camera.to_json()]
                ).encode()
            )
        return cls(total.hexdigest(), capture)


@lru_cache(maxsize=4)
def _unexplained(
    content: ByContent, names: tuple[str, ...], options: DepthOptions, frame: int
) -> tuple[float, float] | None:
    capture = content.capture
    cameras = [capture.camera(name) for name in names]
    sensors = {
        camera: source
        for camera in cameras
        if (source := capture.extras_of(camera.name).depth) is not None
    }
    places = np.linspace(0, len(sensors) - 1, min(COMPARED, len(sensors))).round().astype(int)
    means = []
    for camera, source in track(
        [[*sensors.items()][place] for place in places], "sensors held against stereo"
    ):
        try:
            matched = partners_of_sensed(
                camera, cameras, replace(options, partners=2 * options.partners)
            )
        except DepthError:
            continue
        partners, judges = matched[::2], matched[1::2]
        if not judges:
            continue
        image, *pictures = (
            capture.frame(view.name, frame) for view in (camera, *partners, *judges)
        )
        stereo = DepthEstimator(camera, partners, options).estimate(
            image, pictures[: len(partners)]
        )
        maps = SENSORS["sensor depth"](camera, source).at(frame, image), stereo
        judged = list(zip(judges, pictures[len(partners) :], strict=True))
        errors = []
        for depth_map in maps:
            differences = [_difference(camera, image, depth_map.depth, *judge) for judge in judged]
            errors.append(np.sort(differences, 0)[:2].mean(0))  # occluded judges are the worst ones
        is_known_twice = (
            np.isfinite(errors).all(0)
            & (maps[0].confidence > 0)
            & (stereo.confidence >= LEAST_CONFIDENCE)
        )
        if is_known_twice.any():
            means.append([np.log(error[is_known_twice].mean() + 1e-6) for error in errors])
    return None if not means else (*np.exp(np.mean(means, 0)).tolist(),)


def _difference(camera: Camera, image: Image8, depth: Map, judge: Camera, picture: Image8) -> Map:
    """Return the local difference of an image from a judge's picture at its depth, (H, W), infinite
    where that shows nothing.
    """
    uv, z = judge.project(camera.unproject(camera.pixel_centres(), depth.astype(float)))
    warped = cv2.remap(
        picture,
        (uv - 0.5).astype(np.float32),
        None,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    difference = warped.astype(np.float32) - image
    local = np.abs(difference - cv2.blur(difference, (LOCAL_PX, LOCAL_PX))).mean(2)
    inside = (depth > 0) & (z > 0) & ((uv > 0) & (uv < judge.size)).all(2)
    return np.where(inside, cv2.blur(local, (WINDOW_PX, WINDOW_PX)), np.inf)
