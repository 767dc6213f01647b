"""Frames and error maps of all methods, compressed until they fit into the page."""

import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image
from ggvs_eval.progress import track
from ggvs_eval.reports.figures.regions import ERROR_FULL_SCALE
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.page.data_uri import fitting_width, shrink, webp_uri
from ggvs_eval.run_folder import DIAGNOSTICS, frame_path, missing_frames

MEANINGS = {
    "depth": ("depth", "the fused depth, near yellow, far dark blue, chequered where none was found"),
    "weights": ("weights", "one colour per source view, mixed by its share in the pixel, dark where the background fills in"),
    "coverage": ("coverage", "how far the splatted views cover the pixel, none dark blue, fully yellow"),
    "motion": ("motion", "where the past is forgotten because something moves, yellow; kept, dark blue"),
}
FRAME_BYTES = 10_000_000
FRAMES_AT_MOST = 900
CLEAR_WIDTH = 320  # pixels; where all frames would be narrower, fewer are shown
FRAMES_AT_LEAST = 8
ERROR_SHARE = 0.5


def diagnostics_label(run: MeasuredRun) -> str | None:
    """First method with diagnostics, ours before its variants; None where none has any."""
    first = run.protocol.views.test[0]
    return next((label for label in run.ours_first if (run.folder.renders(label, first) / DIAGNOSTICS).is_dir()), None)


def diagnostics_folders(frames: Path, label: str, indices: range) -> Iterator[tuple[str, Path]]:
    """Key and folder of each kind of picture that is there for every frame."""
    for name in MEANINGS:
        folder = frames / DIAGNOSTICS / name
        if folder.is_dir() and not missing_frames(folder, indices):
            yield f"{label}/{name}", folder


def diagnostics_name(run: MeasuredRun, key: str) -> str:
    """Name a picture: of a method, of the truth, or of a method's diagnostics."""
    label, _, name = key.partition("/")
    return f"{run.name(label)}: {MEANINGS[name][0]}" if name else run.name(label)


def diagnostics_legend(keys: Sequence[str]) -> list[tuple[str, str]]:
    """Return name and meaning of each diagnostic picture among the keys."""
    return [MEANINGS[key.partition("/")[2]] for key in keys if "/" in key]


@dataclass(frozen=True)
class Comparison:
    """Frame comparison of one run.

    Attributes:
        frames: frame numbers shown, every ``stride``-th one.
        stride: 1 where all frames are shown.
        width: width of the pictures, pixels.
        full_size: width and height of the frames on disk.
        keys: ``truth``, the methods' labels, and what one of them decided inside, see `diagnostics_folders`.
        images: view -> key -> one picture per frame shown.
        errors: view -> label -> one error map per frame shown.
    """

    views: tuple[str, ...]
    frames: tuple[int, ...]
    stride: int
    width: int
    height: int
    full_size: tuple[int, int]
    keys: tuple[str, ...]
    names: tuple[str, ...]
    images: dict[str, dict[str, list[str]]]
    errors: dict[str, dict[str, list[str]]]


def compare_frames(run: MeasuredRun, byte_budget: int = FRAME_BYTES) -> Comparison:
    """Compress the frames of every method and the truth, and the errors against the truth, for the page.

    Args:
        byte_budget: what the frames may take, before base64; it decides their width. Error maps and what a method decided inside
            take about a quarter more each.
    """
    views, diagnostics = run.protocol.views.test, _diagnostics(run)
    keys = ("truth", *run.pictured, *next(iter(diagnostics.values())))
    samples = _middle_frames(run)
    stride, width = _fit(run, samples, byte_budget)
    frames = run.frames[::stride]
    height, full_size = shrink(samples[0], width).shape[0], (samples[0].shape[1], samples[0].shape[0])
    images: dict[str, dict[str, list[str]]] = {view: {key: [] for key in keys} for view in views}
    errors: dict[str, dict[str, list[str]]] = {view: {label: [] for label in run.pictured} for view in views}
    instants = [(view, frame) for view in views for frame in frames]
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # OpenCV's codecs release the GIL
        compressed = pool.map(partial(_compress, run, diagnostics, width), instants)
        for (view, _), pictures in zip(instants, track(compressed, "compressing frames", len(instants)), strict=True):
            for key, (picture, error) in pictures.items():
                images[view][key].append(picture)
                if error:
                    errors[view][key].append(error)
    names = tuple(diagnostics_name(run, key) for key in keys)
    return Comparison(views, tuple(frames), stride, width, height, full_size, keys, names, images, errors)


def _fit(run: MeasuredRun, samples: list[Image8], byte_budget: int) -> tuple[int, int]:
    """Frames that are shown, every so many-th, and their width in pixels: all of them, unless fewer can be seen better."""
    n_pictures = len(run.protocol.views.test) * (1 + len(run.pictured))
    stride = math.ceil(len(run.frames) * n_pictures / FRAMES_AT_MOST)
    while True:
        width = fitting_width(samples, byte_budget / (len(run.frames[::stride]) * n_pictures))
        if width >= min(CLEAR_WIDTH, samples[0].shape[1]) or len(run.frames[:: stride + 1]) < FRAMES_AT_LEAST:
            return stride, width
        stride += 1


def _diagnostics(run: MeasuredRun) -> dict[str, dict[str, Path]]:
    """View -> key -> folder of a method's diagnostics, the same keys for every view."""
    label = diagnostics_label(run)
    folders_of = {
        view: {} if label is None else dict(diagnostics_folders(run.folder.renders(label, view), label, run.frames))
        for view in run.protocol.views.test
    }
    common = set.intersection(*(set(folders) for folders in folders_of.values()))
    return {view: {key: folder for key, folder in folders.items() if key in common} for view, folders in folders_of.items()}


def _compress(
    run: MeasuredRun, diagnostics: dict[str, dict[str, Path]], width: int, instant: tuple[str, int]
) -> dict[str, tuple[str, str]]:
    """Key -> compressed picture and error map of one view and frame; only methods have errors."""
    view, frame = instant
    files = {key: frame_path(folder, frame) for key, folder in run.frame_folders(view).items()}
    truth = read_image(files["truth"])
    pictures = {"truth": (webp_uri(shrink(truth, width)), "")}
    for label in run.pictured:
        rendered = read_image(files[label])
        error = error_map(rendered, truth, files[label])
        pictures[label] = webp_uri(shrink(rendered, width)), webp_uri(shrink(error, round(width * ERROR_SHARE)))
    for key, folder in diagnostics[view].items():
        pictures[key] = webp_uri(shrink(read_image(frame_path(folder, frame)), width)), ""
    return pictures


def error_map(rendered: Image8, truth: Image8, file: Path) -> Image8:
    """Mean absolute difference of the three channels in the colours of magma: black is 0, the brightest is `ERROR_FULL_SCALE`.

    Args:
        rendered: (H, W, 3), uint8.
    """
    if rendered.shape != truth.shape:
        truth_size, rendered_size = truth.shape[1::-1], rendered.shape[1::-1]
        raise RenderError(
            f"{file}: wanted {truth_size[0]} x {truth_size[1]} pixels as the truth has, "
            f"got {rendered_size[0]} x {rendered_size[1]}; render it again"
        )
    difference = cv2.absdiff(rendered, truth).mean(axis=2)  # (H, W), 0..255
    scaled = np.rint(np.minimum(difference / ERROR_FULL_SCALE, 1.0) * 255).astype(np.uint8)
    return _magma(scaled)


def error_scale(width: int = 256) -> Image8:
    """The colours of `error_map` from 0 to its full scale, (1, width, 3)."""
    return _magma(np.linspace(0, 255, width).round().astype(np.uint8)[None])


def _magma(values: NDArray[np.uint8]) -> Image8:
    """Colours of 8-bit values, (H, W) -> (H, W, 3)."""
    return np.ascontiguousarray(cv2.applyColorMap(values, cv2.COLORMAP_MAGMA)[..., ::-1], dtype=np.uint8)


def _middle_frames(run: MeasuredRun) -> list[Image8]:
    """The middle frame of the first views and methods, to try widths on."""
    frame = run.frames[len(run.frames) // 2]
    folders = [folder for view in run.protocol.views.test for folder in run.frame_folders(view).values()]
    return [read_image(frame_path(folder, frame)) for folder in folders[:24]]
