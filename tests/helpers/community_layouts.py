"""Tiny valid captures of the layouts of MeetRoom, Technicolor and Google Immersive: the rig of
`captures`.
"""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
from scipy.spatial.transform import Rotation

from ggvs_eval.camera import Camera
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video
from helpers.captures import FPS, make_image, make_rig, write_colmap_model, write_poses

PAIR = ("cam00", "cam01")
N_INSTANTS = 2
# The shape in which Technicolor's pictures are distributed, and its parameters are for.
TECHNICOLOR_SIZE, SMALL_SIZE = (2048, 1088), (64, 34)
# The example camera of the data set's README.
README_VIEW: dict[str, Any] = {
    "name": "camera_0001",
    "position": [0.003311238794086777, 0.000126384684934784, 0.42421246053630285],
    "orientation": [-0.03295944563072383, 0.02964606619481096, -0.03337751007195316],
    "focal_length": 1111.3638715594666,
    "pixel_aspect_ratio": 1.0,
    "principal_point": [1284.7296468363463, 925.4651609728676],
    "height": 1920.0,
    "width": 2560.0,
    "radial_distortion": [0.0970525284520715, -0.01708587111009977, 0.0],
    "projection_type": "fisheye",
}


def write_meetroom(folder: Path, names: Sequence[str] = PAIR) -> Path:
    """A video per camera, without leading zeros in its name."""
    for index, name in enumerate(names):
        frames = (make_image(index, frame) for frame in range(N_INSTANTS))
        write_video(folder / f"cam_{int(name.removeprefix('cam'))}.mp4", frames, FPS)
    write_poses(folder, make_rig(names))
    return folder


def write_extracted(folder: Path, names: Sequence[str] = PAIR) -> Path:
    """What StreamRF's script makes of the videos: a folder per instant."""
    for frame in range(N_INSTANTS):
        for index, name in enumerate(names):
            write_image(
                folder / f"{frame:04d}" / "images" / f"{name}.png", make_image(index, frame)
            )
        write_poses(folder / f"{frame:04d}", make_rig(names))
    return folder


def write_panoptic(
    folder: Path, names: Sequence[str] = ("0", "3", "10"), held_out: Sequence[str] = ("3",)
) -> Path:
    """Folders of images per camera, and the calibration of each instant: those held out in the
    second file.
    """
    rig = make_rig(names)
    for index, name in enumerate(names):
        for frame in range(N_INSTANTS):
            write_image(folder / "ims" / name / f"{frame:06d}.png", make_image(index, frame))
    for file, of_test in (("train_meta.json", False), ("test_meta.json", True)):
        cameras = [camera for camera in rig if (camera.name in held_out) == of_test]
        meta: dict[str, Any] = {"w": rig[0].width, "h": rig[0].height}
        meta["k"] = [[camera.K.tolist() for camera in cameras]] * N_INSTANTS
        meta["w2c"] = [[camera.world_to_camera.tolist() for camera in cameras]] * N_INSTANTS
        meta["fn"] = [
            [f"{camera.name}/{frame:06d}.png" for camera in cameras] for frame in range(N_INSTANTS)
        ]
        meta["cam_id"] = [[int(camera.name) for camera in cameras]] * N_INSTANTS
        (folder / file).write_text(json.dumps(meta))
    return folder


def write_frame_folders(folder: Path, names: Sequence[str] = PAIR) -> Path:
    """3DGStream's folder per instant, with a COLMAP model in the first."""
    for frame in range(N_INSTANTS):
        for index, name in enumerate(names):
            write_image(
                folder / f"frame{frame:06d}" / "images" / f"{name}.png", make_image(index, frame)
            )
    write_colmap_model(folder / "frame000000" / "sparse" / "0", [f"{name}.png" for name in names])
    return folder


def technicolor_row(camera: Camera) -> list[float]:
    """The parameters of a camera calibrated at 2048 x 1088."""
    qx, qy, qz, qw = Rotation.from_matrix(camera.rotation).as_quat()
    focal = [camera.K[0, 0], camera.K[0, 2], camera.K[1, 2], camera.K[1, 1] / camera.K[0, 0], 0.0]
    return [*focal, qw, qx, qy, qz, *camera.translation]


def write_technicolor(
    folder: Path, names: Sequence[str] = PAIR, first: int = 1, pictures: str = "."
) -> Path:
    """Pictures of all cameras in one folder, at a 32nd of the calibration's size."""
    lines = ["# f cu cv ar sk  qw qx qy qz  tx ty tz"]
    for index, camera in enumerate(make_rig(names, *TECHNICOLOR_SIZE)):
        for frame in range(N_INSTANTS):
            file = f"Painter_undist_{first + frame:05d}_{index:02d}.png"
            write_image(folder / pictures / file, make_image(index, frame, *SMALL_SIZE))
        lines.append(" ".join(f"{value:.17g}" for value in technicolor_row(camera)))
    (folder / "cameras_parameters.txt").write_text("\n".join(lines) + "\n")
    return folder


def write_technicolor_with_depth(folder: Path) -> Path:
    """With all that may lie beside it."""
    (write_technicolor(folder) / "depth_range.toml").write_text("near = 1.75\nfar = 10.0\n")
    return folder


def immersive_model(camera: Camera, name: str) -> dict[str, Any]:
    """A camera of the rig with the lens of the README's example."""
    pose = {
        "position": camera.centre.tolist(),
        "orientation": cv2.Rodrigues(camera.rotation)[0].ravel().tolist(),
    }
    K = {"focal_length": camera.K[0, 0], "principal_point": camera.K[:2, 2].tolist()}
    return (
        README_VIEW
        | pose
        | K
        | {"name": name, "width": float(camera.width), "height": float(camera.height)}
    )


def write_models(folder: Path, models: object) -> None:
    (folder / "models.json").write_text(json.dumps(models))


def write_immersive(folder: Path, names: Sequence[str] = PAIR) -> Path:
    """A video per camera, whose pictures are smooth, so that a lens changes little of them."""
    models = []
    for index, camera in enumerate(make_rig(names)):
        name = f"camera_{index + 1:04d}"
        write_video(
            folder / f"{name}.mp4", (make_image(index, frame) for frame in range(N_INSTANTS)), FPS
        )
        models.append(immersive_model(camera, name))
    write_models(folder, models)
    return folder


def with_pictures(folder: Path) -> Path:
    """Frames of the videos as pictures in a folder per camera."""
    for index, video in enumerate(sorted(folder.glob("*.mp4"))):
        for frame in range(N_INSTANTS):
            write_image(folder / video.stem / f"{frame}.png", make_image(index, frame))
        video.unlink()
    return folder


def copied(folder: Path, to: Path) -> Path:
    return Path(shutil.copytree(folder, to))
