"""GPS-Gaussian behind the `Method` interface: every instant alone, from the nearest pair that makes
a stereo pair.

Its cameras are turned so that matching points are on one row, each on its own canvas.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ggvs_eval.arrays import Array, Map
from ggvs_eval.baselines.gps_gaussian.network import (
    SIZE_MULTIPLE,
    GaussianMaps,
    GpsGaussianNetwork,
    load_network,
)
from ggvs_eval.baselines.gps_gaussian.rendering import (
    Gaussians,
    join,
    render_gaussians,
    rotation_matrices,
)
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import clock_s, compute_device, rendering_on
from ggvs_eval.errors import RenderError, ViewRefusedError
from ggvs_eval.geometry.source_views import turn_rad
from ggvs_eval.method import Instant, Rendering, SourceView

MIN_PARALLAX_SINE = 0.5  # between the line through both centres and the viewing direction
MAX_TURN_RAD = np.pi / 3  # between the two viewing directions
# of a rectified ray; smaller ones are so far out that the image is stretched beyond use
MIN_RAY_Z = 0.1
MOST_PIXELS = 6.0  # of a whole canvas per pixel of the larger image


@dataclass(frozen=True, eq=False)
class RectifiedView:
    """One half of a pair.

    Attributes:
        camera: the source camera turned; its size is that of the canvas.
        positions: position of each canvas pixel in the source image, (Hc, Wc, 2), array indices
            (pixel centres at integers).
        inside: canvas pixels that the source sees, (Hc, Wc).
        depth_ratio: depth in the source camera per depth in the rectified one, (Hc, Wc).
    """

    camera: Camera
    positions: Map
    inside: NDArray[np.bool_]
    depth_ratio: Map

    def image(self, source: SourceView) -> Map:
        """Return the source image on the canvas, (Hc, Wc, 3), in [0, 1]; 0 outside."""
        colours = cv2.remap(
            source.image, self.positions, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.where(
            self.inside[..., None], colours.astype(np.float32) / np.float32(255), np.float32(0)
        )

    def inverse_depth(self, source: SourceView) -> Map:
        """Inverse of the depth that the source comes with, in the rectified camera, (Hc, Wc), per
        world unit, 0 = unknown.

        Depth is taken from the nearest pixel, so that no point appears between two surfaces.
        """
        depth = cv2.remap(
            np.ascontiguousarray(source.depth, np.float32),
            self.positions,
            None,
            cv2.INTER_NEAREST,
            borderValue=0,
        )
        return np.divide(
            self.depth_ratio, depth, out=np.zeros_like(depth), where=self.inside & (depth > 0)
        )


@dataclass(frozen=True, eq=False)
class RectifiedPair:
    """Both halves, left one first."""

    left: RectifiedView
    right: RectifiedView

    @property
    def views(self) -> tuple[RectifiedView, RectifiedView]:
        """Left and right."""
        return self.left, self.right

    def inverse_depth(self, flow: Map) -> Map:
        """Return the inverse depth of both halves from the flow between them.

        Args:
            flow: column of each pixel's match in the other half less its own, pixels, (2, Hc, Wc),
                left half first.

        Returns:
            Per world unit, (2, Hc, Wc); 0 outside, and not positive where the flow points the wrong
            way.
        """
        baseline = float(np.linalg.norm(self.right.camera.centre - self.left.camera.centre))
        offset_px = self.right.camera.K[0, 2] - self.left.camera.K[0, 2]
        disparity = np.stack([offset_px - flow[0], offset_px + flow[1]])
        inside = np.stack([view.inside for view in self.views])
        return np.where(inside, disparity / (self.left.camera.K[0, 0] * baseline), 0.0).astype(
            np.float32
        )


@lru_cache(maxsize=4)
def rectify(left: Camera, right: Camera, entire: bool = False) -> RectifiedPair:
    """Rectify a pair.

    Args:
        right: the other one; a right camera below the left one gives canvases on their sides.
        entire: canvases that hold the whole images, instead of ones of the images' size.

    Reading:
        As the authors' recipe: both canvases have the size of the images, one focal length and one
        row for the horizon, and each keeps its image in its middle, so that the principal points
        differ. The focal length is the mean of both. Such canvases lose the corners of turned
        images, which shows where there is more than a person before a black wall: in the validation
        rooms the 1 % of the pixels that stay black for it carried 42 % of the squared error. Hence
        the whole ones. Those of cameras that walk almost ahead grow without bound (50 times the
        image in a hand-held sequence, 16 GB to learn from a window of 96 x 80 pixels): one of more
        than `MOST_PIXELS` takes a shorter focal length; flame_steak reaches 5.1.
    """
    axes = _rectifying_axes(left, right)
    focal_px = (left.focal_px + right.focal_px) / 2
    corners = np.stack([_corners(camera, axes, focal_px) for camera in (left, right)])  # (2, 4, 2)
    if entire:
        shrink = _shrink(corners, max(left.width * left.height, right.width * right.height))
        focal_px, corners = focal_px * shrink, corners * shrink
        low, high = corners.min(axis=1), corners.max(axis=1)
        columns, row = (low + high)[:, 0] / 2, (low[:, 1].min() + high[:, 1].max()) / 2
        size = _in_multiples((high - low)[:, 0].max(), high[:, 1].max() - low[:, 1].min())
    else:
        columns, row = corners[..., 0].mean(axis=1), corners[..., 1].mean()
        size = _canvas_size(left, right, axes)
    views = []
    for camera, column in zip((left, right), columns.tolist(), strict=True):
        K = np.array(
            [[focal_px, 0, size[0] / 2 - column], [0, focal_px, size[1] / 2 - row], [0, 0, 1]]
        )
        views.append(_view(camera, K, axes, size))
    return RectifiedPair(*views)


def _shrink(corners: Array, image_pixels: int) -> float:
    """Return the factor per side, at most 1, that keeps a canvas of all corners (2, 4, 2) within
    `MOST_PIXELS`.
    """
    width, height = np.ptp(corners[..., 0], axis=1).max(), np.ptp(corners[..., 1])
    return float(min(1.0, np.sqrt(MOST_PIXELS * image_pixels / (width * height))))


def _rectifying_axes(left: Camera, right: Camera) -> Array:
    """Return world to rectified axes, (3, 3): x to the right camera, z as close as possible to both
    viewing directions.
    """
    towards = right.centre - left.centre
    forward = left.axis + right.axis
    distance, length = float(np.linalg.norm(towards)), float(np.linalg.norm(forward))
    angle_rad = turn_rad(left, right)
    pair = f"cameras {left.name} and {right.name}"
    if distance < 1e-9 * left.near or angle_rad > MAX_TURN_RAD:
        raise RenderError(
            f"wanted a stereo pair, {pair} are {distance:g} apart and {np.degrees(angle_rad):.0f} "
            f"degrees turned"
        )
    if np.linalg.norm(np.cross(towards, forward)) < MIN_PARALLAX_SINE * distance * length:
        raise RenderError(f"wanted a stereo pair, {pair} are behind each other")
    x = towards / distance
    y = np.cross(forward, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)])


def _canvas_size(left: Camera, right: Camera, axes: Array) -> tuple[int, int]:
    """(width, height): the larger image's, in multiples that the network takes, on its side if the
    pair is upright.
    """
    sides = max(left.width, right.width), max(left.height, right.height)
    across, down = np.abs((left.rotation + right.rotation) @ axes[0])[:2]
    return _in_multiples(*(sides if across >= down else sides[::-1]))


def _in_multiples(width: float, height: float) -> tuple[int, int]:
    """Return the sides in multiples that the network takes."""
    return int(-(-width // SIZE_MULTIPLE) * SIZE_MULTIPLE), int(
        -(-height // SIZE_MULTIPLE) * SIZE_MULTIPLE
    )


def _corners(camera: Camera, axes: Array, focal_px: float) -> Array:
    """Return the image's corners on the rectified plane, pixels from the principal point,
    (4, 2).
    """
    corners = np.array(
        [[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]], np.float64
    )
    rays = (camera.unproject(corners, np.ones(4)) - camera.centre) @ axes.T  # (4, 3)
    if rays[:, 2].min() < MIN_RAY_Z:
        raise RenderError(
            f"camera {camera.name} wanted a stereo pair, its direction differs too much from its "
            f"partner's"
        )
    corners_px: Array = rays[:, :2] / rays[:, 2:] * focal_px
    return corners_px


def _view(camera: Camera, K: Array, axes: Array, size: tuple[int, int]) -> RectifiedView:
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = axes, -axes @ camera.centre
    turned = replace(camera, K=K, world_to_camera=world_to_camera, width=size[0], height=size[1])
    # a point at rectified depth 1 of every canvas pixel
    uv, depth_ratio = camera.project(turned.rays() + camera.centre)
    inside = (depth_ratio > 0) & ((uv >= 0.5) & (uv <= np.array(camera.size) - 0.5)).all(axis=-1)
    positions = np.where(inside[..., None], uv - 0.5, -1.0).astype(np.float32)
    return RectifiedView(
        camera=turned,
        positions=positions,
        inside=inside,
        depth_ratio=depth_ratio.astype(np.float32),
    )


def choose_pairs(target: Camera, cameras: Sequence[Camera], count: int) -> list[tuple[int, int]]:
    """Return the nearest pairs that can be rectified; no camera is in two of them.

    Args:
        count: pairs wanted; fewer come back if there are no more.

    Returns:
        Indices of the cameras of each pair, nearest pair first; in each, left camera first.

    Reading:
        The authors name their pair by hand: the neighbours of the target on a ring. Here it is the
        rectifiable pair with the smallest sum of distances to the target, ties in the order of the
        sources.
    """
    distances = [float(np.linalg.norm(camera.centre - target.centre)) for camera in cameras]
    pairs: list[tuple[int, int]] = []
    refusals: list[str] = []
    for first, second in sorted(
        combinations(range(len(cameras)), 2),
        key=lambda pair: distances[pair[0]] + distances[pair[1]],
    ):
        if len(pairs) == count:
            break
        if any(camera in pair for pair in pairs for camera in (first, second)):
            continue
        ordered = _in_order(cameras, first, second)
        try:
            rectify(cameras[ordered[0]], cameras[ordered[1]])
        except RenderError as error:
            refusals.append(str(error))
            continue
        pairs.append(ordered)
    if not pairs:
        raise ViewRefusedError(
            f"GPS-Gaussian needs a stereo pair among the sources; "
            f"{refusals[0] if refusals else 'got one camera'}"
        )
    return pairs


def _in_order(cameras: Sequence[Camera], first: int, second: int) -> tuple[int, int]:
    """Left camera first; of two that are on top of each other the upper one."""
    camera, partner = cameras[first], cameras[second]
    towards = partner.centre - camera.centre
    across, down = ((camera.rotation + partner.rotation) @ towards)[:2]
    leading = across if abs(across) >= abs(down) else down
    return (first, second) if leading >= 0 else (second, first)


@dataclass(frozen=True)
class GpsGaussian:
    """GPS-Gaussian (Zheng et al. 2024); nothing is remembered from instant to instant.

    Attributes:
        weights: file of its weights, see `load_network`.
        depth: ``own`` stereo between the two images, or the depth ``given`` with the sources;
            Gaussians are its own either way.
        pairs: how many pairs are rendered together; by default what the weights' configuration
            says, one for the authors'.
        rotations_in: what the network's rotations refer to, see `GpsGaussianShape`, which says it
            where nothing is said here.

    Reading:
        The network knows metres: inverse depth goes in per metre, and scales, at most 0.01 m, come
        out in metres. What that is in the world follows from `Instant.units_per_metre`. The limit
        is the authors', for persons two metres away, and is kept so that their weights mean the
        same; it binds where a pixel is wider than about 2 cm: in images 480 pixels wide beyond 5 m.
        Pixels outside the rectified image are grey to the network, as the authors' masks make them,
        and have no Gaussian; nor do pixels whose disparity has the wrong sign.
    """

    weights: Path
    depth: Literal["own", "given"] = "own"
    pairs: int | None = None
    rotations_in: Literal["world", "camera"] | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        """Refuse options that mean nothing."""
        frames = (None, "world", "camera")
        if (
            self.depth not in ("own", "given")
            or self.rotations_in not in frames
            or (self.pairs is not None and self.pairs < 1)
        ):
            raise RenderError(
                "GPS-Gaussian: wanted depth own or given, rotations_in world or camera and at "
                f"least one pair, got {self.depth!r}, {self.rotations_in!r} and {self.pairs}"
            )
        compute_device(self.device)

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant."""
        device = compute_device(self.device)
        network = load_network(self.weights, device)
        config = network.config
        with rendering_on(device):
            started = clock_s(device)
            gaussians = instant_gaussians(
                network,
                instant,
                self.depth,
                self.pairs or config.pairs,
                self.rotations_in or config.rotations_in,
            )
            regressed = clock_s(device)
            image = render_gaussians(gaussians, instant.target, instant.near_plane)
        seconds = {"network": regressed - started, "splat": clock_s(device) - regressed}
        return Rendering(np.minimum(image.colour, np.float32(1)), image.depth, seconds)


def instant_gaussians(
    network: GpsGaussianNetwork,
    instant: Instant,
    depth: Literal["own", "given"],
    pairs: int,
    rotations_in: Literal["world", "camera"],
) -> Gaussians:
    """The Gaussians of an instant's nearest pairs.

    Arguments as of `GpsGaussian`, gradients reach the network's parameters.
    """
    parts = []
    for left, right in choose_pairs(
        instant.target, [source.camera for source in instant.sources], pairs
    ):
        sources = instant.sources[left], instant.sources[right]
        pair = rectify(sources[0].camera, sources[1].camera, network.config.entire)
        colours = [view.image(source) for view, source in zip(pair.views, sources, strict=True)]
        images = torch.stack(
            [_network_image(view, image) for view, image in zip(pair.views, colours, strict=True)]
        )
        features = network.features(images)
        inverse = _given(pair, sources) if depth == "given" else _own(pair, network.flow(features))
        per_metre = torch.as_tensor(inverse * np.float32(instant.units_per_metre))[:, None]
        maps = network.gaussians(images, per_metre, features)
        parts += [
            _of_view(
                view,
                colours[half],
                inverse[half],
                _half(maps, half),
                instant.units_per_metre,
                rotations_in,
            )
            for half, view in enumerate(pair.views)
        ]
    return join(parts)


def _of_view(
    view: RectifiedView,
    image: Map,
    inverse: Map,
    maps: GaussianMaps,
    units_per_metre: float,
    rotations_in: str,
) -> Gaussians:
    """Return the Gaussians of the pixels with known depth; maps are (C, H, W)."""
    rows, columns = np.nonzero(view.inside & (inverse > 0))
    uv = np.stack([columns, rows], axis=1).astype(np.float64) + 0.5
    centres = view.camera.unproject(uv, 1 / inverse[rows, columns].astype(np.float64))
    rotation, scale_m, opacity = (
        values[:, torch.as_tensor(rows), torch.as_tensor(columns)].float() for values in maps
    )
    axes = rotation_matrices(rotation.T)
    if rotations_in == "camera":
        axes = torch.as_tensor(view.camera.rotation.T.astype(np.float32)) @ axes
    colours = torch.as_tensor(image[rows, columns])
    return Gaussians(
        centres=torch.as_tensor(centres),
        axes=axes,
        scales=scale_m.T * units_per_metre,
        opacities=opacity[0],
        colours=colours,
    )


def _network_image(view: RectifiedView, image: Map) -> Tensor:
    """(3, H, W) in [-1, 1], 0 outside."""
    return (
        torch.as_tensor(np.where(view.inside[..., None], 2 * image - 1, np.float32(0)))
        .permute(2, 0, 1)
        .contiguous()
    )


def _given(pair: RectifiedPair, sources: tuple[SourceView, SourceView]) -> Map:
    """Return the inverse depth of both halves from the depth that the sources come with, (2, Hc,
    Wc), per world unit.
    """
    return np.stack(
        [view.inverse_depth(source) for view, source in zip(pair.views, sources, strict=True)]
    )


def _own(pair: RectifiedPair, flow: Tensor) -> Map:
    """Return the inverse depth of both halves from the network's flow (2, 1, Hc, Wc), (2, Hc, Wc),
    per world unit.
    """
    return pair.inverse_depth(flow[:, 0].numpy(force=True))


def _half(maps: GaussianMaps, half: int) -> GaussianMaps:
    return GaussianMaps(*(values[half] for values in maps))
