"""Pictures of the page: frames and error maps of all methods, a video per method, the frames along
the camera path.

All are text that the page carries in itself, compressed until they fit into each run's budget of
bytes.
"""

import base64
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import mean_of_channels, read_image
from ggvs_eval.files.video import write_video
from ggvs_eval.jobs.processes import in_threads
from ggvs_eval.progress import track
from ggvs_eval.reports.figures.data_uris import MAP_QUALITY, shrink, webp_bytes, webp_uri
from ggvs_eval.reports.figures.regions import ERROR_FULL_SCALE
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.run_folder import DIAGNOSTICS, frame_path, missing_frames

WEBP_WIDTHS = (960, 800, 720, 640, 560, 480, 400, 320, 256, 192)
MEANINGS = {
    "depth": ("depth", "fused depth, near yellow, far dark blue, chequered where missing"),
    "weights": (
        "weights",
        "one colour per source view, mixed by its share of the pixel, dark where filled from the "
        "background",
    ),
    "coverage": ("coverage", "coverage by the splatted views, none dark blue, full yellow"),
    "motion": ("motion", "motion, which resets temporal blending, yellow; none dark blue"),
}
FRAME_BYTES = 4_000_000
FRAMES_AT_MOST = 900
CLEAR_WIDTH = 320  # pixels; where all frames would be narrower, fewer are shown
FRAMES_AT_LEAST = 8
ERROR_SHARE = 0.5
VIDEO_BYTES = 900_000
VIDEO_FRAMES_AT_MOST = 300
VIDEO_WIDTHS = (480, 320, 240, 160)
CRF = 26.0  # for looking at; x264's own default is 23
DEFAULT_FPS = 10.0
PATH_BYTES = 900_000
UNDONE = "undone"  # behind the label of a method, in the key of its frames with their faults undone
NOTHING_255 = 128  # grey of a picture that an undone offset leaves without a frame
POSES_AT_MOST = 480  # over all methods; the browser decodes each of them for one row


@dataclass(frozen=True)
class UndoneRenders:
    """Frames of a method with the faults of their handling undone.

    They are in no table and no ranking.

    Attributes:
        words: what is undone, e.g. ``frames renumbered by -1``.
        scores: as handed in and undone, one sentence.
        read: view and frame number -> the frame, (H, W, 3) uint8; None of an instant that has none.
    """

    words: str
    scores: str
    read: Callable[[str, int], Image8 | None]


def diagnostics_label(run: MeasuredRun) -> str | None:
    """Return the first method with diagnostics, ours before its variants; None if none has any."""
    first = run.protocol.views.test[0]
    return next(
        (
            label
            for label in run.ours_first
            if (run.folder.renders(label, first) / DIAGNOSTICS).is_dir()
        ),
        None,
    )


def diagnostics_folders(frames: Path, label: str, indices: range) -> Iterator[tuple[str, Path]]:
    """Yield the key and folder of each kind of picture that is there for every frame."""
    for name in MEANINGS:
        folder = frames / DIAGNOSTICS / name
        if folder.is_dir() and not missing_frames(folder, indices):
            yield f"{label}/{name}", folder


def diagnostics_legend(keys: Sequence[str]) -> list[tuple[str, str]]:
    """Return name and meaning of each diagnostic picture among the keys."""
    return [MEANINGS[name] for key in keys if (name := key.partition("/")[2]) in MEANINGS]


@dataclass(frozen=True)
class Comparison:
    """Frame comparison of one run.

    Attributes:
        frames: frame numbers shown, every ``stride``-th one.
        stride: 1 if all frames are shown.
        width: width of the pictures, pixels.
        full_size: width and height of the frames on disk.
        keys: ``truth``, the methods' labels, and what one of them decided inside, see
            `diagnostics_folders`.
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


def compare_frames(
    run: MeasuredRun,
    byte_budget: int = FRAME_BYTES,
    undone: Mapping[str, UndoneRenders] | None = None,
) -> Comparison:
    """Compress the frames of every method and the truth, and the errors against the truth, for the
    page.

    Args:
        byte_budget: what the frames may take, before base64; it decides their width. Error maps and
            what a method decided inside take about a quarter more each.
        undone: label -> its frames with their faults undone, which are shown too.
    """
    views, diagnostics = run.protocol.views.test, _diagnostics(run)
    names = {key: run.name(key) for key in ("truth", *run.pictured)}
    names |= {
        f"{label}/{UNDONE}": f"{run.name(label)}: {renders.words}"
        for label, renders in (undone or {}).items()
    }
    inside = {key: key.split("/") for key in next(iter(diagnostics.values()))}
    names |= {
        key: f"{run.name(label)}: {MEANINGS[kind][0]}" for key, (label, kind) in inside.items()
    }
    keys = tuple(names)
    folders = [folder for view in views for folder in run.frame_folders(view).values()]
    # to try widths on
    samples = [
        read_image(frame_path(folder, run.frames[len(run.frames) // 2])) for folder in folders[:24]
    ]
    stride, width = _fit(run, samples, byte_budget, len(undone or ()))
    frames = run.frames[::stride]
    height, full_size = (
        shrink(samples[0], width).shape[0],
        (samples[0].shape[1], samples[0].shape[0]),
    )
    images: dict[str, dict[str, list[str]]] = {view: {key: [] for key in keys} for view in views}
    errors: dict[str, dict[str, list[str]]] = {
        view: {label: [] for label in run.pictured} for view in views
    }
    instants = [(view, frame) for view in views for frame in frames]
    compressed = in_threads(
        partial(_compress_frames, run, diagnostics, undone or {}, width), instants
    )
    for (view, _), pictures in zip(
        instants, track(compressed, "compressing frames", len(instants)), strict=True
    ):
        for key, (picture, error) in pictures.items():
            images[view][key].append(picture)
            if error:
                errors[view][key].append(error)
    return Comparison(
        views=views,
        frames=tuple(frames),
        stride=stride,
        width=width,
        height=height,
        full_size=full_size,
        keys=keys,
        names=tuple(names.values()),
        images=images,
        errors=errors,
    )


def _fit(
    run: MeasuredRun, samples: list[Image8], byte_budget: int, n_undone: int
) -> tuple[int, int]:
    """Return the frames that are shown, every Nth, and their width in pixels: all of them, unless
    fewer are clearer.
    """
    n_pictures = len(run.protocol.views.test) * (1 + len(run.pictured) + n_undone)
    stride = math.ceil(len(run.frames) * n_pictures / FRAMES_AT_MOST)
    while True:
        width = fitting_width(samples, byte_budget / (len(run.frames[::stride]) * n_pictures))
        if (
            width >= min(CLEAR_WIDTH, samples[0].shape[1])
            or len(run.frames[:: stride + 1]) < FRAMES_AT_LEAST
        ):
            return stride, width
        stride += 1


def _diagnostics(run: MeasuredRun) -> dict[str, dict[str, Path]]:
    """Return view -> key -> folder of a method's diagnostics, the same keys for every view."""
    label = diagnostics_label(run)
    folders_of = {
        view: {}
        if label is None
        else dict(diagnostics_folders(run.folder.renders(label, view), label, run.frames))
        for view in run.protocol.views.test
    }
    common = set.intersection(*(set(folders) for folders in folders_of.values()))
    return {
        view: {key: folder for key, folder in folders.items() if key in common}
        for view, folders in folders_of.items()
    }


def _compress_frames(
    run: MeasuredRun,
    diagnostics: dict[str, dict[str, Path]],
    undone: Mapping[str, UndoneRenders],
    width: int,
    instant: tuple[str, int],
) -> dict[str, tuple[str, str]]:
    """Return key -> compressed picture and error map of one view and frame.

    Only methods have errors.
    """
    view, frame = instant
    files = {key: frame_path(folder, frame) for key, folder in run.frame_folders(view).items()}
    truth = read_image(files["truth"])
    pictures = {"truth": (webp_uri(shrink(truth, width)), "")}
    for label in run.pictured:
        rendered = read_image(files[label])
        error = error_map(rendered, truth, files[label])
        pictures[label] = (
            webp_uri(shrink(rendered, width)),
            webp_uri(shrink(error, round(width * ERROR_SHARE)), MAP_QUALITY),
        )
    for label, renders in undone.items():
        frame_undone = renders.read(view, frame)
        picture = np.full_like(truth, NOTHING_255) if frame_undone is None else frame_undone
        pictures[f"{label}/{UNDONE}"] = webp_uri(shrink(picture, width)), ""
    for key, folder in diagnostics[view].items():
        pictures[key] = (
            webp_uri(shrink(read_image(frame_path(folder, frame)), width), MAP_QUALITY),
            "",
        )
    return pictures


def error_map(rendered: Image8, truth: Image8, file: Path) -> Image8:
    """Mean absolute difference of the three channels in the colours of magma: black is 0, the
    brightest is `ERROR_FULL_SCALE`.

    Args:
        rendered: (H, W, 3), uint8.
    """
    if rendered.shape != truth.shape:
        truth_size, rendered_size = truth.shape[1::-1], rendered.shape[1::-1]
        raise RenderError(
            f"{file}: wanted {truth_size[0]} x {truth_size[1]} pixels as the truth has, "
            f"got {rendered_size[0]} x {rendered_size[1]}; render it again"
        )
    difference = mean_of_channels(cv2.absdiff(rendered, truth))  # (H, W), 0..255
    scaled = np.rint(np.minimum(difference / ERROR_FULL_SCALE, 1.0) * 255).astype(np.uint8)
    return _magma(scaled)


def error_scale(width: int = 256) -> Image8:
    """Return the colours of `error_map` from 0 to its full scale, (1, width, 3)."""
    return _magma(np.linspace(0, 255, width).round().astype(np.uint8)[None])


def _magma(values: NDArray[np.uint8]) -> Image8:
    """Return the colours of 8-bit values, (H, W) -> (H, W, 3)."""
    return np.ascontiguousarray(
        cv2.applyColorMap(values, cv2.COLORMAP_MAGMA)[..., ::-1], dtype=np.uint8
    )


@dataclass(frozen=True)
class MethodVideo:
    """The video of one method or of the truth.

    Attributes:
        name: of the method, to show.
        views: test views in the order in which they appear.
        width: pixels.
        height: pixels.
        address: the video as text that the page carries.
    """

    name: str
    views: tuple[str, ...]
    width: int
    height: int
    address: str


def method_videos(
    run: MeasuredRun, fps: float, byte_budget: int = VIDEO_BYTES
) -> tuple[MethodVideo, ...]:
    """Encode the truth and every method, at the largest width at which all fit.

    None for a run of one frame.

    Args:
        fps: frames per second of the capture; 0 where unknown, then `DEFAULT_FPS`.
        byte_budget: what all videos may take together, before base64; the narrowest width is taken
            where nothing fits.

    Reading:
        Long runs are cut: as many whole views as `VIDEO_FRAMES_AT_MOST` frames hold, at least the
        beginning of one.
    """
    if len(run.frames) < 2:
        return ()
    views = run.protocol.views.test[: max(1, VIDEO_FRAMES_AT_MOST // len(run.frames))]
    keys = ("truth", *run.pictured)
    for width in VIDEO_WIDTHS:
        videos = list(in_threads(partial(_encode, run, views, width, fps or DEFAULT_FPS), keys))
        if sum(len(video) for video, *_ in videos) <= byte_budget:
            break
    addresses = [
        "data:video/mp4;base64," + base64.b64encode(video).decode("ascii") for video, *_ in videos
    ]
    return tuple(
        MethodVideo(name=run.name(key), views=views, width=width, height=height, address=address)
        for key, (_, width, height), address in zip(keys, videos, addresses, strict=True)
    )


def _encode(
    run: MeasuredRun, views: tuple[str, ...], width: int, fps: float, key: str
) -> tuple[bytes, int, int]:
    folders = [run.frame_folders(view)[key] for view in views]
    first = next(_pictures(folders[:1], run.frames, width))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "video.mp4"
        write_video(file, _pictures(folders, run.frames, width), fps, CRF)
        return file.read_bytes(), first.shape[1], first.shape[0]


def _pictures(folders: list[Path], frames: range, width: int) -> Iterator[Image8]:
    """Yield the frames of folder after folder, reduced, a last odd row or column cut off (4:2:0
    wants even sizes).
    """
    for folder in folders:
        for frame in frames[:VIDEO_FRAMES_AT_MOST]:
            image = shrink(read_image(frame_path(folder, frame)), width)
            yield image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]


@dataclass(frozen=True)
class PathPictures:
    """Path frames from which the page can cut epipolar plane images.

    Attributes:
        poses: numbers of the poses shown, every Nth one.
        keys: ``truth``, where the path has one, the labels that have a path, and what one of them
            decided inside.
        images: key -> one picture per pose shown.
    """

    poses: tuple[int, ...]
    keys: tuple[str, ...]
    images: dict[str, list[str]]


def path_pictures(run: MeasuredRun, byte_budget: int = PATH_BYTES) -> PathPictures | None:
    """Compress the frames along the camera path; None if the run has none.

    Args:
        byte_budget: what they may take, before base64; it decides their width.
    """
    folders, count = run.path_folders(run.pictured)
    if not count:
        return None
    poses = range(0, count, math.ceil(count * len(folders) / POSES_AT_MOST))
    source = diagnostics_label(run)
    if source in folders:
        folders |= dict(diagnostics_folders(folders[source], source, range(count)))
    files = {key: [frame_path(folder, pose) for pose in poses] for key, folder in folders.items()}
    middle = [read_image(paths[len(paths) // 2]) for paths in files.values()]
    width = fitting_width(middle, byte_budget / (len(poses) * len(folders)))
    images = {
        key: list(in_threads(lambda file: webp_uri(shrink(read_image(file), width)), paths))
        for key, paths in files.items()
    }
    return PathPictures(tuple(poses), tuple(folders), images)


@dataclass(frozen=True)
class PictureRoom:
    """Bytes that the pictures of one run may take, before base64."""

    frames: int
    path: int
    videos: int


def share_room(runs: Sequence[MeasuredRun]) -> list[PictureRoom]:
    """Share the page among runs by the pixels that each has to show, so that a small room takes
    nothing from a large one.
    """
    firsts = [
        read_image(frame_path(run.folder.truth(run.protocol.views.test[0]), run.frames[0]))
        for run in runs
    ]
    n_frames = [
        len(run.frames) * len(run.protocol.views.test) * (1 + len(run.pictured)) for run in runs
    ]
    n_poses = [
        sum(len(list(run.folder.path(key).glob("*.png"))) for key in ("truth", *run.pictured))
        for run in runs
    ]
    frames = _shares(
        [
            first.size * min(count, FRAMES_AT_MOST)
            for first, count in zip(firsts, n_frames, strict=True)
        ]
    )
    paths = _shares(
        [
            first.size * min(count, POSES_AT_MOST)
            for first, count in zip(firsts, n_poses, strict=True)
        ]
    )
    return [
        PictureRoom(int(FRAME_BYTES * frame), int(PATH_BYTES * path), int(VIDEO_BYTES * frame))
        for frame, path in zip(frames, paths, strict=True)
    ]


def _shares(weights: Sequence[int]) -> list[float]:
    total = sum(weights)
    return [weight / total if total else 0.0 for weight in weights]


def fitting_width(samples: Sequence[Image8], bytes_each: float) -> int:
    """Return the largest width, at most the samples' own, at which they take at most N bytes on
    average.

    Args:
        bytes_each: what one may take as WebP, before base64; the narrowest width of `WEBP_WIDTHS`
            is taken where nothing fits.
    """
    full_width = samples[0].shape[1]
    for width in (full_width, *(width for width in WEBP_WIDTHS if width < full_width)):
        if np.mean([len(webp_bytes(shrink(sample, width))) for sample in samples]) <= bytes_each:
            break
    return width
