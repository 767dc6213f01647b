"""Clips that degradations are planted in: true frames of a view or a camera path, with the sources
that could render them.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array, Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.files.digest import digest_files

Frames = Image8  # (T, H, W, 3)


@dataclass(frozen=True, eq=False)
class SourceClip:
    """One source camera of a clip.

    Attributes:
        images: of every instant, (T, H, W, 3), or of the only one, (1, H, W, 3).
        depths: from the offline half, world units, 0 = unknown, (T, H, W) or (1, H, W).
        confidences: of these depths, in [0, 1], same shape.
    """

    camera: Camera
    images: Frames
    depths: Map
    confidences: Map


@dataclass(frozen=True, eq=False)
class Clip:
    """True frames of one view.

    Attributes:
        truth: (T, H, W, 3).
        cameras: the one that films, or one for each frame where it moves; none if unknown.
        depths: true view's depth at each frame of a moving camera, (T, H, W), world units, 0 =
            unknown; None where unknown.
        sources: cameras that the view can be rendered from, nearest first; none if their depth is
            unknown.
        rendering: what degradations are planted in, (T, H, W, 3); the truth where None.
    """

    name: str
    truth: Frames
    cameras: tuple[Camera, ...] = ()
    depths: Map | None = None
    sources: tuple[SourceClip, ...] = ()
    units_per_metre: float = 1.0
    rendering: Frames | None = None

    @property
    def undegraded(self) -> Frames:
        """The frames that degradations are planted in."""
        return self.truth if self.rendering is None else self.rendering

    @property
    def moves(self) -> bool:
        """True if the camera moves from frame to frame."""
        return len(self.cameras) > 1

    def camera(self, frame: int) -> Camera:
        """Return the camera at a frame."""
        return self.cameras[frame if self.moves else 0]

    def view_angles_deg(self) -> Array:
        """Angle at each frame between the directions in which the scene's middle sees the camera,
        then and at first, (T,).
        """
        if not self.moves or self.depths is None:
            return np.zeros(len(self.truth))
        middle = self.cameras[len(self.cameras) // 2]
        depths = self.depths[self.depths > 0]
        point = middle.centre + middle.axis * (float(np.median(depths)) if depths.size else 1.0)
        rays = np.stack([camera.centre - point for camera in self.cameras])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        return np.asarray(np.rad2deg(np.arccos(np.clip(rays @ rays[0], -1.0, 1.0))))


@dataclass(frozen=True)
class Take:
    """Views filmed together: what one number of a metric of a rig is made of.

    A folder of clips on disk.

    Attributes:
        folder: holds a file for each clip.
        name: of the scene and of what was taken of it.
    """

    folder: Path
    name: str
    digest: str

    @classmethod
    def open(cls, folder: Path, name: str) -> "Take":
        """Open the clips of `write_take`."""
        files = sorted(folder.glob("*.npz"))
        if not files:
            raise CaptureError(
                f"{folder}: wanted clips of a metric study, got none; choose a new folder"
            )
        return cls(folder, name, digest_files(files))

    def clips(self) -> Iterator[Clip]:
        """Yield the views one by one."""
        return (_read_clip(file) for file in sorted(self.folder.glob("*.npz")))


def write_take(folder: Path, clips: list[Clip]) -> None:
    """Write the clips of a take."""
    for number, clip in enumerate(clips):
        sources = clip.sources
        record = {
            "name": clip.name,
            "cameras": [camera.to_json() for camera in clip.cameras],
            "sources": [
                source.camera.to_json() | {"name": source.camera.name} for source in sources
            ],
            "units_per_metre": clip.units_per_metre,
        }
        optional = {"depths": clip.depths, "rendering": clip.rendering}
        arrays: dict[str, Any] = {"truth": clip.truth} | {
            key: array for key, array in optional.items() if array is not None
        }
        for index, source in enumerate(sources):
            arrays |= {
                f"images{index}": source.images,
                f"depths{index}": source.depths,
                f"confidences{index}": source.confidences,
            }
        with atomic_file(folder / f"{number}.npz") as unfinished, unfinished.open("wb") as file:
            np.savez(file, record=np.array(json.dumps(record)), **arrays)


def _read_clip(file: Path) -> Clip:
    try:
        with np.load(file, allow_pickle=False) as stored:
            arrays = dict(stored)
        record = json.loads(str(arrays["record"]))
    except (OSError, ValueError, EOFError, KeyError) as error:
        raise CaptureError(
            f"{file}: wanted a clip of a metric study, got: {error}; move it away and run the "
            f"study again"
        ) from error
    cameras = tuple(
        Camera.from_json(f"{record['name']}.{index}", values)
        for index, values in enumerate(record["cameras"])
    )
    sources = tuple(
        SourceClip(
            camera=Camera.from_json(values.pop("name"), values),
            images=arrays[f"images{index}"],
            depths=arrays[f"depths{index}"],
            confidences=arrays[f"confidences{index}"],
        )
        for index, values in enumerate(record["sources"])
    )
    depths, rendering = arrays.get("depths"), arrays.get("rendering")
    return Clip(
        name=record["name"],
        truth=arrays["truth"],
        cameras=cameras,
        depths=depths,
        sources=sources,
        units_per_metre=record["units_per_metre"],
        rendering=rendering,
    )
