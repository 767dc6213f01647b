"""LZF chunks of HDF5 whose bytes depend on their content alone.

The encoder in h5py begins with whatever its hash table holds from earlier calls, so that equal images give different, equally
valid bytes. This one looks for nothing but repeated bytes, which is what cut-outs before a black ground consist of.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8

BLOCK, LITERALS = 256, 32
# A reference back by one byte, of length 9 + 247.
REPEAT = (0xE0, BLOCK - 9, 0)
# Bit of a chunk's filter mask that says that its second filter, after shuffle, was not used.
STORED = 0b10


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
