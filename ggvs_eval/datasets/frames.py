"""Images on disk as sources of frames: a folder with one image per instant, or a single image."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

from ggvs_eval.arrays import Image8
from ggvs_eval.capture import FrameSource, source_chain
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.coding import Coding, read_coding
from ggvs_eval.files.digest import digest_files, digest_values
from ggvs_eval.files.images import read_image
from ggvs_eval.files.listing import IMAGE_SUFFIXES, UNREAD_PICTURES, list_images, unread_pictures
from ggvs_eval.files.names import Number, is_stamp, numbers_in
from ggvs_eval.files.picture_header import (
    SEEN_THROUGH,
    UPRIGHT,
    PictureHeader,
    read_picture_header,
    transparent_share,
)
from ggvs_eval.files.plain import NotPlainError
from ggvs_eval.files.video import VideoFrames

Source = TypeVar("Source")
LISTED = 5
JPEG = (".jpg", ".jpeg")
# words for pictures that a camera took
COLOUR = re.compile(r"(?<![a-z])(rgba?|colou?r|image|img|frame)(?![a-z])", re.I)


@dataclass(frozen=True)
class ImageFrames:
    """The frames of one camera as images, a `FrameSource`.

    A folder's frames are its images in the order of the numbers in their names (`numbers_in`),
    whether they count from 0 or 1, with or without leading zeros; other files are ignored. Even
    steps are accepted, gaps are not: they would shift later frames in time. Times, which are clocks
    and numbers with a fraction or of ten digits and more, say where a frame is missing.

    Attributes:
        path: folder of images, or one image.
        as_stored: use the pixels as stored; else turn them by their EXIF tags.
        numbered: frame numbers and images, in any order, where several cameras share the folder or
            a file lists them.
    """

    path: Path
    as_stored: bool = field(default=False, kw_only=True)
    numbered: tuple[tuple[Number, Path], ...] = field(default=(), kw_only=True)

    @property
    def n_frames(self) -> int:
        """Number of images."""
        return len(self.files)

    @cached_property
    def files(self) -> tuple[Path, ...]:
        """The images in the order of time."""
        if self.numbered:
            return self._in_time(self.numbered)
        if self.path.is_file():
            return (self.path,)
        files = _in_colour(list_images(self.path))
        if not files:
            instead = unread_pictures(self.path) or "none"
            raise CaptureError(
                f"{self.path}: wanted images ({', '.join(IMAGE_SUFFIXES)}), got {instead}; restore "
                f"this camera's frames"
            )
        try:
            numbers = numbers_in([file.stem for file in files])
        except ValueError as error:
            raise CaptureError(
                f"{self.path}: wanted images whose numbers can be read in one way, got {error}"
            ) from error
        return self._in_time(list(zip(numbers, files, strict=True)))

    @property
    def other_kinds(self) -> tuple[str, ...]:
        """What pictures beside the frames are called: normals, segments.

        Nothing where the folder holds colour alone.
        """
        if self.numbered or self.path.is_file():
            return ()
        return tuple(sorted(set(map(_kind, list_images(self.path))) - set(map(_kind, self.files))))

    @cached_property
    def numbers(self) -> tuple[Number, ...]:
        """The numbers of the images in the order of time, or their times.

        None of a single image.
        """
        if self.numbered:
            return tuple(sorted(number for number, _ in self.numbered))
        numbers = [] if self.path.is_file() else numbers_in([file.stem for file in self.files])
        return tuple(number for number in numbers if number is not None)

    @cached_property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, read from the header of every image."""
        sizes = {file: self._size(header) for file, header in self._headers.items()}
        (size, _), *other_sizes = Counter(sizes.values()).most_common()
        if other_sizes:
            odd = next(file for file in self.files if sizes[file] != size)
            content = f"got {sizes[odd][0]} x {sizes[odd][1]}"
            raise CaptureError(
                f"{odd}: wanted {size[0]} x {size[1]} like the camera's other frames, {content}; "
                f"resize or restore it"
            )
        return size

    @cached_property
    def conversions(self) -> dict[str, int]:
        """Change by reading them as 8-bit RGB -> number of images that it changes.

        Errors as of `size`.
        """
        changes = Counter(
            change for header in self._headers.values() for change in header.conversions
        )
        clear = [file for file, header in self._headers.items() if header.has_alpha]
        if clear and transparent_share(clear[0]):
            changes[SEEN_THROUGH] = len(clear)
        return dict(changes)

    @cached_property
    def orientations(self) -> tuple[int, ...]:
        """The EXIF orientations of the images that are not stored upright, each once.

        Errors as of `size`.
        """
        return tuple(sorted({header.orientation for header in self._headers.values()} - {UPRIGHT}))

    @cached_property
    def profiles(self) -> tuple[str, ...]:
        """The colour profiles of the images, each once, sRGB aside; errors as of `size`."""
        return tuple(sorted({header.profile for header in self._headers.values()} - {""}))

    def _size(self, header: PictureHeader) -> tuple[int, int]:
        return header.stored_size if self.as_stored else header.size

    @cached_property
    def _headers(self) -> dict[Path, PictureHeader]:
        return {file: _read_header(file) for file in self.files}

    @cached_property
    def digest(self) -> str:
        """Identifies the content; see `digest_files`."""
        digest = digest_files(self.files)
        return digest_values(digest, "as stored") if self.as_stored else digest

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Read frames start <= t < stop one by one, RGB uint8 (H, W, 3).

        Raises:
            CaptureError: frames that are not there, or an image that does not decode to the size of
                the others.
        """
        if not 0 <= start <= stop <= self.n_frames:
            raise CaptureError(
                f"{self.path}: wanted frames {start}..{stop - 1}, the folder has {self.n_frames}"
            )
        for file in self.files[start:stop]:
            image = read_image(file, self.as_stored)
            if image.shape[1::-1] != self.size:
                content = f"{image.shape[1]} x {image.shape[0]}"
                raise CaptureError(
                    f"{file}: wanted {self.size[0]} x {self.size[1]} as its header says, got "
                    f"{content}; restore this frame"
                )
            yield image

    def _in_time(self, numbered: Sequence[tuple[Number | None, Path]]) -> tuple[Path, ...]:
        """Return the files in the order of their frame numbers, which must go in even steps."""
        counts = Counter(number for number, _ in numbered)
        wrong = [
            number
            for number, count in counts.items()
            if count > 1 or (number is None and len(numbered) > 1)
        ]
        if wrong:
            files = [file.name for number, file in numbered if number == wrong[0]]
            number_text = "no number" if wrong[0] is None else f"the number {wrong[0]}"
            repeats = (
                f"{'several with ' * (len(files) > 1)}{number_text} "
                f"({' and '.join(files[:LISTED])})"
            )
            remedy = (
                "give each a number of its own, or put those of other cameras into other folders"
            )
            raise CaptureError(
                f"{self.path}: wanted one image per frame number, got {repeats}; {remedy}"
            )
        in_time = sorted((number or 0, file) for number, file in numbered)
        self._check_steps([number for number, _ in in_time])
        return tuple(file for _, file in in_time)

    def _check_steps(self, ordered: Sequence[Number]) -> None:
        steps = [later - earlier for earlier, later in pairwise(ordered)]
        if not steps or any(map(is_stamp, ordered)):
            return
        gaps = [
            f"{earlier} and {later}"
            for earlier, later in pairwise(ordered)
            if later - earlier > min(steps)
        ]
        if gaps:
            listed = ", ".join(gaps[:LISTED]) + (", ..." if len(gaps) > LISTED else "")
            unread = unread_pictures(self.path)
            content = f"{len(ordered)} images with gaps between {listed}" + (
                f", and {unread}" if unread else ""
            )
            raise CaptureError(
                f"{self.path}: wanted frames numbered in even steps, got {content}; restore the "
                f"frames or renumber them"
            )


def _kind(file: Path) -> str:
    """Return the text of a name, without its numbers."""
    return re.sub(r"\d+", "", file.stem)


def _in_colour(files: list[Path]) -> list[Path]:
    """Return the pictures in colour where as many of several kinds are there, else all."""
    counts = Counter(map(_kind, files))
    colour = [kind for kind in counts if COLOUR.search(kind)]
    is_one = len(colour) == 1 and len(set(counts.values())) == 1
    return [file for file in files if _kind(file) == colour[0]] if is_one else files


def as_calibrated(frames: Source, width: int, height: int) -> Source:
    """Orient frames to match a calibration of (width, height).

    Reading:
        COLMAP and OpenCV's calibration ignore EXIF tags, so poses that were found elsewhere may
        belong to stored pixels: these are taken where they alone have the calibrated shape.
    """
    if (
        not isinstance(frames, ImageFrames)
        or has_shape(frames.size, (width, height))
        or not frames.orientations
    ):
        return frames
    stored = replace(frames, as_stored=True)
    return stored if has_shape(stored.size, (width, height)) else frames


def has_shape(size: tuple[int, int], calibrated: tuple[float, float]) -> bool:
    """Return whether frames are those that a calibration was made for, up to one scale: the heights
    agree within a pixel.
    """
    return abs(calibrated[1] * size[0] / calibrated[0] - size[1]) <= 1


def _read_header(file: Path) -> PictureHeader:
    """Return the size and kind of an image, without decoding it."""
    from PIL.Image import DecompressionBombError

    try:
        return read_picture_header(file)
    except NotPlainError as error:
        raise CaptureError(f"{file}: wanted an image, got {error}; restore this frame") from error
    except Exception as error:  # the parsers raise any exception on a damaged header
        is_large = isinstance(error, DecompressionBombError)
        reason = "whose header states too many pixels" if is_large else "that do not open"
        if file.suffix.lower() in UNREAD_PICTURES:
            raise CaptureError(
                f"{file}: wanted {', '.join(IMAGE_SUFFIXES)}, got {unread_pictures(file.parent)}"
            ) from error
        content = f"{file.stat().st_size} bytes {reason}" if file.is_file() else "no such file"
        raise CaptureError(f"{file}: wanted an image, got {content}; restore this frame") from error


def video_of(source: FrameSource) -> VideoFrames | None:
    """Return the video that a source takes its frames from, directly or through others.

    None if it is no video.
    """
    *_, stored = source_chain(source)
    return stored if isinstance(stored, VideoFrames) else None


def coding_of(source: FrameSource, frames: range) -> Coding | None:
    """State how frames were coded.

    Returns:
        None if every pixel is as it was given; `Coding.unknown` where it is not and nothing more is
        known.
    """
    *_, stored = source_chain(source)  # it may be undistorted, held still, or with noise added
    if isinstance(stored, VideoFrames):
        changed = Coding(unknown="frames were changed after they were coded")
        return read_coding(stored.path, frames) if stored is source else changed
    if isinstance(stored, ImageFrames) and Path(stored.files[0]).suffix.lower() in JPEG:
        return Coding(unknown="frames are JPEG images")
    return None
