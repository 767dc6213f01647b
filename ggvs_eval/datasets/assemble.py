"""Assembly, the last step of every adapter: cameras and frames that fit each other become a `Capture`."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Protocol

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, Extras, FrameSource, source_chain
from ggvs_eval.datasets.frames import ImageFrames, list_images
from ggvs_eval.datasets.units import Units
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.video import VideoFrames

# Image folders do not say their rate; every capture published in this layout was recorded at this one.
FOLDER_FPS = 30.0
ARRANGEMENTS = "CAM.mp4, videos/CAM.mp4, images/CAM/, CAM/images/, CAM/images_scaled_2/, CAM/ or one image per camera in images/"
LISTED = 24
LARGEST_RIG = 10_000  # poses of a hand-held sequence, each of which is a camera, are some thousands
# File systems take no longer ones.
LONGEST_NAME_BYTES, LONGEST_PATH = 200, 1000


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
    """Check that all cameras have the same instants and bring each camera to the size of its frames.

    Args:
        path: the capture.
        layout: name of its layout.
        cameras: at the size they are calibrated for.
        sources: frames of each camera.
        units: world units per metre.
        scene: what the scene is called; the last part of the path by default.
        fps: frames per second where the layout says it; by default that of the videos, 30 for images.
        extras: of each camera, or none.
        notes: what was left out and why.
        test_views: cameras that the capture's authors hold out.

    Raises:
        CaptureError: cameras that differ in frame count or rate, frames of another shape than the calibration, or two cameras of
            one name.
    """
    check_rig_size(path, len(cameras))
    names = [camera.name for camera in cameras]
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice or not names:
        matches = f"several called {', '.join(twice)}" if twice else "none"
        raise CaptureError(f"{path}: wanted cameras of different names, got {matches}; correct the calibration")
    unfit = [name for name in names if not _is_file_name(name)]
    if unfit:
        raise CaptureError(f"{path}: wanted camera names that can be file names, got {unfit[0]!r:.80}; rename this camera")
    n_frames = _common([source.n_frames for source in sources], names, path, "frame count", "cut them to a common length")
    rates = [fps or _rate(source) for source in sources]
    rate = _common(rates, names, path, "frame rate", "convert them to one rate")
    return Capture(
        scene=scene or path.resolve().name,
        layout=layout,
        path=path,
        cameras=tuple(_fit_camera(camera, source, path) for camera, source in zip(cameras, sources, strict=True)),
        sources=tuple[FrameSource, ...](sources),
        n_frames=int(n_frames),
        fps=rate if n_frames > 1 else 0.0,
        units_per_metre=units.per_metre,
        units_origin=units.origin,
        extras=tuple(extras),
        notes=(*notes, *_notes(cameras, sources)),
        test_views=tuple(test_views),
    )


def check_rig_size(path: Path, n_cameras: int) -> None:
    """Refuse a rig that nobody has, before anything is computed of it.

    Raises:
        CaptureError: more than `LARGEST_RIG` cameras.
    """
    if n_cameras > LARGEST_RIG:
        raise CaptureError(f"{path}: wanted at most {LARGEST_RIG} cameras, got {n_cameras}; leave some out")


def _notes(cameras: Sequence[Camera], sources: Sequence[SizedSource]) -> list[str]:
    """List what was mended, and what nobody can mend here."""
    notes = []
    slanted = [camera for camera in cameras if camera.deviation]
    if slanted:
        largest = max(camera.deviation for camera in slanted)
        of = listed([camera.name for camera in slanted])
        notes.append(f"rotations of {of} are off by up to {largest:.1e}: the nearest ones are taken")
    videos = {camera.name: _video(source) for camera, source in zip(cameras, sources, strict=True)}
    steps = [f"{name} ({video.uneven})" for name, video in videos.items() if video and video.uneven]
    if steps:
        notes.append(f"variable frame rate in {listed(steps)}: frame t of each camera is taken as one instant, whatever its time")
    return notes + _conversion_notes(cameras, sources)


def _conversion_notes(cameras: Sequence[Camera], sources: Sequence[SizedSource]) -> list[str]:
    """List the changes by reading frames as 8-bit RGB."""
    by_change: dict[str, list[str]] = {}
    for camera, source in zip(cameras, sources, strict=True):
        inner = getattr(source, "source", source)  # behind an undistortion
        for change, count in inner.conversions.items() if isinstance(inner, ImageFrames | VideoFrames) else ():
            by_change.setdefault(change, []).append(f"{camera.name} ({count} of {inner.n_frames})")
    shown = {change: "all cameras" if len(names) == len(cameras) > 1 else listed(names) for change, names in by_change.items()}
    return [f"frames of {names} are read {change}" for change, names in shown.items()]


def _is_file_name(name: str) -> bool:
    """Results are written to files that are called after cameras; none may lead out of their folder."""
    return bool(name) and name.isprintable() and Path(name).name == name and name != ".." and len(name.encode()) < 200


def _rate(source: FrameSource) -> float:
    """Frames per second."""
    video = _video(source)
    return round(video.fps, 2) if video else FOLDER_FPS


def _video(source: FrameSource) -> VideoFrames | None:
    """The video that frames come from, which may lie behind an undistortion; None where they are images."""
    return next((each for each in source_chain(source) if isinstance(each, VideoFrames)), None)


def _common(values: Sequence[float], names: Sequence[str], path: Path, quantity: str, mend: str) -> float:
    if len(set(values)) > 1:
        listed = ", ".join(f"{name} {value:g}" for name, value in zip(names, values, strict=True))
        raise CaptureError(f"{path}: wanted one {quantity} for all cameras, got {listed}; {mend}")
    return values[0]


def _fit_camera(camera: Camera, source: SizedSource, path: Path) -> Camera:
    """The camera at the size of its frames, which may be a uniformly scaled one."""
    width, height = source.size
    if abs(camera.height * width / camera.width - height) > 1:
        raise CaptureError(
            f"{getattr(source, 'path', path)}: frames of {width} x {height} have another shape than the "
            f"{camera.width} x {camera.height} that {camera.name} is calibrated for; give the frames this calibration was made "
            "for, scaled but not cropped"
        )
    return camera.resized(width, height)


def find_sources(path: Path, image_names: Mapping[str, str]) -> list[SizedSource]:
    """Frames of each camera by the first arrangement that holds any of them; it must hold all.

    Args:
        path: the capture.
        image_names: camera -> its image in the calibration, relative to ``images/`` or to the capture.

    Raises:
        CaptureError: no frames, or none for some cameras.
    """
    sources = first_sources(path, image_names)
    if not sources:
        raise CaptureError(f"{path}: wanted frames of {listed(list(image_names))}, got none; put them in {ARRANGEMENTS}")
    missing = sorted(set(image_names) - set(sources))
    if missing:
        kept = getattr(next(iter(sources.values())), "path", path)
        raise CaptureError(f"{path}: no frames for {listed(missing)} beside {kept}; restore them or take them off the model")
    return [sources[name] for name in image_names]


def first_sources(path: Path, image_names: Mapping[str, str]) -> dict[str, SizedSource]:
    """Frames by the first arrangement that holds those of any camera, by its name; arguments as of `find_sources`."""
    return next((sources for sources in _arrangements(path, image_names) if sources), {})


def listed(names: Sequence[str]) -> str:
    """Names in a message, not thousands of them."""
    return ", ".join(names[:LISTED]) + (f" and {len(names) - LISTED} more" if len(names) > LISTED else "")


def _arrangements(path: Path, image_names: Mapping[str, str]) -> Iterator[dict[str, SizedSource]]:
    names = [name for name in image_names if _is_plain(name)]
    for pattern in ("{}.mp4", "videos/{}.mp4"):
        yield {name: VideoFrames(path / pattern.format(name)) for name in names if (path / pattern.format(name)).is_file()}
    for pattern in ("images/{}", "{}/images", "{}/images_scaled_2", "{}"):
        yield {name: ImageFrames(path / pattern.format(name)) for name in names if list_images(path / pattern.format(name))}
    for parent in (path / "images", path):
        files = {name: parent / image for name, image in image_names.items() if _stays_inside(image)}
        yield {name: ImageFrames(file) for name, file in files.items() if file.is_file()}


def _is_plain(name: str) -> bool:
    """Tell whether a camera's name can be a file's."""
    return _stays_inside(name) and PurePosixPath(name).name == name


def _stays_inside(relative: str) -> bool:
    """Tell whether a name in a calibration can be a file's below the capture; a hostile model must not lead out of it."""
    if not relative.isprintable() or len(relative) >= LONGEST_PATH:
        return False
    path = PurePosixPath(relative)
    fits = all(len(part.encode()) < LONGEST_NAME_BYTES for part in path.parts)
    return fits and bool(path.name) and not path.is_absolute() and ".." not in path.parts
