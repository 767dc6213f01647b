"""Panoptic Sports as Dynamic 3D Gaussians keeps it: ``ims/CAM/FRAME.jpg`` with ``train_meta.json``
and ``test_meta.json``.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture, check_rig_size
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.rig import pinhole_camera, pinhole_cameras
from ggvs_eval.datasets.units import METRIC, GivenUnits, choose_units
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.names import is_inside
from ggvs_eval.files.plain import read_plain_text

IMAGES = "ims"
METAS = ("train_meta.json", "test_meta.json")
# that a pose or a focal length may change, of its size, for a camera that does not move
STILL = 1e-6
DAMAGE = (OSError, ValueError, TypeError, KeyError, IndexError, RecursionError, AttributeError)


class _View(NamedTuple):
    """One camera of a file: the names of its images in order.

    K (3, 3), the size that it is for, world_to_camera (4, 4).
    """

    files: list[str]
    calibration: tuple[Array, tuple[int, int], Array]


def refuse(path: Path) -> str | None:
    """Return the reason why this is no scene of Panoptic Sports, or None if it is one."""
    if not any((path / name).is_file() for name in METAS):
        return f"no {METAS[0]}"
    return None if (path / IMAGES).is_dir() else f"{METAS[0]}, but no {IMAGES}/"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a scene with the cameras of both files, called as their folders, in the order of their
    numbers.

    Args:
        units: world units per metre or a file that says how to measure them; the data set is metric
            when None.

    Raises:
        CaptureError: damaged JSON, a camera that moves, or frames that are missing or of another
            shape.

    Reading:
        Which cameras are held out is the protocol's affair: ``test_meta.json`` lists those of
        ``panoptic_sports``. The files give no range of depth.
    """
    views = {
        name: view for file in METAS if (path / file).is_file() for name, view in _read(path / file)
    }
    check_rig_size(path, len(views))
    names = sorted(views, key=lambda name: (len(name), name))
    rig = [pinhole_camera(path, name, *views[name].calibration) for name in names]
    cameras = pinhole_cameras(rig, path)
    folder = path / IMAGES
    sources = [
        ImageFrames(
            folder, numbered=tuple(enumerate(folder / name / file for file in views[name].files))
        )
        for name in names
    ]
    return assemble_capture(
        path, "panoptic", cameras, sources, choose_units(path, units, cameras, of_data_set=METRIC)
    )


def _read(file: Path) -> Iterator[tuple[str, _View]]:
    try:
        yield from _views(json.loads(read_plain_text(file)))
    except DAMAGE as error:
        reason = f"no {error}" if isinstance(error, KeyError) else str(error)
        form = "w, h, and of each instant the lists k, w2c, fn and cam_id"
        raise CaptureError(f"{file}: wanted {form}, got: {reason:.200}") from error


def _views(meta: Mapping[str, Any]) -> Iterator[tuple[str, _View]]:
    """Yield the cameras of a file.

    Of each all instants are read, since a camera that moves would be a wrong one.
    """
    # (T, N, 3, 3), (T, N, 4, 4)
    K, poses = np.array(meta["k"], np.float64), np.array(meta["w2c"], np.float64)
    files, numbers = meta["fn"], meta["cam_id"]
    if (
        K.ndim != 4
        or K.shape[2:] != (3, 3)
        or poses.shape != (*K.shape[:2], 4, 4)
        or not np.isfinite(poses).all()
    ):
        raise ValueError(f"k of {K.shape} and w2c of {poses.shape}")
    if (
        any(row != numbers[0] for row in numbers)
        or [len(row) for row in files] != [K.shape[1]] * K.shape[0]
    ):
        raise ValueError("instants that differ in their cameras")
    size = int(meta["w"]), int(meta["h"])
    for index in range(K.shape[1]):
        name = _folder(str(files[0][index]))
        for values, key in ((K[:, index], "k"), (poses[:, index], "w2c")):
            if np.abs(values - values[0]).max() > STILL * max(np.abs(values[0]).max(), 1.0):
                raise ValueError(
                    f"{key} of camera {name} that changes; if it stands still, write the first "
                    f"instant's for all"
                )
        pictures = [str(row[index]) for row in files]
        if any(_folder(file) != name for file in pictures):
            raise ValueError(f"images of several folders for camera {name}")
        yield (
            name,
            _View(
                [PurePosixPath(file).name for file in pictures],
                (K[0, index], size, poses[0, index]),
            ),
        )


def _folder(file: str) -> str:
    """Return the folder of an image, which is its camera's name."""
    *parents, folder, name = ("", "", *PurePosixPath(file).parts)
    if (
        not folder
        or not is_inside(f"{folder}/{name}")
        or any(part not in ("", IMAGES) for part in parents)
    ):
        raise ValueError(f"the image {file!r:.60}, wanted CAM/FRAME.jpg")
    return folder


LAYOUT = DatasetSpec(
    describe="train_meta.json and test_meta.json with ims/CAM/ (Panoptic Sports)",
    refuse=refuse,
    load=load,
    marks=METAS,
)
