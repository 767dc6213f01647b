"""The demo capture that ships with the package, filmed once by `write_demo`.

It is there in a second, with the same pictures whatever encoder is installed: decoding H.264 has one result,
encoding has not.
"""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.files.plain import ffmpeg_name

if TYPE_CHECKING:
    from av.container import InputContainer

FOLDER = Path(__file__).parent / "shipped_demo"
PATH_IMAGES = Path("path") / "images"
# The images of the camera path, one after another without loss: two fifths of what they take as PNG.
PATH_VIDEO = Path("path") / "images.mkv"


def unpack_shipped(folder: Path) -> None:
    """Write the shipped demo into a folder that is there and empty."""
    shutil.copytree(FOLDER, folder, dirs_exist_ok=True)
    (folder / PATH_VIDEO).unlink()
    images = folder / PATH_IMAGES
    images.mkdir()
    for number, image in enumerate(_path_frames(FOLDER / PATH_VIDEO)):
        write_image(images / f"{number:04d}.png", image)


def pack_shipped(folder: Path) -> None:
    """Make a demo that `write_demo` has filmed, in DyNeRF's layout and without exact depth, the one that ships."""
    shutil.rmtree(FOLDER, ignore_errors=True)
    shutil.copytree(folder, FOLDER, ignore=shutil.ignore_patterns(PATH_IMAGES.name))
    _write_path_frames(FOLDER / PATH_VIDEO, sorted((folder / PATH_IMAGES).glob("*.png")))


def _path_frames(video: Path) -> Iterator[Image8]:
    with _opened(video) as container:
        for frame in container.decode(video=0):
            yield np.asarray(frame.to_ndarray(format="rgb24"), np.uint8)


@contextmanager
def _opened(video: Path) -> "Iterator[InputContainer]":
    import av

    with av.open(ffmpeg_name(video)) as container:
        yield container


def _write_path_frames(video: Path, images: list[Path]) -> None:
    import av

    with av.open(ffmpeg_name(video), "w", options={"fflags": "+bitexact"}) as container:
        stream = container.add_stream("libx264rgb", rate=Fraction(30))
        stream.height, stream.width = read_image(images[0]).shape[:2]
        stream.pix_fmt, stream.options = "rgb24", {"crf": "0", "preset": "slow", "threads": "1"}
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(read_image(image), format="rgb24")))
        container.mux(stream.encode())
