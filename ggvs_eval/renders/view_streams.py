"""Renders as one video, or one numpy stack, per view.

A stack is a ``.npy`` file or a member of an ``.npz`` archive: read frame by frame, nothing is
unpickled.
"""

import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.errors import RenderError
from ggvs_eval.files.array_file import HEADER_ERRORS, map_array
from ggvs_eval.files.images import to_8_bit, write_image
from ggvs_eval.files.listing import VIDEO_SUFFIXES, list_files, same_name
from ggvs_eval.files.plain import check_plain
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.progress import counted
from ggvs_eval.renders.numbering import number_streams
from ggvs_eval.renders.request import (
    FrameRequest,
    PixelRemarks,
    RenderedView,
    RenderSet,
    size_fault,
)
from ggvs_eval.renders.truth_match import LARGEST_DIFFERENCE, difference
from ggvs_eval.renders.view_folders import instead_of, respelled
from ggvs_eval.run_folder import as_ranges, frame_path

# Renderers overshoot a little; values farther out are not in [0, 1] by design.
OVERSHOOT = 0.1
ZIP_ERRORS = (
    zipfile.BadZipFile,
    zlib.error,
    OSError,
    EOFError,
    NotImplementedError,
    RuntimeError,
    ValueError,
)
SAFE_CODINGS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
ARRAY_SUFFIXES = (".npy", ".npz")
# members of an archive of renders with their truth, as 4DGV publishes them
OWN_RENDERS, OWN_TRUTH = "renders", "gts"
RATE_TOLERANCE = 0.005  # by which stated rates may differ: 29.97 is 30
VIDEO_NOTE = "decoded from video; coding errors count against the method"
ARRAY_NOTE = "written to PNG from an array"


@dataclass(frozen=True)
class ArrayStack:
    """Frames (T, H, W, 3), uint8 or float in [0, 1], a `FrameStream`.

    Attributes:
        path: ``.npy`` or ``.npz``.
        member: name of the array in an ``.npz``; None for an ``.npy``.
        place: of the view in an ``.npy`` that holds those of all views, (views, T, H, W, 3); None
            for one view's.
    """

    path: Path
    member: str | None = None
    place: int | None = None

    @property
    def name(self) -> str:
        """File, and member if there is one, for messages."""
        return f"{self.path}" if self.member is None else f"{self.path}[{self.member}]"

    @property
    def n_frames(self) -> int:
        """T."""
        return self._layout[0][0]

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self._layout[0][2], self._layout[0][1]

    @property
    def conversions(self) -> dict[str, int]:
        """None: other channels and types are refused."""
        return {}

    def frames(self, start: int, stop: int) -> Iterator[NDArray[np.generic]]:
        """Yield the frames start <= t < stop one by one, RGB (H, W, 3), uint8 or float64 in [0, 1]
        except for a little overshoot.

        Raises:
            RenderError: a file that ends early, NaN, or values that are not in [0, 1].
        """
        shape, dtype = self._layout
        stored = (
            self._mapped(start, stop)
            if self.member is None
            else self._unzipped(start, stop, shape, dtype)
        )
        for index, frame in enumerate(stored, start):
            yield self._checked(frame, index)

    @cached_property
    def _layout(self) -> tuple[tuple[int, ...], np.dtype[Any]]:
        """Shape and type as the header claims them, checked."""
        if self.member is None:
            array = self._map()
            shape, dtype = array.shape, array.dtype
            shape = shape if self.place is None else shape[1:]
        else:
            with self._open_member() as file:
                shape, dtype = self._read_header(file)
        if len(shape) != 4 or shape[3] != 3 or 0 in shape:
            raise RenderError(
                f"{self.name}: wanted an array (T, H, W, 3), got {_other_shape(shape)}"
            )
        if dtype != np.uint8 and dtype.kind != "f":
            remedy = "divide by 65535.0" if dtype == np.uint16 else "convert it"
            raise RenderError(
                f"{self.name}: wanted uint8, or float in [0, 1], got {dtype}; {remedy}"
            )
        return shape, dtype

    def _map(self) -> np.ndarray:
        try:
            return map_array(self.path)
        except ValueError as error:
            raise RenderError(
                f"{self.path}: wanted an array of numbers, got: {error}; save it with numpy.save"
            ) from error

    def _mapped(self, start: int, stop: int) -> Iterator[np.ndarray]:
        array = self._map() if self.place is None else self._map()[self.place]
        return (array[index] for index in range(start, stop))

    def _unzipped(
        self, start: int, stop: int, shape: tuple[int, ...], dtype: np.dtype[Any]
    ) -> Iterator[np.ndarray]:
        n_bytes = int(np.prod(shape[1:], dtype=np.int64)) * dtype.itemsize
        with self._open_member() as file:
            self._read_header(file)
            for index in range(stop):
                content = self._read(file, n_bytes, index)
                if index >= start:
                    yield np.frombuffer(content, dtype).reshape(shape[1:])

    def _read(self, file: IO[bytes], n_bytes: int, index: int) -> bytes:
        try:
            content = file.read(n_bytes)
        except ZIP_ERRORS as error:
            raise RenderError(
                f"{self.name}: damaged at frame {index} ({error}); save it again"
            ) from error
        if len(content) < n_bytes:
            raise RenderError(f"{self.name}: the file ends in frame {index}; save it again")
        return content

    def _open_member(self) -> IO[bytes]:
        try:
            check_plain(self.path)
            archive = zipfile.ZipFile(self.path)
            if archive.getinfo(f"{self.member}.npy").compress_type not in SAFE_CODINGS:
                raise NotImplementedError("a coding that numpy does not write")
            return archive.open(f"{self.member}.npy")
        except (*ZIP_ERRORS, KeyError) as error:
            raise RenderError(
                f"{self.name}: cannot be opened ({error}); save it with numpy.savez"
            ) from error

    def _read_header(self, file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
        readers = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }
        try:
            shape, is_fortran, dtype = readers[np.lib.format.read_magic(file)](file)
        except (*HEADER_ERRORS, *ZIP_ERRORS, KeyError) as error:
            reason = " ".join(str(error).split())[:120]
            raise RenderError(
                f"{self.name}: wanted an array of numbers, got: {reason}; save it again"
            ) from error
        if dtype.hasobject or is_fortran:
            contents = (
                "Python objects, which are never unpickled" if dtype.hasobject else "Fortran order"
            )
            raise RenderError(
                f"{self.name}: wanted numbers in C order, got {contents}; save "
                f"numpy.ascontiguousarray(frames)"
            )
        return shape, dtype

    def _checked(self, frame: np.ndarray, index: int) -> NDArray[np.generic]:
        if frame.dtype == np.uint8:
            return np.ascontiguousarray(frame)
        values = np.asarray(frame, dtype=np.float64)
        if (broken := ~np.isfinite(values)).any():
            row, column, _ = np.argwhere(broken)[0]
            kind = "NaN" if np.isnan(values[broken]).all() else "NaN or infinite"
            raise RenderError(
                f"{self.name}: wanted floats in [0, 1], but {np.count_nonzero(broken)} values of "
                f"frame {index} are {kind}, the first at row {row}, column {column}; find out "
                "where the renderer makes them, clipping keeps NaN"
            )
        low, high = float(values.min()), float(values.max())
        if low < -OVERSHOOT or high > 1 + OVERSHOOT:
            scale = "divide them by 255" if 2 < high <= 255 and low >= 0 else "scale or clip them"
            scale = (
                "map them by (x + 1) / 2"
                if -1 - OVERSHOOT <= low < -0.5 and high <= 1 + OVERSHOOT
                else scale
            )
            raise RenderError(
                f"{self.name}: wanted floats in [0, 1], frame {index} has {low:g} to {high:g}; "
                f"{scale}"
            )
        return values


def _other_shape(shape: tuple[int, ...]) -> str:
    """Describe what an array of another shape seems to be, and what makes it (T, H, W, 3)."""
    if len(shape) == 3:
        return f"{shape}, which has no colours: save numpy.repeat(frames[..., None], 3, -1)"
    if len(shape) == 4 and shape[3] == 1:
        return f"{shape}, which is grey: save numpy.repeat(frames, 3, -1)"
    if len(shape) == 4 and shape[3] == 4:
        return f"{shape}, which has a fourth channel: save frames[..., :3]"
    if len(shape) == 4 and shape[1] == 3:
        return f"{shape}, which has its channels first: save frames.transpose(0, 2, 3, 1)"
    return f"{shape}; transpose or split it"


def npz_members(path: Path) -> list[str]:
    """Return the names of the arrays in an ``.npz``."""
    try:
        check_plain(path)
        with zipfile.ZipFile(path) as archive:
            return [
                name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")
            ]
    except ZIP_ERRORS as error:
        raise RenderError(
            f"{path}: wanted an .npz archive, got an unreadable file ({error}); save it with "
            f"numpy.savez"
        ) from error


def read_small_array(path: Path, member: str) -> np.ndarray:
    """Return one array of an ``.npz`` as a whole, nothing unpickled."""
    try:
        check_plain(path)
        with np.load(path, allow_pickle=False) as archive:
            return archive[member]
    except (*ZIP_ERRORS, KeyError) as error:
        raise RenderError(
            f"{path}[{member}]: wanted an array of numbers, got an unreadable one ({error}); save "
            f"it again"
        ) from error


class FrameStream(Protocol):
    """Frames in order, at one size."""

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""

    @property
    def conversions(self) -> Mapping[str, int]:
        """List the changes by reading them as RGB."""

    def frames(self, start: int, stop: int) -> Iterator[NDArray[np.generic]]:
        """Yield the frames start <= t < stop one by one, RGB (H, W, 3), uint8 or float in
        [0, 1].
        """


@dataclass(frozen=True)
class StreamView:
    """Frames of one view out of a stream, a `RenderedView`.

    Attributes:
        indices: frame number -> place in the stream, both rising in steps of one.
        note: what people should know of the source, e.g. that it is a lossy video.
    """

    stream: FrameStream
    indices: Mapping[int, int]
    note: str

    @property
    def numbers(self) -> tuple[int, ...]:
        """Frame numbers that there are, ascending."""
        return tuple(sorted(self.indices))

    def faults(self, size: tuple[int, int]) -> dict[int, str]:
        """Return all frames where the stream has another size."""
        fault = size_fault(self.stream.size, size)
        return dict.fromkeys(self.numbers, fault) if fault else {}

    def write(self, folder: Path, numbers: tuple[int, ...]) -> list[str]:
        """Write these frames as PNG files, floats rounded to 8 bit.

        Says where they were clipped, and what is all zero.
        """
        folder.mkdir(parents=True, exist_ok=True)
        first, last = self.indices[numbers[0]], self.indices[numbers[-1]]
        numbered = {
            index: number for number, index in self.indices.items() if number in set(numbers)
        }
        remarks, clipped, n_floats = PixelRemarks(), dict[int, tuple[float, float]](), 0
        for index, frame in enumerate(self.stream.frames(first, last + 1), first):
            if index not in numbered:
                continue
            number, image = numbered[index], to_8_bit(frame)
            if frame.dtype != np.uint8:
                n_floats += 1
                low, high = float(frame.min()), float(frame.max())
                clipped |= {number: (low, high)} if low < 0 or high > 1 else {}
            remarks.add(number, image)
            write_image(frame_path(folder, number), image)
        converted = [f"frames are read {change}" for change in self.stream.conversions]
        return [self.note, *converted, *_float_notes(n_floats, clipped), *remarks.notes()]


def _float_notes(n_floats: int, clipped: Mapping[int, tuple[float, float]]) -> list[str]:
    notes = [f"{counted(n_floats, 'frame')} of floats, rounded to 8 bit"] if n_floats else []
    if clipped:
        low, high = (
            min(low for low, _ in clipped.values()),
            max(high for _, high in clipped.values()),
        )
        frames = f"{counted(len(clipped), 'frame')} ({as_ranges(sorted(clipped))})"
        notes.append(
            f"{frames} with values outside [0, 1], {low:.4g} to {high:.4g}, which are clipped"
        )
    return notes


def refuse_videos(path: Path, request: FrameRequest) -> str | None:
    """State why this is not one video per view; None if it is."""
    if not path.is_dir():
        return "not a folder"
    return (
        None
        if _of_views(path, VIDEO_SUFFIXES, request)
        else f"no {request.views[0]}.mp4 or the like"
    )


def video_files(path: Path, request: FrameRequest) -> list[Path]:
    """Return the videos of the views."""
    return _of_views(path, VIDEO_SUFFIXES, request)


def find_videos(path: Path, request: FrameRequest, is_temporary: bool) -> RenderSet:
    """Return the views' videos: frame t of each is frame start + t, or t where all hold the whole
    capture.
    """
    del is_temporary  # decoded either way
    by_view = _one_each(path, VIDEO_SUFFIXES, request)
    streams = {view: (file.name, VideoFrames(file)) for view, file in by_view.items()}
    _require_rate(path, {view: video for view, (_, video) in streams.items()}, request)
    counted = {view: (name, video, video.n_frames) for view, (name, video) in streams.items()}
    return _found(
        path, counted, _unexpected_files(path, VIDEO_SUFFIXES, request), VIDEO_NOTE, request
    )


def _require_rate(path: Path, videos: Mapping[str, VideoFrames], request: FrameRequest) -> None:
    """Refuse videos whose frames are other instants than the capture's.

    Reading:
        Programs write any rate into a video of one frame per instant. So the rate counts only where
        the number of frames is neither that of the protocol nor that of the capture.

    Raises:
        RenderError: another rate and another number of frames.
    """
    for view, video in videos.items():
        differs = request.fps and video.fps and abs(video.fps / request.fps - 1) > RATE_TOLERANCE
        if differs and video.n_frames not in (len(request.frames), request.n_frames):
            rates = (
                f"{video.fps:.4g} frames per second and {video.n_frames} frames, the capture "
                f"{request.fps:.4g}"
            )
            remedy = f"-vf fps={request.fps:.6g} -frames:v {len(request.frames)} -crf 0"
            raise RenderError(
                f"{path}: the video of {view} has {rates} and {request.n_frames}, so that frame k "
                "is not instant k; render the capture's instants, or repeat frames: ffmpeg -i "
                f"{video.path.name} {remedy} OUT/{video.path.name}"
            )


def refuse_arrays(path: Path, request: FrameRequest) -> str | None:
    """State why this is not one array per view; None if it is."""
    if path.is_file():
        return (
            None
            if path.suffix.lower() == ".npz" or _stack_of_all(path, request)
            else "not an .npz file"
        )
    if _of_views(path, ARRAY_SUFFIXES, request) or _stack_of_all(path, request):
        return None
    return f"no {request.views[0]}.npy or .npz"


def _stack_of_all(path: Path, request: FrameRequest) -> Path | None:
    """Return the only ``.npy``, itself or in a folder, if it holds the stacks of as many views as
    are wanted.
    """
    files = [path] if path.is_file() else list_files(path, (".npy",))
    if len(files) != 1 or files[0].suffix.lower() != ".npy":
        return None
    try:
        shape = map_array(files[0]).shape
    except (ValueError, OSError):
        return None
    return files[0] if len(shape) == 5 and shape[0] == len(request.views) else None


def array_files(path: Path, request: FrameRequest) -> list[Path]:
    """Return the files that hold the arrays."""
    return (
        [path]
        if path.is_file()
        else _of_views(path, ARRAY_SUFFIXES, request)
        or [*filter(None, [_stack_of_all(path, request)])]
    )


def find_arrays(path: Path, request: FrameRequest, is_temporary: bool) -> RenderSet:
    """The views' stacks (T, H, W, 3): ``<view>.npy``, ``<view>.npz`` with one array, or one
    ``.npz`` with an array per view.

    One ``.npy`` of (views, T, H, W, 3) is read in the protocol's order of views.
    An ``.npz`` with renders and truth is one view's: of its name, or the only one.
    """
    del is_temporary  # written to PNG either way
    notes: tuple[str, ...] = ()
    unexpected: list[str]
    if (
        path.is_file()
        and {OWN_RENDERS, OWN_TRUTH} <= {*(members := npz_members(path))}
        and not {*members} & {*request.views}
    ):
        spelled = {same_name(view): view for view in request.views}
        view = spelled.get(
            same_name(path.stem), request.views[0] if len(request.views) == 1 else ""
        )
        if not view:
            raise RenderError(
                f"{path}: wanted an archive called like one of {', '.join(request.views)}; rename "
                f"it to <view>.npz"
            )
        stacks, unexpected = {view: ArrayStack(path, OWN_RENDERS)}, []
    elif not _of_views(path, ARRAY_SUFFIXES, request) and (file := _stack_of_all(path, request)):
        stacks, unexpected = (
            {view: ArrayStack(file, place=place) for place, view in enumerate(request.views)},
            [],
        )
        notes += (
            f"{file.name}: its {len(stacks)} stacks are taken for {', '.join(stacks)}, the "
            f"protocol's order of views",
        )
    elif path.is_file():
        members = npz_members(path)
        twice = sorted({member for member in members if members.count(member) > 1})
        if twice:
            raise RenderError(
                f"{path}: wanted one array per view, got several called {', '.join(twice)}; save "
                f"it again"
            )
        stacks = {view: ArrayStack(path, view) for view in request.views if view in members}
        unexpected = [f"{path.name}[{member}]" for member in members if member not in request.views]
    else:
        stacks = {
            view: _stack(file) for view, file in _one_each(path, ARRAY_SUFFIXES, request).items()
        }
        unexpected = list(_unexpected_files(path, ARRAY_SUFFIXES, request))
    counted = {view: (stack.name, stack, stack.n_frames) for view, stack in stacks.items()}
    renders = _found(path, counted, unexpected, ARRAY_NOTE, request)
    for view, stack in stacks.items():
        rendered = renders.views.get(view)
        if stack.member == OWN_RENDERS and isinstance(rendered, StreamView):
            notes += (_compare_truth(stack, rendered.indices, view, request),)
    return replace(renders, notes=notes)


def _compare_truth(
    stack: ArrayStack, indices: Mapping[int, int], view: str, request: FrameRequest
) -> str:
    """Compare the truth in an archive with the captured frames.

    Raises:
        RenderError: it shows other pictures.
    """
    truth, numbers = (
        ArrayStack(stack.path, OWN_TRUTH),
        {index: number for number, index in indices.items()},
    )
    if (truth.n_frames, truth.size) != (stack.n_frames, stack.size):
        sizes = [
            f"{array.n_frames} frames of {array.size[0]} x {array.size[1]}"
            for array in (stack, truth)
        ]
        raise RenderError(
            f"{stack.path}: wanted {OWN_RENDERS} and {OWN_TRUTH} of one shape, got "
            f"{' and '.join(sizes)}; save again"
        )
    if size_fault(truth.size, request.sizes[view]):
        return (
            f"{truth.path.name}[{OWN_TRUTH}] was not compared with the captured frames, which "
            f"have another size"
        )
    levels = [
        difference(to_8_bit(frame), request.truth(view, numbers[index]))
        for index, frame in enumerate(truth.frames(0, truth.n_frames))
        if index in numbers
    ]
    level = float(np.mean(levels))
    if level > LARGEST_DIFFERENCE:
        raise RenderError(
            f"{truth.name}: wanted the captured frames of {view}, got pictures {level:.1f} levels "
            "of 255 away; check view, frames and --first-frame, or score them with their own "
            "truth: --with-truth"
        )
    return (
        f"{truth.path.name}[{OWN_TRUTH}] agrees with the truth of the run ({level:.1f} levels "
        f"of 255 apart)"
    )


def _found(
    path: Path,
    counted: Mapping[str, tuple[str, FrameStream, int]],
    unexpected: Iterable[str],
    note: str,
    request: FrameRequest,
) -> RenderSet:
    unexpected = list(unexpected)
    numbered = number_streams(
        path, {view: count for view, (_, _, count) in counted.items()}, request
    )
    views: dict[str, RenderedView] = {
        view: StreamView(stream, numbered.frames[view], note)
        for view, (_, stream, _) in counted.items()
        if numbered.frames[view]
    }
    unused = {Path(name).name: numbered.extras[view] for view, (name, _, _) in counted.items()}
    extras = [
        f"{name}: {len(some)} frames after the first {len(request.frames)}"
        for name, some in unused.items()
        if some
    ]
    members = {name.partition("[")[2].rstrip("]"): name for name in unexpected if "[" in name}
    absent = [view for view in request.views if view not in views]
    hints = {
        view: respelled(view, members, request) or instead_of(path, view, request)
        for view in absent
    }
    return RenderSet(views, (*unexpected, *extras), numbering=numbered.note, hints=hints)


def _stack(file: Path) -> ArrayStack:
    if file.suffix.lower() == ".npy":
        return ArrayStack(file)
    members = npz_members(file)
    if {OWN_RENDERS, OWN_TRUTH} <= {*members}:
        return ArrayStack(file, OWN_RENDERS)
    if len(members) != 1:
        contents = ", ".join(members[:9]) or "none"
        raise RenderError(
            f"{file}: wanted one array, got {contents}; save frames (T, H, W, 3) alone"
        )
    return ArrayStack(file, members[0])


def _one_each(path: Path, suffixes: tuple[str, ...], request: FrameRequest) -> dict[str, Path]:
    by_view: dict[str, Path] = {}
    for view, file in _by_view(path, suffixes, request):
        if view in by_view:
            raise RenderError(
                f"{path}: wanted one file for {view}, got {by_view[view].name}, {file.name}; give "
                f"a folder with one"
            )
        by_view[view] = file
    return by_view


def _by_view(
    path: Path, suffixes: tuple[str, ...], request: FrameRequest
) -> list[tuple[str, Path]]:
    spelled = {same_name(view): view for view in request.views}
    named = [(spelled.get(same_name(file.stem)), file) for file in list_files(path, suffixes)]
    return [(view, file) for view, file in named if view is not None]


def _of_views(path: Path, suffixes: tuple[str, ...], request: FrameRequest) -> list[Path]:
    return [file for _, file in _by_view(path, suffixes, request)]


def _unexpected_files(path: Path, suffixes: tuple[str, ...], request: FrameRequest) -> list[str]:
    view_files = _of_views(path, suffixes, request)
    return [file.name for file in list_files(path, suffixes) if file not in view_files]
