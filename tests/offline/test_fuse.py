"""An instant as point cloud and mesh: where the surfaces are, in their colours, whatever took part
in vain.
"""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import DepthError
from ggvs_eval.pipelines.offline.export.surfaces import fuse_instant, surface_normals
from helpers.refusals import refused
from helpers.stereo_scenes import look_from

WALL_Z, BALL, RADIUS = 7.0, np.array([0.3, -0.2, 5.0]), 0.8
RED, BLUE = (220, 40, 30), (20, 60, 200)
VOXEL = 0.04


def cameras() -> list[Camera]:
    """Four cameras in a square, turned inwards."""
    return [look_from(x, y, f"cam{x:+g}{y:+g}", -0.06) for x in (-0.5, 0.5) for y in (-0.4, 0.4)]


def see(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Image and exact depth of a red wall with a blue ball before it."""
    rays, from_ball = camera.rays(), camera.centre - BALL
    wall = (WALL_Z - camera.centre[2]) / rays[..., 2]
    a, b, c = (rays**2).sum(-1), rays @ from_ball, from_ball @ from_ball - RADIUS**2
    root = b * b - a * c
    ball = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    image = np.where((ball < wall)[..., None], BLUE, RED).astype(np.uint8)
    return image, np.minimum(ball, wall).astype(np.float32)


def confident(depth: np.ndarray, confidence: float = 0.9) -> DepthMap:
    return DepthMap(depth, np.where(depth > 0, np.float32(confidence), np.float32(0)))


def distance(points: np.ndarray, shift: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the nearest of the two surfaces, and whether that is the ball."""
    points = points - shift
    wall, ball = (
        np.abs(points[:, 2] - WALL_Z),
        np.abs(np.linalg.norm(points - BALL, axis=1) - RADIUS),
    )
    return np.minimum(wall, ball), ball < wall


def fitted_centre(points: np.ndarray) -> np.ndarray:
    """Centre of the sphere through points of the ball, by least squares."""
    off, on_ball = distance(points)
    chosen = points[on_ball & (off < 0.2 * RADIUS)]
    return np.linalg.lstsq(
        np.c_[2 * chosen, np.ones(len(chosen))], (chosen**2).sum(axis=1), rcond=None
    )[0][:3]


@pytest.fixture(scope="module")
def scene() -> tuple[list[Camera], list[np.ndarray], list[np.ndarray]]:
    rig = cameras()
    seen = [see(camera) for camera in rig]
    return rig, [image for image, _ in seen], [depth for _, depth in seen]


@pytest.fixture(scope="module")
def fused(scene, tmp_path_factory):
    rig, images, depths = scene
    return fuse_instant(
        rig,
        images,
        [confident(depth) for depth in depths],
        tmp_path_factory.mktemp("fused") / "a" / "b",
    )


def test_points_lie_on_the_surfaces(fused):
    """Trimesh reads the cloud back: as many points as were said, all within half a voxel of the
    wall or the ball.
    """
    cloud = trimesh.load(fused.points)
    off, on_ball = distance(np.asarray(cloud.vertices))
    assert len(cloud.vertices) == fused.n_points > 2000
    assert off.max() < fused.voxel / 2
    assert 0.05 < on_ball.mean() < 0.5
    # a third of a pixel
    assert np.abs(fitted_centre(np.asarray(cloud.vertices)) - BALL).max() < 0.005
    assert np.asarray(cloud.vertices)[:, 2].max() == pytest.approx(WALL_Z, abs=1e-3)
    assert np.asarray(cloud.vertices)[:, 2].min() == pytest.approx(BALL[2] - RADIUS, abs=0.02)


def test_points_have_the_colours_of_the_images(fused):
    """The ball is blue and the wall is red, in the order of channels that the images have."""
    cloud = trimesh.load(fused.points)
    _, on_ball = distance(np.asarray(cloud.vertices))
    colours = np.asarray(cloud.colors)[:, :3].astype(int)
    assert (np.abs(colours[on_ball] - BLUE).max(axis=1) <= 1).mean() > 0.99
    assert (np.abs(colours[~on_ball] - RED).max(axis=1) <= 1).mean() > 0.99


def test_points_have_normals_towards_the_cameras(fused):
    """Normals are those of the wall and of the ball, and face the side they were seen from."""
    raw = trimesh.load(fused.points).metadata["_ply_raw"]["vertex"]["data"]
    points, normals = (
        np.stack([raw[axis] for axis in names], axis=-1).reshape(-1, 3)
        for names in ("xyz", ("nx", "ny", "nz"))
    )
    _, on_ball = distance(points)
    truth = np.where(on_ball[:, None], (points - BALL) / RADIUS, [0, 0, -1.0])
    cosine = (normals * truth).sum(axis=1)
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-6
    assert np.median(cosine) > 0.999
    assert (cosine > 0.95).mean() > 0.98


def test_mesh_is_the_surface(fused):
    """Trimesh reads the mesh back: its vertices lie on the wall or the ball, and the ball's front
    is all there.
    """
    mesh = trimesh.load(fused.mesh)
    off, on_ball = distance(np.asarray(mesh.vertices))
    assert (len(mesh.vertices), len(mesh.faces)) == (fused.n_vertices, fused.n_triangles)
    assert np.median(off) < 0.1 * fused.voxel
    assert (off < fused.voxel).mean() > 0.98
    beside = np.abs(fitted_centre(np.asarray(mesh.vertices)) - BALL)
    assert beside[:2].max() < 0.005  # a third of a pixel
    # signed distances along rays are too long where they graze the ball
    assert beside[2] < 0.25 * fused.voxel
    towards = np.random.default_rng(0).normal(size=(300, 3)) * [0.4, 0.4, 0.1] - [0, 0, 1]
    front = BALL + RADIUS * towards / np.linalg.norm(towards, axis=1, keepdims=True)
    gaps = np.linalg.norm(front[:, None] - np.asarray(mesh.vertices)[None, on_ball], axis=-1).min(
        axis=1
    )
    assert gaps.max() < 1.5 * fused.voxel


def test_mesh_has_colours_and_faces_the_cameras(fused):
    """Vertices have the colours of the images; triangles run counter-clockwise as seen from the
    cameras.
    """
    mesh = trimesh.load(fused.mesh, process=False)
    off, on_ball = distance(np.asarray(mesh.vertices))
    colours, sure = mesh.visual.vertex_colors[:, :3].astype(int), off < 0.1 * fused.voxel
    assert np.median(np.abs(colours[on_ball & sure] - BLUE).max(axis=1)) <= 1
    assert np.median(np.abs(colours[~on_ball & sure] - RED).max(axis=1)) <= 1
    first, second, third = np.asarray(mesh.vertices)[np.asarray(mesh.faces)].swapaxes(0, 1)
    assert (np.cross(second - first, third - first)[:, 2] < 0).mean() > 0.98


@pytest.mark.slow
def test_far_from_the_origin(scene, tmp_path):
    """A world whose origin is ten million units away gives the same surfaces; 32 bits alone would
    lose them.
    """
    rig, images, depths = scene
    shift = np.array([1e7, -2e7, 3e6])
    moved = []
    for camera in rig:
        world_to_camera = camera.world_to_camera.copy()
        world_to_camera[:3, 3] -= camera.rotation @ shift
        moved.append(replace(camera, world_to_camera=world_to_camera))
    fused = fuse_instant(
        moved, images, [confident(depth) for depth in depths], tmp_path, voxel=VOXEL
    )
    assert np.float32(shift[1]) + np.float32(VOXEL) == np.float32(shift[1])
    for path in (fused.points, fused.mesh):
        off, _ = distance(np.asarray(trimesh.load(path).vertices), shift)
        assert np.median(off) < 0.1 * VOXEL


def test_untrusted_pixels_take_no_part(scene, fused, tmp_path):
    """Nonsense that nobody is confident of, and pixels without depth, change nothing but the number
    of points.
    """
    rig, images, depths = scene
    random, maps = np.random.default_rng(1), []
    for depth in depths:
        bad = np.zeros(depth.shape, bool)
        bad[60:90] = True
        nonsense = np.where(bad, random.uniform(4, 9, depth.shape), depth).astype(np.float32)
        nonsense[:, 100:110] = 0
        maps.append(DepthMap(nonsense, np.where(bad, 0.02, 0.9).astype(np.float32)))
    again = fuse_instant(rig, images, maps, tmp_path)
    off, _ = distance(np.asarray(trimesh.load(again.points).vertices))
    assert off.max() < again.voxel / 2
    assert 0.5 < again.n_points / fused.n_points < 1


def test_debris_is_left_out(scene, tmp_path):
    """A small patch that floats before the wall is in the mesh only where debris is wanted."""
    rig, images, depths = scene
    floating = [depth.copy() for depth in depths]
    floating[0][10:18, 10:18] = 4.2
    maps = [confident(depth) for depth in floating]
    kept = fuse_instant(rig[:1], images[:1], maps[:1], tmp_path, fewest_triangles=0)
    assert np.asarray(trimesh.load(kept.mesh).vertices)[:, 2].min() < 4.19
    clean = fuse_instant(rig[:1], images[:1], maps[:1], tmp_path, fewest_triangles=500)
    assert np.asarray(trimesh.load(clean.mesh).vertices)[:, 2].min() > 4.19
    assert not [file for file in tmp_path.iterdir() if file.name.startswith(".")]


def test_what_cannot_be_fused(scene, tmp_path):
    """No trusted pixel, sizes that do not fit, and voxels that make no sense are refused, and
    nothing is written.
    """
    rig, images, depths = scene
    maps = [confident(depth, 0.1) for depth in depths]
    with refused(DepthError, "0.3", "4 depth maps", "depth page"):
        fuse_instant(rig, images, maps, tmp_path / "out")
    with refused(DepthError, "camera cam-0.5-0.4", "150 x 200", "(75, 200)"):
        fuse_instant(rig[:1], images[:1], [confident(depths[0][::2])], tmp_path / "out")
    with refused(DepthError, "got -1"):
        fuse_instant(rig, images, maps, tmp_path / "out", voxel=-1)
    assert not (tmp_path / "out").exists()


@settings(max_examples=15, deadline=None, derandomize=True)
@given(st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)), st.floats(0.5, 500))
def test_normals_of_planes_are_exact(slope, scale):
    """Any plane, at any scale of the world, gives its own normal at every pixel, the borders
    included.
    """
    camera = look_from(0, 0, "camera")
    normal = np.array([*slope, -1.0]) / np.linalg.norm([*slope, 1.0])
    depth = -6.0 * scale / (camera.rays() @ normal)
    normals = surface_normals(camera, np.where(depth > 0, depth, 0).astype(np.float32))
    assert np.abs(normals - normal)[depth > 0].max() < 1e-3


def test_normals_do_not_mix_surfaces():
    """Along a step both sides keep their normals; a pixel alone, and one without depth,
    have none.
    """
    camera = look_from(0, 0, "camera")
    depth = np.full((camera.height, camera.width), 6.0, np.float32)
    depth[:, 100:] = 8.0
    depth[20, 30], depth[40, 50] = 4.0, 0.0
    normals = surface_normals(camera, depth)
    assert not normals[20, 30].any()
    assert not normals[40, 50].any()
    kept = normals.any(axis=-1)
    assert (~kept).sum() == 2
    assert np.abs(normals[kept] - [0, 0, -1]).max() < 1e-4
