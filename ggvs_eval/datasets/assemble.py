"""Assembly, the last step of every adapter: cameras and frames that fit each other become a `Capture`."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, Extras, FrameSource, source_chain
from ggvs_eval.datasets.camera_frames import listed
from ggvs_eval.datasets.crop import describe_crop
from ggvs_eval.datasets.frames import ImageFrames, as_calibrated, has_shape
from ggvs_eval.datasets.instants import common_count, common_rate, uneven_notes
from ggvs_eval.datasets.units import Units
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.video import VideoFrames

LARGEST_RIG = 10_000  # poses of a hand-held sequence, each of which is a camera, are some thousands


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
        units: world units per metre.
        scene: what the scene is called; the last part of the path by default.
        fps: frames per second where the layout says it; by default that of the videos, 30 for images.

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
    sources = [as_calibrated(source, *camera.size) for camera, source in zip(cameras, sources, strict=True)]
    by_name = dict(zip(names, sources, strict=True))
    n_frames = common_count(path, by_name)
    rate = fps or common_rate(path, by_name)
    return Capture(
        scene=scene or path.resolve().name,
        layout=layout,
        path=path,
        cameras=tuple(_fit_camera(camera, source, path) for camera, source in zip(cameras, sources, strict=True)),
        sources=tuple[FrameSource, ...](sources),
        n_frames=n_frames,
        fps=rate if n_frames > 1 else 0.0,
        units_per_metre=units.per_metre,
        units_origin=units.origin,
        extras=tuple(extras),
        notes=(*notes, *_notes(cameras, sources)),
        test_views=tuple(test_views),
    )


def check_rig_size(path: Path, n_cameras: int) -> None:
    """Refuse an implausibly large rig before anything is computed of it."""
    if n_cameras > LARGEST_RIG:
        raise CaptureError(f"{path}: wanted at most {LARGEST_RIG} cameras, got {n_cameras}; leave some out")


def _notes(cameras: Sequence[Camera], sources: Sequence[SizedSource]) -> list[str]:
    notes = []
    slanted = [camera for camera in cameras if camera.deviation]
    if slanted:
        largest = max(camera.deviation for camera in slanted)
        of = listed([camera.name for camera in slanted])
        notes.append(f"rotations of {of} are off by up to {largest:.1e}: the nearest ones are taken")
    notes += uneven_notes({camera.name: source for camera, source in zip(cameras, sources, strict=True)})
    return [*notes, *_exif_notes(cameras, sources), *_conversion_notes(cameras, sources)]


def _exif_notes(cameras: Sequence[Camera], sources: Sequence[SizedSource]) -> list[str]:
    """List what was made of the EXIF orientations of pictures; the poses alone tell whether that is right."""
    names: dict[bool, list[str]] = {}
    for camera, source in zip(cameras, sources, strict=True):
        inner = list(source_chain(source))[-1]
        if isinstance(inner, ImageFrames) and inner.orientations:
            names.setdefault(inner.as_stored, []).append(f"{camera.name} ({', '.join(map(str, inner.orientations))})")
    how = {
        True: "taken as their pixels are stored, which the calibration is of",
        False: "turned as it says; a calibration of the stored pixels, as COLMAP's are, would be of other pictures: see that "
        "`check` finds matched features in place, else remove the tag (exiftool -Orientation= FILES)",
    }
    return [f"pictures with an EXIF orientation, {listed(some)}, are {how[as_stored]}" for as_stored, some in names.items()]


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


def _fit_camera(camera: Camera, source: SizedSource, path: Path) -> Camera:
    """The camera at the size of its frames, which may be a uniformly scaled one."""
    width, height = source.size
    if not has_shape((width, height), camera.size):
        tags = source.orientations if isinstance(source, ImageFrames) else ()
        turned = f", turned as their EXIF orientation {tags[0]} says," if tags else ""
        raise CaptureError(
            f"{getattr(source, 'path', path)}: frames of {width} x {height}{turned} have another shape than the {camera.width} x "
            f"{camera.height} that {camera.name} is calibrated for; {describe_crop((width, height), camera.size, path)}"
        )
    return camera.resized(width, height)
