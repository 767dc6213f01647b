"""How the demo data that ship were packed: filmed rooms, and renders of the main one."""

import shutil
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.worlds.layouts.pictures import write_grey_png
from ggvs_eval.files.images import read_image
from ggvs_eval.files.plain import ffmpeg_name
from ggvs_eval.files.video import write_video
from ggvs_eval.run_folder import frame_path
from ggvs_eval.synthetic import shipped
from ggvs_eval.synthetic.d3dmv_scene import SCENE
from ggvs_eval.synthetic.shipped import (
    PATH_IMAGES,
    PATH_VIDEO,
    SCENE_COVER,
    SCENE_VIDEO,
    packed_room,
    quick_protocol,
)

FPS, RENDERS_CRF = 30, 10


def pack_room(name: str, folder: Path) -> None:
    """Make a demo without exact depth that `film_demo` has filmed the room of that name
    that ships.
    """
    import h5py

    packed = packed_room(name)
    shutil.rmtree(packed, ignore_errors=True)
    shutil.copytree(folder, packed, ignore=lambda place, names: _left_out(folder, Path(place)))
    if (folder / PATH_IMAGES).is_dir():
        _write_lossless(
            packed / PATH_VIDEO,
            [read_image(file) for file in sorted((folder / PATH_IMAGES).glob("*.png"))],
        )
    if (folder / SCENE).is_file():
        with h5py.File(folder / SCENE) as file:
            rgb, cover = file["rgb"][:], file["fg_rgb"][..., 3]
        _write_lossless(packed / SCENE_VIDEO, rgb.reshape(-1, *rgb.shape[2:]))
        write_grey_png(packed / SCENE_COVER, cover.reshape(-1, cover.shape[-1]))


def _left_out(folder: Path, place: Path) -> set[str]:
    """Return the names in a folder of the demo that are packed in another form."""
    return {path.name for path in (folder / PATH_IMAGES, folder / SCENE) if path.parent == place}


def pack_renders(renders: Path) -> None:
    """Make the first frames of a method in a run of the demo the renders that ship,
    ``renders/ours`` when this was written.
    """
    protocol = quick_protocol()
    for view in protocol.views.test:
        frames = [
            read_image(frame_path(renders / view, frame))
            for frame in range(protocol.frames.numbers.stop)
        ]
        write_video(shipped.RENDERS / f"{view}.mp4", frames, FPS, RENDERS_CRF)


def _write_lossless(video: Path, images: Sequence[Image8]) -> None:
    import av

    with av.open(ffmpeg_name(video), "w", options={"fflags": "+bitexact"}) as container:
        stream = container.add_stream("libx264rgb", rate=Fraction(FPS))
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt, stream.options = "rgb24", {"crf": "0", "preset": "slow", "threads": "1"}
        for image in images:
            container.mux(
                stream.encode(
                    av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
                )
            )
        container.mux(stream.encode())
