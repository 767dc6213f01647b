"""Source views as the network sees them: all of one size, lengths in its unit."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from ggvs_eval.method import Instant, SourceView

# nearest depth of the authors' training on RealEstate10K, whose inverses the network sees
TRAINED_NEAR = 1.0


@dataclass(frozen=True, eq=False)
class Views:
    """Source views.

    Attributes:
        images: RGB in [0, 1], (K, 3, H, W).
        K: intrinsics in pixels, pixel centres at halves, (K, 3, 3).
        camera_to_world: lengths in the network's unit, (K, 4, 4).
        near: nearest depth that is searched, in that unit.
        far: farthest depth.
        unit: the network's units of length per world unit.
        sizes: widths and heights of the images before they were padded, (K, 2).
    """

    images: Tensor
    K: NDArray[np.float64]
    camera_to_world: NDArray[np.float64]
    near: float
    far: float
    unit: float
    sizes: NDArray[np.int64]

    def __len__(self) -> int:
        """Return the number of views."""
        return len(self.K)


def see_views(instant: Instant, multiple: int) -> Views:
    """Return the sources of an instant for the network.

    Args:
        instant: at least two sources, of any sizes.
        multiple: sides become multiples of it.

    Reading:
        The authors crop images at their middle to multiples of 16. Here they are padded at the
        right and at the bottom, by repeating their border; what is outside the image gives no
        Gaussian. Depths are searched between the nearest and the farthest of the instant's cameras,
        and lengths are scaled so that the nearest is that of the authors' training.
    """
    near, far = instant.depth_range
    unit = TRAINED_NEAR / near
    cameras = [source.camera for source in instant.sources]
    sizes = np.array([camera.size for camera in cameras])
    width, height = (-(-side // multiple) * multiple for side in sizes.max(axis=0).tolist())
    poses = np.stack([np.linalg.inv(camera.world_to_camera) for camera in cameras])
    poses[:, :3, 3] *= unit
    images = torch.cat([_padded(source, width, height) for source in instant.sources])
    return Views(
        images=images,
        K=np.stack([camera.K for camera in cameras]),
        camera_to_world=poses,
        near=near * unit,
        far=far * unit,
        unit=unit,
        sizes=sizes,
    )


def _padded(source: SourceView, width: int, height: int) -> Tensor:
    """Its image, (1, 3, height, width)."""
    image = torch.as_tensor(np.ascontiguousarray(source.image)).permute(2, 0, 1)[None].float() / 255
    return functional.pad(
        image, (0, width - image.shape[3], 0, height - image.shape[2]), mode="replicate"
    )
