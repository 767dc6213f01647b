"""The file of Deep 3D Mask Volume's layout, compressed as it is distributed: all frames of all
cameras in HDF5, lossless.

The bytes of its LZF chunks depend on their content alone. The encoder in h5py begins with leftovers
in its hash table from earlier calls, so that equal images give different, equally valid bytes. This
one looks for nothing but repeated bytes, which is what cut-outs before a black ground consist of.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8

SCENE = "scene000.h5"
MEDIAN_FRAMES = 32
BLOCK, LITERALS = 256, 32
# A reference back by one byte, of length 9 + 247.
REPEAT = (0xE0, BLOCK - 9, 0)
# Bit of a chunk's filter mask that says that its second filter, after shuffle, was not used.
STORED = 0b10


def write_scene(path: Path, rgb: Sequence[Image8], alpha: Sequence[NDArray[np.uint8]]) -> None:
    """Write all frames, what moves cut out of each, and the median of each camera.

    Args:
        path: file to write.
        rgb: frames per camera, (T, H, W, 3).
        alpha: share of each pixel that moving things cover, of 255, per camera, (T, H, W).
    """
    import h5py

    n_frames, height, width, _ = rgb[0].shape
    with h5py.File(path, "w") as file:
        for key, channels in (("rgb", 3), ("fg_rgb", 4)):
            joined = create_lzf(
                file,
                key,
                (len(rgb), n_frames, height, width, channels),
                (1, 1, height, width, channels),
            )
            for row, index in np.ndindex(len(rgb), n_frames):
                image = rgb[row][index]
                write_chunk(
                    joined,
                    (row, index),
                    image if channels == 3 else cut_out(image, alpha[row][index]),
                )
        joined = create_lzf(file, "bg_rgb", (len(rgb), height, width, 3), (1, height, width, 3))
        for row, frames in enumerate(rgb):
            write_chunk(joined, (row,), median_background(frames))


def cut_out(image: Image8, alpha: NDArray[np.uint8]) -> Image8:
    """Cut what moves out of a frame: RGBA, colour 0 where alpha is 0; (H, W, 4)."""
    covered = alpha[..., None]
    return np.concatenate([np.where(covered > 0, image, 0), covered], axis=-1).astype(np.uint8)


def median_background(frames: Image8) -> Image8:
    """Return the median over time, per pixel and channel, (H, W, 3).

    Reading:
        The original takes every 25th of some hundreds of frames; this takes evenly spaced ones, at
        most 32.
    """
    stride = -(-len(frames) // MEDIAN_FRAMES)
    return np.rint(np.median(frames[::stride], axis=0)).astype(np.uint8)


def create_lzf(file: Any, key: str, shape: tuple[int, ...], chunk: tuple[int, ...]) -> Any:
    """Return an empty uint8 dataset with shuffle and LZF."""
    return file.create_dataset(
        key, shape, np.uint8, chunks=chunk, compression="lzf", shuffle=True, track_times=False
    )


def write_chunk(dataset: Any, index: tuple[int, ...], image: Image8) -> None:
    """Write one image, (H, W, C), as the chunk at an index of the leading axes."""
    content = np.ascontiguousarray(image).ravel()
    encoded, mask = encode_lzf(content), 0
    if len(encoded) >= len(content):
        encoded, mask = content.tobytes(), STORED  # as HDF5 does with what does not shrink
    dataset.id.write_direct_chunk((*index, 0, 0, 0), encoded, mask)


def encode_lzf(content: NDArray[np.uint8]) -> bytes:
    """LZF of bytes, (N,): blocks that repeat the byte before them become references, all others
    literals.
    """
    count = len(content) // BLOCK
    blocks = content[: count * BLOCK].reshape(count, BLOCK)
    repeats = np.zeros(count, bool)
    repeats[1:] = (blocks[1:] == blocks[:-1, -1:]).all(axis=1)
    runs = BLOCK // LITERALS
    literals = np.empty((count, runs, 1 + LITERALS), np.uint8)
    literals[..., 0], literals[..., 1:] = LITERALS - 1, blocks.reshape(count, runs, LITERALS)
    tokens = literals.reshape(count, runs * (1 + LITERALS))
    tokens[repeats, : len(REPEAT)] = REPEAT
    mask = np.ones(tokens.shape, bool)
    mask[repeats, len(REPEAT) :] = False
    remainder = content[count * BLOCK :]
    tail = [
        bytes([len(part) - 1]) + part.tobytes()
        for part in np.split(remainder, range(LITERALS, len(remainder), LITERALS))
        if len(part)
    ]
    return tokens[mask].tobytes() + b"".join(tail)
