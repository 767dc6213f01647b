"""Videos without a capture: the frames, or the depth maps, of one folder, video or array,
in order.
"""

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.errors import RenderError, no_such_path
from ggvs_eval.files.images import decode_image, read_encoded, read_image, to_8_bit
from ggvs_eval.files.listing import IMAGE_SUFFIXES, VIDEO_SUFFIXES, list_files
from ggvs_eval.files.names import numbers_in
from ggvs_eval.files.packed_maps import unpack
from ggvs_eval.files.plain import check_plain
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.renders.view_streams import ARRAY_SUFFIXES, ArrayStack, npz_members

DEPTH_PICTURES = (".png", ".tif", ".tiff", ".pfm")
DEPTH_SUFFIXES = (*DEPTH_PICTURES, *ARRAY_SUFFIXES)
MEMBER = "depth"  # of an archive that holds several arrays, as this package's own depth maps do


def read_frames(path: Path) -> Iterator[Image8]:
    """Read the frames of a rendered video.

    Args:
        path: a folder of .png or .jpg pictures, taken by the last number in their names; an .mp4 or
            .mov; a .npy or .npz of (T, H, W, 3), uint8 or float in [0, 1].

    Yields:
        (H, W, 3) uint8.
    """
    if path.is_dir():
        yield from map(read_image, _numbered(path, IMAGE_SUFFIXES, "pictures"))
    elif path.suffix.lower() in VIDEO_SUFFIXES:
        video = VideoFrames(path)
        yield from video.frames(0, video.n_frames)
    elif path.suffix.lower() in ARRAY_SUFFIXES and path.is_file():
        stack = ArrayStack(path, _member(path) if path.suffix.lower() == ".npz" else None)
        yield from map(to_8_bit, stack.frames(0, stack.n_frames))
    else:
        raise _nothing(path, "a folder of pictures, a video (.mp4, .mov) or an array (.npy, .npz)")


def read_depths(path: Path) -> Iterator[Map]:
    """Read the maps of a depth video from any source.

    Args:
        path: a folder of .png (8 or 16 bit), .tif, .pfm, .npy or .npz (its array ``depth``, or its
            only one), taken by the last number in their names - a folder of `RUN/depth` is one; a
            .npy or .npz of (T, H, W); or an .mp4 or .mov, whose grey levels are taken. Depth or
            disparity in any unit, 0 = unknown.

    Yields:
        (H, W) float32.
    """
    if path.is_dir():
        yield from map(_read_depth, _numbered(path, DEPTH_SUFFIXES, "depth maps"))
    elif path.suffix.lower() in VIDEO_SUFFIXES:
        video = VideoFrames(path)
        yield from (_one_channel(path, frame) for frame in video.frames(0, video.n_frames))
    elif path.suffix.lower() in ARRAY_SUFFIXES and path.is_file():
        stack = _load(path)
        if stack.ndim != 3 or not len(stack):
            raise RenderError(
                f"{path}: wanted depth maps (T, H, W), got {stack.shape}; save them as one array, "
                f"without channels"
            )
        yield from (np.asarray(depth, np.float32) for depth in stack)
    else:
        raise _nothing(
            path, "a folder of depth maps, an array (.npy, .npz) or a video (.mp4, .mov)"
        )


def _numbered(folder: Path, suffixes: tuple[str, ...], noun: str) -> list[Path]:
    """Files of a folder in the order of the last numbers of their names."""
    files = [path for path in list_files(folder, suffixes) if path.is_file()]
    if not files:
        raise RenderError(
            f"{folder}: wanted {noun} ({', '.join(suffixes)}), got none; name the folder that "
            f"holds them"
        )
    try:
        numbers = numbers_in([file.stem for file in files])
    except ValueError as error:
        raise RenderError(
            f"{folder}: wanted {noun} whose numbers can be read in one way, got {error}"
        ) from None
    if len(set(numbers)) < len(files):
        twice = next(
            file for file, number in zip(files, numbers, strict=True) if numbers.count(number) > 1
        )
        raise RenderError(
            f"{folder}: wanted {noun} with a number each, {twice.name} repeats one; give a folder "
            f"with one kind of file"
        )
    ordered = sorted(
        zip(numbers, files, strict=True), key=lambda pair: (pair[0] is not None, pair[0] or 0)
    )
    return [file for _, file in ordered]


def _read_depth(path: Path) -> Map:
    """Return one map out of one file."""
    if path.suffix.lower() in ARRAY_SUFFIXES:
        depth = _load(path)
        if depth.ndim != 2:
            raise RenderError(
                f"{path}: wanted one depth map (H, W), got {depth.shape}; save it without channels"
            )
        return np.asarray(depth, np.float32)
    picture = decode_image(read_encoded(path), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise RenderError(
            f"{path}: wanted a depth map, got {path.stat().st_size} bytes that do not decode; "
            f"write it again"
        )
    return _one_channel(path, picture)


def _one_channel(path: Path, picture: NDArray[np.generic]) -> Map:
    """Return the levels of a picture whose colours are alike."""
    values = np.asarray(picture, np.float32)
    if values.ndim == 2:
        return values
    colours = values[..., :3]
    if (np.ptp(colours, axis=-1) > 2).any():
        raise RenderError(
            f"{path}: wanted depth in one channel, got colours; save the values, not a colour map"
        )
    return np.ascontiguousarray(colours[..., 0])


def _load(path: Path) -> NDArray[Any]:
    """Return an array of numbers, mapped where it can be."""
    try:
        check_plain(path)
        if path.suffix.lower() == ".npy":
            array: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
        else:
            with np.load(path, allow_pickle=False) as archive:
                maps = unpack(archive)
            array = maps[MEMBER if MEMBER in maps else _member(path)]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise RenderError(
            f"{path}: wanted an array of numbers ({error}); save it with numpy.save"
        ) from error
    if array.dtype.kind not in "fiu":
        raise RenderError(
            f"{path}: wanted an array of numbers, got {array.dtype}; save it with numpy.save"
        )
    return array


def _member(path: Path) -> str:
    """Return the array of an archive that holds the frames: the only one, or the one called
    ``depth``.
    """
    members = npz_members(path)
    if len(members) != 1 and MEMBER not in members:
        raise RenderError(
            f"{path}: wanted one array, got {', '.join(members) or 'none'}; save one, or call it "
            f"{MEMBER}"
        )
    return members[0] if len(members) == 1 else MEMBER


def _nothing(path: Path, kinds: str) -> RenderError:
    message = f"{path}: wanted {kinds}, got another kind; check the path"
    return RenderError(message if path.exists() else no_such_path(path, kinds))
