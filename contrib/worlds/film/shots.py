"""Shots to be rendered: one per camera of the rig, per pose of the hand-held camera and per pose of the true path."""

from dataclasses import dataclass, replace

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import Coefficients
from ggvs_eval.contrib.worlds.film.rig import GRID_YAW_RAD, OUTERMOST_YAW_RAD, arc_rig, hand_held_poses, rig, sideways_path
from ggvs_eval.contrib.worlds.film.sensor import Sensor, rig_sensors
from ggvs_eval.kernels.portable import product, rotation_by

PATH_LENGTH = 5.0
# Pictures of which a blurred one is the mean.
BLUR_POSES = 4
# Barrel distortion as of a wide-angle lens: k1, k2, p1, p2, k3; every lens differs a little from it.
LENS = (-0.12, 0.03, 3e-4, -2e-4, 0.0)
LENS_SPREAD = (0.008, 0.002, 1e-4, 1e-4, 0.0)
# k1 .. k4 of a fisheye, as of the camera that the description of Google Immersive shows, and how its lenses differ.
FISHEYE_LENS = (0.097, -0.017, 0.0, 0.0)
FISHEYE_SPREAD = (0.003, 0.001, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Shot:
    """One camera and the instants it films.

    Attributes:
        camera: the true one, world units of the rig.
        noted: the camera as it is written down, wrong where the options want it to be.
        instants: the instant that each frame shows, in frames from time 0.
        sensor: what films; None gives the pictures without gain and noise.
        poses: where the camera is while it exposes a picture, evenly spaced in time; empty where it stands still.
        depth_pose: where the sensor of depth of a hand-held camera is when it measures; None where it has none.
    """

    camera: Camera
    noted: Camera
    instants: tuple[int, ...]
    sensor: Sensor | None
    lens: Coefficients = ()
    poses: tuple[Camera, ...] = ()
    depth_pose: Camera | None = None


def rig_of(options: DemoOptions) -> list[Camera]:
    """The true cameras of the rig, in the order of their names."""
    if options.rig == "arc":
        return arc_rig(options.seed, options.width, options.height, len(options.camera_names))
    yaw_rad = GRID_YAW_RAD if options.rig == "grid" else OUTERMOST_YAW_RAD
    return rig(
        options.seed, options.width, options.height, options.cameras_per_row, outermost_yaw_rad=yaw_rad, spacing=options.spacing
    )


def rig_shots(options: DemoOptions) -> list[Shot]:
    """The cameras of the rig, all frames of each, in the order of their names."""
    cameras = rig_of(options)
    offsets = dict(options.frame_offset)
    shots = []
    for number, (camera, sensor) in enumerate(zip(cameras, rig_sensors(options), strict=True)):
        first = offsets.get(camera.name, 0)
        noted = noted_camera(options, camera, camera.name, number)
        shots.append(Shot(camera, noted, tuple(range(first, first + options.n_frames)), sensor))
    return shots


def distorted_shots(options: DemoOptions) -> list[Shot]:
    """The cameras of the rig, each through a lens of its own."""
    return _through_lenses(options, LENS, LENS_SPREAD)


def fisheye_shots(options: DemoOptions) -> list[Shot]:
    """The cameras of the rig, each through a fisheye of its own."""
    return _through_lenses(options, FISHEYE_LENS, FISHEYE_SPREAD)


def _through_lenses(options: DemoOptions, lens: Coefficients, spread: Coefficients) -> list[Shot]:
    shots = []
    for number, shot in enumerate(rig_shots(options)):
        rng = np.random.default_rng([options.seed, 7, number])
        shots.append(replace(shot, lens=tuple((np.array(lens) + spread * rng.uniform(-1, 1, len(lens))).tolist())))
    return shots


def hand_held_shots(options: DemoOptions) -> list[Shot]:
    """One camera, cam00, that walks through the rig's volume while time stands still at 0; a shot per pose."""
    sensor = rig_sensors(options)[0]
    exposed_s = options.shutter_s * ((np.arange(BLUR_POSES) + 0.5) / BLUR_POSES - 0.5)
    shots = []
    for index, camera in enumerate(_poses_at(options)):
        grain = replace(sensor, seed=(*sensor.seed, index))
        shots.append(Shot(camera, noted_camera(options, camera, "cam00", index), (0,), grain, depth_pose=camera))
    if options.shutter_s:
        during = [_poses_at(options, seconds) for seconds in exposed_s]
        shots = [replace(shot, poses=poses) for shot, poses in zip(shots, zip(*during, strict=True), strict=True)]
    if options.depth_delay_s:
        earlier = _poses_at(options, -options.depth_delay_s)
        shots = [replace(shot, depth_pose=pose) for shot, pose in zip(shots, earlier, strict=True)]
    return shots


def _poses_at(options: DemoOptions, later_s: float = 0.0) -> list[Camera]:
    """The poses of the hand-held camera, each so many seconds later."""
    size = (options.width, options.height)
    return hand_held_poses(
        options.seed, *size, options.n_frames, options.fps, later_s=later_s, sway=options.sway, spacing=options.spacing
    )


def path_shots(options: DemoOptions) -> list[Shot]:
    """The true camera path, without gain and noise, all at one instant."""
    cameras = rig_of(options)
    middle = cameras[len(cameras) // 2 if options.rig == "arc" else 0]
    path = sideways_path(middle, PATH_LENGTH, options.path_poses)
    return [Shot(pose, pose, (options.path_frame,), None) for pose in path]


def rig_and_path_shots(options: DemoOptions) -> list[Shot]:
    """The rig first, then the true path."""
    return rig_shots(options) + path_shots(options)


def noted_camera(options: DemoOptions, camera: Camera, name: str, number: int) -> Camera:
    """The camera as the calibration says, with the errors that the options want.

    Reading:
        A rotation about the camera's own centre by a vector whose three components are normal with a standard deviation of
        error / focal length: the image's centre moves by the error along rows and along columns.
    """
    K, world_to_camera = camera.K.copy(), camera.world_to_camera.copy()
    K[[0, 1], [0, 1]] *= dict(options.focal_error).get(name, 1.0)
    if options.calibration_error_px:
        rng = np.random.default_rng([options.seed, 6, number])
        turn = rotation_by(rng.standard_normal(3) * options.calibration_error_px / camera.focal_px)
        world_to_camera[:3] = product(turn, world_to_camera[:3])
    return replace(camera, K=K, world_to_camera=world_to_camera)
