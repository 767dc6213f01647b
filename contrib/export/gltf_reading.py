"""Gaussians of a ``.glb`` with KHR_gaussian_splatting, read with suspicion.

The conventions are those of `gltf`.

Reading:
    Gaussians are read as their mesh has them: in a file that `write_glb` wrote, the root may turn
    the scene for viewers, and the animation scales the nodes. A file of others has one mesh of
    Gaussians, and no node that moves it. An opacity of 0 or 1, whose logit is infinite, is read as
    one within half a step of float32.
"""

import json
import struct
from collections.abc import Callable, Mapping
from math import isqrt
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
import torch

from ggvs_eval.arrays import Array32
from ggvs_eval.contrib.export.gltf import (
    BINARY_CHUNK,
    EXTENSION,
    FRAME,
    JSON_CHUNK,
    KERNEL,
    MAGIC,
    OPACITY,
    ROTATION,
    SCALE,
    TERMS,
    TYPES,
)
from ggvs_eval.errors import RenderError
from ggvs_eval.files.plain import check_plain, why_unread
from ggvs_eval.gaussians.cloud import GaussianCloud

LARGEST_DOCUMENT = 64 << 20  # bytes of JSON; an instant of degree 3 takes 4 kB
NUMBERS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5126: "<f4"}
LEAST, MOST_OPACITY = 1e-38, 1 - 2.0**-25
TRANSFORM = ("matrix", "translation", "rotation", "scale")
LIKE_A_BROKEN_DOCUMENT = (
    KeyError,
    IndexError,
    TypeError,
    ValueError,
    AttributeError,
    StopIteration,
)


def glb_frames(path: Path) -> dict[int, int]:
    """Return frame number -> number of its mesh, ascending.

    The mesh of a file of others is of frame 0.

    Raises:
        RenderError: no such file, no ``.glb``, or no Gaussians in it that are read.
    """
    document = _open(path).document
    try:
        splats = [
            n for n, mesh in enumerate(document["meshes"]) if EXTENSION in str(mesh["primitives"])
        ]
        nodes = [node for node in document["nodes"] if node.get("mesh") in splats]
        frames = {
            int(node["extras"][FRAME]): int(node["mesh"])
            for node in nodes
            if FRAME in node.get("extras", {})
        }
        moved = any(key in node for node in document["nodes"] for key in TRANSFORM)
    except LIKE_A_BROKEN_DOCUMENT as error:
        raise _unlike(path, f"a document that lacks or mistypes {error}") from error
    if len(frames) == len(nodes) > 0:
        return dict(sorted(frames.items()))
    if len(nodes) != 1 or moved:
        raise _unlike(
            path,
            f"{len(nodes)} meshes of them without a frame number{', and nodes that move' * moved}",
        )
    return {0: nodes[0]["mesh"]}


def read_glb(path: Path, mesh: int) -> GaussianCloud:
    """Read the Gaussians of one mesh, see `glb_frames`.

    Raises:
        RenderError: no such file, cut short, compressed, of another kernel or colour space,
            attributes that are absent or of another kind, or numbers beyond floats.
    """
    opened = _open(path)
    try:
        (primitive,) = opened.document["meshes"][mesh]["primitives"]
        kernel, attributes = (
            {**KERNEL, **primitive["extensions"][EXTENSION]},
            primitive["attributes"],
        )
        if kernel != KERNEL:
            unlike = (f"{key} {value}" for key, value in kernel.items() if KERNEL.get(key) != value)
            raise _unlike(path, ", ".join(unlike))
        terms = [name for name in attributes if name in TERMS]
        with path.open("rb") as file:
            values = {
                name: _values(opened, attributes[name], file)
                for name in ("POSITION", ROTATION, SCALE, OPACITY, *terms)
            }
        if sorted(terms) != sorted(TERMS[: max(1, isqrt(len(terms)) ** 2)]):
            raise _unlike(
                path, f"an incomplete degree of harmonics, {len(terms)} coefficients in all"
            )
        sh = np.stack([values[name] for name in TERMS[: len(terms)]], axis=1)
        opacity = values[OPACITY].astype(np.float64)[:, 0].clip(LEAST, MOST_OPACITY)
        parts = [
            values["POSITION"],
            np.log(values[SCALE].clip(LEAST)),
            np.roll(values[ROTATION], 1, axis=1),
        ]
        parts += [np.log(opacity / (1 - opacity)), sh]
        cloud = GaussianCloud(
            *(torch.from_numpy(np.ascontiguousarray(part, np.float32)) for part in parts)
        )
    except (OSError, *LIKE_A_BROKEN_DOCUMENT) as error:
        raise _unlike(
            path, f"mesh {mesh} that cannot be read, {type(error).__name__} {error}"
        ) from error
    if (
        not all(tensor.isfinite().all() for tensor in cloud.parameters().values())
        or (values[SCALE] < 0).any()
    ):
        raise _unlike(path, f"mesh {mesh} with numbers that are not finite, or scales below 0")
    return cloud


class _Opened(NamedTuple):
    """Return the document of a file, and the place of its binary chunk."""

    document: Any
    start: int
    n_bytes: int


def _open(path: Path) -> _Opened:
    try:
        size = check_plain(path)
        with path.open("rb") as file:
            magic, version, _, length, kind = struct.unpack("<4sIII4s", file.read(20))
            if (magic, version, kind) != (MAGIC, 2, JSON_CHUNK) or length > LARGEST_DOCUMENT:
                raise ValueError(
                    f"{magic!r} of version {version} with {length} bytes of {kind!r} first"
                )
            document = json.loads(file.read(length))
            n_bytes, kind = struct.unpack("<I4s", file.read(8))
    except (OSError, struct.error, ValueError, RecursionError) as error:
        raise _unlike(
            path,
            why_unread(error) if isinstance(error, OSError) else f"{type(error).__name__} {error}",
        ) from error
    if kind != BINARY_CHUNK or 28 + length + n_bytes > size or not isinstance(document, dict):
        raise _unlike(path, f"{size} bytes instead of {28 + length + n_bytes}")
    return _Opened(document, 28 + length, n_bytes)


def _values(opened: _Opened, number: int, file: IO[bytes]) -> Array32:
    """Return the rows of an accessor as floats, (N, components)."""
    accessor = opened.document["accessors"][number]
    view = opened.document["bufferViews"][accessor["bufferView"]]
    width = next(count for count, name in TYPES.items() if name == accessor["type"])
    kind = np.dtype(NUMBERS[accessor["componentType"]])
    count, stride = accessor["count"], view.get("byteStride", width * kind.itemsize)
    offset, length = (
        view.get("byteOffset", 0) + accessor.get("byteOffset", 0),
        stride * (count - 1) + width * kind.itemsize,
    )
    if (
        "sparse" in accessor
        or min(count, stride, offset + 1) < 1
        or offset + length > opened.n_bytes
    ):
        raise ValueError(f"accessor {number} does not fit its data")
    file.seek(opened.start + offset)
    rows = np.ndarray(
        (count, width), kind, file.read(length), strides=(stride, kind.itemsize)
    ).astype(np.float32)
    return (
        np.maximum(rows / np.float32(np.iinfo(kind).max), -1)
        if accessor.get("normalized")
        else rows
    )


def _unlike(path: Path, got: str) -> RenderError:
    remedy = "write it again, or convert it, e.g. 'splat-transform in.glb out.ply'"
    return RenderError(
        f"{path}: wanted a .glb with Gaussians of {EXTENSION}, one mesh or a sequence, got {got}; "
        f"{remedy}"
    )


class SplatFile(NamedTuple):
    """Return the readers of Gaussian files: (path, mesh) -> cloud, and path -> frame number ->
    mesh.
    """

    read: Callable[[Path, int], GaussianCloud]
    frames: Callable[[Path], Mapping[int, int]]


GLB = SplatFile(read_glb, glb_frames)
