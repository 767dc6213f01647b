"""A first evaluation to type along: the demo capture, renders of it with and without a planted fault, and a short protocol."""

from dataclasses import replace
from pathlib import Path

from ggvs_eval.files.atomic import atomic_folder
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.files.video import VideoFrames, write_video
from ggvs_eval.protocol import Frames, Measurement, Protocol, load_protocol
from ggvs_eval.run_folder import frame_path
from ggvs_eval.synthetic.demo import MAIN, SHIPPED, write_demo

ROOM, PROTOCOL, LATE, MENDED = "room", "quick.toml", "late", "mended"
FRAMES = Frames(start=1, count=8)  # the renders that are late show frame 0 first
METRICS = ("PSNR", "SSIM", "L1", "LPIPS", "TCC", "STED", "Flicker", "SDT", "SDV")
FPS, RENDERS_CRF = 30, 10
RENDERS = Path(__file__).parent / "shipped_renders"  # frames 0 to 8 of the demo's test views by `ours`, as videos


def write_quick(folder: Path) -> Path:
    """Write the four parts into a new folder, which is returned.

    Returns:
        The folder: ``room/``, the capture; ``late/`` and ``mended/``, VIEW/FRAME.png of the test views, the first a frame
        behind; ``quick.toml``, the demo's protocol over `FRAMES`.
    """
    with atomic_folder(folder) as unfinished:
        write_demo(unfinished / ROOM, SHIPPED)
        protocol = quick_protocol()
        (unfinished / PROTOCOL).write_text(protocol.to_toml(), encoding="utf-8")
        numbers = protocol.frames.numbers
        for view in protocol.views.test:
            images = list(VideoFrames(RENDERS / f"{view}.mp4").frames(numbers.start - 1, numbers.stop))
            for frame, before, now in zip(numbers, images, images[1:], strict=False):
                write_image(frame_path(unfinished / LATE / view, frame), before)
                write_image(frame_path(unfinished / MENDED / view, frame), now)
    return folder


def pack_renders(renders: Path) -> None:
    """Make the first frames of a method in a run of the demo the renders that ship, ``renders/ours`` when this was written."""
    protocol = quick_protocol()
    for view in protocol.views.test:
        frames = [read_image(frame_path(renders / view, frame)) for frame in range(protocol.frames.numbers.stop)]
        write_video(RENDERS / f"{view}.mp4", frames, FPS, RENDERS_CRF)


def quick_protocol() -> Protocol:
    """The demo's protocol over a few frames, without a camera path, by the metrics that README shows."""
    protocol = load_protocol(MAIN)
    measurement = replace(protocol.measurement, metrics=METRICS, ceilings=Measurement.ceilings)
    return replace(protocol.shortened(None, 0), name="quick", frames=FRAMES, measurement=measurement)
