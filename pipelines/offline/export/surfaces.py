"""Surfaces of depth maps: normals of single maps, and the mesh that several fuse into."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import DepthError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.geometry.pinhole import as_image, as_image8

BLOCK = 8  # voxels along the edge of a block, the unit in which Open3D allocates
FEWEST_VIEWS = 0.5  # weight of a voxel is the number of cameras that measured it: one is enough
RADIUS_PX = 3  # of the window that a plane is fitted to
SAME_SURFACE = 0.03  # neighbours whose depth differs by a larger share belong to another surface
FEWEST = 8  # neighbours that decide on a plane
FOOTPRINTS = 2.0  # a voxel by default, in median pixels on the surface
MOST_VOXELS = 512  # along the diagonal of the scene by default; more would be gigabytes
TRUNCATION = 5.0  # voxels before and behind the surface over which it is averaged
# filled pixels have less, and with four partners those that one alone believes in
LEAST_CONFIDENCE = 0.3
FEWEST_TRIANGLES = 50  # of a connected part of the mesh; with fewer it is debris
SAMPLES = 20_000  # points of a camera that determine the scene's size


@dataclass(frozen=True, eq=False)
class Mesh:
    """A coloured mesh.

    Attributes:
        vertices: world units, (V, 3).
        colours: RGB in [0, 1], (V, 3).
        triangles: indices of vertices, (F, 3), counter-clockwise seen from outside.
    """

    vertices: Array
    colours: Array
    triangles: NDArray[np.int64]


def mesh_of(
    cameras: Sequence[Camera],
    images: Sequence[Image8],
    depths: Sequence[Map],
    voxel: float,
    truncation: float,
    origin: Array,
) -> Mesh:
    """Average the signed distances of all depth maps (Curless and Levoy) and extract their zero
    crossing.

    Args:
        images: RGB uint8, (H, W, 3).
        depths: z in world units, 0 = takes no part, (H, W) float32.
        voxel: edge of a voxel, world units.
        truncation: distances are averaged this many voxels before and behind the surface.
        origin: a place in the scene, (3,); Open3D computes in float32, and the world's own origin
            may be far away.

    Returns:
        The mesh in canonical order, so that equal inputs give equal bits: Open3D numbers its blocks
        as its threads meet them.
    """
    import open3d

    # its stubs refuse what its documentation shows
    core, grid_type = open3d.core, cast(Any, open3d.t.geometry.VoxelBlockGrid)
    grid = grid_type(
        ("tsdf", "weight", "color"), (core.float32,) * 3, ((1,), (1,), (3,)), voxel, BLOCK, 10_000
    )
    for camera, image, depth in zip(cameras, images, depths, strict=True):
        if depth.any():
            _integrate(grid, camera, image, depth, truncation, origin)
    mesh = grid.extract_triangle_mesh(FEWEST_VIEWS)
    if "positions" not in mesh.vertex or not len(mesh.vertex.positions):
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), np.int64))
    vertices, colours = (
        tensor.numpy().astype(np.float64) for tensor in (mesh.vertex.positions, mesh.vertex.colors)
    )
    return _in_order(
        vertices + origin, np.clip(colours, 0, 1), mesh.triangle.indices.numpy().astype(np.int64)
    )


def _integrate(
    grid: Any, camera: Camera, image: Image8, depth: Map, truncation: float, origin: Array
) -> None:
    import open3d

    tensor, picture = cast(Any, open3d.core.Tensor), cast(Any, open3d.t.geometry.Image)
    world_to_camera = camera.world_to_camera.copy()
    world_to_camera[:3, 3] += camera.rotation @ origin
    depth_image, colour_image = (
        picture(tensor(depth)),
        picture(tensor(image.astype(np.float32) / np.float32(255))),
    )
    # K as it is: a voxel reads the pixel that it falls into
    pose = tensor(camera.K), tensor(world_to_camera)
    # depth is in world units already, and none of it is too far
    limits = 1.0, 2 * float(depth.max()), truncation
    grid.integrate(
        grid.compute_unique_block_coordinates(depth_image, *pose, *limits),
        depth_image,
        colour_image,
        *pose,
        *limits,
    )


def _in_order(vertices: Array, colours: Array, triangles: NDArray[np.int64]) -> Mesh:
    """Sort vertices by place, and triangles by their vertices; vertices at one place become one."""
    rows, number = np.unique(
        np.concatenate([vertices, colours], axis=1), axis=0, return_inverse=True
    )
    triangles = number[triangles]
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    first = triangles.argmin(axis=1)[:, None]
    # (F, 3), the same sense of rotation
    turned = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    return Mesh(rows[:, :3], rows[:, 3:], turned[np.lexsort(turned.T[::-1])])


def surface_normals(camera: Camera, depth: Map) -> Map:
    """Return the unit normals in the camera's frame, towards the camera, by a plane fitted around
    each pixel.

    A plane n . p = d is linear in inverse depth, n . (x, y, 1) = d / z along the ray (x, y, 1), so
    that least squares over the neighbours of the same surface give its normal.

    Args:
        depth: (H, W), z in world units, 0 = invalid.

    Returns:
        (H, W, 3) float32; 0 if the depth is invalid or too few neighbours are on the same surface.
    """
    sums = _window_sums(depth)
    determined = (depth > 0) & (sums[5] >= FEWEST)
    across, down, level, determinant = _solve(*sums.astype(np.float64))
    determined &= determinant > 1.0
    x, y = np.moveaxis((camera.pixel_centres() - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]], -1, 0)
    across, down = across * camera.K[0, 0], down * camera.K[1, 1]
    away = np.stack([across, down, 1 + level - across * x - down * y], axis=-1)  # (H, W, 3)
    normals = -away / np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-30)
    return np.where(determined[..., None], normals, 0).astype(np.float32)


def _window_sums(depth: Map) -> Map:
    """Normal equations of inverse depth over that of the middle pixel, less 1, as a linear function
    of column and row.

    Returns:
        Sums over the neighbours of the same surface, (9, H, W): column^2, column row, row^2,
        column, row, 1, and of the excess times column, row and 1.
    """
    height, width = depth.shape
    padded = np.pad(depth, RADIUS_PX)
    sums = np.zeros((9, height, width), np.float32)
    for row, column in np.ndindex(2 * RADIUS_PX + 1, 2 * RADIUS_PX + 1):
        neighbour = padded[row : row + height, column : column + width]
        on_surface = (
            (depth > 0) & (neighbour > 0) & (np.abs(neighbour - depth) <= SAME_SURFACE * depth)
        )
        excess = np.divide(depth - neighbour, neighbour, out=np.zeros_like(depth), where=on_surface)
        u, v = np.float32(column - RADIUS_PX), np.float32(row - RADIUS_PX)
        for total, factor in zip(sums[:6], (u * u, u * v, v * v, u, v, np.float32(1)), strict=True):
            np.add(total, factor, out=total, where=on_surface)
        for total, factor in zip(sums[6:], (u, v, np.float32(1)), strict=True):
            total += factor * excess
    return sums


def _solve(
    uu: Array,
    uv: Array,
    vv: Array,
    u: Array,
    v: Array,
    count: Array,
    ru: Array,
    rv: Array,
    r: Array,
) -> tuple[Array, Array, Array, Array]:
    """Cramer's rule for the slopes across and down, the level, and the determinant, (H, W) each."""
    a, b, c = vv * count - v * v, u * v - uv * count, uv * v - u * vv
    d, e, f = uu * count - u * u, u * uv - uu * v, uu * vv - uv * uv
    determinant: Array = uu * a + uv * b + u * c
    safe = np.where(determinant > 0, determinant, 1.0)
    return (
        (a * ru + b * rv + c * r) / safe,
        (b * ru + d * rv + e * r) / safe,
        (c * ru + e * rv + f * r) / safe,
        determinant,
    )


@dataclass(frozen=True)
class FusedFiles:
    """Files that the fusion wrote.

    Attributes:
        points: PLY of the point cloud: places in world units, normals, colours.
        mesh: PLY of the mesh: vertices in world units, normals, colours, triangles.
        voxel: edge of a voxel, world units.
    """

    points: Path
    mesh: Path
    n_points: int
    n_vertices: int
    n_triangles: int
    voxel: float


@dataclass(frozen=True, eq=False)
class _View:
    """Contribution of one camera to the fusion.

    Attributes:
        image: RGB, (H, W, 3).
        depth: z of the pixels that are trusted, world units, 0 elsewhere, (H, W).
        normals: of these pixels, in the world, (N, 3).
    """

    camera: Camera
    image: Image8
    depth: Map
    normals: NDArray[np.float32]

    def points_world(self) -> Array:
        """Return the places of these pixels, (N, 3)."""
        mask = self.depth > 0
        return self.camera.unproject(
            self.camera.pixel_centres()[mask], self.depth[mask].astype(np.float64)
        )


def fuse_instant(
    cameras: Sequence[Camera],
    images: Sequence[Image8],
    depth_maps: Sequence[DepthMap],
    folder: Path,
    voxel: float = 0.0,
    fewest_triangles: int = FEWEST_TRIANGLES,
) -> FusedFiles:
    """Fuse the depth maps of one instant and write ``points.ply`` and ``mesh.ply``.

    Files that are there are replaced.

    Pixels that are not trusted, or around which the depth is no surface, take no part.

    Args:
        images: of one instant, RGB uint8 (H, W, 3), in the order of the cameras.
        folder: where to; made.
        voxel: edge of a voxel, world units, of the mesh and of the point cloud; 0 chooses one that
            suits the pixels.
        fewest_triangles: of a connected part of the mesh; smaller ones are debris and left out.

    Raises:
        DepthError: sizes that do not fit, no pixel that can be trusted, no surface, or files that
            cannot be written.

    Reading:
        The mesh is Curless and Levoy's: averaged signed distances in sparse voxels, zero crossing
        by marching cubes. All pixels weigh alike; confidence decides only which take part.
    """
    if not 0 <= voxel < np.inf:
        raise DepthError(f"fuse: wanted a voxel of 0 or more units, got {voxel:g}")
    _check_sizes(cameras, images, depth_maps)
    views = [_trusted(*view) for view in zip(cameras, images, depth_maps, strict=True)]
    if not any(view.depth.any() for view in views):
        raise DepthError(
            f"{folder}: wanted pixels with a confidence of {LEAST_CONFIDENCE:g} or more, "
            f"{len(cameras)} depth maps have none; check the depth page of `ggvs-eval prepare`, "
            "and use another --matcher"
        )
    sample = np.concatenate([_sample(view) for view in views])
    voxel = voxel or _fitting_voxel(views, sample)
    cloud, mesh = (
        _point_cloud(views, voxel),
        _mesh(views, sample.mean(axis=0), voxel, fewest_triangles),
    )
    if not len(mesh.triangles):
        raise DepthError(
            f"{folder}: {len(cloud.points)} points give no surface with voxels of {voxel:g} units; "
            f"choose others"
        )
    import open3d

    folder.mkdir(parents=True, exist_ok=True)
    _write(folder / "points.ply", lambda path: open3d.io.write_point_cloud(path, cloud))
    _write(folder / "mesh.ply", lambda path: open3d.io.write_triangle_mesh(path, mesh))
    counts = len(cloud.points), len(mesh.vertices), len(mesh.triangles)
    return FusedFiles(folder / "points.ply", folder / "mesh.ply", *counts, voxel)


def _check_sizes(
    cameras: Sequence[Camera], images: Sequence[Image8], depth_maps: Sequence[DepthMap]
) -> None:
    for camera, image, depth_map in zip(cameras, images, depth_maps, strict=True):
        as_image8(image, camera, DepthError)
        as_image(depth_map.depth, camera, "depth", DepthError)


def _trusted(camera: Camera, image: Image8, depth_map: DepthMap) -> _View:
    mask = (depth_map.depth > 0) & (depth_map.confidence >= LEAST_CONFIDENCE)
    depth = np.where(mask, depth_map.depth, np.float32(0))
    normals = surface_normals(camera, depth)
    lies_on_surface = normals.any(axis=-1)
    depth = np.where(lies_on_surface, depth, np.float32(0))
    return _View(
        camera=camera,
        image=image,
        depth=depth,
        normals=(normals[lies_on_surface] @ camera.rotation).astype(np.float32),
    )


def _sample(view: _View) -> Array:
    points_world = view.points_world()
    return points_world[:: -(-len(points_world) // SAMPLES) or 1]


def _fitting_voxel(views: Sequence[_View], sample: Array) -> float:
    """Return a few pixels on the surface, unless the scene is so large that this would be too many
    voxels.
    """
    footprints = np.concatenate(
        [view.depth[view.depth > 0] / view.camera.focal_px for view in views]
    )
    low, high = np.percentile(sample, (1, 99), axis=0)
    return max(
        FOOTPRINTS * float(np.median(footprints)), float(np.linalg.norm(high - low)) / MOST_VOXELS
    )


def _point_cloud(views: Sequence[_View], voxel: float) -> Any:
    """Return the mean place, normal and colour in each voxel, every camera counted once, an
    `open3d.geometry.PointCloud`.
    """
    import open3d

    vectors, cloud = open3d.utility.Vector3dVector, open3d.geometry.PointCloud()
    for view in views:
        if view.depth.any():
            view_cloud = open3d.geometry.PointCloud(vectors(view.points_world()))
            view_cloud.normals = vectors(view.normals.astype(np.float64))
            view_cloud.colors = vectors(view.image[view.depth > 0] / 255.0)
            # camera by camera: all pixels of a rig would be gigabytes
            cloud += view_cloud.voxel_down_sample(voxel)
    return cloud.voxel_down_sample(voxel).normalize_normals()


def _mesh(views: Sequence[_View], middle: Array, voxel: float, fewest_triangles: int) -> Any:
    """Return the mesh without debris, an `open3d.geometry.TriangleMesh`."""
    import open3d

    origin = np.rint(middle / voxel) * voxel
    cameras, images, depths = (
        [getattr(view, part) for view in views] for part in ("camera", "image", "depth")
    )
    surface = mesh_of(cameras, images, depths, voxel, TRUNCATION, origin)
    utility = open3d.utility
    mesh = open3d.geometry.TriangleMesh(
        utility.Vector3dVector(surface.vertices), utility.Vector3iVector(surface.triangles)
    )
    mesh.vertex_colors = utility.Vector3dVector(surface.colours)
    part, n_triangles, _ = (np.asarray(values) for values in mesh.cluster_connected_triangles())
    mesh.remove_triangles_by_mask(n_triangles[part] < fewest_triangles if len(part) else [])
    mesh.remove_unreferenced_vertices()
    mesh.compute_vertex_normals()
    return mesh


def _write(path: Path, write: Callable[[Path], bool]) -> None:
    """Write a PLY file whole or not at all."""
    with atomic_file(path, ending=".ply") as temporary:  # Open3D goes by the suffix
        if not write(temporary):
            raise DepthError(
                f"{path}: Open3D cannot write this file; check the free disk space and the "
                f"folder's permissions"
            )
