"""Panoptic Sports as Dynamic 3D Gaussians keeps it: ``ims/CAM/FRAME.jpg`` with ``train_meta.json`` and ``test_meta.json``."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture, check_rig_size
from ggvs_eval.datasets.depth_range import Placed, ranged_cameras
from ggvs_eval.datasets.frames import NumberedFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.units import METRIC, GivenUnits, choose_units
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.plain import read_plain_text

IMAGES = "ims"
METAS = ("train_meta.json", "test_meta.json")
STILL = 1e-6  # that a pose or a focal length may change, of its size, for a camera that does not move
DAMAGE = (OSError, ValueError, TypeError, KeyError, IndexError, RecursionError, AttributeError)


class _View(NamedTuple):
    """One camera of a file: its images in order, intrinsics (3, 3), world_to_camera (4, 4), and the size they are for."""

    files: list[str]
    K: Array
    world_to_camera: Array
    width: int
    height: int


def refuse(path: Path) -> str | None:
    """Return the reason why this is no scene of Panoptic Sports, or None if it is one."""
    if not any((path / name).is_file() for name in METAS):
        return f"no {METAS[0]}"
    return None if (path / IMAGES).is_dir() else f"{METAS[0]}, but no {IMAGES}/"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a scene with the cameras of both files, called as their folders, in the order of their numbers.

    Args:
        units: world units per metre or a file that says how to measure them; the data set is metric when None.

    Raises:
        CaptureError: damaged JSON, a camera that moves, or frames that are missing or of another shape.

    Reading:
        Which cameras are held out is the protocol's affair: ``test_meta.json`` lists those of ``panoptic_sports``. The files give
        no range of depth.
    """
    views = {name: view for file in METAS if (path / file).is_file() for name, view in _read(path / file)}
    check_rig_size(path, len(views))
    names = sorted(views, key=lambda name: (len(name), name))
    rig = [Placed(name, views[name].K, views[name].world_to_camera, (views[name].width, views[name].height)) for name in names]
    cameras = ranged_cameras(rig, path)
    folder = path / IMAGES
    sources = [NumberedFrames(folder, tuple(enumerate(folder / file for file in views[name].files))) for name in names]
    return assemble_capture(path, "panoptic", cameras, sources, choose_units(path, units, cameras, of_data_set=METRIC))


def _read(file: Path) -> Iterator[tuple[str, _View]]:
    try:
        yield from _views(json.loads(read_plain_text(file)))
    except DAMAGE as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error)
        wanted = "w, h, and of each instant the lists k, w2c, fn and cam_id"
        raise CaptureError(f"{file}: wanted {wanted}, got: {reason:.200}; copy the scene again") from error


def _views(meta: Mapping[str, Any]) -> Iterator[tuple[str, _View]]:
    """Yield the cameras of a file; of each all instants are read, since a camera that moves would be a wrong one."""
    K, poses = np.array(meta["k"], np.float64), np.array(meta["w2c"], np.float64)  # (T, N, 3, 3), (T, N, 4, 4)
    files, numbers = meta["fn"], meta["cam_id"]
    if K.ndim != 4 or K.shape[2:] != (3, 3) or poses.shape != (*K.shape[:2], 4, 4) or not np.isfinite(poses).all():
        raise ValueError(f"k of {K.shape} and w2c of {poses.shape}")
    if any(row != numbers[0] for row in numbers) or [len(row) for row in files] != [K.shape[1]] * K.shape[0]:
        raise ValueError("instants that differ in their cameras")
    for index in range(K.shape[1]):
        name = _folder(str(files[0][index]))
        for values, what in ((K[:, index], "intrinsics"), (poses[:, index], "pose")):
            if np.abs(values - values[0]).max() > STILL * max(np.abs(values[0]).max(), 1.0):
                raise ValueError(f"camera {name} changes its {what}, which a fixed camera does not")
        yield name, _View(_checked(files, index, name), K[0, index], poses[0, index], int(meta["w"]), int(meta["h"]))


def _folder(file: str) -> str:
    """Return the folder of an image, which is its camera's name."""
    parts = PurePosixPath(file).parts
    if len(parts) != 2 or ".." in parts or parts[0] == "/" or not file.isprintable() or len(file) > 200:
        raise ValueError(f"the image {file!r:.60}, wanted CAM/FRAME.jpg")
    return parts[0]


def _checked(files: Sequence[Sequence[str]], index: int, name: str) -> list[str]:
    """Return the images of one camera in order, all in its folder."""
    own = [str(row[index]) for row in files]
    if any(_folder(file) != name for file in own):
        raise ValueError(f"images of several folders for camera {name}")
    return own


LAYOUT = DatasetSpec("train_meta.json and test_meta.json with ims/CAM/ (Panoptic Sports)", refuse, load, METAS)
