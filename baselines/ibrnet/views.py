"""Source views, looked up at points of the world."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ggvs_eval.baselines.ibrnet.network import Networks
from ggvs_eval.camera import Camera
from ggvs_eval.method import SourceView

Pixels = NDArray[np.float32]
Pass = Literal["coarse", "fine"]

PIXEL_CENTRE = 0.5  # ours lie at halves, the network was trained with centres at whole numbers
FARTHEST_PX = 1e6
BILINEAR, ZEROS = 0, 0  # torch's numbers of interpolation and padding
EPSILON = 1e-6


@dataclass(frozen=True)
class SeenView:
    """One source view, ready to be looked up.

    Attributes:
        image: RGB in [0, 1], (3, H, W).
        coarse: features for the coarse pass, (32, h, w).
        fine: features for the fine pass, (32, h, w).
        projection: world to image, pixel centres at whole numbers, (3, 4).
        centre: of the camera in the world, (3,).
    """

    image: Tensor
    coarse: Tensor
    fine: Tensor
    projection: Tensor
    centre: Tensor

    @cached_property
    def pixels(self) -> dict[str, Pixels]:
        """``image``, ``coarse`` and ``fine`` with the channels of a pixel side by side, (H, W, C), as kernels read them."""
        maps = {"image": self.image, "coarse": self.coarse, "fine": self.fine}
        return {name: np.ascontiguousarray(each.permute(1, 2, 0).numpy(), np.float32) for name, each in maps.items()}

    def look_up(self, points_world: Tensor, of_pass: Pass) -> tuple[Tensor, Tensor]:
        """Colour and features at points, and whether the image shows them.

        Args:
            points_world: (..., 3).

        Returns:
            (..., 35), linear between pixels, and (..., 1) bool.
        """
        projected = points_world @ self.projection[:, :3].T + self.projection[:, 3]
        depth = projected[..., 2:]
        uv = (projected[..., :2] / depth.clamp(min=1e-8)).clamp(-FARTHEST_PX, FARTHEST_PX)
        largest = uv.new_tensor([self.image.shape[2] - 1, self.image.shape[1] - 1])
        inside = ((uv >= 0) & (uv <= largest)).all(dim=-1, keepdim=True)
        places = 2 * uv / largest - 1  # of the corners' centres: -1 and 1, at whatever size
        features = self.coarse if of_pass == "coarse" else self.fine
        return torch.cat([_sample(self.image, places), _sample(features, places)], dim=-1), inside & (depth > 0)


def directions(points_world: Tensor, target_centre: Tensor, source_centre: Tensor) -> Tensor:
    """Compare the viewing directions of target and source at points: unit difference of the rays and dot product, (..., 4)."""
    of_target = _unit(target_centre - points_world)
    of_source = _unit(source_centre - points_world)
    difference = of_target - of_source
    length = difference.norm(dim=-1, keepdim=True).clamp(min=EPSILON)
    return torch.cat([difference / length, (of_target * of_source).sum(dim=-1, keepdim=True)], dim=-1)


def projection_of(camera: Camera) -> Tensor:
    """World to image with pixel centres at whole numbers, (3, 4)."""
    K = camera.K.copy()
    K[:2, 2] -= PIXEL_CENTRE
    return torch.as_tensor(np.ascontiguousarray(K @ camera.world_to_camera[:3])).float()


def _unit(vectors: Tensor) -> Tensor:
    return vectors / (vectors.norm(dim=-1, keepdim=True) + EPSILON)


def _sample(channels: Tensor, places: Tensor) -> Tensor:
    """Bilinear lookup of (C, H, W) at (..., 2) in [-1, 1], 0 outside, (..., C)."""
    flat = places.reshape(1, 1, -1, 2)
    # The kernel behind `functional.grid_sample`, which on a GPU would take cuDNN's: that refuses some numbers of places.
    sampled = torch.grid_sampler_2d(channels[None], flat, BILINEAR, ZEROS, True)
    return sampled[0, :, 0].T.reshape(*places.shape[:-1], channels.shape[0])


def see(networks: Networks, sources: Sequence[SourceView]) -> list[SeenView]:
    """The source views, ready to be looked up."""
    views = []
    for source in sources:
        image = torch.as_tensor(source.image).permute(2, 0, 1).float() / 255
        coarse, fine = networks.feature_net(image[None])
        centre = torch.as_tensor(source.camera.centre).float()
        views.append(SeenView(image, coarse[0].float(), fine[0].float(), projection_of(source.camera), centre))
    return views
