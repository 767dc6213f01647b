"""Maps of one size in an ``.npz``, without loss at half the size: bytes of equal weight side by
side, by zstandard.

Of a depth map at 1345 x 1008 that takes 4 ms, reading 6 ms, and leaves 2.2 of 4 bytes a pixel.
"""

from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

LEVEL = 1  # of zstandard: higher ones take twice the time for 2 %
SIZE, SUFFIX = "size", ".zstd"
MOST_PIXELS = 2**31
DTYPES = {"float32": np.float32, "uint8": np.uint8}


def write_packed(file: BinaryIO, maps: Mapping[str, NDArray[np.generic]]) -> None:
    """Write maps (H, W), float32 or uint8.

    A member is called ``<name>.<dtype>.zstd``, next to their ``size``.
    """
    members = {f"{name}.{array.dtype.name}{SUFFIX}": _pack(array) for name, array in maps.items()}
    size = np.array(next(iter(maps.values())).shape, np.int64)
    np.savez(file, allow_pickle=False, **{SIZE: size}, **members)


def unpack(members: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays of an ``.npz`` by their names, packed or plain.

    Raises:
        ValueError: a member that is not of the size it says.
    """
    if not any(member.endswith(SUFFIX) for member in members):
        return dict(members)
    height, width = (int(side) for side in members[SIZE])
    if not 0 < height * width <= MOST_PIXELS:
        raise ValueError(f"maps of {width} x {height} pixels")
    maps: dict[str, NDArray[Any]] = {}
    for member, packed in members.items():
        name, _, dtype = member.removesuffix(SUFFIX).rpartition(".")
        if member.endswith(SUFFIX):
            maps[name] = _unpack(packed, np.dtype(DTYPES[dtype]), (height, width))
    return maps


def _pack(values: NDArray[np.generic]) -> NDArray[np.uint8]:
    from pyarrow import Codec

    planes = np.ascontiguousarray(
        np.ascontiguousarray(values).reshape(-1).view(np.uint8).reshape(-1, values.itemsize).T
    )
    return np.frombuffer(Codec("zstd", LEVEL).compress(planes, asbytes=True), np.uint8)


def _unpack(
    packed: NDArray[np.generic], dtype: np.dtype, shape: tuple[int, int]
) -> NDArray[np.generic]:
    from pyarrow import Codec

    n_bytes = dtype.itemsize * shape[0] * shape[1]
    content = Codec("zstd").decompress(packed.tobytes(), n_bytes, asbytes=True)
    if len(content) != n_bytes:
        raise ValueError(f"{len(content)} bytes in the place of {n_bytes}")
    planes = np.frombuffer(content, np.uint8).reshape(dtype.itemsize, -1)
    return np.ascontiguousarray(planes.T).view(dtype).reshape(shape)
