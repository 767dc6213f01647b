"""Images on disk as sources of frames: a folder with one image per instant, or a single image."""

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.digest import digest_files
from ggvs_eval.files.images import IMAGE_SUFFIXES, read_image
from ggvs_eval.files.picture_header import PictureHeader, read_picture_header
from ggvs_eval.files.plain import NotPlainError

LISTED = 5
UNREAD_PICTURES = (".webp", ".tif", ".tiff", ".bmp", ".exr", ".hdr", ".gif", ".avif", ".heic", ".jxl", ".jp2", ".ppm", ".tga")


@dataclass(frozen=True)
class ImageFrames:
    """The frames of one camera as images, a `FrameSource`.

    A folder's frames are its images in the order of the last number in their names, whether that counts from 0 or 1, with or
    without leading zeros; other files are ignored. Even steps are accepted, gaps are not: they would shift later frames in time.

    Attributes:
        path: folder of images, or one image.
    """

    path: Path

    @property
    def n_frames(self) -> int:
        """Number of images."""
        return len(self.files)

    @cached_property
    def files(self) -> tuple[Path, ...]:
        """The images in the order of time.

        Raises:
            CaptureError: no image, two images for one instant, or a gap.
        """
        if self.path.is_file():
            return (self.path,)
        files = list_images(self.path)
        if not files:
            instead = unread_pictures(self.path) or "none"
            raise CaptureError(
                f"{self.path}: wanted images ({', '.join(IMAGE_SUFFIXES)}), got {instead}; restore this camera's frames"
            )
        return self._in_time({file: _last_number(file) for file in files})

    @cached_property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, read from the header of every image.

        Raises:
            CaptureError: images that differ in size, or a file that is no image.
        """
        sizes = {file: header.size for file, header in self._headers.items()}
        (size, _), *others = Counter(sizes.values()).most_common()
        if others:
            odd = next(file for file in self.files if sizes[file] != size)
            content = f"got {sizes[odd][0]} x {sizes[odd][1]}"
            raise CaptureError(
                f"{odd}: wanted {size[0]} x {size[1]} like the camera's other frames, {content}; resize or restore it"
            )
        return size

    @cached_property
    def conversions(self) -> dict[str, int]:
        """Change by reading them as 8-bit RGB -> number of images that it changes; errors as of `size`."""
        return dict(Counter(change for header in self._headers.values() for change in header.conversions))

    @cached_property
    def _headers(self) -> dict[Path, PictureHeader]:
        return {file: _read_header(file) for file in self.files}

    @cached_property
    def digest(self) -> str:
        """Identifies the content; see `digest_files`."""
        return digest_files(self.files)

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Read frames start <= t < stop one by one, RGB uint8 (H, W, 3).

        Raises:
            CaptureError: frames that are not there, or an image that does not decode to the size of the others.
        """
        if not 0 <= start <= stop <= self.n_frames:
            raise CaptureError(f"{self.path}: wanted frames {start}..{stop - 1}, the folder has {self.n_frames}")
        for file in self.files[start:stop]:
            image = read_image(file)
            if image.shape[1::-1] != self.size:
                content = f"{image.shape[1]} x {image.shape[0]}"
                raise CaptureError(
                    f"{file}: wanted {self.size[0]} x {self.size[1]} as its header says, got {content}; restore this frame"
                )
            yield image

    def _in_time(self, numbers: Mapping[Path, int]) -> tuple[Path, ...]:
        """The files in the order of their frame numbers, which must go in even steps."""
        if len(numbers) > 1:
            self._check_numbers(numbers)
        return tuple(sorted(numbers, key=numbers.__getitem__))

    def _check_numbers(self, number_of: Mapping[Path, int]) -> None:
        numbers = list(number_of.values())
        twice = sorted(number for number, count in Counter(numbers).items() if count > 1)
        if twice:
            names = " and ".join([file.name for file, number in number_of.items() if number == twice[0]][:LISTED])
            listed = "no number" if twice[0] < 0 else f"the number {twice[0]}"
            raise CaptureError(
                f"{self.path}: wanted one image per frame number, got several with {listed} ({names}); keep one of them"
            )
        ordered = sorted(numbers)
        step = min(later - earlier for earlier, later in pairwise(ordered))
        gaps = [f"{earlier} and {later}" for earlier, later in pairwise(ordered) if later - earlier != step]
        if gaps:
            listed = ", ".join(gaps[:LISTED]) + (", ..." if len(gaps) > LISTED else "")
            unread = unread_pictures(self.path)
            content = f"{len(ordered)} images with gaps between {listed}" + (f", and {unread}" if unread else "")
            raise CaptureError(
                f"{self.path}: wanted frames numbered in even steps, got {content}; restore the frames or renumber them"
            )


@dataclass(frozen=True)
class NumberedFrames(ImageFrames):
    """The frames of one camera where those of several share a folder, or each instant has one; else as `ImageFrames`.

    Attributes:
        path: what messages name: the folder that holds them all.
        numbered: frame numbers and images, in any order.
    """

    numbered: tuple[tuple[int, Path], ...]

    @cached_property
    def files(self) -> tuple[Path, ...]:
        """The images in the order of time.

        Raises:
            CaptureError: no image, two images for one instant, or a gap.
        """
        if not self.numbered:
            raise CaptureError(f"{self.path}: wanted images of each camera, got none of one; restore them")
        return self._in_time({file: number for number, file in self.numbered})


def list_images(folder: Path) -> list[Path]:
    """The images that lie in a folder, by name."""
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES) if folder.is_dir() else []


def unread_pictures(folder: Path) -> str:
    """Pictures in a folder whose format is not read, and what to do; empty where there are none."""
    suffixes = [file.suffix.lower() for file in folder.iterdir()] if folder.is_dir() else []
    counts = Counter(suffix for suffix in suffixes if suffix in UNREAD_PICTURES)
    listed = " and ".join(f"{count} {suffix}" for suffix, count in counts.most_common())
    return f"{listed} pictures, which are not read: convert them to .png" if listed else ""


def _last_number(file: Path) -> int:
    numbers = re.findall(r"\d+", file.stem)
    return int(numbers[-1]) if numbers else -1


def _read_header(file: Path) -> PictureHeader:
    """Size and kind of an image, without decoding it."""
    from PIL.Image import DecompressionBombError

    try:
        return read_picture_header(file)
    except NotPlainError as error:
        raise CaptureError(f"{file}: wanted an image, got {error}; restore this frame") from error
    except Exception as error:  # the parsers raise whatever a damaged header makes them stumble over
        is_large = isinstance(error, DecompressionBombError)
        reason = "whose header claims more pixels than any camera has" if is_large else "that do not open"
        content = f"{file.stat().st_size} bytes {reason}" if file.is_file() else "no such file"
        raise CaptureError(f"{file}: wanted an image, got {content}; restore this frame") from error
