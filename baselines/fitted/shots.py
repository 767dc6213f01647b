"""The training images of a fit: which camera and instant each step looks at, and what it saw."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.arrays import Image8
from ggvs_eval.baselines.fitted.points import clip_times
from ggvs_eval.camera import Camera
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.method import NEAR_M
from ggvs_eval.scene_fitter import Footage

EXTENT_MARGIN = 1.1


@dataclass(frozen=True, eq=False)
class Shot:
    """One training image.

    Attributes:
        time: of the clip, in [0, 1].
        image: what it saw, in [0, 1], (H, W, 3).
    """

    camera: Camera
    time: float
    image: Tensor


class Shots:
    """Images of all training cameras at some instants, each once before any comes again, in a
    seeded order.

    Frames of videos depend on each other; they are decoded once, into a file next to the fit, which
    is read in any order.

    Args:
        salt: makes the order of this fit another than that of the folder's other fits.
    """

    def __init__(
        self, footage: Footage, indices: Sequence[int], folder: Path, salt: int = 0
    ) -> None:
        self.footage, self.indices, self.salt = footage, list(indices), salt
        self._folder = folder
        self._times = dict(
            zip(self.indices, clip_times(footage, self.indices).tolist(), strict=True)
        )
        self._frames: dict[str, Image8] = {}

    @property
    def extent(self) -> float:
        """1.1 times the largest distance of a camera from their mean, world units.

        For one camera its nearest depth.
        """
        centres = np.stack([camera.centre for camera in self.footage.cameras])
        reach = float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())
        return EXTENT_MARGIN * reach or self.footage.cameras[0].near

    @property
    def near(self) -> float:
        """Depth from which on Gaussians are rendered, world units."""
        return NEAR_M * self.footage.units_per_metre

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.footage.cameras) * len(self.indices)

    def at(self, step: int) -> Shot:
        """Return the image of a step; it depends on the seed and the step alone."""
        epoch, place = divmod(step, len(self))
        order = np.random.default_rng([self.footage.seed, self.salt, epoch]).permutation(len(self))
        return self.shot(int(order[place]))

    def shot(self, ordinal: int) -> Shot:
        """Return one of the images, counted camera by camera."""
        camera_ordinal, instant = divmod(ordinal, len(self.indices))
        camera, index = self.footage.cameras[camera_ordinal], self.indices[instant]
        frame = self._stored(camera.name)[index - self.footage.indices[0]]
        return Shot(
            camera, self._times[index], torch.as_tensor(np.array(frame), dtype=torch.float32) / 255
        )

    def evenly(self, count: int) -> list[Shot]:
        """Return a few of the images, far from one another."""
        return [self.shot(int(ordinal)) for ordinal in np.linspace(0, len(self) - 1, count)]

    def remove_frames(self) -> None:
        """Remove the decoded frames."""
        self._frames.clear()
        for camera in self.footage.cameras:
            with suppress(OSError):
                self._path(camera.name).unlink()

    def _path(self, view: str) -> Path:
        return self._folder / f"{view}.frames.npy"

    def _stored(self, view: str) -> Image8:
        """Return all frames of a camera, (T, H, W, 3), memory-mapped from a file."""
        if view not in self._frames:
            path, indices = self._path(view), self.footage.indices
            if not path.is_file():
                camera = self.footage.cameras[self.footage.views.index(view)]
                with atomic_file(path) as temporary:
                    shape = (len(indices), camera.height, camera.width, 3)
                    stored = np.lib.format.open_memmap(temporary, "w+", np.uint8, shape)
                    for place, frame in enumerate(
                        self.footage.frames[view].frames(indices[0], indices[-1] + 1)
                    ):
                        stored[place] = frame
                    stored.flush()
            self._frames[view] = np.load(path, mmap_mode="r")
        return self._frames[view]
