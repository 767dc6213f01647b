"""Reads what each image of a COLMAP model saw of its points, in a separate process: pycolmap breaks
the writing of PNG files.

Command: ``python -m benchmarks.depth_validation.sparse_reader MODEL_DIR OUT.npz``
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

PINHOLES = ("SIMPLE_PINHOLE", "PINHOLE")


def read_observations(folder: Path) -> dict[str, NDArray[np.float64]]:
    """Observations of the registered images, by the image's name.

    Args:
        folder: a sparse model, text or binary.

    Returns:
        Per image a row for each point it saw, (N, 5): x and y as shares of the image's width and
        height, the point's depth in that camera in world units, by how many observations it was
        triangulated, and its mean reprojection error in pixels.

    Raises:
        ValueError: damaged, or a camera that distorts, whose observations are elsewhere in an
            undistorted image.
    """
    import pycolmap

    model = pycolmap.Reconstruction(str(folder))
    distorting = sorted(
        {
            camera.model.name
            for camera in model.cameras.values()
            if camera.model.name not in PINHOLES
        }
    )
    if distorting:
        raise ValueError(
            f"wanted pinhole cameras, got {', '.join(distorting)}; run 'colmap image_undistorter' "
            f"first"
        )
    return {
        image.name: _observed(model, image) for image in model.images.values() if image.has_pose
    }


def _observed(model: Any, image: Any) -> NDArray[np.float64]:
    camera = model.cameras[image.camera_id]
    observations = [observation for observation in image.points2D if observation.has_point3D()]
    points = [model.points3D[observation.point3D_id] for observation in observations]
    pose = image.cam_from_world() if callable(image.cam_from_world) else image.cam_from_world
    world_to_camera = np.asarray(pose.matrix())  # (3, 4)
    depth = (
        np.array([point.xyz for point in points]).reshape(-1, 3) @ world_to_camera[2, :3]
        + world_to_camera[2, 3]
    )
    share = np.array([observation.xy for observation in observations]).reshape(-1, 2) / (
        camera.width,
        camera.height,
    )
    return np.column_stack(
        [
            share,
            depth,
            [point.track.length() for point in points],
            [point.error for point in points],
        ]
    )


if __name__ == "__main__":
    observed = read_observations(Path(sys.argv[1]))
    counts = [len(part) for part in observed.values()]
    np.savez(
        sys.argv[2],
        names=list(observed),
        counts=counts,
        rows=np.concatenate(list(observed.values())),
    )
