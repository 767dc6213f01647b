"""Frames of each camera on disk, by the one table of arrangements that layouts and commands look through, and their coding."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from ggvs_eval.capture import FrameSource
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.coding import Coding, read_coding
from ggvs_eval.files.listing import (
    VIDEO_SUFFIXES,
    list_entries,
    list_files,
    list_images,
    same_name,
    unread_pictures,
    unread_videos,
)
from ggvs_eval.files.video import VideoFrames

CameraFrames = VideoFrames | ImageFrames
# Places of the frames of a camera called CAM; the first that holds any counts; .mp4 is any video, .png any picture.
ARRANGEMENTS = (
    *("CAM.mp4", "videos/CAM.mp4", "images/CAM/", "frames/CAM/", "CAM/images/", "CAM/images_scaled_2/", "CAM/"),
    *("images/CAM.png", "CAM.png", "images_2/CAM.png", "images_4/CAM.png", "images_8/CAM.png"),
)
IN_WORDS = f"{', '.join(each for each in ARRANGEMENTS if not each.endswith('.png'))} or one image per camera, here or in images/"
# Folders that captures hold next to those of their cameras.
NO_CAMERAS = {"images", "frames", "videos", "background", "bkgd", "mask", "masks", "bgmtv2", "schp", "depth", "path", "sparse"}
LISTED = 24
# File systems take no longer ones.
LONGEST_NAME_BYTES, LONGEST_PATH = 200, 1000
JPEG = (".jpg", ".jpeg")


class FoundFrames(NamedTuple):
    """The frames of some cameras, and the names of others in the same arrangement."""

    sources: dict[str, CameraFrames]
    beside: list[str]


def frames_in(path: Path, arrangement: str, even_empty: bool = False) -> list[tuple[str, CameraFrames]]:
    """Everything that may be a camera's frames in one arrangement, by name.

    Args:
        arrangement: as in `ARRANGEMENTS`.
        even_empty: folders without images too.
    """
    parent, _, rest = arrangement.partition("CAM")
    if rest == ".mp4":
        return [(file.stem, VideoFrames(file)) for file in list_files(path / parent, VIDEO_SUFFIXES)]
    if rest == ".png":
        return [(file.stem, ImageFrames(file)) for file in list_images(path / parent)]
    folders = [(entry.name, entry / rest.strip("/")) for entry in list_entries(path / parent)]
    return [(name, ImageFrames(each)) for name, each in folders if list_images(each) or (even_empty and each.is_dir())]


def find_frames(path: Path, image_names: Mapping[str, str]) -> FoundFrames:
    """Return the frames of known cameras by the first arrangement that holds those of any.

    Args:
        image_names: camera -> its image in the calibration, relative to ``images/`` or to the capture.
    """
    spelled = {same_name(name): name for name in image_names}
    for arrangement in ARRANGEMENTS:
        on_disk = frames_in(path, arrangement)
        found = [(spelled[same_name(name)], frames) for name, frames in on_disk if same_name(name) in spelled]
        if arrangement.endswith(".png"):
            stills = _named_stills(path / arrangement.removesuffix("CAM.png"), image_names)
            found = [*stills.items(), *((name, frames) for name, frames in found if name not in stills)]
        if found:
            beside = [name for name, _ in on_disk if same_name(name) not in spelled and name not in NO_CAMERAS]
            return FoundFrames(_one_each(path, found), beside)
    return FoundFrames({}, [])


def require_frames(path: Path, image_names: Mapping[str, str]) -> FoundFrames:
    """Find the frames of all of some cameras; arguments as of `find_frames`."""
    found = find_frames(path, image_names)
    if not found.sources:
        raise CaptureError(f"{path}: wanted frames of {listed(list(image_names))}, got {instead_of_frames(path, image_names)}")
    missing = sorted(set(image_names) - set(found.sources))
    if missing:
        kept = next(iter(found.sources.values())).path
        unread = _unread(path, missing)
        remedy = f"but {unread}" if unread else "restore them or remove these cameras from the model"
        raise CaptureError(f"{path}: wanted frames of every camera, got none for {listed(missing)}, only for {kept}; {remedy}")
    return FoundFrames({name: found.sources[name] for name in image_names}, found.beside)


# GoPro's chapters: GX and GH with the chapter before the recording's number; GOPR, and GP from the second one on.
CHAPTER = re.compile(r"G[XH](?P<chapter>\d\d)(?P<recording>\d{4})|GOPR(?P<first>\d{4})|GP(?P<next>\d\d)(?P<same>\d{4})", re.I)


def refuse_chapters(path: Path, names: Iterable[str]) -> None:
    """Refuse files that are chapters of one recording, which a camera splits by size: each would be taken for a camera."""
    recordings: dict[str, list[str]] = {}
    for name in sorted(names, key=lambda name: (not name.upper().startswith("GOPR"), name)):
        if match := CHAPTER.fullmatch(name):
            recordings.setdefault(match["recording"] or match["first"] or match["same"], []).append(name)
    split = {number: chapters for number, chapters in recordings.items() if len(chapters) > 1}
    if split:
        chapters = next(iter(split.values()))
        shown = "; ".join(" and ".join(each) for each in split.values())
        raise CaptureError(
            f"{path}: wanted one video per camera, got chapters of one recording: {shown}; join each into one, in another "
            f"folder: write \"file '{chapters[0]}.MP4'\" and the like into LIST, then ffmpeg -f concat -i LIST -c copy OUT.mp4"
        )


def find_rig_frames(path: Path) -> dict[str, CameraFrames]:
    """The frames of cameras that nothing is known of, by the first arrangement that holds two or more, in the order of names.

    Raises:
        CaptureError: no such folder, no two cameras in it, or several files of one.
    """
    if not path.is_dir():
        there = "a file" if path.exists() else "nothing there"
        raise CaptureError(f"{path}: wanted a folder with the frames of several cameras, got {there}; check the path")
    for arrangement in ARRANGEMENTS:
        skipped = NO_CAMERAS if arrangement.startswith("CAM/") else ()
        found = [(name, frames) for name, frames in frames_in(path, arrangement) if name not in skipped]
        if arrangement.endswith(".mp4"):
            refuse_chapters(path, [name for name, _ in found])
        if len({name for name, _ in found}) > 1:
            return dict(sorted(_one_each(path, found).items()))
    raise CaptureError(
        f"{path}: wanted the frames of two cameras or more, got {instead_of_frames(path)} "
        "(for a capture of another layout, 'ggvs-eval undistort' writes its frames as videos)"
    )


def instead_of_frames(path: Path, names: Iterable[str] = ()) -> str:
    """Describe what a folder holds instead of the frames of some or all cameras, and where they belong."""
    unread = _unread(path, names)
    return f"none, but {unread}" if unread else f"none; put them in {IN_WORDS}"


def listed(names: Iterable[str]) -> str:
    """Return the names in a message, not thousands of them."""
    names = list(names)
    return ", ".join(names[:LISTED]) + (f" and {len(names) - LISTED} more" if len(names) > LISTED else "")


def _unread(path: Path, names: Iterable[str]) -> str:
    places = (path, path / "videos")
    videos = next(filter(None, (unread_videos(place, tuple(names)) for place in places)), "")
    folders = [place / name for name in names for place in (path / "images", path) if is_inside(name)]
    pictures = ((folder, unread_pictures(folder)) for folder in [*folders, path / "images", path])
    return videos or next((f"{folder} holds {unread}" for folder, unread in pictures if unread), "")


def _named_stills(parent: Path, image_names: Mapping[str, str]) -> dict[str, CameraFrames]:
    """Single images by their very names in the calibration."""
    files = {name: parent / image for name, image in image_names.items() if is_inside(image)}
    return {name: ImageFrames(file) for name, file in files.items() if file.is_file()}


def _one_each(path: Path, found: list[tuple[str, CameraFrames]]) -> dict[str, CameraFrames]:
    sources = dict(found)
    if len(sources) < len(found):
        names = [name for name, _ in found]
        twice = listed(sorted({name for name in names if names.count(name) > 1}))
        raise CaptureError(
            f"{path}: wanted one file per camera, got several called {twice}; rename the others or move them elsewhere"
        )
    return sources


def is_inside(relative: str) -> bool:
    """Return whether a name in a calibration can be a file's below the capture; a hostile model must not lead out of it."""
    if not relative.isprintable() or len(relative) >= LONGEST_PATH:
        return False
    path = PurePosixPath(relative)
    fits = all(len(part.encode()) < LONGEST_NAME_BYTES for part in path.parts)
    return fits and bool(path.name) and not path.is_absolute() and ".." not in path.parts


def coding_of(source: FrameSource, frames: range) -> Coding | None:
    """State how frames were coded.

    Returns:
        None if every pixel is as it was given; `Coding.unknown` where it is not and nothing more is known.
    """
    stored = source
    while hasattr(stored, "source"):  # undistorted, held still, or with noise added
        stored = stored.source
    if isinstance(stored, VideoFrames):
        changed = Coding(unknown="frames were changed after they were coded")
        return read_coding(stored.path, frames) if stored is source else changed
    if isinstance(stored, ImageFrames) and Path(stored.files[0]).suffix.lower() in JPEG:
        return Coding(unknown="frames are JPEG images")
    return None
