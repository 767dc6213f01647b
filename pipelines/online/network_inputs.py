"""What the blending network looks at: colours, depths and angles of every view, as channels in the target view."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.baselines.method import Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.pinhole import rigid_between
from ggvs_eval.pipelines.online.blending import BlendingInputs

COVERED_ALPHA = 0.5  # from this coverage on a view shows something


@dataclass(frozen=True, eq=False)
class BlendMaps:
    """The K views in the target view, nearest camera first.

    Attributes:
        target: camera of the maps.
        sources: cameras of the views.
        colours: splatted colour, (K, H, W, 3), float32 in [0, 1].
        depths: splatted depth, (K, H, W), float32, world units, 0 where the view shows nothing.
        alphas: coverage, (K, H, W), float32 in [0, 1).
        fused_depth: of the ray march, (H, W), float32, world units, 0 where it met nothing.
    """

    target: Camera
    sources: tuple[Camera, ...]
    colours: Map
    depths: Map
    alphas: Map
    fused_depth: Map

    def cropped(self, left: int, top: int, width: int, height: int) -> "BlendMaps":
        """The window that starts at pixel (left, top)."""
        rows, columns = slice(top, top + height), slice(left, left + width)
        return replace(
            self,
            target=self.target.cropped(left, top, width, height),
            colours=self.colours[:, rows, columns],
            depths=self.depths[:, rows, columns],
            alphas=self.alphas[:, rows, columns],
            fused_depth=self.fused_depth[rows, columns],
        )


def blend_maps(inputs: BlendingInputs) -> BlendMaps:
    """The maps of one instant, views ordered by the distance of their cameras from the target, ties by name."""
    cameras = [source.camera for source in inputs.instant.sources]
    if len(cameras) != len(inputs.splats):
        raise RenderError(f"blending network: wanted one splat per source view, got {len(inputs.splats)} for {len(cameras)}")
    target = inputs.instant.target
    order = sorted(range(len(cameras)), key=lambda k: (_distance(cameras[k], target), cameras[k].name))
    splats = [inputs.splats[k] for k in order]
    return BlendMaps(
        target=target,
        sources=tuple(cameras[k] for k in order),
        colours=np.stack([view.features[..., :3] for view in splats]),
        depths=np.stack([view.depth for view in splats]),
        alphas=np.stack([view.alpha for view in splats]),
        fused_depth=inputs.depth,
    )


def channel_count(views: int, tsdf_guidance: bool) -> int:
    """Number of channels of `input_channels`: 9 K + 1, without TSDF guidance 8 K."""
    return 9 * views + 1 if tsdf_guidance else 8 * views


def guide_depth(maps: BlendMaps, tsdf_guidance: bool = True) -> Map:
    """The depth of the surface that angles are measured at, (H, W), world units, 0 where unknown.

    Reading:
        The paper's ablation takes the fused depth away; angles are then measured at the splatted depth of the nearest view that
        covers the pixel.
    """
    if tsdf_guidance:
        return maps.fused_depth
    covers = maps.alphas >= COVERED_ALPHA  # (K, H, W)
    first = np.argmax(covers, axis=0)[None]
    return np.where(covers.any(axis=0), np.take_along_axis(maps.depths, first, axis=0)[0], np.float32(0))


def reference_depth(depth: Map, camera: Camera) -> float:
    """The length that depths and distances are measured in: the median of what is known, or the far plane."""
    known = depth[depth > 0]
    return float(np.median(known)) if known.size else camera.far


def input_channels(maps: BlendMaps, tsdf_guidance: bool = True, unit: float | None = None) -> Map:
    """The channels of the network's input.

    Args:
        maps: the views.
        tsdf_guidance: without, channels 4 and 5 are left out (ablation 'No TSDF Guidance').
        unit: what depths and distances are measured in, world units; `reference_depth` of the guide's depth unless given. A crop
            wants that of the whole view.

    Returns:
        (9 K + 1, H, W) or (8 K, H, W), float32, in this order: 1. splatted colours, 3 K; 2. their inverse depths, K;
        3. coverages, K; 4. inverse fused depth, 1; 5. cosine between the surface's normal and the direction to each camera, K;
        6. cosine between the directions to the target camera and to each camera, K; 7. distance of each camera from the target
        camera, K; 8. cosine between their axes, K.

    Reading:
        The paper names the eight groups. Depth enters as unit / depth, distance as distance / unit, so that nothing depends on
        the scale of the world. Directions go from the surface to the cameras; where the surface is unknown, cosines to its
        normal are 0 and the point lies on the far plane.
    """
    guide = guide_depth(maps, tsdf_guidance)
    unit = unit or reference_depth(guide, maps.target)
    known, size = guide > 0, guide.shape
    points = surface_points(maps.target, np.where(known, guide, np.float32(maps.target.far)))
    to_sources = [_unit(_centre(source, maps.target) - points) for source in maps.sources]
    of_surface = [_inverse(guide, unit)[None], _cosines(to_sources, surface_normals(points, known))] if tsdf_guidance else []
    groups = [
        np.moveaxis(maps.colours, 3, 1).reshape(-1, *size),
        _inverse(maps.depths, unit),
        maps.alphas,
        *of_surface,
        _cosines(to_sources, _unit(-points)),
        _constant([_distance(source, maps.target) / unit for source in maps.sources], size),
        _constant([float(source.axis @ maps.target.axis) for source in maps.sources], size),
    ]
    return np.concatenate(groups, dtype=np.float32)


def surface_points(camera: Camera, depth: Map) -> Map:
    """The points of a depth map in its camera's frame, (3, H, W), float32."""
    across = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    down = (np.arange(camera.height) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    return np.stack([depth * across.astype(np.float32), depth * down.astype(np.float32)[:, None], depth])


def surface_normals(points: Map, known: NDArray[np.bool_]) -> Map:
    """Unit normals of a depth map, towards the camera, from central differences (one-sided at the border).

    Args:
        points: in the camera's frame, (3, H, W).
        known: where there is a surface, (H, W).

    Returns:
        (3, H, W), float32, 0 where the pixel or one of its four neighbours is unknown.
    """
    padded = np.pad(points, ((0, 0), (1, 1), (1, 1)), mode="edge")
    along_row = padded[:, 1:-1, 2:] - padded[:, 1:-1, :-2]
    along_column = padded[:, 2:, 1:-1] - padded[:, :-2, 1:-1]
    normals = _unit(np.cross(along_column, along_row, axis=0))
    around = np.pad(known, 1, mode="edge")
    whole = known & around[1:-1, 2:] & around[1:-1, :-2] & around[2:, 1:-1] & around[:-2, 1:-1]
    facing = -np.sign(_dot(normals, points))
    return normals * (facing * whole)


def _distance(first: Camera, second: Camera) -> float:
    return float(np.linalg.norm(first.centre - second.centre))


def _centre(camera: Camera, target: Camera) -> Map:
    """Where a camera stands, seen from the target camera, (3, 1, 1)."""
    return rigid_between(camera, target)[:3, 3, None, None].astype(np.float32)


def _constant(values: Sequence[float], size: tuple[int, ...]) -> Map:
    """One constant map per value, (K, H, W)."""
    return np.broadcast_to(np.array(values, np.float32)[:, None, None], (len(values), *size))


def _cosines(directions: Sequence[Map], other: Map) -> Map:
    """Between each of K fields of unit vectors and another one, (K, H, W)."""
    return np.stack([_dot(each, other) for each in directions])


def _inverse(depth: Map, unit: float) -> Map:
    return np.divide(np.float32(unit), depth, out=np.zeros_like(depth), where=depth > 0)


def _dot(first: Map, second: Map) -> Map:
    return np.einsum("chw,chw->hw", first, second)


def _unit(vectors: Map) -> Map:
    length = np.maximum(np.sqrt(_dot(vectors, vectors)), np.float32(1e-12))
    return np.divide(vectors, length, dtype=np.float32)
