"""Video files as sources of frames: written so that equal frames give equal bytes, read so that
frame t is frame t.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.files.digest import digest_files
from ggvs_eval.files.picture_header import conversions_to_rgb8
from ggvs_eval.files.plain import check_plain, ffmpeg_name, why_unread

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer, OutputContainer
    from av.video.stream import VideoStream

MEND = "copy or encode this video again"
KEY_FRAME_INTERVAL = 30
# x264's macroblock tree gives other bytes once in some dozens of runs, with one thread too (seen at
# 64 x 48), and its assembly others than its plain code unless that is switched off.
X264 = "mbtree=0:cpu-independent=1"
HDR_TRANSFERS = {18: "HLG", 16: "PQ"}  # by their numbers in ITU-T H.273
PROGRESSIVE = 1  # of FFmpeg's orders of fields; 0 is unknown, what is above is interlaced
DEINTERLACE = "ffmpeg -i IN -vf bwdif -c:v libx264 -crf 12 OUT.mp4"
EXACT_DECODING = (
    "from video with full precision (OpenCV, imageio and plain ffmpeg are about a level darker)"
)
UNSPECIFIED = 2  # of the matrices in ITU-T H.273
UNTAGGED = (
    "by the matrix of BT.601, as no tag states one; if they are of BT.709, as HD cameras mean it, "
    "write that: ffmpeg -i IN -c copy -bsf:v h264_metadata=matrix_coefficients=1 OUT.mp4"
)
OTHER_TRACK = "ffmpeg -i IN -map 0:v:TRACK -c copy OUT.mp4"
# of a display matrix, in its largest: about the degree that ffmpeg allows for a right angle
LEAST_ENTRY = 0.02
LARGEST_JITTER = 0.01  # of the longest step between frames, for a rate that is taken as constant


def write_video(
    path: Path, frames: Iterable[Image8], fps: float, crf: float = 12, settings: str = X264
) -> None:
    """Encode frames as H.264 (yuv420p, BT.709, limited range) in an MP4 file.

    One thread and fixed parameters: equal frames give equal bytes. The file appears under its name
    when it is whole.

    Args:
        path: file to write, usually ``*.mp4``.
        frames: RGB images, all of one even size, (H, W, 3); consumed one at a time.
        crf: x264's constant rate factor; 12 is visually lossless, 0 the best the 4:2:0 format can
            do.
        settings: more of x264's parameters, ``name=value`` with colons between them.
    """
    import av

    with (
        atomic_file(path) as temporary,
        av.open(
            ffmpeg_name(temporary), "w", format="mp4", options={"fflags": "+bitexact"}
        ) as container,
    ):
        _encode(container, path, frames, fps, crf, settings)


def _encode(
    container: "OutputContainer",
    path: Path,
    frames: Iterable[Image8],
    fps: float,
    crf: float,
    settings: str,
) -> None:
    stream: VideoStream | None = None
    size = (0, 0)
    for index, image in enumerate(frames):
        if stream is None:
            size = (image.shape[1], image.shape[0])
            stream = _add_stream(container, path, size, fps, crf, settings)
        if image.shape != (size[1], size[0], 3) or image.dtype != np.uint8:
            expected = (
                f"wanted ({size[1]}, {size[0]}, 3) uint8 like frame 0, got {image.shape} "
                f"{image.dtype}"
            )
            raise CaptureError(
                f"{path}: frame {index} does not fit: {expected}; give all frames one size"
            )
        container.mux(stream.encode(_to_yuv(image)))
    if stream is None:
        raise CaptureError(
            f"{path}: wanted at least one frame to encode, got none; check the range of frames"
        )
    container.mux(stream.encode())


def _add_stream(
    container: "OutputContainer",
    path: Path,
    size: tuple[int, int],
    fps: float,
    crf: float,
    settings: str,
) -> "VideoStream":
    from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc

    if size[0] % 2 or size[1] % 2:
        raise CaptureError(
            f"{path}: yuv420p wants even width and height, got {size[0]} x {size[1]}; crop or "
            f"resize the frames"
        )
    stream = container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
    stream.width, stream.height = size
    stream.pix_fmt = "yuv420p"
    stream.codec_context.colorspace = Colorspace.ITU709
    stream.codec_context.color_range = ColorRange.MPEG
    stream.codec_context.color_primaries = ColorPrimaries.BT709
    stream.codec_context.color_trc = ColorTrc.BT709
    stream.options = {
        "crf": f"{crf:g}",
        "preset": "medium",
        "threads": "1",
        "g": str(KEY_FRAME_INTERVAL),
        "x264-params": settings,
    }
    return stream


def _to_yuv(image: Image8) -> "VideoFrame":
    from av import VideoFrame
    from av.video.reformatter import ColorRange, Colorspace

    rgb = VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
    return rgb.reformat(
        format="yuv420p",
        dst_colorspace=Colorspace.ITU709,
        dst_color_range=ColorRange.MPEG,
        interpolation=_exact_conversion(),
    )


def _exact_conversion() -> int:
    """Flags for swscale: its default path is 1.2 of 255 levels too dark, repeats chroma unfiltered
    and varies with the CPU.
    """
    from av.video.reformatter import Interpolation

    return (
        Interpolation.BICUBIC
        | Interpolation.FULL_CHR_H_INT
        | Interpolation.ACCURATE_RND
        | Interpolation.BITEXACT
    )


class FrameTime(NamedTuple):
    """Presentation and decoding time of a frame, in ticks of its stream.

    Hidden ones only lead to others (edit lists).
    """

    presented: int
    decoded: int
    is_key: bool
    is_hidden: bool


class VideoHeader(NamedTuple):
    """Properties of a video that its index, its stream and its first frame give.

    The others are not read.

    Attributes:
        n_frames: frames that are presented.
        n_inside: those of them whose data are inside the file.
        size: (width, height) of the frames as they are stored.
        fps: average over the file.
        steps: shortest and longest distance between frames, ticks.
        tick_ms: length of a tick.
        conversions: changes by reading frames as 8-bit RGB.
        transfer: see `VideoFrames.transfer`.
        turn_deg: angle by which the first frame is to be turned against the clock, where that is no
            right one.
        orientation: of the columns and rows as they are stored, where they go as they are shown:
            signs of the matrix (column by column, column by row, row by column, row by row) that
            the file states, which can mirror too.
        timecode: of the first frame, as hours, minutes, seconds and frames; empty without a track
            of it.
    """

    n_frames: int
    n_inside: int
    n_bytes: int
    size: tuple[int, int]
    fps: float
    steps: tuple[int, int]
    tick_ms: float
    conversions: tuple[str, ...]
    transfer: str
    interlaced: bool
    turn_deg: int = 0
    orientation: tuple[int, ...] = (1, 0, 0, 1)
    timecode: str = ""


@dataclass(frozen=True)
class VideoFrames:
    """The frames of a video file, a `FrameSource`.

    Frames are numbered in the order of presentation, from 0.

    Colour range and matrix (BT.601, BT.709, ...) follow the file's tags; BT.601 limited range where
    it has none, as swscale does, which is a conversion that is said. Frames are turned and mirrored
    as the file says they are to be shown, as pictures are by their EXIF tag.

    Attributes:
        path: MP4 or MOV file.
        is_exact: convert colours with full precision; else by FFmpeg's fast way, as OpenCV and
            imageio do.
    """

    path: Path
    is_exact: bool = True

    @property
    def n_frames(self) -> int:
        """Frames that are presented, counted in the file's index of samples."""
        return self._whole.n_frames

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, as the frames are shown."""
        width, height = self._whole.size
        return (height, width) if self._shown_as[1] else (width, height)

    @property
    def uneven(self) -> str:
        """Distances between frames where their rate varies; empty if it does not."""
        shortest, longest = self._header.steps
        # time stamps are rounded to ticks
        if longest - shortest <= max(1, LARGEST_JITTER * longest):
            return ""
        return f"{shortest * self._header.tick_ms:.1f} to {longest * self._header.tick_ms:.1f} ms"

    @cached_property
    def times_s(self) -> Array:
        """Presentation times of the frames, seconds after the first, (T,).

        The whole file is read for it.
        """
        with self._open() as container:
            tick_s = float(shown_track(container).time_base or 0)
        return tick_s * np.array(
            [frame.presented - self._shown[0].presented for frame in self._shown], np.float64
        )

    @property
    def timecode(self) -> str:
        """Of the first frame, see `VideoHeader`."""
        return self._header.timecode

    @property
    def conversions(self) -> dict[str, int]:
        """Change by reading frames as 8-bit RGB -> number of frames that it changes."""
        return dict.fromkeys(self._header.conversions, self.n_frames)

    @property
    def transfer(self) -> str:
        """``HLG`` or ``PQ`` where the levels are those of high dynamic range and not of a display.

        Else empty.
        """
        return self._header.transfer

    @property
    def interlaced(self) -> bool:
        """Whether a frame holds two instants, one in every other row, as the stream or its first
        frame says.
        """
        return self._header.interlaced

    @property
    def fps(self) -> float:
        """Frames per second, the average over the file."""
        return self._whole.fps

    @cached_property
    def digest(self) -> str:
        """Identifies the content; see `digest_files`."""
        return digest_files([self.path])

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Decode frames start <= t < stop one by one, from the last key frame before `start`.

        One frame is held at a time.

        Yields:
            RGB uint8 images, (H, W, 3).

        Raises:
            CaptureError: frames the video does not have, or data that do not decode to exactly
                these frames. Flipped bits that leave a stream which can be decoded pass unnoticed,
                since H.264 carries no checksum; they change the digest.
        """
        import av

        if not 0 <= start <= stop <= self.n_frames:
            raise CaptureError(
                f"{self.path}: wanted frames {start}..{stop - 1}, the video has {self.n_frames}"
            )
        if start == stop:
            return
        index, reason = start, "data missing or damaged"
        for key in self._key_frames_before(start):
            try:
                for frame in islice(
                    self._decode_from(key, self._shown[index].presented), stop - index
                ):
                    # A frame that is missing or concealed must not shift or spoil those after it.
                    if frame.pts != self._shown[index].presented or frame.is_corrupt:
                        break
                    conversion = _exact_conversion() if self.is_exact else None
                    image = frame.to_ndarray(format="rgb24", interpolation=conversion).astype(
                        np.uint8, copy=False
                    )
                    yield self._oriented(image)
                    index += 1
            except av.error.FFmpegError as error:
                reason = str(error.strerror)
            if index == stop:
                return
        raise self._damaged(index, reason)

    def _key_frames_before(self, start: int) -> list[FrameTime]:
        """List where decoding may begin: at the last key frame or, where that is not enough (intra
        refresh), at the first frame.

        Either may be hidden: a video that was cut without being encoded again keeps what its first
        frames refer to.
        """
        presented = self._shown[start].presented
        first = min(self._timestamps, key=lambda frame: frame.decoded)
        last = [
            frame for frame in self._timestamps if frame.is_key and frame.presented <= presented
        ][-1:]
        return list(dict.fromkeys([*last, first]))

    def _decode_from(self, first: FrameTime, presented: int) -> "Iterator[VideoFrame]":
        """Frames in the order of presentation from a time on, decoded from the frame `first`, which
        is shown no later.
        """
        with self._open() as container:
            stream = shown_track(container)
            stream.thread_type = "AUTO"
            stream.codec_context.options = {"err_detect": "explode"}
            # By decoding time: the presentation time of `start` can be past the decoding time of
            # the next key frame.
            container.seek(first.decoded, stream=stream)
            for packet in container.demux(stream):
                # Frames shown before an open group's key frame refer to the group before it and
                # cannot be decoded from here.
                if packet.pts is None or packet.pts >= first.presented:
                    yield from (
                        frame
                        for frame in packet.decode()
                        if frame.pts is None or frame.pts >= presented
                    )

    @cached_property
    def _timestamps(self) -> list[FrameTime]:
        """Decoding and presentation times of the frames, in the order of presentation."""
        import av

        try:
            with self._open() as container:
                timestamps = sorted(
                    FrameTime(
                        presented=packet.pts,
                        decoded=packet.dts,
                        is_key=packet.is_keyframe,
                        is_hidden=packet.is_discard,
                    )
                    for packet in container.demux(shown_track(container))
                    if packet.pts is not None and packet.dts is not None
                )
        except av.error.FFmpegError as error:
            raise self._damaged(0, str(error.strerror)) from error
        n_shown = sum(not frame.is_hidden for frame in timestamps)
        if n_shown != self.n_frames:
            raise self._damaged(n_shown, "packets missing")
        return timestamps

    @cached_property
    def _shown(self) -> list[FrameTime]:
        """Presented frames in order; frame t is the one at index t."""
        return [frame for frame in self._timestamps if not frame.is_hidden]

    @property
    def _whole(self) -> VideoHeader:
        """The header of a file that holds the data of all its frames."""
        header = self._header
        if not header.n_frames or header.n_inside < header.n_frames:
            raise self._damaged(
                header.n_inside, f"the file ends after {header.n_bytes} bytes", header.n_frames
            )
        return header

    @cached_property
    def _header(self) -> VideoHeader:
        """Header and first frame, read in one opening of the file, which takes longer than reading
        them.
        """
        import av
        from av.stream import Disposition

        n_bytes = self.path.stat().st_size if self.path.is_file() else 0
        with self._open() as container:
            stream = shown_track(container)
            tracks = [
                track
                for track in container.streams.video
                if not track.disposition & Disposition.attached_pic
            ]
            place = (
                f"from track {stream.index} of {len(tracks)} "
                f"{stream.metadata.get('name', '')}; another: {OTHER_TRACK}"
            )
            samples = [sample for sample in stream.index_entries if not sample.is_discard]
            steps = [
                later - earlier
                for earlier, later in pairwise(sorted(sample.timestamp for sample in samples))
            ] or [0]
            components = stream.format.components if stream.format else ()
            has_alpha = any(component.is_alpha for component in components)
            colours = (
                "grey"
                if len(components) - has_alpha == 1
                and not (stream.format and stream.format.has_palette)
                else ""
            )
            bits = max((component.bits for component in components), default=8)
            is_untagged = stream.codec_context.colorspace == UNSPECIFIED and (
                stream.codec_context.pix_fmt or ""
            ).startswith("yuv")
            header = VideoHeader(
                n_frames=len(samples),
                n_inside=sum(sample.pos + sample.size <= n_bytes for sample in samples),
                n_bytes=n_bytes,
                size=(stream.width, stream.height),
                fps=float(stream.average_rate or 0),
                steps=(min(steps), max(steps)),
                tick_ms=1000 * float(stream.time_base or 0),
                conversions=(
                    *conversions_to_rgb8(colours, bits, has_alpha),
                    *[UNTAGGED] * is_untagged,
                    *[place] * (len(tracks) > 1),
                ),
                transfer=HDR_TRANSFERS.get(int(stream.codec_context.color_trc), ""),
                interlaced=stream.codec_context.field_order > PROGRESSIVE,
                timecode=stream.metadata.get("timecode", ""),
            )
            try:
                first = next(container.decode(stream), None)
            except av.error.FFmpegError:  # damaged: reading frames gives the better message
                return header
        if first is None:
            return header
        header = header._replace(interlaced=header.interlaced or first.interlaced_frame)
        # a container of all kinds, which PyAV's types call a table of one
        side_data: Any = first.side_data
        if "DISPLAYMATRIX" not in side_data:
            return header
        matrix = (
            np.frombuffer(bytes(side_data["DISPLAYMATRIX"]), np.int32)
            .reshape(3, 3)[:2, :2]
            .astype(np.float64)
        )
        matrix[np.abs(matrix) < LEAST_ENTRY * np.abs(matrix).max()] = 0
        if np.count_nonzero(matrix) != 2:
            return header._replace(turn_deg=first.rotation)
        return header._replace(orientation=tuple(np.sign(matrix).astype(int).ravel().tolist()))

    @property
    def _shown_as(self) -> tuple[int, ...]:
        """Where columns and rows go as frames are shown, see `VideoHeader`.

        The first frame says so.
        """
        if self._header.turn_deg:
            expected = "frames that are shown upright or turned by right angles"
            raise CaptureError(
                f"{self.path}: wanted {expected}, got {self._header.turn_deg} degrees; {MEND} "
                f"without a turn"
            )
        return self._header.orientation

    def _oriented(self, image: Image8) -> Image8:
        """Return a frame as it is shown: turned and mirrored as ffmpeg does."""
        columns, turned, rows_to_columns, rows = self._shown_as
        if turned:
            image, columns, rows = image.transpose(1, 0, 2), rows_to_columns, turned
        return np.ascontiguousarray(image[::rows, ::columns])

    def _open(self) -> "InputContainer":
        import av

        try:
            check_plain(self.path)
        except OSError as error:
            raise CaptureError(
                f"{self.path}: wanted a video, got {why_unread(error)}; restore it or drop its "
                f"camera"
            ) from error
        try:
            container = av.open(ffmpeg_name(self.path), metadata_errors="replace")
        except av.error.FFmpegError as error:
            content = (
                f"{self.path.stat().st_size} bytes that do not open ({error.strerror}), 0 "
                f"frames can be decoded"
            )
            raise CaptureError(
                f"{self.path}: wanted a video, got {content}; the file is truncated or no video: "
                f"{MEND}"
            ) from error
        if not container.streams.video or "mp4" not in container.format.name:
            content = (
                f"{container.format.name} without index of frames"
                if container.streams.video
                else "no video stream"
            )
            container.close()
            raise CaptureError(
                f"{self.path}: wanted an MP4 or MOV video, got {content}; copy it: ffmpeg -i IN -c "
                f"copy OUT.mp4"
            )
        if container.streams.video[0].codec_context is None:
            container.close()
            raise CaptureError(
                f"{self.path}: wanted a video in a known code such as H.264, got an unknown one; "
                f"{MEND}"
            )
        return container

    def _damaged(self, n_decoded: int, reason: str, n_frames: int | None = None) -> CaptureError:
        total = self.n_frames if n_frames is None else n_frames
        return CaptureError(
            f"{self.path}: damaged, {n_decoded} of {total} frames can be decoded, then {reason}; "
            f"{MEND}"
        )


def shown_track(container: "InputContainer") -> "VideoStream":
    """Return the video track that players show: of several the one marked as the default."""
    from av.stream import Disposition

    return max(
        container.streams.video, key=lambda track: bool(track.disposition & Disposition.default)
    )
