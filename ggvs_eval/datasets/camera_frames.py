"""Frames of each camera on disk, found in the index of media by layouts and commands, and their
coding.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, NamedTuple

from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.media import (
    DEEPEST,
    KINDS,
    NO_CAMERA,
    SETS,
    CameraFrames,
    Matches,
    MediaGroup,
    index_media,
    match_cameras,
)
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.listing import (
    IMAGE_SUFFIXES,
    UNREAD_PICTURES,
    UNREAD_VIDEOS,
    list_files_below,
    list_images,
    unread_pictures,
    unread_videos,
)
from ggvs_eval.files.names import is_inside, listed

# Patterns of `index_media` in the order in which they count, whatever else is there.
USUAL = (
    *(
        "CAM.mp4",
        "videos/CAM.mp4",
        "images/CAM/",
        "frames/CAM/",
        "*/images/CAM.png",
        "CAM/images/",
        "CAM/images_scaled_2/",
        "CAM/",
    ),
    *("images/CAM.png", "CAM.png", "images_2/CAM.png", "images_4/CAM.png", "images_8/CAM.png"),
)
IN_WORDS = (
    f"{', '.join(name for name in USUAL if not name.endswith('.png'))} or one image per "
    f"camera, here or in images/"
)


class FoundFrames(NamedTuple):
    """The frames of some cameras, in the order in which these were asked for.

    Attributes:
        beside: the names of others that lie alike.
        notes: how names were matched that are not equal, and cameras without frames.
    """

    sources: dict[str, CameraFrames]
    beside: list[str]
    notes: list[str]


def find_frames(path: Path, image_names: Mapping[str, str], fewest: int = 2) -> FoundFrames:
    """Return the frames of known cameras: of the first usual group that has those of any, else of
    the one that has most.

    Args:
        image_names: camera -> its image in the calibration, relative to ``images/`` or to the
            capture.
        fewest: cameras that suffice where frames of the others are absent.

    Raises:
        CaptureError: frames of fewer cameras, several groups that are equally good, or several
            files of one camera.
    """
    fitting: dict[MediaGroup, tuple[Matches, dict[str, CameraFrames]]] = {}
    for group in _groups(path):
        matches = match_cameras(image_names, group.names)
        stills = _named_stills(path / group.place, image_names) if group.kind == ".png" else {}
        if stills or (
            matches.names
            and not (matches.how and (group.kind == ".png" or NO_CAMERA.search(group.place)))
        ):
            fitting[group] = matches, stills
    best = _best(
        path,
        fitting,
        lambda group: (not fitting[group][0].how, *_worth(group, len(fitting[group][0].names))),
    )
    if best is None:
        raise CaptureError(
            f"{path}: wanted frames of {listed(image_names)}, got "
            f"{instead_of_frames(path, image_names)}"
        )
    matches, stills = fitting[best]
    cameras = {name: camera for camera, name in matches.names.items() if camera not in stills}
    on_disk = [(cameras[name], frames) for name, frames in best.members if name in cameras]
    sources = _one_each(path, [*stills.items(), *on_disk])
    absent = [name for name in image_names if name not in sources]
    unread = _unread(path, absent) if absent else ""
    if len(sources) < min(fewest, len(image_names)):
        remedy = (
            f"but {unread}"
            if unread
            else "restore them or remove these cameras from the calibration"
        )
        place = next(iter(sources.values())).path
        raise CaptureError(
            f"{path}: wanted frames of every camera, got none for {listed(absent)}, only for "
            f"{place}; {remedy}"
        )
    beside = [
        name
        for name in best.names
        if name not in {*matches.names.values(), *SETS} and not NO_CAMERA.search(name)
    ]
    pairs = listed(f"{camera} {name}" for camera, name in matches.names.items())
    notes = [f"cameras are matched to {best.pattern} {matches.how}: {pairs}"] if matches.how else []
    notes += (
        [
            f"{listed(absent)} left out: calibrated, but without frames"
            + f", {unread}" * bool(unread)
        ]
        if absent
        else []
    )
    return FoundFrames(
        {name: sources[name] for name in image_names if name in sources}, beside, notes
    )


def _groups(path: Path) -> list[MediaGroup]:
    """Return the groups of media below a folder, usual ones also where they are empty: pictures may
    lie deeper.
    """
    index = index_media(path)
    return [*({pattern: MediaGroup(pattern, []) for pattern in USUAL} | index).values()]


def _may_be_rig(group: MediaGroup) -> bool:
    """Tell whether a group can be the recordings of cameras of which nothing is known."""
    return group.kind != ".png" and not NO_CAMERA.search(group.pattern)


def _worth(group: MediaGroup, n_cameras: int) -> tuple[int, int, int]:
    """What decides between groups that have frames of cameras: usual ones in their order go first,
    whatever they have.
    """
    if group.pattern in USUAL:
        return -USUAL.index(group.pattern), 0, 0
    return -len(USUAL), n_cameras, KINDS.index(group.kind)


def _best(
    path: Path, groups: Iterable[MediaGroup], worth: Callable[[MediaGroup], Any]
) -> MediaGroup | None:
    """Return the group of most worth, None of none; two of the same worth are an error."""
    ordered = sorted(groups, key=worth)
    equal = [group for group in ordered if worth(group) == worth(ordered[-1])]
    if len(equal) > 1:
        sets_text = listed(f"{group.pattern} ({len(group.members)})" for group in equal)
        remedy = (
            "give the folder of one to 'ggvs-eval calibrate FOLDER RIG' (known poses: "
            "--known-poses FILE)"
        )
        if all(map(_is_recording, equal)):
            remedy = (
                f"these are parts of one recording each, by their first frames: "
                f"{JOIN.format(equal[0].names[0])}"
            )
        raise CaptureError(
            f"{path}: wanted one set of frames of its cameras, got several: {sets_text}; {remedy}"
        )
    return ordered[-1] if ordered else None


def _is_recording(group: MediaGroup) -> bool:
    """Tell whether videos are the parts of one, each called by the number of its first frame."""
    if group.kind != ".mp4" or not all(map(str.isdecimal, group.names)):
        return False
    parts = sorted((int(name), video.n_frames) for name, video in group.members)
    return all(later[0] == sum(earlier) for earlier, later in pairwise(parts))


JOIN = (
    "join each into one, in another folder: write \"file '{}.MP4'\" and the like into LIST, then "
    "ffmpeg -f concat -i LIST -c copy OUT.mp4"
)
# GoPro's chapters: GX and GH with the chapter before the recording's number; GOPR, and GP from the
# second one on.
CHAPTER = re.compile(r"(?:G[XH]\d\d|GOPR|GP\d\d)(\d{4})", re.I)
# editing programs add a word to the name of a smaller copy
COPY = re.compile(r"(.+?)[_\-. ]+[a-z]+", re.I)


def _refuse_parts(path: Path, names: Sequence[str]) -> None:
    """Refuse videos that are chapters of one recording, or of which each has a copy: all would be
    taken for cameras.
    """
    recordings: dict[str, list[str]] = {}
    for name in sorted(names, key=lambda name: (not name.upper().startswith("GOPR"), name)):
        chapter, copy = CHAPTER.fullmatch(name), COPY.fullmatch(name)
        recording = chapter[1] if chapter else copy[1] if copy and copy[1] in names else name
        recordings.setdefault(recording, []).append(name)
    parts = [videos for videos in recordings.values() if len(videos) > 1]
    is_split = any(CHAPTER.fullmatch(videos[0]) for videos in parts)
    if not is_split and (len(parts) < 2 or {len(videos) for videos in recordings.values()} != {2}):
        return
    videos_text = "; ".join(" and ".join(videos) for videos in parts)
    remedy = JOIN.format(parts[0][0])
    kind, remedy = (
        ("chapters", remedy)
        if is_split
        else ("a smaller copy (proxy)", "move the copies into a folder elsewhere")
    )
    raise CaptureError(
        f"{path}: wanted one video per camera, got {kind} of one recording: {videos_text}; {remedy}"
    )


def find_rig_frames(path: Path) -> dict[str, CameraFrames]:
    """The frames of cameras that nothing is known of, in the order of names.

    Of the first usual group of two or more; else of the group of most videos or folders of pictures
    below.

    Raises:
        CaptureError: no such folder, no two cameras in it, several groups that are equally good, or
            several files of one camera.
    """
    if not path.is_dir():
        content = "a file" if path.exists() else "nothing there"
        raise CaptureError(
            f"{path}: wanted a folder with the frames of several cameras, got {content}; check the "
            f"path"
        )
    if sources := rig_frames(path):
        return sources
    raise CaptureError(
        f"{path}: wanted the frames of two cameras or more, got {instead_of_frames(path)} "
        "(for a capture of another layout, 'ggvs-eval undistort' writes its frames as videos)"
    )


def rig_frames(path: Path) -> dict[str, CameraFrames]:
    """The same, none if there are none; errors are those of frames that are there."""
    groups = [group for group in _groups(path) if len(set(group.names)) > 1]
    rigs = [group for group in groups if group.pattern in USUAL or _may_be_rig(group)]
    group = _best(path, rigs, lambda group: _worth(group, len(group.members)))
    if group is None:
        return {}
    if group.kind == ".mp4":
        _refuse_parts(path, group.names)
    return dict(sorted(_one_each(path, group.members).items()))


def instead_of_frames(path: Path, names: Iterable[str] = ()) -> str:
    """Describe what a folder holds instead of the frames of some or all cameras, and where they
    belong.
    """
    if unread := _unread(path, names):
        return f"none, but {unread}"
    remedy = "call these like the cameras" if names else "give the folder of one of these"
    groups = (
        group
        for group in index_media(path).values()
        if len(group.members) > 1 and not NO_CAMERA.search(group.pattern)
    )
    rigs = islice((group for group in groups if not all(map(str.isdecimal, group.names))), 3)
    groups_text = "; ".join(f"{group.pattern} ({listed(sorted(group.names))})" for group in rigs)
    return (
        f"none, but there is {groups_text}: {remedy}"
        if groups_text
        else f"none; put them in {IN_WORDS}"
    )


def _unread(path: Path, names: Iterable[str]) -> str:
    """Return the media in formats that are not read: videos of these cameras or, without names, of
    any; pictures.
    """
    folders = dict.fromkeys(
        file.parent for file in list_files_below(path, (*UNREAD_VIDEOS, *UNREAD_PICTURES), DEEPEST)
    )
    videos = next(filter(None, (unread_videos(folder, tuple(names)) for folder in folders)), "")
    pictures = ((folder, unread_pictures(folder)) for folder in folders)
    return videos or next((f"{folder} holds {unread}" for folder, unread in pictures if unread), "")


def _named_stills(parent: Path, image_names: Mapping[str, str]) -> dict[str, CameraFrames]:
    """Single images by their very names in the calibration."""
    files = {name: find_picture(parent, image) for name, image in image_names.items()}
    return {name: ImageFrames(file) for name, file in files.items() if file}


def find_picture(parent: Path, image: str) -> Path | None:
    """Return a picture by its name in a calibration, which may lack the suffix.

    None if there is none inside the folder.
    """
    places = (
        [parent / f"{image}{suffix}" for suffix in ("", *IMAGE_SUFFIXES)]
        if is_inside(image)
        else []
    )
    return next((place for place in places if place.is_file()), None)


def backgrounds(folder: Path, names: Iterable[str]) -> dict[str, ImageFrames]:
    """Return the picture of each camera in a folder of pictures without what moves.

    Raises:
        CaptureError: some cameras lack one.
    """
    files = {file.stem: ImageFrames(file) for file in list_images(folder)}
    if missing := [name for name in names if name not in files]:
        raise CaptureError(
            f"{folder}: wanted a background of every camera, none of {listed(missing)}; restore "
            "them, or move the folder elsewhere"
        )
    return files


def _one_each(path: Path, named_frames: list[tuple[str, CameraFrames]]) -> dict[str, CameraFrames]:
    sources = dict(named_frames)
    if len(sources) < len(named_frames):
        names = [name for name, _ in named_frames]
        twice = listed(sorted({name for name in names if names.count(name) > 1}))
        raise CaptureError(
            f"{path}: wanted one file per camera, got several called {twice}; rename the others or "
            f"move them elsewhere"
        )
    return sources
