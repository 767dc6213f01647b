"""Sequences of Gaussians as one binary glTF (``.glb``) with the extension KHR_gaussian_splatting,
written one instant at a time.

Source: Khronos, "KHR_gaussian_splatting" (ratified 2026): "Ellipse Kernel" and "Spherical Harmonics
Attributes" for what a primitive holds, "Fallback Behavior" for COLOR_0, "Calculating color from
Spherical Harmonics" for signs and order, which are those of `harmonic_basis`; and glTF 2.0,
sections 3.6 (alignment, bounds), 3.11 (animations) and 4.4 (the container).

Reading:
    Files of 3D Gaussian splatting have logarithms of scales, logits of opacity and w first; the
    extension has scales and opacity as they are, unit quaternions and w last. The colour space is
    ``srgb_rec709_display``, since fits see 8-bit sRGB pictures. A sequence has a node per instant,
    which an animation scales in steps: 1 while its instant lasts, 0 else. glTF 2.0 (3.5.3) names
    that as the way to animate visibility, and viewers play it that know no extension. The splatting
    extension leaves open what splats at a scale of 0 look like; they are not meant to be seen, and
    Babylon.js leaves them out. KHR_node_visibility is animated by KHR_animation_pointer alone,
    which fewer viewers have. The container takes 28 bytes of headers, so `struct` and `json` write
    it; pygltflib would keep all instants in memory.
"""

import json
import shutil
import struct
from collections.abc import Callable, Sequence
from importlib.metadata import version
from math import sqrt
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np
import torch
from numpy.typing import NDArray

from ggvs_eval.arrays import Array32
from ggvs_eval.errors import RenderError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.gaussians.cloud import CONSTANT, GaussianCloud
from ggvs_eval.progress import track

EXTENSION = "KHR_gaussian_splatting"
KERNEL = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "projection": "perspective",
    "sortingMethod": "cameraDistance",
}
ROTATION, SCALE, OPACITY = (f"{EXTENSION}:{name}" for name in ("ROTATION", "SCALE", "OPACITY"))
TERMS = [
    f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{n}" for degree in range(4) for n in range(2 * degree + 1)
]
HIGHEST_DEGREE = 3  # of the extension
FRAME = "frame"  # in a node's extras: the number of its instant
MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = b"glTF", 2, b"JSON", b"BIN\0"
MOST_BYTES = (1 << 32) - 1  # the container counts its bytes in 32 bits
FLOAT = 5126
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
POINTS, VERTICES = 0, 34962
Cloud = Callable[[int], GaussianCloud]


def write_glb(
    path: Path,
    frames: Sequence[int],
    cloud: Cloud,
    *,
    fps: float = 30.0,
    degree: int | None = None,
    up: Sequence[float] | None = None,
) -> None:
    """Write clouds of Gaussians as one file, an instant after the other.

    Never more than one of them is in memory.

    Args:
        path: the ``.glb`` to write.
        frames: numbers of the instants, ascending; each lasts until the next one, the last one a
            frame.
        cloud: gives the Gaussians of an instant.
        fps: frames per second.
        degree: of the spherical harmonics that are kept, at most; all by default.
        up: the direction that viewers show as up, in the world of the Gaussians; unchanged by
            default.

    Raises:
        RenderError: a cloud without Gaussians, with harmonics that the extension does not know or
            with numbers beyond floats; or more than a .glb can hold. Nothing is left of the file
            then.
    """
    turn = {} if up is None else {"rotation": _rotation_to_y(up)}
    with (
        atomic_file(path) as unfinished,
        unfinished.open("wb") as file,
        TemporaryFile(dir=unfinished.parent) as binary,
    ):
        parts = _Parts(binary)
        meshes = []
        for place, frame in enumerate(track(frames, "writing instants")):
            with torch.no_grad():
                meshes.append(
                    _mesh(parts, _rows(cloud(frame), degree, f"{path}: frame {frame}"), frame)
                )
            if parts.n_bytes > MOST_BYTES:
                raise _too_large(path, place, len(frames))
        document = _document(meshes, frames, turn) | (
            {"animations": [_animation(parts, frames, fps)]} if len(frames) > 1 else {}
        )
        document |= {
            "accessors": parts.accessors,
            "bufferViews": parts.views,
            "buffers": [{"byteLength": parts.n_bytes}],
        }
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + 8 + parts.n_bytes
        if total > MOST_BYTES:
            raise _too_large(path, len(frames) - 1, len(frames))
        file.write(struct.pack("<4sII", MAGIC, VERSION, total))
        file.write(struct.pack("<I4s", len(text), JSON_CHUNK) + text)
        file.write(struct.pack("<I4s", parts.n_bytes, BINARY_CHUNK))
        binary.seek(0)
        shutil.copyfileobj(binary, file, 1 << 20)


class _Parts:
    """The binary chunk while it grows, and what the document says of it."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.n_bytes = 0
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: Array32, *, of_vertices: bool = True, has_bounds: bool = False) -> int:
        """Append rows of floats, (N, components), which keeps all aligned.

        Returns the number of their accessor.
        """
        accessor: dict[str, Any] = {"bufferView": len(self.views), "componentType": FLOAT}
        accessor |= {"count": len(values), "type": TYPES[values.shape[1]]}
        if has_bounds:
            accessor |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        view = {"buffer": 0, "byteOffset": self.n_bytes, "byteLength": values.nbytes}
        self._file.write(values.astype("<f4").tobytes())
        self.n_bytes += values.nbytes
        self.views.append(view | ({"target": VERTICES} if of_vertices else {}))
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _rows(cloud: GaussianCloud, degree: int | None, name: str) -> dict[str, Array32]:
    """Attributes of a primitive by their names."""
    if degree is None and cloud.degree > HIGHEST_DEGREE:
        raise RenderError(
            f"{name}: wanted harmonics of degree 0 to {HIGHEST_DEGREE}, got {cloud.degree}; keep "
            f"degree 3 of them"
        )
    if not len(cloud):
        raise RenderError(
            f"{name}: wanted at least one Gaussian, got an empty cloud; omit this instant"
        )
    values = {key: tensor.detach().cpu().numpy() for key, tensor in cloud.parameters().items()}
    sh = values.pop("sh")
    # so that activations are rounded once
    values = {key: array.astype(np.float64) for key, array in values.items()}
    n_terms = (
        min(cloud.degree if degree is None else degree, cloud.degree, HIGHEST_DEGREE) + 1
    ) ** 2
    with np.errstate(over="ignore", invalid="ignore"):
        turns = values["quaternions"] / np.linalg.norm(values["quaternions"], axis=1, keepdims=True)
        opacity = 1 / (1 + np.exp(-values["opacity_logits"]))
        wide = {
            "POSITION": values["means"],
            ROTATION: np.roll(turns, -1, axis=1),
            SCALE: np.exp(values["log_scales"]),
        }
        wide |= {OPACITY: opacity[:, None], "COLOR_0": _fallback_colours(sh[:, 0], opacity)} | {
            term: sh[:, n] for n, term in enumerate(TERMS[:n_terms])
        }
        rows = {key: array.astype(np.float32) for key, array in wide.items()}
    broken = [key for key, row in rows.items() if not np.isfinite(row).all()]
    if broken:
        raise RenderError(
            f"{name}: wanted finite numbers, got others in {broken[0]}; the fit diverged, fit again"
        )
    return rows


def _fallback_colours(constant_terms: Array32, opacity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colours for viewers that show points, (N, 4): linear, as glTF wants them of vertices, with
    the opacity as alpha.
    """
    display = (constant_terms * CONSTANT + 0.5).clip(0, 1)
    linear = np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)
    return np.column_stack([linear, opacity])


def _mesh(parts: _Parts, rows: dict[str, Array32], frame: int) -> dict[str, Any]:
    attributes = {
        name: parts.add(values, has_bounds=name == "POSITION") for name, values in rows.items()
    }
    return {
        "name": f"Gaussians of frame {frame}",
        "primitives": [
            {"mode": POINTS, "attributes": attributes, "extensions": {EXTENSION: KERNEL}}
        ],
    }


def _document(
    meshes: list[dict[str, Any]], frames: Sequence[int], turn: dict[str, Any]
) -> dict[str, Any]:
    """The scene: a root, which may turn, and a node per instant, of which the first one is shown
    where no animation plays.
    """
    root = {"name": "sequence", "children": list(range(1, len(meshes) + 1))}
    nodes = [
        {"name": f"frame {frame}", "mesh": n, "extras": {FRAME: frame}}
        for n, frame in enumerate(frames)
    ]
    for node in nodes[1:]:
        node["scale"] = [0.0, 0.0, 0.0]
    return {
        "asset": {"version": "2.0", "generator": f"ggvs-eval {version('ggvs-eval')}"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [root | turn, *nodes],
        "meshes": meshes,
    }


def _animation(parts: _Parts, frames: Sequence[int], fps: float) -> dict[str, Any]:
    """Scales of the nodes in steps; the last instant lasts a frame, which the last key is for."""
    starts = [(frame - frames[0]) / fps for frame in [*frames, frames[-1] + 1]]
    samplers: list[dict[str, Any]] = []
    for n in range(len(frames)):
        keys = sorted({0.0, starts[n], starts[n + 1]})
        visibility = [
            starts[n] <= time and (time < starts[n + 1] or n == len(frames) - 1) for time in keys
        ]
        times = parts.add(np.array(keys, np.float32)[:, None], of_vertices=False, has_bounds=True)
        scales = parts.add(
            np.repeat(np.array(visibility, np.float32)[:, None], 3, axis=1), of_vertices=False
        )
        samplers.append({"input": times, "output": scales, "interpolation": "STEP"})
    channels = [
        {"sampler": n, "target": {"node": n + 1, "path": "scale"}} for n in range(len(frames))
    ]
    return {"name": "sequence", "samplers": samplers, "channels": channels}


def _rotation_to_y(up: Sequence[float]) -> list[float]:
    """Return the shortest rotation that takes a direction to +Y, which is up in glTF.

    X, y, z, w.
    """
    direction = np.asarray(up, np.float64)
    length = float(np.linalg.norm(direction))
    if direction.shape != (3,) or not 0 < length < np.inf:
        raise RenderError(
            f"--up: wanted three numbers that are not all 0, got {' '.join(map(str, up))}"
        )
    x, y, z = direction / length
    if y < -1 + 1e-9:
        return [1.0, 0.0, 0.0, 0.0]  # half a turn around x
    w = sqrt((1 + y) / 2)
    return [float(-z / (2 * w)), 0.0, float(x / (2 * w)), w]


def _too_large(path: Path, fit: int, count: int) -> RenderError:
    fewer = f"fewer (--frames {fit}) or " if fit else ""
    return RenderError(
        f"{path}: a .glb holds {(MOST_BYTES + 1) / 2**30:.3g} GiB, wanted {count} instants, of "
        f"which {fit} fit; write {fewer}view-independent colours (--degree 0)"
    )
