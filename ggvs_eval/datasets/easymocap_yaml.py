"""EasyMocap's two camera files: OpenCV's YAML with one entry per camera and quantity."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.datasets.assemble import check_rig_size
from ggvs_eval.datasets.filestorage_yaml import FileStorageYaml, refused
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.lens import Lens

# OpenCV calibrates with pixel centres at whole numbers, ours lie at halves.
PIXEL_CENTRE = 0.5


@dataclass(frozen=True, eq=False)
class EasyMocapView:
    """One camera of the files.

    Attributes:
        name: as in ``names``.
        K: intrinsics at the size of the calibration, pixel centres at halves.
        world_to_camera: (4, 4).
        size: (width, height) of the calibration; None where the file does not say.
        near_far: depth range; None where the file does not say.
    """

    name: str
    K: Array
    coefficients: tuple[float, ...]
    world_to_camera: Array
    size: tuple[int, int] | None
    near_far: tuple[float, float] | None

    def lens(self, frame_size: tuple[int, int]) -> Lens:
        """The lens at the size of the calibration, which is taken to be that of the frames where the file names no size."""
        return Lens(self.K, "opencv", self.coefficients, *(self.size or frame_size))


def read_views(intrinsics: Path, extrinsics: Path) -> tuple[list[EasyMocapView], list[str]]:
    """Read both files.

    Args:
        intrinsics: ``intri.yml`` with ``names``, ``K_<cam>``, ``dist_<cam>`` or ``D_<cam>``, maybe ``H_``, ``W_``.
        extrinsics: ``extri.yml`` with ``R_<cam>`` (Rodrigues) or ``Rot_<cam>`` (matrix), ``T_<cam>``, maybe ``n_``, ``f_``.

    Returns:
        The cameras in the order of ``names``, and the names of those that the second file does not place.

    Raises:
        CaptureError: absent or damaged, or an entry that is absent, of another shape or not finite.

    Reading:
        Where both are there, R_ counts, as ENeRF reads it. The camera centre is -R^T T. OpenCV's principal point is moved by half
        a pixel to our pixel centres.
    """
    intri, extri = FileStorageYaml(intrinsics), FileStorageYaml(extrinsics)
    names = _names(intri, intrinsics)
    check_rig_size(intrinsics, len(names))
    views = []
    placed = [name for name in names if any(extri.has(f"{key}_{name}") for key in ("R", "Rot", "T"))]
    for name in placed:
        K = intri.matrix(f"K_{name}", (3, 3))
        K[:2, 2] += PIXEL_CENTRE
        size = intri.number(f"W_{name}"), intri.number(f"H_{name}")
        near_far = extri.number(f"n_{name}"), extri.number(f"f_{name}")
        view = EasyMocapView(
            name,
            K,
            _coefficients(intri, name),
            _pose(extri, name),
            (int(size[0]), int(size[1])) if size[0] and size[1] else None,
            (near_far[0], near_far[1]) if near_far[0] and near_far[1] else None,
        )
        try:
            view.lens(view.size or (1, 1))
        except CameraError as error:
            raise CaptureError(f"{intrinsics}: {name}: {error}") from error
        views.append(view)
    return views, [name for name in names if name not in placed]


def _names(intri: FileStorageYaml, path: Path) -> list[str]:
    names = intri.texts("names")
    if not all(names) or not names or len(set(names)) < len(names):
        raise refused(path, "names: a sequence of different camera names", ", ".join(names) or "none")
    return names


def _coefficients(intri: FileStorageYaml, name: str) -> tuple[float, ...]:
    for key in (f"dist_{name}", f"D_{name}"):
        if intri.has(key):
            return tuple(intri.matrix(key, None).ravel())
    return (0.0,) * 5


def _pose(extri: FileStorageYaml, name: str) -> Array:
    world_to_camera = np.eye(4)
    if not extri.has(f"R_{name}") or extri.has(f"Rot_{name}"):  # what is not used must make sense too
        world_to_camera[:3, :3] = extri.matrix(f"Rot_{name}", (3, 3))
    if extri.has(f"R_{name}"):
        world_to_camera[:3, :3] = cv2.Rodrigues(extri.matrix(f"R_{name}", (3, 1)))[0]
    world_to_camera[:3, 3] = extri.matrix(f"T_{name}", (3, 1)).ravel()
    return world_to_camera
