"""A rig of lenses with frames becomes a capture: frames are undistorted as they are read, ranges
that are not given guessed.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera, RangeOrigin
from ggvs_eval.datasets.assemble import SizedSource, crop_lens, given_crop
from ggvs_eval.datasets.depth_range import rig_depth_range
from ggvs_eval.datasets.frames import as_calibrated
from ggvs_eval.datasets.undistort import UndistortedFrames
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.lens import Lens


class RigCamera(NamedTuple):
    """A camera as a calibration has it.

    Attributes:
        lens: at the size of the calibration.
        world_to_camera: (4, 4).
        near_far: depth range, world units; None if the calibration gives none.
        K: of the pinhole image at the size of the calibration, (3, 3); that without blank pixels
            when None.
    """

    name: str
    lens: Lens
    world_to_camera: Array
    near_far: tuple[float, float] | None = None
    K: Array | None = None


def pinhole_cameras(rig: Sequence[RigCamera], file: Path) -> list[Camera]:
    """Return the cameras of the undistorted images; `file` is named in errors."""
    guesses = rig_depth_range([camera.world_to_camera for camera in rig])
    cameras = []
    for (name, lens, pose, near_far, K), guess in zip(rig, guesses, strict=True):
        origin: RangeOrigin = "given" if near_far else "guessed"
        try:
            K = lens.undistorted_K() if K is None else K
            cameras.append(
                Camera(
                    name,
                    K,
                    pose,
                    lens.width,
                    lens.height,
                    *(near_far or guess),
                    range_origin=origin,
                )
            )
        except CameraError as error:
            raise CaptureError(f"{file}: {error}") from error
    return cameras


def pinhole_rig(
    rig: Sequence[RigCamera], sources: Sequence[SizedSource], file: Path, folder: Path
) -> tuple[list[Camera], list[SizedSource]]:
    """Return the cameras and the frames of undistorted images.

    Args:
        sources: frames of each camera, at the size of its calibration, uniformly scaled, or the
            part that ``crop.toml`` states.
        file: of the calibration, named in errors.
        folder: of the capture.
    """
    crop = given_crop(folder)
    try:
        lenses = [
            crop_lens(camera.name, camera.lens, source.size, crop)
            for camera, source in zip(rig, sources, strict=True)
        ]
    except CameraError as error:
        raise CaptureError(f"{file}: {error}") from error
    cameras = pinhole_cameras(
        [camera._replace(lens=lens) for camera, lens in zip(rig, lenses, strict=True)], file
    )
    pinholes = [camera.K for camera in cameras]
    return cameras, [
        undistorted(source, lens, K)
        for source, lens, K in zip(sources, lenses, pinholes, strict=True)
    ]


def undistorted(source: SizedSource, lens: Lens, K: Array) -> SizedSource:
    """Return the frames as pinhole frames; the source itself where the lens does not distort.

    Args:
        source: frames at the size of the calibration, or uniformly scaled.
        K: of the pinhole image at the size of the calibration.
    """
    source = as_calibrated(source, lens.width, lens.height)
    if lens.is_pinhole:
        return source
    width, height = source.size
    scale = np.diag([width / lens.width, height / lens.height, 1.0])
    return UndistortedFrames(source, lens.resized(width, height), scale @ K)


def pinhole_camera(
    file: Path,
    name: str,
    K: Array,
    size: tuple[int, int],
    pose: Array,
    near_far: tuple[float, float] | None = None,
) -> RigCamera:
    """Return a camera whose pictures are undistorted already; `file` is named in errors."""
    try:
        return RigCamera(
            name=name,
            lens=Lens(K, "opencv", (0.0,) * 4, *size),
            world_to_camera=pose,
            near_far=near_far,
        )
    except CameraError as error:
        raise CaptureError(f"{file}: {name}: {error}") from error
