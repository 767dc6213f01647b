"""Technicolor's light-field videos (Sabater et al. 2017), undistorted: pictures of a rig in one
folder, and its parameters.
"""

import re
from pathlib import Path

import numpy as np

from ggvs_eval.camera import Camera, pinhole_K, rigid
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.assemble import assemble_capture, check_rig_size, known_depths
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.rig import pinhole_camera, pinhole_cameras
from ggvs_eval.datasets.units import GivenUnits, choose_units
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.listing import list_images
from ggvs_eval.files.names import listed
from ggvs_eval.files.plain import parse_numbers, read_plain_text

PARAMETERS = "cameras_parameters.txt"
COLUMNS = "f cu cv ar sk qw qx qy qz tx ty tz"
N_COLUMNS = len(COLUMNS.split())
FRAME = re.compile(r".*_undist_(\d{1,8})_(\d{1,4})")
# The pictures are in the scene's folder, as SpacetimeGaussians expects them, or in images/, as
# HyperReel does.
FOLDERS = (".", "images")
CALIBRATED_SIZE = 2048, 1088
LARGEST_NUMBER = 1e9
# at which no pixel of the image is off by more than 0.03 px in depth and place
LARGEST_SKEW_PX = 0.1


def refuse(path: Path) -> str | None:
    """Return the reason why this folder is not a scene of Technicolor's, or None if it is one."""
    if not (path / PARAMETERS).is_file():
        return f"no {PARAMETERS}"
    return None if _find_frames(path) else f"{PARAMETERS}, but no SCENE_undist_00000_00.png"


def load(path: Path, units: GivenUnits) -> Capture:
    """Open a scene; its cameras are called cam00, cam01, ... in the order of their rows.

    Args:
        path: folder with ``cameras_parameters.txt`` and ``SCENE_undist_<frame>_<camera>.png``, or
            ``images/`` with these.

    Reading:
        The data set has no public description. After HyperReel's loader: row i belongs to the
        pictures of number i; fx = f, fy = ar f at 2048 x 1088; the quaternion (w first) and t map
        world to camera. sk must be zero. Frames count from the first picture that is there,
        regardless of its number: Painter's begin at 0, the others' at 1. Depth range: HyperReel's
        of the scene by its name.
    """
    folder, by_camera = _find_frames(path) or (path, {})
    rows = _read_rows(path / PARAMETERS)
    unmatched = sorted(set(range(len(rows))) ^ set(by_camera))
    if unmatched:
        gaps = listed(
            [
                f"{number:02d} ({PARAMETERS if number in range(len(rows)) else 'pictures'} only)"
                for number in unmatched
            ]
        )
        raise CaptureError(
            f"{path}: wanted pictures of the camera of each row of {PARAMETERS}, got {gaps}; "
            f"restore these"
        )
    cameras = _cameras(path, rows)
    sources = [
        ImageFrames(folder, numbered=tuple(by_camera[number])) for number in range(len(rows))
    ]
    return assemble_capture(
        path, "technicolor", cameras, sources, choose_units(path, units, cameras)
    )


def _find_frames(path: Path) -> tuple[Path, dict[int, list[tuple[int, Path]]]] | None:
    for folder in (path / name for name in FOLDERS):
        by_camera: dict[int, list[tuple[int, Path]]] = {}
        for file in list_images(folder):
            if match := FRAME.fullmatch(file.stem):
                by_camera.setdefault(int(match[2]), []).append((int(match[1]), file))
        if by_camera:
            return folder, by_camera
    return None


def _read_rows(file: Path) -> np.ndarray:
    """Return the parameters, (cameras, 12)."""
    try:
        _, _, numbers = read_plain_text(file).partition("\n")
        rows = [row for row in parse_numbers(numbers, 2) if row]
    except (OSError, ValueError) as error:
        raise CaptureError(
            f"{file}: wanted {COLUMNS} of each camera, got: {error}; copy the scene again"
        ) from error
    check_rig_size(file, len(rows))
    if not rows:
        raise CaptureError(
            f"{file}: wanted a line of names and a row per camera, got none; copy the scene again"
        )
    for index, row in enumerate(rows):
        row_text = " ".join(f"{value:g}" for value in row)
        if len(row) != N_COLUMNS or not all(abs(value) < LARGEST_NUMBER for value in row):
            form = f"{COLUMNS} as finite numbers"
        elif abs(row[4]) > LARGEST_SKEW_PX or not 0.99 < float(np.linalg.norm(row[5:9])) < 1.01:
            form = "zero skew (sk) and a unit quaternion"
        else:
            continue
        raise CaptureError(
            f"{file}: wanted {form} of camera {index}, got {row_text:.80}; copy the scene again"
        )
    return np.array(rows)


def _cameras(path: Path, rows: np.ndarray) -> list[Camera]:
    from scipy.spatial.transform import Rotation

    depths = known_depths("technicolor", path.resolve().name.lower())
    rig = []
    for index, row in enumerate(rows):
        focal_px, cu, cv, aspect = row[:4]
        K = pinhole_K(focal_px, aspect * focal_px, cu, cv)
        pose = rigid(Rotation.from_quat(row[[6, 7, 8, 5]]).as_matrix(), row[9:12])
        rig.append(
            pinhole_camera(path / PARAMETERS, f"cam{index:02d}", K, CALIBRATED_SIZE, pose, depths)
        )
    return pinhole_cameras(rig, path / PARAMETERS)


LAYOUT = DatasetSpec(
    describe="cameras_parameters.txt with SCENE_undist_00000_00.png (Technicolor)",
    refuse=refuse,
    load=load,
    marks=(PARAMETERS,),
)
