"""Splat, TSDF and the whole geometric step at 1352 x 1014 with K = 4, against Open3D and against
this package's readable twins.

``python benchmarks/bench_geometry.py`` prints the figures. All peers run in the same process
environment and the same minute; Open3D runs in a child process with a time limit, since its
VoxelBlockGrid.ray_cast can hang.
"""

import importlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.geometry.splat import splat
from ggvs_eval.geometry.tsdf import fusion_weights, ray_march
from ggvs_eval.method import SourceView

# the twins are next to the tests that they define
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

WIDTH, HEIGHT, FOCAL, VIEWS = 1352, 1014, 730.0, 4
TAU, DEPTH_NOISE, VOXEL, NEAR = 0.02, 0.001, 0.006, 0.2  # metres
OPEN3D_SECONDS = 240
POINTS = "Open3D PointCloud.project_to_rgbd_image (one pixel per point, no blending)"
GRID = "Open3D VoxelBlockGrid, 6 mm voxels, integrate + ray_cast"
COMMAND = "python benchmarks/bench_geometry.py"
SPHERES = (((0.1, -0.05, 2.6), 0.6), ((-0.9, 0.4, 2.2), 0.35), ((0.8, 0.6, 1.8), 0.25))
PLANES = (
    ((0.0, 0.0, 1.0), 4.0),
    ((0.0, 1.0, 0.0), 1.2),
    ((0.9, 0.0, 0.436), 2.9),
    ((-0.9, 0.0, 0.436), 2.9),
)


@dataclass(frozen=True)
class Scene:
    """Noisy depth of the sources, one image for all of them, and the target."""

    target: Camera
    cameras: list[Camera]
    depths: list[NDArray[np.float32]]
    image: NDArray[np.float32]

    def source(self, view: int) -> SourceView:
        """Return one source, its image left in floats."""
        depth = self.depths[view]
        return SourceView(self.cameras[view], self.image, depth, np.ones_like(depth))  # type: ignore[arg-type]

    def splat(self, view: int) -> None:
        """Forward rendering of one source."""
        splat([self.source(view)], self.target, near=NEAR)

    def fuse(self) -> NDArray[np.float32]:
        """TSDF depth of the target: weights of all sources, then the march."""
        weights = [fusion_weights(depth, TAU, DEPTH_NOISE) for depth in self.depths]
        return ray_march(self.target, self.cameras, self.depths, weights, tau=TAU).depth

    def step(self) -> None:
        """The whole geometric step of a frame."""
        for view in range(VIEWS):
            self.splat(view)
        self.fuse()


def measure() -> dict[str, dict]:
    """Return the milliseconds and millimetres of this package's kernels and of their peers, name ->
    figure.
    """
    scene = make_scene(WIDTH)
    splat_ms, tsdf_ms, step_ms = (
        _best_ms(lambda: scene.splat(0)),
        _best_ms(scene.fuse),
        _best_ms(scene.step),
    )
    peers = _open3d(scene)
    splat_twin_ms, tsdf_twin_ms = _twins_ms()
    truth = _depth(scene.target)
    error_mm = _median_error_mm(scene.fuse(), truth)
    peer_mm = _median_error_mm(peers["depth"], truth) if "depth" in peers else None
    both = (
        peers["points_ms"] * VIEWS + peers["grid_ms"]
        if {"points_ms", "grid_ms"} <= peers.keys()
        else None
    )
    return {
        "geometry_splat": _figure(splat_ms, 60.0, POINTS, peers.get("points_ms")),
        "geometry_splat_to_twin": _figure(
            splat_ms, None, "torch twin at 64 x 48, scaled by Gaussian-pixel pairs", splat_twin_ms
        ),
        "geometry_tsdf_depth": _figure(tsdf_ms, 300.0, GRID, peers.get("grid_ms")),
        "geometry_tsdf_depth_to_twin": _figure(
            tsdf_ms, None, "numpy twin at 64 x 48, scaled by pixels", tsdf_twin_ms
        ),
        "geometry_step": _figure(step_ms, 1000.0, f"{VIEWS} times {POINTS}, then {GRID}", both),
        "geometry_tsdf_median_error": _figure(error_mm, None, GRID, peer_mm, unit="mm"),
    }


def _figure(
    value: float, target: float | None, peer: str, peer_value: float | None, unit: str = "ms"
) -> dict:
    """Return one entry of out/bench.json.

    A peer that did not finish leaves its value and ratio empty.
    """
    ratio = None if peer_value is None else peer_value / value
    entry = {
        "value": value,
        "unit": unit,
        "target": target,
        "higher_is_better": False,
        "command": COMMAND,
    }
    return entry | {
        "peer": peer if peer_value is not None else None,
        "peer_value": peer_value,
        "ratio": ratio,
    }


def _best_ms(job: Callable[[], object], seconds: float = 3.0) -> float:
    """Fastest of the calls that fit into some seconds, at least three: what else the machine does
    only ever adds time.
    """
    times: list[float] = []
    while len(times) < 3 or sum(times) < seconds:
        start = time.perf_counter()
        job()
        times.append(time.perf_counter() - start)
    return min(times) * 1000


def make_scene(width: int) -> Scene:
    """Return four noisy depth cameras before walls and spheres, at `width` pixels of the full field
    of view.
    """
    cameras = [_camera(-0.3 + 0.2 * k, 0.25 * (-0.3 + 0.2 * k), width) for k in range(VIEWS)]
    depths = [_noisy(camera, seed) for seed, camera in enumerate(cameras)]
    image = np.random.default_rng(0).random((*depths[0].shape, 3), dtype=np.float32)
    return Scene(_camera(0.03, 0.0, width), cameras, depths, image)


def _camera(x: float, yaw: float, width: int) -> Camera:
    """Return a camera at (x, 0, 0) turned by yaw about the vertical axis.

    The field of view does not depend on the width.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    pose = np.eye(4)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    pose[:3, 3] = pose[:3, :3] @ [-x, 0, 0]
    K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    camera = Camera(f"x{x:+.2f}", K, pose, WIDTH, HEIGHT, 0.5, 6.0)
    return camera if width == WIDTH else camera.resized(width, width * HEIGHT // WIDTH)


def _depth(camera: Camera) -> NDArray[np.float64]:
    """Return the exact depth of a room with three spheres, (H, W), metres."""
    rays, centre = camera.rays(), camera.centre
    depth = np.full(rays.shape[:2], np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for normal, offset in PLANES:
            z = (offset - centre @ normal) / (rays @ normal)
            depth = np.where((z > 0) & (z < depth), z, depth)
        for middle, radius in SPHERES:
            a, b, c = (
                (rays**2).sum(axis=-1),
                rays @ (centre - middle),
                ((centre - middle) ** 2).sum() - radius**2,
            )
            z = (-b - np.sqrt(b * b - a * c)) / a
            depth = np.where((z > 0) & (z < depth), z, depth)
    return depth


def _noisy(camera: Camera, seed: int) -> NDArray[np.float32]:
    depth = _depth(camera)
    return (depth * np.random.default_rng(seed).normal(1.0, 0.003, depth.shape)).astype(np.float32)


def _median_error_mm(depth: NDArray, truth: NDArray) -> float:
    return float(np.median(np.abs(depth - truth)[depth > 0])) * 1000


def _twins_ms() -> tuple[float, float]:
    """Estimate the time of the twins for one splat and one TSDF depth at full size, from a 64 x 48
    run.
    """
    splat_twin, tsdf_twin = (
        importlib.import_module(f"helpers.twins.{name}") for name in ("splat", "tsdf")
    )
    scene = make_scene(64)
    source = scene.source(0)

    def fuse() -> None:
        weights = [tsdf_twin.fusion_weights_twin(depth, TAU, DEPTH_NOISE) for depth in scene.depths]
        tsdf_twin.ray_march_twin(scene.target, scene.cameras, scene.depths, weights, tau=TAU)

    count = source.depth.size
    enlargement = WIDTH * HEIGHT / count
    # The twin evaluates every pair, touched or not: its cost per evaluated pair, times the pairs
    # that a full-size splat touches.
    full_pairs = splat_twin.touched_pairs(source, scene.target, NEAR) * enlargement
    splat_ms = (
        _best_ms(lambda: splat_twin.splat_twin([source], scene.target, near=NEAR))
        * full_pairs
        / count**2
    )
    return splat_ms, _best_ms(fuse) * enlargement


def _open3d(scene: Scene) -> dict:
    """Open3D's times and depth from a child process; what it did not reach in time is left out."""
    with tempfile.TemporaryDirectory() as folder:
        poses = np.stack([camera.world_to_camera for camera in [*scene.cameras, scene.target]])
        np.savez(
            Path(folder) / "scene.npz",
            depths=np.stack(scene.depths),
            image=scene.image,
            poses=poses,
            K=scene.target.K,
        )
        command = [sys.executable, __file__, "--open3d", folder]
        try:
            subprocess.run(command, timeout=OPEN3D_SECONDS, check=False, stdout=subprocess.DEVNULL)
        except subprocess.TimeoutExpired:
            print(f"Open3D did not finish within {OPEN3D_SECONDS} s", file=sys.stderr)
        files = {path.stem: path for path in Path(folder).iterdir()}
        figures = {
            name: json.loads(files[name].read_text())
            for name in ("points_ms", "grid_ms")
            if name in files
        }
        return figures | ({"depth": np.load(files["depth"])} if "depth" in files else {})


def _run_open3d(folder: Path) -> None:
    """The child: one point rendering of view 0, then fusion of all views and a ray cast.

    Each result in its own file.
    """
    # its type stubs refuse what its documentation shows
    o3d: Any = importlib.import_module("open3d")
    scene = np.load(folder / "scene.npz")
    core, K, poses = (
        o3d.core,
        o3d.core.Tensor(scene["K"]),
        [o3d.core.Tensor(pose) for pose in scene["poses"]],
    )
    colour = o3d.t.geometry.Image(core.Tensor(scene["image"]))
    images = [o3d.t.geometry.Image(core.Tensor(depth)) for depth in scene["depths"]]
    rgbd = o3d.t.geometry.RGBDImage(colour, images[0])
    cloud = o3d.t.geometry.PointCloud.create_from_rgbd_image(
        rgbd, K, poses[0], depth_scale=1.0, depth_max=10.0
    )
    points_ms = _best_ms(
        lambda: cloud.project_to_rgbd_image(
            WIDTH, HEIGHT, K, poses[-1], depth_scale=1.0, depth_max=10.0
        )
    )
    (folder / "points_ms.json").write_text(json.dumps(points_ms))

    start = time.perf_counter()
    names, types, channels = ("tsdf", "weight"), (core.float32, core.float32), ((1,), (1,))
    grid = o3d.t.geometry.VoxelBlockGrid(names, types, channels, VOXEL, 16, 100_000)
    for depth, pose in zip(images, poses, strict=False):
        blocks = grid.compute_unique_block_coordinates(depth, K, pose, 1.0, 10.0, TAU / VOXEL)
        grid.integrate(blocks, depth, K, pose, 1.0, 10.0, TAU / VOXEL)
    blocks = grid.compute_unique_block_coordinates(images[0], K, poses[-1], 1.0, 10.0, TAU / VOXEL)
    result = grid.ray_cast(
        grid.hashmap().key_tensor(),
        K,
        poses[-1],
        WIDTH,
        HEIGHT,
        ["depth"],
        1.0,
        0.5,
        6.0,
        1.0,
        TAU / VOXEL,
    )
    depth = result["depth"].numpy()[..., 0]
    (folder / "grid_ms.json").write_text(json.dumps((time.perf_counter() - start) * 1000))
    np.save(folder / "depth.npy", depth)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--open3d"]:
        _run_open3d(Path(sys.argv[2]))
    else:
        for name, figure in measure().items():
            peer = (
                f"; {figure['peer']}: {figure['peer_value']:.4g}, ratio {figure['ratio']:.3g}"
                if figure["peer"]
                else ""
            )
            print(f"{name}: {figure['value']:.4g} {figure['unit']}{peer}")
