"""Assembly, the last step of every adapter: cameras and frames that fit each other become a `Capture`.

Frame t of every camera shows one instant, so that counts and rates must be one; ``crop.toml`` says which part of a calibration's
pictures the frames are; known faults of public scenes and cameras are reported or left out.
"""

import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, Extras, FrameSource, source_chain
from ggvs_eval.datasets.frames import ImageFrames, as_calibrated, has_shape
from ggvs_eval.datasets.units import Units
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.names import Number, is_inside, listed
from ggvs_eval.files.toml_tables import build_table, read_toml
from ggvs_eval.files.video import DEINTERLACE, VideoFrames
from ggvs_eval.lens import LARGEST_OFFSET, Lens

# Image folders do not say their rate; every capture published in this layout was recorded at this one.
FOLDER_FPS = 30.0
# Of constant rates that are one: what averages are rounded by, a fifth of what 29.97 is off 30.
LARGEST_DIFFERENCE = 2e-4
LARGEST_LAG = 0.5  # steps between frames of one number, where rates vary: farther off, the next frame is nearer
CROP_FILE = "crop.toml"
UNNAMED = "capture"  # the folder that `evaluate` writes into OUT, whose name is the scene's
AS_STORED = "read as stored, which the calibration matches"
TURNED = (
    "turned accordingly; a calibration of the stored pixels (COLMAP) would not fit: check by `ggvs-eval check`, else remove the "
    "tag (exiftool -Orientation= FILES)"
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
    """Check that all cameras have the same instants and scale each camera to the size of its frames.

    Args:
        units: world units per metre.
        scene: what the scene is called; the last part of the path by default, the one above for a `capture`.
        fps: frames per second where the layout says it; by default that of the videos, 30 for images.

    Raises:
        CaptureError: cameras that differ in frame count or rate, frames of another shape than the calibration, or two cameras of
            one name.
    """
    check_rig_size(path, len(cameras))
    *_, parent, name = ("", *path.resolve().parts[1:])
    names = [camera.name for camera in cameras]
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice or not names:
        matches = f"several called {', '.join(twice)}" if twice else "none"
        raise CaptureError(f"{path}: wanted cameras of different names, got {matches}; correct the calibration")
    unfit = [name for name in names if not is_inside(name) or Path(name).name != name]
    if unfit:
        raise CaptureError(f"{path}: wanted camera names that can be file names, got {unfit[0]!r:.80}; rename this camera")
    sources = [as_calibrated(source, *camera.size) for camera, source in zip(cameras, sources, strict=True)]
    sources, aligned = align_numbers(path, dict(zip(names, sources, strict=True)), has_extras=bool(extras))
    by_name = dict(zip(names, sources, strict=True))
    n_frames = common_count(path, by_name)
    rate = fps or common_rate(path, by_name)
    return Capture(
        scene=scene or (parent if name == UNNAMED and parent else name),
        layout=layout,
        path=path,
        cameras=tuple(_fit_camera(camera, source, path) for camera, source in zip(cameras, sources, strict=True)),
        sources=tuple[FrameSource, ...](sources),
        n_frames=n_frames,
        fps=rate if n_frames > 1 else 0.0,
        units_per_metre=units.per_metre,
        units_origin=units.origin,
        extras=tuple(extras),
        notes=(*notes, *aligned, *_notes(cameras, sources)),
        test_views=tuple(test_views),
    )


def check_rig_size(path: Path, n_cameras: int) -> None:
    """Refuse an implausibly large rig before anything is computed of it."""
    if n_cameras > LARGEST_RIG:
        raise CaptureError(f"{path}: wanted at most {LARGEST_RIG} cameras, got {n_cameras}; remove some")


def _notes(cameras: Sequence[Camera], sources: Sequence[SizedSource]) -> list[str]:
    notes = []
    slanted = [camera for camera in cameras if camera.deviation]
    if slanted:
        largest = max(camera.deviation for camera in slanted)
        of = listed([camera.name for camera in slanted])
        notes.append(f"rotations of {of} are off by up to {largest:.1e}: replaced by the nearest rotations")
    notes += uneven_notes({camera.name: source for camera, source in zip(cameras, sources, strict=True)})
    sentences: dict[str, list[str]] = {}
    for camera, source in zip(cameras, sources, strict=True):
        files = list(source_chain(source))[-1]
        if isinstance(files, ImageFrames | VideoFrames):
            for sentence, detail in _said_of(files):
                sentences.setdefault(sentence, []).append(f"{camera.name}{detail}")
    for sentence, names in sentences.items():
        notes.append(sentence.format("all cameras" if len(names) == len(cameras) > 1 else listed(names)))
    return notes


def _said_of(files: ImageFrames | VideoFrames) -> Iterator[tuple[str, str]]:
    """Yield what is to be said of the frames of a camera, with a place for names, and what is added to its own."""
    if isinstance(files, VideoFrames) and files.interlaced:
        yield f"frames of {{}} are interlaced, two instants in every other row each: {DEINTERLACE} parts them", ""
    if isinstance(files, ImageFrames) and files.orientations:
        tags = ", ".join(map(str, files.orientations))
        yield f"pictures of {{}} with the EXIF orientation {tags} are {AS_STORED if files.as_stored else TURNED}", ""
    if isinstance(files, ImageFrames) and files.other_kinds:
        yield f"frames of {{}} are read without {', '.join(files.other_kinds)} beside them", ""
    for change, count in files.conversions.items():
        yield f"frames of {{}} are read {change}", f" ({count} of {files.n_frames})"


def _fit_camera(camera: Camera, source: SizedSource, path: Path) -> Camera:
    """Return the camera at the size of its frames, which may be a uniformly scaled one."""
    width, height = source.size
    if (width, height) != camera.size:
        _check_K_is_of(camera, source.size, path)
    if not has_shape((width, height), camera.size):
        tags = source.orientations if isinstance(source, ImageFrames) else ()
        turned = f", turned as their EXIF orientation {tags[0]} says," if tags else ""
        raise CaptureError(
            f"{getattr(source, 'path', path)}: frames of {width} x {height}{turned} have another shape than the {camera.width} x "
            f"{camera.height} that {camera.name} is calibrated for; {describe_crop((width, height), camera.size, path)}"
        )
    return camera.resized(width, height)


def _check_K_is_of(camera: Camera, frames: Size, path: Path) -> None:
    """Refuse a K whose principal point is in the middle of the frames, and far off that of the size which its file states."""
    off_stated, off_frames = (np.abs(camera.K[:2, 2] / size - 0.5).max() for size in (camera.size, frames))
    if off_stated > LARGEST_OFFSET >= off_frames:
        point = f"({camera.K[0, 2]:g}, {camera.K[1, 2]:g})"
        raise CaptureError(
            f"{path}: K of {camera.name} is of {frames[0]} x {frames[1]} images, by its principal point {point}, its file says "
            f"{camera.width} x {camera.height}: correct the size, or K"
        )


def align_numbers(
    path: Path, sources: Mapping[str, SizedSource], has_extras: bool = False
) -> tuple[list[SizedSource], list[str]]:
    """Frames of equal numbers under one index, where all cameras are folders of as many numbered images; with a note.

    Cameras that count from 0 and others that count from 1 are taken to begin together. Time stamps are each camera's own, and so
    frames in their order are one instant.

    Raises:
        CaptureError: cameras without a common number, or masks or depth with another number of images.
    """
    unchanged = list(sources.values())
    images = {name: list(source_chain(source))[-1] for name, source in sources.items()}
    counted = {
        name: each.numbers
        for name, each in images.items()
        if isinstance(each, ImageFrames) and each.n_frames > 1 and each.numbers
    }
    if len(counted) < len(sources) or len({len(numbers) for numbers in counted.values()}) > 1:
        return unchanged, []
    ranges: dict[tuple[Number, ...], list[str]] = {}
    for name, numbers in counted.items():
        ranges.setdefault(numbers, []).append(name)
    if len(ranges) == 1:
        return unchanged, []
    shown = "; ".join(f"{listed(names)} from {numbers[0]} to {numbers[-1]}" for numbers, names in ranges.items())
    if {numbers[0] for numbers in ranges} == {0, 1} and len({_steps(numbers) for numbers in ranges}) == 1:
        return unchanged, [f"frames are numbered from 0 in some cameras and from 1 in others, taken to begin together: {shown}"]
    common = set.intersection(*(set(numbers) for numbers in ranges))
    if not common or has_extras:
        raise CaptureError(
            f"{path}: wanted cameras with {'equal' if common else 'common'} frame numbers, got {shown}; if they begin together, "
            "number all from one frame on"
        )
    note = f"frames {min(common)} to {max(common)}, which all cameras have, are taken ({shown})"
    return [_only(source, common) for source in unchanged], [note]


def _only(source: Any, common: set[Number]) -> Any:
    """A source, behind whatever is done to its frames, with the images of these numbers alone."""
    if hasattr(source, "source"):
        return replace(source, source=_only(source.source, common))
    kept = tuple((number, file) for number, file in zip(source.numbers, source.files, strict=True) if number in common)
    return ImageFrames(source.path, numbered=kept, as_stored=source.as_stored)


def common_count(path: Path, sources: Mapping[str, FrameSource]) -> int:
    """Return the number of frames of every camera."""
    counts = {name: source.n_frames for name, source in sources.items()}
    if len(set(counts.values())) > 1:
        shown = listed([f"{name} {count}" for name, count in counts.items()])
        raise CaptureError(f"{path}: wanted one frame count for all cameras, got {shown}; cut them to a common length")
    return next(iter(counts.values()))


def common_rate(path: Path, sources: Mapping[str, FrameSource]) -> float:
    """Return the frame rate of a rig whose cameras have equally many frames.

    Raises:
        CaptureError: constant rates that differ; variable ones where frames of one number differ by over half a step.

    Reading:
        The average of a variable rate says little: phones that are started together keep step while their averages differ, and
        cameras that each drop a frame have equal ones. So the times of equal frame numbers are compared, each camera's counted
        from its first frame.
    """
    videos = _videos(sources)
    rates = {name: video.fps if video else FOLDER_FPS for name, video in videos.items()}
    rate, differ = float(np.mean(list(rates.values()))), np.ptp(list(rates.values())) > LARGEST_DIFFERENCE * max(rates.values())
    lag_s = largest_lag_s(sources) if any(video and video.uneven for video in videos.values()) else None
    if lag_s is None and not differ:
        return round(rates[next(iter(rates))], 2)
    if lag_s is not None and lag_s <= LARGEST_LAG / rate:
        return round(rate, 2)
    if lag_s is not None and (gaps := _gaps(videos)):
        nominal = 1 / min(np.median(np.diff(video.times_s)) for video in videos.values() if video)
        raise CaptureError(
            f"{path}: wanted frames of one number within half a step in time, got {1000 * lag_s:.0f} ms: {'; '.join(gaps)}; "
            f"write each such video with 'ffmpeg -i IN -vf fps={nominal:.5g} OUT', which repeats the frame before a gap, and cut "
            "all to one length"
        )
    shown = listed([f"{name} {rate:.2f}".rstrip("0").rstrip(".") for name, rate in rates.items()])
    apart = f" with frames of one number up to {1000 * lag_s:.0f} ms apart" if lag_s is not None else ""
    raise CaptureError(f"{path}: wanted one frame rate for all cameras, got {shown}{apart}; convert them to one rate")


def _gaps(videos: Mapping[str, VideoFrames | None]) -> list[str]:
    """The instants that cameras lack, by their times: steps of one and a half median ones and more."""
    cameras: dict[str, list[str]] = {}
    for name, times_s in ((name, video.times_s) for name, video in videos.items() if video):
        steps_s = np.diff(times_s)
        step_s = np.median(steps_s) if len(steps_s) else 0.0
        lacking_s = times_s[:-1][steps_s > 1.5 * step_s] + step_s
        if len(lacking_s):
            cameras.setdefault(f"at {listed([f'{time_s:.3f}' for time_s in lacking_s])} s", []).append(name)
    return [f"{listed(names)} lack{'s' * (len(names) == 1)} the frame {when}" for when, names in cameras.items()]


def largest_lag_s(sources: Mapping[str, FrameSource]) -> float | None:
    """Return the largest distance in time of frames of one number, by the videos' time stamps; None if some are no videos."""
    times = [video.times_s for video in _videos(sources).values() if video]
    if len(times) < len(sources):
        return None
    return float(np.ptp(np.stack(times), axis=0).max())


def uneven_notes(sources: Mapping[str, FrameSource]) -> list[str]:
    """Note cameras of a variable frame rate, and the time between their frames of one number."""
    steps = [f"{name} ({video.uneven})" for name, video in _videos(sources).items() if video and video.uneven]
    lag_s = largest_lag_s(sources) if steps else None
    apart = f"; their times differ by up to {1000 * lag_s:.1f} ms" if lag_s is not None else ""
    taken = "frame t of each camera counts as one instant, regardless of its time"
    return [f"variable frame rate in {listed(steps)}: {taken}{apart}"] if steps else []


def _videos(sources: Mapping[str, FrameSource]) -> dict[str, VideoFrames | None]:
    """Return the video of each camera, also behind an undistortion; None if its frames are images."""
    return {
        name: next((each for each in source_chain(source) if isinstance(each, VideoFrames)), None)
        for name, source in sources.items()
    }


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
    return build_table(Crop, read_toml(file, CaptureError), str(file), "", CaptureError) if file.exists() else None


def write_crop(folder: Path, crop: Crop) -> Path:
    """Write a file that `given_crop` reads back, and return it."""
    file = folder / CROP_FILE
    file.write_text(f"left = {crop.left}\ntop = {crop.top}\n", encoding="utf-8")
    return file


def crop_lens(name: str, lens: Lens, frames: Size, crop: Crop | None) -> Lens:
    """Return the lens of a camera's frames; of pictures that are whole, or only scaled, the lens as it is.

    Args:
        frames: (width, height) of the frames, pixels; the crop is of pixels of the calibrated size.
        crop: where they begin in the calibrated picture; None if that is not given.
    """
    if crop is None or has_shape(frames, (lens.width, lens.height)):
        return lens
    right, bottom = crop.left + frames[0], crop.top + frames[1]
    if min(crop.left, crop.top) < 0 or right > lens.width or bottom > lens.height:
        raise CameraError(
            f"wanted a crop within the {lens.width} x {lens.height} that {name} is calibrated for, got frames of {frames[0]} x "
            f"{frames[1]} from {crop.left} {crop.top}; correct it"
        )
    return lens.cropped(crop.left, crop.top, *frames)


def describe_crop(frames: Size, calibrated: Size, path: Path) -> str:
    """Explain frames of another shape than their calibration, and what to do; for the end of a message.

    Examples:
        >>> describe_crop((1080, 1920), (1088, 1920), Path("rig"))[:25]
        '8 columns of it are missi'
    """
    columns, rows = calibrated[0] - frames[0], calibrated[1] - frames[1]
    if min(columns, rows) < 0:
        return "use the calibrated frames, scaled but not cropped"
    counts = [f"{count} {noun}" for count, noun in ((columns, "columns"), (rows, "rows")) if count]
    centred = f"{columns // 2} {rows // 2}"
    return (
        f"{' and '.join(counts)} of it are missing. If they were cut off, give the first column and row of the frames: "
        f"'ggvs-eval check {path} --crop 0 0' where they are cut at the right and the bottom, as codecs do, {centred} where on "
        "all sides ('crop' in capture.toml); if the frames were scaled unevenly, give those that were not"
    )


@dataclass(frozen=True)
class KnownTrap:
    """One trap, as the file names it.

    Attributes:
        dataset: what people call the data set.
        reason: what is wrong, in words that follow the camera's or the scene's name.
        scenes: folders of the scenes that it concerns, regardless of the case of their letters; any when empty.
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
        leave_out: leave cameras out; when False they are kept, and the note says what is wrong with them.
    """
    for trap in known_traps():
        if not trap.concerns(capture):
            continue
        reason = f"{trap.reason} ({trap.source})"
        if trap.leave_out and leave_out:
            capture = capture.without([trap.camera], reason)
        else:
            of = f"{trap.camera} of {capture.scene}" if trap.camera else capture.scene
            capture = capture.noted(f"known trap of {trap.dataset}, {of}{', kept' if trap.leave_out else ''}: {reason}")
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


def _steps(numbers: Sequence[Number]) -> tuple[Number, ...]:
    return tuple(later - earlier for earlier, later in pairwise(numbers))
