"""Three source views, and the feature volume in the frustum of the first."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.more_baselines.mvsnerf.network import FEATURE_WIDTH, VIEWS, Encoding
from ggvs_eval.method import SourceView

PLANES = 128
MARGIN_CELLS = 24  # on every side of the reference's frustum
CELL_PX = 4  # pixels of the image per cell
SIZE_MULTIPLE = 32  # sides are padded to it: the volume is at 1/4 and is halved three times
IMAGENET_MEAN, IMAGENET_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
# of the nearest depth; what is behind a camera is far outside its image
SMALLEST_DEPTH_SHARE = 1e-6
Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Volume:
    """The encoded frustum of the reference, the first of the views.

    Attributes:
        features: of its cells, (8, D, h, w), margin included.
        images: of the views, RGB in [0, 1], (3, H, W) each.
        cameras: of the views.
        near: depth of its first plane in the reference, world units.
        far: depth of its last one.
        width: of the padded image that the frustum is of, pixels.
        height: of it, pixels.
    """

    features: Tensor
    images: tuple[Tensor, ...]
    cameras: tuple[Camera, ...]
    near: float
    far: float
    width: int
    height: int

    def places(self, points_world: Tensor) -> Tensor:
        """Return the points (N, 3) in the volume whose sides, margin included, run from 0 to 1, (N,
        3).
        """
        u, v, z = project(self.cameras[0], points_world, self.near).unbind(dim=-1)
        sides = [(u, self.width), (v, self.height)]
        across, down = (
            _with_margin(pixels / (size - 1), size // CELL_PX) for pixels, size in sides
        )
        return torch.stack([across, down, (z - self.near) / (self.far - self.near)], dim=-1)

    def look_up(self, places: Tensor) -> Tensor:
        """Return the features at places (N, 3), zero outside, (N, 8)."""
        grid = (2 * places - 1).view(1, 1, 1, -1, 3)
        return functional.grid_sample(
            self.features[None], grid, mode="bilinear", align_corners=True
        )[0, :, 0, 0].T

    def colours(self, points_world: Tensor) -> Tensor:
        """RGB of each view at points (N, 3), that of the border outside its image, and 1 within it
        or 0, (N, 3 * 4).
        """
        columns = []
        for image, camera in zip(self.images, self.cameras, strict=True):
            uvz = project(camera, points_world, self.near)
            grid = 2 * uvz[:, :2] / uvz.new_tensor([image.shape[2] - 1, image.shape[1] - 1]) - 1
            sampled = functional.grid_sample(
                image[None],
                grid[None, None],
                mode="bilinear",
                padding_mode="border",
                align_corners=True,
            )
            columns += [sampled[0, :, 0].T, _inside(grid)[:, None]]
        return torch.cat(columns, dim=-1)


def _with_margin(share: Tensor, cells: int) -> Tensor:
    return (share * cells + MARGIN_CELLS) / (cells + 2 * MARGIN_CELLS)


def _inside(grid: Tensor) -> Tensor:
    """1 if both coordinates are within (-1, 1), else 0."""
    return (grid.abs() < 1).all(dim=-1).float()


def project(camera: Camera, points_world: Tensor, near: float) -> Tensor:
    """Return the pixels with centres at whole numbers, and depth, (N, 3) to (N, 3)."""
    world_to_image = camera.K_opencv @ camera.world_to_camera[:3]
    matrix = torch.as_tensor(world_to_image).float()
    projected = points_world @ matrix[:, :3].T + matrix[:, 3]
    depth = projected[:, 2:]
    return torch.cat(
        [projected[:, :2] / depth.clamp(min=SMALLEST_DEPTH_SHARE * near), depth], dim=-1
    )


def encode_volume(
    network: Encoding, sources: Sequence[SourceView], near: float, far: float
) -> Volume:
    """Encode the frustum of the first source.

    Args:
        network: the trained one.
        sources: three, the first one is the reference.
        near: depth of the first plane in it, world units.
        far: depth of the last one.
    """
    images = [torch.as_tensor(source.image).permute(2, 0, 1).float() / 255 for source in sources]
    height, width = (_padded(max(image.shape[axis] for image in images)) for axis in (1, 2))
    padded = torch.stack([_pad(image, height, width) for image in images])
    mean, deviation = (
        padded.new_tensor(values)[:, None, None] for values in (IMAGENET_MEAN, IMAGENET_DEVIATION)
    )
    normalised = (padded - mean) / deviation
    features = network.feature(normalised)
    small = functional.interpolate(
        normalised, features.shape[2:], mode="bilinear", align_corners=False
    )
    cameras = tuple(source.camera for source in sources)
    costs = cost_volume(features, small, cameras, near, torch.linspace(near, far, PLANES))
    encoded = network.cost_reg_2(costs[None])[0]
    return Volume(
        features=encoded,
        images=tuple(images),
        cameras=cameras,
        near=near,
        far=far,
        width=width,
        height=height,
    )


def cost_volume(
    features: Tensor, colours: Tensor, cameras: Sequence[Camera], near: float, depths: Tensor
) -> Tensor:
    """Return the colours of the views and the variance of their features over planes before the
    reference.

    Args:
        features: of the views, (3, 32, h, w).
        colours: of the views at that size, (3, 3, h, w).
        cameras: of the views.
        near: smallest depth that is distinguished from zero, world units.
        depths: of the planes in the reference, (D,).

    Returns:
        (9 + 32, D, h + 2 margin, w + 2 margin). A view counts where it sees a cell, the reference
        everywhere, with zeros in the margin.

    Reading:
        The authors leave the reference's colours undefined in the margin; they are zero here.
    """
    height, width = features.shape[2:]
    margins = (MARGIN_CELLS,) * 4
    of_reference = functional.pad(features[0], margins)
    rows, columns = (
        torch.arange(-MARGIN_CELLS, side + MARGIN_CELLS, dtype=torch.float32)
        for side in (height, width)
    )
    grid = torch.stack(
        [*torch.meshgrid(columns, rows, indexing="xy"), torch.ones(len(rows), len(columns))], dim=-1
    )
    cell_to_world = np.linalg.inv(_projection(cameras[0]))
    warps = [torch.as_tensor(_projection(camera) @ cell_to_world).float() for camera in cameras[1:]]
    turned = [grid @ warp[:3, :3].T for warp in warps]
    largest = grid.new_tensor([width - 1, height - 1])
    volume = features.new_zeros(3 * VIEWS + FEATURE_WIDTH, len(depths), len(rows), len(columns))
    volume[:3] = functional.pad(colours[0], margins)[:, None]
    # one at a time: the warped features of all would take three times the volume
    for plane, depth in enumerate(depths):
        total, squares, count = (
            of_reference.clone(),
            of_reference.square(),
            torch.ones_like(of_reference[:1]),
        )
        for view, (warp, directions) in enumerate(zip(warps, turned, strict=True), start=1):
            projected = directions * depth + warp[:3, 3]
            places = (
                2
                * projected[..., :2]
                / projected[..., 2:].clamp(min=SMALLEST_DEPTH_SHARE * near)
                / largest
                - 1
            )
            stacked = torch.cat([colours[view], features[view]])[None]
            warped = functional.grid_sample(
                stacked, places[None], mode="bilinear", align_corners=True
            )[0]
            volume[3 * view : 3 * view + 3, plane] = warped[:3]
            total, squares, count = (
                total + warped[3:],
                squares + warped[3:].square(),
                count + _inside(places),
            )
        volume[3 * VIEWS :, plane] = squares / count - (total / count).square()
    return volume


def _projection(camera: Camera) -> Matrix:
    """World to (u z, v z, z, 1) in cells, (4, 4).

    The first two rows of K are scaled, pixel (0, 0) stays, as the authors'.
    """
    scaled = np.eye(4)
    scaled[:3, :3] = np.diag([1 / CELL_PX, 1 / CELL_PX, 1.0]) @ camera.K_opencv
    return np.asarray(scaled @ camera.world_to_camera)


def _padded(side_px: int) -> int:
    """Return the next multiple of 32."""
    return -(-side_px // SIZE_MULTIPLE) * SIZE_MULTIPLE


def _pad(image: Tensor, height: int, width: int) -> Tensor:
    """Repeat the border at the right and at the bottom, (3, H, W) to (3, height, width)."""
    return functional.pad(
        image[None], (0, width - image.shape[2], 0, height - image.shape[1]), mode="replicate"
    )[0]
