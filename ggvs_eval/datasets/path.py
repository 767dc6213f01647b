"""The true camera path that a synthetic capture may carry, for epipolar plane images."""

from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.datasets.dynerf import POSES
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.llff import llff_camera, read_llff_poses
from ggvs_eval.datasets.units import read_note
from ggvs_eval.errors import CaptureError


@dataclass(frozen=True)
class CameraPath:
    """Poses along a path and what a camera would have seen there.

    Attributes:
        cameras: one pose per image, called ``path0000``, ...
        images: the true images; None where only the poses are known.
        time_s: the instant of the capture that they show, as ``demo.json`` says; the first where it says nothing.
    """

    cameras: tuple[Camera, ...]
    images: ImageFrames | None
    time_s: float


def open_path(capture_folder: Path) -> CameraPath | None:
    """Open ``path/poses_bounds.npy`` and ``path/images/`` of a capture folder; None where it carries no path.

    Raises:
        CaptureError: damaged poses, or another number of images than of poses.
    """
    poses_file = capture_folder / "path" / POSES
    if not poses_file.is_file():
        return None
    poses = read_llff_poses(poses_file)
    cameras = tuple(llff_camera(pose, f"path{index:04d}", poses_file) for index, pose in enumerate(poses))
    time_s = read_note(capture_folder, "path_time_s") or 0.0
    folder = capture_folder / "path" / "images"
    if not folder.is_dir():
        return CameraPath(cameras, None, time_s)
    images = ImageFrames(folder)
    if images.n_frames != len(cameras):
        raise CaptureError(f"{folder}: wanted {len(cameras)} images, one per row of {poses_file.name}, got {images.n_frames}")
    return CameraPath(tuple(camera.resized(*images.size) for camera in cameras), images, time_s)
