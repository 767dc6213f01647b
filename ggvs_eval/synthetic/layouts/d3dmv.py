"""Deep 3D Mask Volume's layout, compressed as it is distributed: one HDF5 file with all frames, lossless, and LLFF poses.

The bytes of its LZF chunks depend on their content alone. The encoder in h5py begins with whatever its hash table holds from
earlier calls, so that equal images give different, equally valid bytes. This one looks for nothing but repeated bytes, which is
what cut-outs before a black ground consist of.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.datasets.llff import llff_pose, write_llff_poses
from ggvs_eval.files.images import quantise
from ggvs_eval.synthetic.film.film import PARTS, Footage, Frame
from ggvs_eval.synthetic.film.options import DemoOptions

SCENE = "scene000.h5"
POSES = "scene000_pb.npy"
# The poses are those of the images before they were compressed, 1280 x 720 for 640 x 360.
POSE_SCALE = 2
MEDIAN_FRAMES = 32
BLOCK, LITERALS = 256, 32
# A reference back by one byte, of length 9 + 247.
REPEAT = (0xE0, BLOCK - 9, 0)
# Bit of a chunk's filter mask that says that its second filter, after shuffle, was not used.
STORED = 0b10


def write_shot(folder: Path, footage: Footage) -> Camera:
    """Write the frames of one camera to a file of their own and its exact depth; gives the camera to note."""
    camera, options = footage.noted_camera(), footage.options
    size = (options.n_frames, options.height, options.width)
    rgb = open_memmap(_part(folder, camera.name, "rgb"), "w+", np.uint8, (*size, 3))
    foreground = open_memmap(_part(folder, camera.name, "fg_rgb"), "w+", np.uint8, (*size, 4))
    for index, frame in enumerate(footage.frames_keeping_depth(folder)):
        rgb[index] = frame.image
        foreground[index] = cut_out(frame)
    np.save(_part(folder, camera.name, "bg_rgb"), median_background(rgb))
    return camera


def finish(folder: Path, options: DemoOptions, cameras: Sequence[Camera]) -> None:
    """Join the frames of all cameras in ``scene000.h5`` and write ``scene000_pb.npy``."""
    import h5py

    frames, image = (options.n_frames,), (options.height, options.width)
    with h5py.File(folder / SCENE, "w") as file:
        for key, times, channels in (("rgb", frames, 3), ("fg_rgb", frames, 4), ("bg_rgb", (), 3)):
            shape, chunk = (len(cameras), *times, *image, channels), (1, *(1 for _ in times), *image, channels)
            joined = create_lzf(file, key, shape, chunk)
            for row, camera in enumerate(cameras):
                part = np.load(_part(folder, camera.name, key), mmap_mode="r")
                for index in np.ndindex(times):
                    write_chunk(joined, (row, *index), part[index])
    large = [camera.resized(POSE_SCALE * camera.width, POSE_SCALE * camera.height) for camera in cameras]
    write_llff_poses(folder / POSES, [llff_pose(camera) for camera in large])


def cut_out(frame: Frame) -> Image8:
    """Cut what moves out of a frame: RGBA, alpha the share of the pixel it covers, colour 0 where that is 0; (H, W, 4)."""
    alpha = quantise(frame.foreground)[..., None]
    return np.concatenate([np.where(alpha > 0, frame.image, 0), alpha], axis=-1).astype(np.uint8)


def median_background(frames: Image8) -> Image8:
    """Median over time, per pixel and channel, (H, W, 3).

    Reading:
        The original takes every 25th of some hundreds of frames; this takes evenly spaced ones, at most 32.
    """
    stride = -(-len(frames) // MEDIAN_FRAMES)
    return np.rint(np.median(frames[::stride], axis=0)).astype(np.uint8)


def files(options: DemoOptions) -> list[str]:
    """List the files that every complete demo has."""
    return [SCENE, POSES]


def _part(folder: Path, name: str, key: str) -> Path:
    return folder / PARTS / f"{name}_{key}.npy"


def create_lzf(file: Any, key: str, shape: tuple[int, ...], chunk: tuple[int, ...]) -> Any:
    """An empty uint8 dataset with shuffle and LZF."""
    return file.create_dataset(key, shape, np.uint8, chunks=chunk, compression="lzf", shuffle=True, track_times=False)


def write_chunk(dataset: Any, index: tuple[int, ...], image: Image8) -> None:
    """Write one image, (H, W, C), as the chunk at an index of the leading axes."""
    content = np.ascontiguousarray(image).ravel()
    encoded, mask = encode_lzf(content), 0
    if len(encoded) >= len(content):
        encoded, mask = content.tobytes(), STORED  # as HDF5 does with what does not shrink
    dataset.id.write_direct_chunk((*index, 0, 0, 0), encoded, mask)


def encode_lzf(content: NDArray[np.uint8]) -> bytes:
    """LZF of bytes, (N,): blocks that repeat the byte before them become references, all others literals."""
    count = len(content) // BLOCK
    blocks = content[: count * BLOCK].reshape(count, BLOCK)
    repeats = np.zeros(count, bool)
    repeats[1:] = (blocks[1:] == blocks[:-1, -1:]).all(axis=1)
    runs = BLOCK // LITERALS
    literals = np.empty((count, runs, 1 + LITERALS), np.uint8)
    literals[..., 0], literals[..., 1:] = LITERALS - 1, blocks.reshape(count, runs, LITERALS)
    tokens = literals.reshape(count, runs * (1 + LITERALS))
    tokens[repeats, : len(REPEAT)] = REPEAT
    used = np.ones(tokens.shape, bool)
    used[repeats, len(REPEAT) :] = False
    rest = content[count * BLOCK :]
    tail = [bytes([len(part) - 1]) + part.tobytes() for part in np.split(rest, range(LITERALS, len(rest), LITERALS)) if len(part)]
    return tokens[used].tobytes() + b"".join(tail)
