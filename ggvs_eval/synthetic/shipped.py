"""The demo rooms that ship, as they were filmed, and a first evaluation to type along: one of them
with renders of it.

They are unpacked in seconds, with the same pictures for any encoder: decoding H.264 has one result,
encoding has not.
"""

import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.atomic import atomic_folder
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.files.plain import ffmpeg_name
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.protocol import Frames, Measurement, Protocol, load_protocol
from ggvs_eval.run_folder import frame_path
from ggvs_eval.synthetic.d3dmv_scene import SCENE, write_scene

if TYPE_CHECKING:
    from av.container import InputContainer

FOLDER = Path(__file__).parent
RoomName = Literal["demo", "demo-enerf-outdoor", "demo-d3dmv"]  # of their protocols
ROOMS: tuple[RoomName, ...] = get_args(RoomName)
MAIN = ROOMS[0]
# Packed without loss: the images of a camera path and the frames of D3DMV's file as videos, what
# covers these as one picture.
PATH_IMAGES, PATH_VIDEO = Path("path") / "images", Path("path") / "images.mkv"
SCENE_VIDEO, SCENE_COVER = Path("scene000.mkv"), Path("scene000.png")
LISTED = 5
QUICK_ROOM, PROTOCOL, LATE, FIXED = "room", "quick.toml", "late", "fixed"
FRAMES = Frames(start=1, count=8)  # the renders that are late show frame 0 first
METRICS = ("PSNR", "SSIM", "L1", "LPIPS", "TCC", "STED", "Flicker", "SDT", "SDV")
RENDERS = FOLDER / "shipped_renders"  # frames 0 to 8 of the demo's test views by `ours`, as videos


def write_room(folder: Path, name: str = MAIN) -> Path:
    """Write a demo room that ships; a complete one is left as it is.

    Args:
        folder: where to; absent, empty, or the same room.
        name: one of `ROOMS`.

    Returns:
        The folder: the files of the layout and ``demo.json``; of the main room also
        ``path/poses_bounds.npy`` and ``path/images/`` (one instant, without gain and noise).

    Raises:
        CaptureError: the folder holds something else, or has lost files.
    """
    packed = packed_room(name)
    content = [path.relative_to(packed) for path in packed.rglob("*") if path.is_file()]
    files = [
        SCENE if path == SCENE_VIDEO else str(path)
        for path in content
        if path not in (PATH_VIDEO, SCENE_COVER)
    ]
    if not is_written(folder, (packed / DEMO_NOTES).read_text(encoding="utf-8"), sorted(files)):
        with atomic_folder(folder) as unfinished:
            _unpack(packed, unfinished)
    return folder


def packed_room(name: str) -> Path:
    """Return the place of an included room in the package."""
    return FOLDER / f"shipped_{name}"


def is_written(folder: Path, description: str, files: Sequence[str]) -> bool:
    """Return whether a folder holds this very demo; False if it is absent or empty.

    Args:
        description: the text of its ``demo.json``.
        files: that every complete one has.

    Raises:
        CaptureError: it holds something else, or has lost files.
    """
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return False
    described = folder / DEMO_NOTES
    if not described.is_file():
        raise CaptureError(
            f"{folder}: wanted an empty folder or a demo of these options, found other files; "
            f"choose another"
        )
    if described.read_text(encoding="utf-8") != description:
        raise CaptureError(
            f"{folder}: holds a demo of other options or another version; choose another folder"
        )
    if missing := [name for name in files if not (folder / name).is_file()]:
        listed = ", ".join(missing[:LISTED]) + (
            f" and {len(missing) - LISTED} more" if len(missing) > LISTED else ""
        )
        raise CaptureError(f"{folder}: this demo has lost {listed}; write it into another folder")
    return True


def _unpack(packed: Path, folder: Path) -> None:
    shutil.copytree(packed, folder, dirs_exist_ok=True)
    for path in (PATH_VIDEO, SCENE_VIDEO, SCENE_COVER):
        (folder / path).unlink(missing_ok=True)
    if (packed / PATH_VIDEO).is_file():
        (folder / PATH_IMAGES).mkdir()
        for number, image in enumerate(_frames(packed / PATH_VIDEO)):
            write_image(folder / PATH_IMAGES / f"{number:04d}.png", image)
    if (packed / SCENE_VIDEO).is_file():
        # of one camera after another, (N, H, W, 3)
        rgb = np.stack(list(_frames(packed / SCENE_VIDEO)))
        of_camera = (
            -1,
            json.loads((packed / DEMO_NOTES).read_text(encoding="utf-8"))["options"]["n_frames"],
            *rgb.shape[1:3],
        )
        cover = read_image(packed / SCENE_COVER)[..., 0].reshape(of_camera)
        write_scene(folder / SCENE, list(rgb.reshape(*of_camera, 3)), list(cover))


def _frames(video: Path) -> Iterator[Image8]:
    with _opened(video) as container:
        for frame in container.decode(video=0):
            yield np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)


@contextmanager
def _opened(video: Path) -> "Iterator[InputContainer]":
    import av

    with av.open(ffmpeg_name(video)) as container:
        yield container


def write_quick(folder: Path) -> Path:
    """Write the four parts of a first evaluation into a new folder, which is returned.

    Returns:
        The folder: ``room/``, the capture; ``late/`` and ``fixed/``, VIEW/FRAME.png of the test
        views, the first a frame behind; ``quick.toml``, the demo's protocol over `FRAMES`.
    """
    with atomic_folder(folder) as unfinished:
        write_room(unfinished / QUICK_ROOM)
        protocol = quick_protocol()
        (unfinished / PROTOCOL).write_text(protocol.to_toml(), encoding="utf-8")
        numbers = protocol.frames.numbers
        for view in protocol.views.test:
            images = list(
                VideoFrames(RENDERS / f"{view}.mp4").frames(numbers.start - 1, numbers.stop)
            )
            for frame, before, image in zip(numbers, images, images[1:], strict=False):
                write_image(frame_path(unfinished / LATE / view, frame), before)
                write_image(frame_path(unfinished / FIXED / view, frame), image)
    return folder


def quick_protocol() -> Protocol:
    """Return the demo's protocol over a few frames, without a camera path, by the metrics that
    README shows.
    """
    protocol = load_protocol(MAIN)
    measurement = replace(
        protocol.measurement, metrics=METRICS, ceilings=Measurement.ceilings, lpips_every=1
    )
    return replace(
        protocol.shortened(None, 0), name="quick", frames=FRAMES, measurement=measurement
    )
