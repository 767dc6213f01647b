"""Assembly, the last step of every adapter: cameras and frames that fit each other become a
`Capture`.

Frame t of every camera shows one instant, so that counts and rates must be one; ``crop.toml`` says
which part of a calibration's pictures the frames are; known faults of public scenes and cameras are
reported or left out.
"""

import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, Extras, FrameSource, source_chain
from ggvs_eval.datasets.frames import ImageFrames, as_calibrated, has_shape
from ggvs_eval.datasets.instants import align_instants
from ggvs_eval.datasets.units import Units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.names import is_inside, listed
from ggvs_eval.files.toml_tables import build_table, read_toml
from ggvs_eval.files.video import DEINTERLACE, VideoFrames
from ggvs_eval.lens import LARGEST_OFFSET, Lens

CROP_FILE = "crop.toml"
UNNAMED = "capture"  # the folder that `evaluate` writes into OUT, whose name is the scene's
AS_STORED = "read as stored, which the calibration matches"
TURNED = (
    "turned accordingly; a calibration of the stored pixels (COLMAP) would not fit: check by "
    "`ggvs-eval check`, else remove the tag (exiftool -Orientation= FILES)"
)
Size = tuple[int, int]
LARGEST_RIG = 10_000  # poses of a hand-held sequence, each of which is a camera, are some thousands
FILE = "known_traps.toml"


class SizedSource(FrameSource, Protocol):
    """A `FrameSource` that knows the size of its frames without decoding one."""

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""


def assemble_capture(
    path: Path,
    layout: str,
    cameras: Sequence[Camera],
    sources: Sequence[SizedSource],
    units: Units,
    *,
    scene: str | None = None,
    fps: float | None = None,
    extras: Sequence[Extras] = (),
    notes: Sequence[str] = (),
    test_views: Sequence[str] = (),
) -> Capture:
    """Check that all cameras have the same instants and scale each camera to the size of its
    frames.

    Args:
        units: world units per metre.
        scene: what the scene is called; the last part of the path by default, the one above for a
            `capture`.
        fps: frames per second where the layout says it; by default that of the videos, 30 for
            images.

    Raises:
        CaptureError: cameras that differ in frame count or rate, frames of another shape than the
            calibration, or two cameras of one name.
    """
    check_rig_size(path, len(cameras))
    *_, parent, name = ("", *path.resolve().parts[1:])
    names = [camera.name for camera in cameras]
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice or not names:
        matches = f"several called {', '.join(twice)}" if twice else "none"
        raise CaptureError(
            f"{path}: wanted cameras of different names, got {matches}; correct the calibration"
        )
    unfit = [name for name in names if not is_inside(name) or Path(name).name != name]
    if unfit:
        raise CaptureError(
            f"{path}: wanted camera names that can be file names, got {unfit[0]!r:.80}; rename "
            f"this camera"
        )
    sources = [
        as_calibrated(source, *camera.size) for camera, source in zip(cameras, sources, strict=True)
    ]
    aligned = align_instants(path, dict(zip(names, sources, strict=True)), extras, fps)
    crop = given_crop(path)
    cut = (
        [f"frames begin at {crop.left} {crop.top} of the calibrated picture, by {CROP_FILE}"]
        if crop
        else []
    )
    return Capture(
        scene=scene or (parent if name == UNNAMED and parent else name),
        layout=layout,
        path=path,
        cameras=tuple(
            _fit_camera(camera, source, path, crop)
            for camera, source in zip(cameras, sources, strict=True)
        ),
        sources=tuple[FrameSource, ...](aligned.sources.values()),
        n_frames=next(iter(aligned.sources.values())).n_frames,
        fps=aligned.fps,
        units_per_metre=units.per_metre,
        units_origin=units.origin,
        extras=tuple(aligned.extras),
        notes=(*notes, *cut, *aligned.notes, *_notes(cameras, sources)),
        test_views=tuple(test_views),
    )


def check_rig_size(path: Path, n_cameras: int) -> None:
    """Refuse an implausibly large rig before anything is computed of it."""
    if n_cameras > LARGEST_RIG:
        raise CaptureError(
            f"{path}: wanted at most {LARGEST_RIG} cameras, got {n_cameras}; give a part of them"
        )


def _notes(cameras: Sequence[Camera], sources: Sequence[SizedSource]) -> list[str]:
    notes = []
    slanted = [camera for camera in cameras if camera.deviation]
    if slanted:
        largest = max(camera.deviation for camera in slanted)
        names_text = listed([camera.name for camera in slanted])
        notes.append(
            f"rotations of {names_text} are off by up to {largest:.1e}: replaced by the nearest "
            f"rotations"
        )
    sentences: dict[str, list[str]] = {}
    for camera, source in zip(cameras, sources, strict=True):
        files = list(source_chain(source))[-1]
        if isinstance(files, ImageFrames | VideoFrames):
            for sentence, detail in _said_of(files):
                sentences.setdefault(sentence, []).append(f"{camera.name}{detail}")
    for sentence, names in sentences.items():
        notes.append(
            sentence.format("all cameras" if len(names) == len(cameras) > 1 else listed(names))
        )
    return notes


def _said_of(files: ImageFrames | VideoFrames) -> Iterator[tuple[str, str]]:
    """Yield what is to be said of the frames of a camera, with a place for names, and what is added
    to its own.
    """
    if isinstance(files, VideoFrames) and files.interlaced:
        yield (
            f"frames of {{}} are interlaced, two instants in every other row each: {DEINTERLACE} "
            f"parts them",
            "",
        )
    if isinstance(files, ImageFrames) and files.orientations:
        tags = ", ".join(map(str, files.orientations))
        yield (
            f"pictures of {{}} with the EXIF orientation {tags} are "
            f"{AS_STORED if files.as_stored else TURNED}",
            "",
        )
    if isinstance(files, ImageFrames) and files.other_kinds:
        yield f"frames of {{}} are read without {', '.join(files.other_kinds)} beside them", ""
    for change, count in files.conversions.items():
        yield f"frames of {{}} are read {change}", f" ({count} of {files.n_frames})"


def _fit_camera(camera: Camera, source: SizedSource, path: Path, crop: "Crop | None") -> Camera:
    """Return the camera at the size of its frames, which may be a uniformly scaled one, or of a
    part.
    """
    width, height = source.size
    if crop:
        lens = crop_lens(
            camera.name, Lens(camera.K, "opencv", (0.0,) * 4, *camera.size), source.size, crop
        )
        camera = replace(camera, K=lens.K, width=lens.width, height=lens.height)
    if (width, height) != camera.size:
        _check_K_is_of(camera, source.size, path)
    if not has_shape((width, height), camera.size):
        tags = source.orientations if isinstance(source, ImageFrames) else ()
        turned = f", turned as their EXIF orientation {tags[0]} says," if tags else ""
        raise CaptureError(
            f"{getattr(source, 'path', path)}: frames of {width} x {height}{turned} have another "
            f"shape than the {camera.width} x {camera.height} that {camera.name} is calibrated "
            f"for; {describe_crop((width, height), camera.size, path)}"
        )
    return camera.resized(width, height)


def _check_K_is_of(camera: Camera, frames: Size, path: Path) -> None:
    """Refuse a K whose principal point is in the middle of the frames, and far off that of the size
    which its file states.
    """
    off_stated, off_frames = (
        np.abs(camera.K[:2, 2] / size - 0.5).max() for size in (camera.size, frames)
    )
    if off_stated > LARGEST_OFFSET >= off_frames:
        point = f"({camera.K[0, 2]:g}, {camera.K[1, 2]:g})"
        raise CaptureError(
            f"{path}: K of {camera.name} is of {frames[0]} x {frames[1]} images, by its principal "
            f"point {point}, its file says {camera.width} x {camera.height}: correct the size, or K"
        )


@dataclass(frozen=True)
class Crop:
    """Offset of the frames in the calibrated picture; the whole file.

    Attributes:
        left: column of the calibrated picture that the first column of the frames shows.
        top: row that the first row shows.
    """

    left: int
    top: int


def given_crop(folder: Path) -> Crop | None:
    """Read ``crop.toml`` in a capture's folder; None without that file."""
    file = folder / CROP_FILE
    return (
        build_table(Crop, read_toml(file, CaptureError), str(file), "", CaptureError)
        if file.exists()
        else None
    )


def write_crop(folder: Path, crop: Crop) -> Path:
    """Write a file that `given_crop` reads back, and return it."""
    file = folder / CROP_FILE
    file.write_text(f"left = {crop.left}\ntop = {crop.top}\n", encoding="utf-8")
    return file


def crop_lens(name: str, lens: Lens, frames: Size, crop: Crop | None) -> Lens:
    """Return the lens of a camera's frames.

    Of pictures that are whole, or only scaled, the lens as it is.

    Args:
        frames: (width, height) of the frames, pixels; the crop is of pixels of the calibrated size.
        crop: where they begin in the calibrated picture; None if that is not given.
    """
    if crop is None or has_shape(frames, (lens.width, lens.height)):
        return lens
    right, bottom = crop.left + frames[0], crop.top + frames[1]
    if min(crop.left, crop.top) < 0 or right > lens.width or bottom > lens.height:
        raise CameraError(
            f"wanted a crop within the {lens.width} x {lens.height} that {name} is calibrated for, "
            f"got frames of {frames[0]} x {frames[1]} from {crop.left} {crop.top}; correct it"
        )
    return lens.cropped(crop.left, crop.top, *frames)


def describe_crop(frames: Size, calibrated: Size, path: Path) -> str:
    """Explain frames of another shape than their calibration, and what to do.

    For the end of a message.

    Examples:
        >>> describe_crop((1080, 1920), (1088, 1920), Path("rig"))[:25]
        '8 columns of it are missi'
    """
    columns, rows = calibrated[0] - frames[0], calibrated[1] - frames[1]
    if rows == 0 > columns and frames[0] % calibrated[0] == 0:
        n_beside = frames[0] // calibrated[0]
        return (
            f"each frame holds {n_beside} pictures side by side: cut them into one video or folder "
            f"per camera, ffmpeg -i IN -vf crop=iw/{n_beside}:ih:0:0 OUT.mp4 for the first"
        )
    if min(columns, rows) < 0:
        return "use the calibrated frames, scaled but not cropped"
    counts = [f"{count} {noun}" for count, noun in ((columns, "columns"), (rows, "rows")) if count]
    centred = f"{columns // 2} {rows // 2}"
    return (
        f"{' and '.join(counts)} of it are missing. If they were cut off, give the first column "
        f"and row of the frames: 'ggvs-eval check {path} --crop 0 0' where they are cut at the "
        f"right and the bottom, as codecs do, {centred} where on all sides ('crop' in "
        "capture.toml). If 'colmap image_undistorter' wrote the frames, take the sparse/ that it "
        "wrote beside them for the model, or the original frames; if they were scaled unevenly, "
        "give those that were not"
    )


@dataclass(frozen=True)
class KnownTrap:
    """One trap, as the file names it.

    Attributes:
        dataset: what people call the data set.
        reason: what is wrong, in words that follow the camera's or the scene's name.
        scenes: folders of the scenes that it concerns, regardless of the case of their letters; any
            when empty.
        layout: name of the layout that it concerns; any when empty.
        camera: the camera that it concerns; the whole scene when empty.
        leave_out: the camera is no good as a source and left out unless it is asked for.
        more_frames_than: it concerns captures with more frames only.
    """

    dataset: str
    reason: str
    source: str
    scenes: Sequence[str] = ()
    layout: str = ""
    camera: str = ""
    leave_out: bool = False
    more_frames_than: int = 0

    def concerns(self, capture: Capture) -> bool:
        """Return whether a capture is of the trap's scene and has its camera."""
        return (
            (not self.scenes or capture.scene.lower() in self.scenes)
            and self.layout in ("", capture.layout)
            and (not self.camera or self.camera in capture.camera_names)
            and capture.n_frames > self.more_frames_than
        )


def apply_known_traps(capture: Capture, leave_out: bool = True) -> Capture:
    """Leave out cameras that are known to be faulty, and note the other known faults of a capture.

    Args:
        leave_out: leave cameras out; when False they are kept, and the note says what is wrong with
            them.
    """
    for trap in known_traps():
        if not trap.concerns(capture):
            continue
        reason = f"{trap.reason} ({trap.source})"
        if trap.leave_out and leave_out:
            capture = capture.without([trap.camera], reason)
        else:
            subject = f"{trap.camera} of {capture.scene}" if trap.camera else capture.scene
            capture = capture.noted(
                f"known trap of {trap.dataset}, {subject}{', kept' if trap.leave_out else ''}: "
                f"{reason}"
            )
    return capture


def known_traps() -> tuple[KnownTrap, ...]:
    """Return the traps that ship with the package.

    Examples:
        >>> [(*trap.scenes, trap.camera) for trap in known_traps() if trap.leave_out]
        [('coffee_martini', 'cam13')]
    """
    return tuple(KnownTrap(**row) for row in _known()["trap"])


def known_depths(layout: str, scene: str) -> tuple[float, float] | None:
    """Return near and far of a scene that are published, world units; None of other scenes."""
    near_far = _known()["depths"][layout].get(scene)
    return near_far and (near_far[0], near_far[1])


@cache
def _known() -> dict[str, Any]:
    return tomllib.loads((resources.files("ggvs_eval.datasets") / FILE).read_text(encoding="utf-8"))
