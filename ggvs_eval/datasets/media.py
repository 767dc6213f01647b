"""The one index of media: all videos, folders of pictures and single pictures below a folder, and
whose frames they are.
"""

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import groupby, pairwise
from os.path import commonprefix
from pathlib import Path
from typing import NamedTuple

from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.files.listing import (
    IMAGE_SUFFIXES,
    VIDEO_SUFFIXES,
    list_entries,
    list_files_below,
    same_name,
)
from ggvs_eval.files.video import VideoFrames

CameraFrames = VideoFrames | ImageFrames
KINDS = (".png", "/", "/*.mp4", ".mp4")  # of equally many members, the last goes first
DEEPEST = 4  # folders between a scene and a file, as on the cards of cameras
MEDIA = (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES)
# Words of folders whose pictures are of no camera: masks, depth, what was computed. Also those of
# whole sets of cameras.
NO_CAMERA = re.compile(
    r"(?<![a-z])(backgrounds?|bkgd|f?masks?|bgmtv2|schp|depths?|normals?|segm\w*|flow|conf\w*|path|sparse|renders?|truth|\d+x)(?![a-z])",
    re.I,
)
SETS = {"images", "frames", "videos", "train", "val", "test"}
INSTANT = re.compile(r"(?:frame_?|t)?(\d{3,9}(\.\d+)?)")  # a folder of the pictures of one instant


@dataclass(frozen=True, eq=False)
class MediaGroup:
    """Files that lie alike: their paths differ in one part, which names the camera.

    Attributes:
        pattern: that path below the scene, with CAM for the part; it ends with .mp4 (any video), /
            (a folder of pictures) or .png (any picture). A * is any file, or a folder for each
            instant.
        members: the part, and the frames.
    """

    pattern: str
    members: list[tuple[str, CameraFrames]]

    @property
    def names(self) -> list[str]:
        """What the part is."""
        return [name for name, _ in self.members]

    @property
    def kind(self) -> str:
        """How the pattern ends."""
        return next(kind for kind in KINDS if self.pattern.endswith(kind))

    @property
    def place(self) -> str:
        """The folder that holds all of them."""
        return self.pattern.partition("CAM")[0]


def index_media(scene: Path) -> dict[str, MediaGroup]:
    """Return the groups of media below a scene by their patterns, those that lie higher first."""
    media: list[tuple[str, str, CameraFrames]] = []
    instants: dict[tuple[str, str], list[tuple[Decimal, Path]]] = {}
    for folder, files in groupby(list_files_below(scene, MEDIA, DEEPEST), lambda file: file.parent):
        paths = list(files)
        videos = [file for file in paths if file.suffix.lower() in VIDEO_SUFFIXES]
        pictures = [file for file in paths if file not in videos]
        parts = folder.relative_to(scene).parts
        media += [("/".join((*parts, "CAM.mp4")), file.stem, VideoFrames(file)) for file in videos]
        media += [
            ("/".join((*parts, "CAM.png")), file.stem, ImageFrames(file)) for file in pictures
        ]
        for level, part in enumerate(parts):
            around = parts[:level], parts[level + 1 :]
            if match := INSTANT.fullmatch(part):
                pattern = "/".join((*around[0], "*", *around[1], "CAM.png"))
                for file in pictures:
                    instants.setdefault((pattern, file.stem), []).append((Decimal(match[1]), file))
            if (match and match[2]) or part in SETS or NO_CAMERA.search(part):
                continue
            pattern = "/".join((*around[0], "CAM", *around[1], ""))
            if len(videos) == 1:
                media.append((f"{pattern}*.mp4", part, VideoFrames(videos[0])))
            if pictures:
                media.append((pattern, part, ImageFrames(folder)))
    media += [(*at, ImageFrames(scene, numbered=tuple(files))) for at, files in instants.items()]
    index: dict[str, MediaGroup] = {}
    for pattern, name, frames in sorted(media, key=lambda file: (file[0].count("/"), *file[:2])):
        index.setdefault(pattern, MediaGroup(pattern, [])).members.append((name, frames))
    return index


def members(scene: Path, patterns: Sequence[str], form: str) -> dict[str, CameraFrames]:
    """Return those whose names are of one form, a regular expression, in their order.

    Of the first group that has any.
    """
    index = index_media(scene)
    groups = (index[pattern].members for pattern in patterns if pattern in index)
    named = (
        {name: frames for name, frames in group if re.fullmatch(form, name)} for group in groups
    )
    return next(filter(None, named), {})


def folders_beside(scene: Path) -> list[Path]:
    """Return a scene, and the folders up to two levels below it that hold no media: its calibration
    may lie there.
    """
    inner = [entry for entry in list_entries(scene) if entry.is_dir()]
    inner += [entry for folder in inner for entry in list_entries(folder) if entry.is_dir()]
    return [scene, *(folder for folder in inner if not list_files_below(folder, MEDIA, DEEPEST))]


class Matches(NamedTuple):
    """Which names on disk belong to cameras.

    Attributes:
        names: camera -> name on disk.
        how: what was assumed; empty if the names are equal.
    """

    names: dict[str, str]
    how: str = ""


def match_cameras(cameras: Collection[str], names: Collection[str]) -> Matches:
    """Match cameras to names on disk.

    Reading:
        Equal names, however their umlauts are written. Where none is: names that are equal without
        what begins and ends all of a side, in any case of letters (``vid01-camA`` is A, ``cam_0``
        is 0). As the last resort, two rows of as many consecutive numbers, ``cam_0`` to ``cam_5``
        and ``Cam1`` to ``Cam6``, in their order. Else none: a name that is merely alike may be
        another camera's.

    Examples:
        >>> match_cameras(["A", "B"], ["vid-camA", "vid-camB"]).names
        {'A': 'vid-camA', 'B': 'vid-camB'}
        >>> match_cameras(["cam_0", "cam_1"], ["Cam1", "Cam2"]).how
        'in their order'
        >>> match_cameras(["cam_0", "cam_1"], ["Cam1", "Cam5"]).names
        {}
    """
    spelled = {same_name(name): name for name in names}
    equal = {
        camera: spelled[same_name(camera)] for camera in cameras if same_name(camera) in spelled
    }
    bare, on_disk = _bare(cameras), _bare(spelled.values())
    if equal or not 1 < len(cameras) == len(bare) == len(on_disk) == len(set(names)):
        return Matches(equal)
    if bare.keys() == on_disk.keys():
        return Matches(
            {camera: on_disk[key] for key, camera in bare.items()},
            "by the part of the names that varies",
        )
    numbers, numbers_on_disk = _numbers(bare), _numbers(on_disk)
    if not numbers or not numbers_on_disk:
        return Matches({})
    in_order = zip(numbers, numbers_on_disk, strict=True)
    return Matches({bare[key]: on_disk[name] for key, name in in_order}, "in their order")


def _bare(names: Iterable[str]) -> dict[str, str]:
    """Return the part of each name that varies -> the name.

    Neither end of it cuts a number in two.
    """
    texts = {name: same_name(name).casefold() for name in names}
    start = len(re.sub(r"\d+$", "", commonprefix([*texts.values()])))  # noqa: RUF071  of texts, which are no paths
    texts = {name: text[start:] for name, text in texts.items()}
    end = len(re.sub(r"\d+$", "", commonprefix([text[::-1] for text in texts.values()])))  # noqa: RUF071
    parts = {name: text[: len(text) - end] for name, text in texts.items()}
    return {part.lstrip("0") or part[-1:]: name for name, part in parts.items()}


def _numbers(names: Iterable[str]) -> list[str]:
    """Return names that are consecutive numbers, in their order; none where they are others."""
    ordered = sorted(filter(str.isdecimal, names), key=int)
    is_row = all(int(later) == int(earlier) + 1 for earlier, later in pairwise(ordered))
    return ordered if is_row and len(ordered) == len(list(names)) else []
