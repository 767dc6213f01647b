"""Frames along the camera path, compressed, so that the page can cut any row of them into an epipolar plane image."""

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ggvs_eval.files.images import read_image
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.page.data_uri import fitting_width, shrink, webp_uri
from ggvs_eval.reports.page.diagnostics import diagnostics_folders, diagnostics_label
from ggvs_eval.run_folder import frame_path, require_frames

PATH_BYTES = 3_000_000
POSES_AT_MOST = 480  # over all methods; the browser decodes each of them for one row


@dataclass(frozen=True)
class PathPictures:
    """What the page can cut epipolar plane images from.

    Attributes:
        poses: numbers of the poses shown, every so many-th one.
        keys: ``truth``, where the path has one, the labels that have a path, and what one of them decided inside.
        images: key -> one picture per pose shown.
    """

    poses: tuple[int, ...]
    keys: tuple[str, ...]
    images: dict[str, list[str]]


def path_pictures(run: MeasuredRun, byte_budget: int = PATH_BYTES) -> PathPictures | None:
    """Compress the frames along the camera path; None where the run has none.

    Args:
        run: a scored run.
        byte_budget: what they may take, before base64; it decides their width.

    Raises:
        RenderError: poses are missing.
    """
    folders = {key: run.folder.path(key) for key in ("truth", *run.pictured) if run.folder.path(key).is_dir()}
    count = max((len(list(folder.glob("*.png"))) for folder in folders.values()), default=0)
    if not count:
        return None
    require_frames({f"{run.name(key)} on the path": folder for key, folder in folders.items()}, range(count))
    poses = range(0, count, math.ceil(count * len(folders) / POSES_AT_MOST))
    told = diagnostics_label(run)
    if told in folders:
        folders |= dict(diagnostics_folders(folders[told], told, range(count)))
    files = {key: [frame_path(folder, pose) for pose in poses] for key, folder in folders.items()}
    middle = [read_image(paths[len(paths) // 2]) for paths in files.values()]
    width = fitting_width(middle, byte_budget / (len(poses) * len(folders)))
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # OpenCV's codecs release the GIL
        compress = partial(_compress, width)
        images = {key: list(pool.map(compress, paths)) for key, paths in files.items()}
    return PathPictures(tuple(poses), tuple(folders), images)


def _compress(width: int, file: Path) -> str:
    return webp_uri(shrink(read_image(file), width))
