"""Where the frames of named cameras may lie: videos, folders of images, or one image each."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath

from ggvs_eval.datasets.assemble import SizedSource
from ggvs_eval.datasets.frames import ImageFrames, list_images
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.video import VideoFrames

ARRANGEMENTS = "CAM.mp4, videos/CAM.mp4, images/CAM/, CAM/images/, CAM/ or one image per camera in images/"
LISTED = 24
# File systems take no longer ones.
LONGEST_NAME_BYTES, LONGEST_PATH = 200, 1000


def find_sources(path: Path, image_names: Mapping[str, str]) -> list[SizedSource]:
    """Frames of each camera by the first arrangement that holds any of them; it must hold all.

    Args:
        path: the capture.
        image_names: camera -> its image in the calibration, relative to ``images/`` or to the capture.

    Raises:
        CaptureError: no frames, or none for some cameras.
    """
    for sources in _arrangements(path, image_names):
        missing = sorted(set(image_names) - set(sources))
        if sources and missing:
            kept = getattr(next(iter(sources.values())), "path", path)
            raise CaptureError(f"{path}: no frames for {listed(missing)} beside {kept}; restore them or take them off the model")
        if sources:
            return [sources[name] for name in image_names]
    raise CaptureError(f"{path}: wanted frames of {listed(list(image_names))}, got none; put them in {ARRANGEMENTS}")


def listed(names: Sequence[str]) -> str:
    """Names in a message, not thousands of them."""
    return ", ".join(names[:LISTED]) + (f" and {len(names) - LISTED} more" if len(names) > LISTED else "")


def _arrangements(path: Path, image_names: Mapping[str, str]) -> Iterator[dict[str, SizedSource]]:
    names = [name for name in image_names if _is_plain(name)]
    for pattern in ("{}.mp4", "videos/{}.mp4"):
        yield {name: VideoFrames(path / pattern.format(name)) for name in names if (path / pattern.format(name)).is_file()}
    for pattern in ("images/{}", "{}/images", "{}"):
        yield {name: ImageFrames(path / pattern.format(name)) for name in names if list_images(path / pattern.format(name))}
    for parent in (path / "images", path):
        files = {name: parent / image for name, image in image_names.items() if _stays_inside(image)}
        yield {name: ImageFrames(file) for name, file in files.items() if file.is_file()}


def _is_plain(name: str) -> bool:
    """Whether a camera's name can be a file's."""
    return _stays_inside(name) and PurePosixPath(name).name == name


def _stays_inside(relative: str) -> bool:
    """Whether a name in a calibration can be a file's below the capture; a hostile model must not lead out of it."""
    if not relative.isprintable() or len(relative) >= LONGEST_PATH:
        return False
    path = PurePosixPath(relative)
    fits = all(len(part.encode()) < LONGEST_NAME_BYTES for part in path.parts)
    return fits and bool(path.name) and not path.is_absolute() and ".." not in path.parts
