"""Coding parameters of a video, as its encoder wrote them into it: enough to code another one in
the same way.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from ggvs_eval.errors import CaptureError
from ggvs_eval.files.plain import ffmpeg_name
from ggvs_eval.files.video import VideoFrames, shown_track

if TYPE_CHECKING:
    from collections.abc import Sequence

    from av.sidedata.sidedata import SideData

X264 = re.compile(rb"x264 - core \d+.*?options: ([ -~]*)")
# x264 turns a rate factor of 0 into lossless
RATE_FACTOR = re.compile(r"\bcrf=([0-9.]+)|\brc=cqp.* qp=(0)\b")
PIXEL_FORMATS = ("yuv420p", "yuvj420p")
# A setting as x264 prints it -> as it takes it; what is left out does not change what frames look
# like, or is printed otherwise.
SETTINGS = {
    "ref": "ref",
    "subme": "subme",
    "trellis": "trellis",
    "8x8dct": "8x8dct",
    "psy_rd": "psy-rd",
    "bframes": "bframes",
    "weightp": "weightp",
    "keyint": "keyint",
    "keyint_min": "min-keyint",
    "scenecut": "scenecut",
    "rc_lookahead": "rc-lookahead",
    "mbtree": "mbtree",
    "qcomp": "qcomp",
    "ip_ratio": "ipratio",
    "pb_ratio": "pbratio",
}


@dataclass(frozen=True)
class Coding:
    """Coding of a camera's frames before they were measured.

    Attributes:
        size: of the coded frames, (width, height), pixels.
        crf: x264's constant rate factor.
        settings: other settings of x264, in its own syntax.
        frame_bytes: of each measured frame that is coded by its difference from others; of all
            frames where none is.
        unknown: why frames cannot be coded again in the same way; empty if they can.
    """

    size: tuple[int, int] = (0, 0)
    crf: float = 0.0
    settings: str = ""
    frame_bytes: tuple[int, ...] = ()
    unknown: str = ""

    @property
    def step_255(self) -> float:
        """Step of the quantiser, grey levels of 255: H.264's at a quantiser equal to the rate
        factor; 0 for lossless.
        """
        return float(2 ** ((self.crf - 4) / 6)) if self.crf > 0 else 0.0


def read_coding(path: Path, frames: range) -> Coding:
    """Read how a video was coded.

    Args:
        path: MP4 or MOV file.

    Returns:
        What x264 wrote into the first frame; `Coding.unknown` says what is missing where it did
        not, or worked to a bit rate.
    """
    import av
    from av.sidedata.sidedata import Type

    size = VideoFrames(path).size
    try:
        with av.open(ffmpeg_name(path), metadata_errors="replace") as container:
            track = container.streams.video.index(shown_track(container))
            frame = next(container.decode(video=track))
            beside = cast("Sequence[SideData]", frame.side_data)  # declared as a mapping
            notes = [
                bytes(beside[index])
                for index in range(len(beside))
                if beside[index].type == Type.SEI_UNREGISTERED
            ]
            pixels = frame.format.name
            container.seek(0)
            packets = sorted(
                (packet.pts, packet.size, packet.is_keyframe)
                for packet in container.demux(video=track)
                if packet.pts is not None
            )
    except (av.error.FFmpegError, StopIteration) as error:
        raise CaptureError(
            f"{path}: wanted a video, got data that do not decode; copy or encode it again"
        ) from error
    printed = next((match[1].decode() for note in notes if (match := X264.search(note))), "")
    factor = RATE_FACTOR.search(printed)
    if not factor:
        return Coding(
            size,
            unknown="coded without a rate factor"
            if printed
            else "coded by another encoder than x264",
        )
    if pixels not in PIXEL_FORMATS:
        return Coding(size, unknown=f"coded as {pixels}, not as {PIXEL_FORMATS[0]}")
    clip = packets[frames.start : frames.stop]
    differences = tuple(n_bytes for _, n_bytes, is_key in clip if not is_key) or tuple(
        packet[1] for packet in clip
    )
    return Coding(
        size=size, crf=float(factor[1] or 0), settings=_settings(printed), frame_bytes=differences
    )


def _settings(printed: str) -> str:
    values = dict(setting.split("=", 1) for setting in printed.split() if "=" in setting)
    # Colons separate settings, so that none can contain one.
    settings = [
        f"{name}={values[key].replace(':', ',')}" for key, name in SETTINGS.items() if key in values
    ]
    mode, _, strength = values.get("aq", "0").partition(":")
    return ":".join(
        [*settings, f"aq-mode={mode}", *([f"aq-strength={strength}"] if strength else [])]
    )
