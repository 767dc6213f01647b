"""A training sample of a learned baseline: the input of a method for a target view, and the
captured target.
"""

import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.errors import TrainingError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.method import Instant, SourceView

POSE_SIZE = 16


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays so that a killed process leaves either the whole file or none."""
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        np.savez(file, **arrays)


@contextmanager
def stored_arrays(path: Path) -> Iterator[dict[str, Any]]:
    """The arrays of a file.

    What they turn out not to hold while a sample is made of them is the file's fault too.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        yield arrays
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise TrainingError(
            f"{path}: wanted a training sample, got none ({reason}); move it away and prepare again"
        ) from error


def camera_arrays(cameras: Sequence[Camera]) -> dict[str, Any]:
    """Return the cameras as arrays: a row of K, pose, size and depth range each, and their
    names.
    """
    rows = [
        [*camera.K.ravel(), *camera.world_to_camera.ravel(), *camera.size, camera.near, camera.far]
        for camera in cameras
    ]
    return {"cameras": np.array(rows), "names": np.array([camera.name for camera in cameras])}


def stored_cameras(arrays: Mapping[str, Any]) -> list[Camera]:
    """Return the cameras of `camera_arrays`, in their order."""
    return [
        _camera(str(name), row)
        for name, row in zip(arrays["names"], arrays["cameras"], strict=True)
    ]


def _camera(name: str, row: Array) -> Camera:
    K, pose, (width, height, near, far) = np.split(row, [9, 9 + POSE_SIZE])
    return Camera(
        name=name,
        K=K.reshape(3, 3),
        world_to_camera=pose.reshape(4, 4),
        width=int(width),
        height=int(height),
        near=float(near),
        far=float(far),
    )


FOCUS_MARGIN_PX = 8  # what a convolution sees around a pixel
FOCUS_MULTIPLE = 32


@dataclass(frozen=True, eq=False)
class InstantSample:
    """One target view.

    Attributes:
        instant: what a method is shown.
        truth: what the target's camera saw, (H, W, 3) uint8.
    """

    instant: Instant
    truth: Image8

    @property
    def truth_tensor(self) -> Tensor:
        """Captured image of the target's camera, (3, H, W) in [0, 1]."""
        return torch.as_tensor(np.ascontiguousarray(np.moveaxis(self.truth, 2, 0))).float() / 255

    def cropped(self, left: int, top: int, width: int, height: int) -> "InstantSample":
        """Return the window of the target that starts at pixel (left, top); sources stay whole."""
        target = self.instant.target.cropped(left, top, width, height)
        truth = self.truth[top : top + height, left : left + width]
        return InstantSample(replace(self.instant, target=target), truth)

    def focused(
        self, margin_px: int = FOCUS_MARGIN_PX, multiple: int = FOCUS_MULTIPLE
    ) -> "InstantSample":
        """Return the same with each source cut to what the target's window can show of it at any
        depth, all to one size.

        Args:
            multiple: sides are multiples of this number of pixels, if the sources are large enough.
        """
        # (K, 4)
        boxes = np.stack(
            [_window_in(source.camera, self.instant.target) for source in self.instant.sources]
        )
        sizes = np.array([source.camera.size for source in self.instant.sources])
        extent_px = (boxes[:, 2:] - boxes[:, :2]).max(axis=0) + 2 * margin_px
        size = np.minimum(np.ceil(extent_px / multiple) * multiple, sizes.min(axis=0)).astype(int)
        start = np.clip(np.floor((boxes[:, :2] + boxes[:, 2:] - size) / 2), 0, sizes - size).astype(
            int
        )
        sources = tuple(
            _cut(source, *corner, *size.tolist())
            for source, corner in zip(self.instant.sources, start.tolist(), strict=True)
        )
        return InstantSample(replace(self.instant, sources=sources), self.truth)

    def recoloured(self, order: tuple[int, ...]) -> "InstantSample":
        """Return the same with red, green and blue in another order, in sources and truth alike."""
        sources = tuple(
            replace(source, image=np.ascontiguousarray(source.image[..., order]))
            for source in self.instant.sources
        )
        return InstantSample(
            replace(self.instant, sources=sources), np.ascontiguousarray(self.truth[..., order])
        )


def _window_in(source: Camera, target: Camera) -> NDArray[np.float64]:
    """Left, top, right and bottom of what the target can see, where the source sees it, (4,),
    within the source's image.
    """
    columns, rows = (np.linspace(0, side, 5) for side in target.size)
    rim = np.stack(
        np.meshgrid(columns, rows, [target.near, (target.near * target.far) ** 0.5, target.far]),
        axis=-1,
    ).reshape(-1, 3)
    uv, depth = source.project(target.unproject(rim[:, :2], rim[:, 2]))
    visible_uv = uv[depth > 0] if (depth > 0).any() else np.array([[0.0, 0.0], source.size])
    limits = np.array(source.size, np.float64)
    return np.concatenate(
        [visible_uv.min(axis=0).clip(0, limits), visible_uv.max(axis=0).clip(0, limits)]
    )


def _cut(source: SourceView, left: int, top: int, width: int, height: int) -> SourceView:
    rows, columns = slice(top, top + height), slice(left, left + width)
    return SourceView(
        camera=source.camera.cropped(left, top, width, height),
        image=np.ascontiguousarray(source.image[rows, columns]),
        depth=np.ascontiguousarray(source.depth[rows, columns]),
        confidence=np.ascontiguousarray(source.confidence[rows, columns]),
    )


def write_instant(path: Path, sample: InstantSample) -> None:
    """Write a sample, the whole file or none; depth in half precision, relative to its median."""
    instant = sample.instant
    depths = np.stack([source.depth for source in instant.sources])
    unit = float(np.median(depths[depths > 0])) if (depths > 0).any() else 1.0
    arrays = camera_arrays([instant.target, *(source.camera for source in instant.sources)])
    arrays |= {"unit": np.float64(unit), "depths": (depths / np.float32(unit)).astype(np.float16)}
    arrays |= {
        "images": np.stack([source.image for source in instant.sources]),
        "truth": sample.truth,
    }
    write_arrays(path, arrays | {"units_per_metre": np.float64(instant.units_per_metre)})


def read_instant(path: Path) -> InstantSample:
    """Read a sample of `write_instant`; confidence is 1 where depth is known."""
    with stored_arrays(path) as arrays:
        target, *cameras = stored_cameras(arrays)
        depths = arrays["depths"].astype(np.float32) * np.float32(arrays["unit"])
        sources = tuple(
            SourceView(
                camera=camera, image=image, depth=depth, confidence=(depth > 0).astype(np.float32)
            )
            for camera, image, depth in zip(cameras, arrays["images"], depths, strict=True)
        )
        return InstantSample(
            Instant(
                index=0,
                target=target,
                sources=sources,
                units_per_metre=float(arrays["units_per_metre"]),
            ),
            arrays["truth"],
        )
