"""Calibrations in the formats of other tools, written by the formats' definitions, and what they
say of a point.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.camera import Camera
from helpers.captures import HEIGHT, WIDTH, make_rig
from helpers.small_layouts import opencv_K, write_storage

COEFFICIENTS = (-0.12, 0.03, 0.001, -0.002, 0.004)


def project_opencv(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Where OpenCV sees points through a lens of `COEFFICIENTS`, (P, 2); the first pixel's centre
    is (0, 0).
    """
    rotation = cv2.Rodrigues(camera.rotation)[0]
    return cv2.projectPoints(
        points, rotation, camera.translation, opencv_K(camera), np.array(COEFFICIENTS)
    )[0].reshape(-1, 2)


def write_anipose(
    file: Path, cameras: Sequence[Camera], metadata: str = "adjusted = false\nerror = 0.0"
) -> Path:
    """A table ``[cam_0]`` per camera, as aniposelib dumps it; with freemocap's metadata it is in
    millimetres.
    """
    scale, text = 1000.0 if "charuco" in metadata else 1.0, ""
    for index, camera in enumerate(cameras):
        text += (
            f'[cam_{index}]\nname = "{camera.name}"\nsize = [ {camera.width}, {camera.height},]\n'
        )
        text += f"matrix = {opencv_K(camera).tolist()}\ndistortions = {list(COEFFICIENTS)}\n"
        text += f"rotation = {cv2.Rodrigues(camera.rotation)[0].ravel().tolist()}\n"
        text += f"translation = {(scale * camera.translation).tolist()}\n\n"
    file.write_text(f"{text}[metadata]\n{metadata}\n")
    return file


def write_opencv(folder: Path, cameras: Sequence[Camera], with_size: bool = True) -> Path:
    """``CAM.yml`` of each camera, by OpenCV itself."""
    for camera in cameras:
        entries = {
            "camera_matrix": opencv_K(camera),
            "distortion_coefficients": np.array([COEFFICIENTS]),
        }
        entries |= {"image_width": camera.width, "image_height": camera.height} if with_size else {}
        write_storage(
            folder / f"{camera.name}.yml",
            entries | {"R": camera.rotation, "T": camera.translation.reshape(3, 1)},
        )
    return folder


def write_stereo(file: Path, left: Camera, right: Camera) -> Path:
    """M1 D1 M2 D2 R T of OpenCV's stereo calibration: R and T take points of the left camera to the
    right one.
    """
    second = right.world_to_camera @ np.linalg.inv(left.world_to_camera)
    entries = {f"M{index}": opencv_K(camera) for index, camera in ((1, left), (2, right))}
    entries |= {f"D{index}": np.array([COEFFICIENTS]) for index in (1, 2)}
    write_storage(file, entries | {"R": second[:3, :3].copy(), "T": second[:3, 3:].copy()})
    return file


def write_qualisys(
    file: Path,
    cameras: Sequence[Camera],
    left: int = 0,
    top: int = 0,
    coefficients: Sequence[float] = COEFFICIENTS,
) -> Path:
    """An XML file of Qualisys: millimetres, axes right, up and backwards, 64ths of a pixel of a
    sensor larger than the video.
    """
    text = "<?xml version='1.0' encoding='ASCII'?>\n<calibration>\n <cameras>\n"
    for camera in cameras:
        (fx, _, cx), (_, fy, cy), _ = (
            opencv_K(camera) + np.array([[0, 0, left], [0, 0, top], [0, 0, 0]])
        ).tolist()
        rows = np.diag([1.0, -1.0, -1.0]) @ camera.rotation
        pose = " ".join(
            f'r{i + 1}{j + 1}="{float(rows[i, j])!r}"' for i in range(3) for j in range(3)
        )
        pose += " " + " ".join(
            f'{axis}="{1000 * float(value)!r}"'
            for axis, value in zip("xyz", camera.centre, strict=True)
        )
        k1, k2, p1, p2, k3 = coefficients
        lens = (
            f'focalLengthU="{64 * fx!r}" focalLengthV="{64 * fy!r}" centerPointU="{64 * cx!r}" '
            f'centerPointV="{64 * cy!r}"'
        )
        lens += f' radialDistortion1="{k1}" radialDistortion2="{k2}" radialDistortion3="{k3}"'
        lens += f' tangentalDistortion1="{p1}" tangentalDistortion2="{p2}"'
        edges = (
            f'left="{left}" top="{top}" right="{left + camera.width - 1}" '
            f'bottom="{top + camera.height - 1}"'
        )
        text += (
            f'  <camera serial="{camera.name}" model="Miqus Video" viewrotation="0">\n   '
            f"<fov_video {edges}/>\n"
        )
        text += f"   <transform {pose}/>\n   <intrinsic {lens}/>\n  </camera>\n"
    file.write_text(f"{text} </cameras>\n</calibration>\n")
    return file


def turned_rig(names: Sequence[str] = ("cam00", "cam01", "cam02")) -> list[Camera]:
    """Cameras in general position: none of the axes of camera and world agree."""
    turn = np.eye(4)
    turn[:3, :3] = cv2.Rodrigues(np.array([0.7, -1.1, 0.4]))[0]
    turn[:3, 3] = (0.3, -0.2, 0.9)
    shift = np.array([[0, 0, 1.7], [0, 0.9, -2.2], [0, 0, 0]])
    rig = make_rig(names)
    return [
        Camera(each.name, each.K + shift, each.world_to_camera @ turn, WIDTH, HEIGHT, 1.0, 9.0)
        for each in rig
    ]
