"""Clouds of Gaussians as ``.ply`` files in the layout of 3D Gaussian splatting, read with suspicion
and written whole.

One element ``vertex`` of scalar properties: x y z, f_dc_0..2, f_rest_0.. (all coefficients of red,
then of green, then of blue), opacity (logit), scale_0..2 (logarithms), rot_0..3 (w first). Normals,
colours and labels are passed over; properties by which Gaussians are drawn otherwise are refused.
"""

import re
from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Array32
from ggvs_eval.errors import RenderError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.files.plain import check_plain, why_unread
from ggvs_eval.gaussians.cloud import (
    CONSTANT,
    HIGHEST_DEGREE,
    AntialiasedCloud,
    GaussianCloud,
    antialiased,
)

COMPRESSED = ("chunk", "vertex", "sh")  # its elements, the last one if there is one
CHUNK_SIZE = 256
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
CHUNK = tuple(
    f"{end}_{axis}"
    for kind in ("", "scale_")
    for end in ("min", "max")
    for axis in (f"{kind}x", f"{kind}y", f"{kind}z")
)
SH_RANGE = 8.0  # coefficients are within half of it on both sides of zero
LEAST_OPACITY = 1e-6  # the logit of 0 and 1 is infinite


def decompressed(
    chunks: NDArray[np.void], packed: NDArray[np.void], sh: NDArray[np.void] | None = None
) -> NDArray[np.void]:
    """Return the rows of the same cloud in the layout of 3D Gaussian splatting.

    Args:
        chunks: bounds of each chunk, ``min_x`` ...
        packed: of each Gaussian, ``packed_position`` ...
        sh: coefficients of each, ``f_rest_0`` ...

    Reading:
        Positions and logarithms of scales have 11, 10 and 11 bits of x, y and z between their
        chunk's bounds; red, green, blue and opacity 8 bits each, colours between bounds too where
        the chunk has them. A quaternion names the largest of its four parts (w first) in 2 bits,
        and the others in 10 bits each, of +-sqrt(1/2).
    """
    chunk = np.arange(len(packed)) // CHUNK_SIZE

    def between(steps: Array, kind: str, axes: str) -> Array:
        low, high = (
            np.stack([chunks[f"{end}_{kind}{axis}"][chunk] for axis in axes], axis=1)
            for end in ("min", "max")
        )
        return np.asarray(low + steps * (high.astype(np.float64) - low))

    position, turn, scale, colour = (packed[name].astype(np.uint32) for name in PACKED)
    rgba = _parts(colour, (8, 8, 8, 8))
    rgb = between(rgba[:, :3], "", "rgb") if "min_r" in (chunks.dtype.names or ()) else rgba[:, :3]
    opacity = np.clip(rgba[:, 3], LEAST_OPACITY, 1 - LEAST_OPACITY)
    columns = {
        **_named("{}", "xyz", between(_parts(position, (11, 10, 11)), "", "xyz")),
        **_named("f_dc_{}", range(3), (rgb - 0.5) / CONSTANT),
        "opacity": np.log(opacity / (1 - opacity)),
        **_named("scale_{}", range(3), between(_parts(scale, (11, 10, 11)), "scale_", "xyz")),
        **_named("rot_{}", range(4), _quaternions(turn)),
    }
    if sh is not None:
        columns |= {
            name: ((sh[name] + 0.5) / 256 - 0.5) * SH_RANGE for name in sh.dtype.names or ()
        }
    rows = np.empty(len(packed), [(name, "f4") for name in columns])
    for name, values in columns.items():
        rows[name] = values
    return rows


def _parts(words: NDArray[np.uint32], bits: tuple[int, ...]) -> Array:
    """Return the numbers that share a word, the first in its highest bits, each in [0, 1], (N,
    len(bits)).
    """
    shifts = np.cumsum((0, *bits[:0:-1]))[::-1]
    return np.stack(
        [
            (words >> shift & (1 << n) - 1) / ((1 << n) - 1)
            for shift, n in zip(shifts, bits, strict=True)
        ],
        axis=1,
    )


def _quaternions(words: NDArray[np.uint32]) -> Array:
    """Return the unit quaternions, w first, (N, 4)."""
    components = (_parts(words & np.uint32((1 << 30) - 1), (10, 10, 10)) - 0.5) * np.sqrt(2)
    largest = np.sqrt(np.maximum(1 - np.square(components).sum(axis=1), 0))
    quaternions = np.empty((len(words), 4))
    for part in range(4):
        rows = words >> 30 == part
        quaternions[rows] = np.insert(components[rows], part, largest[rows], axis=1)
    return quaternions


def _named(form: str, keys: Iterable[object], values: Array) -> dict[str, Array]:
    return {form.format(key): column for key, column in zip(keys, values.T, strict=True)}


LONGEST_HEADER = 64 << 10  # bytes; 3D Gaussian splatting writes 1.5 kB
MOST_GAUSSIANS = 50_000_000  # 12 GB of degree 3; what has been published stays below 10 million
NUMBERS = {
    **{
        "char": "i1",
        "int8": "i1",
        "uchar": "u1",
        "uint8": "u1",
        "short": "i2",
        "int16": "i2",
        "ushort": "u2",
        "uint16": "u2",
    },
    **{
        "int": "i4",
        "int32": "i4",
        "uint": "u4",
        "uint32": "u4",
        "float": "f4",
        "float32": "f4",
        "double": "f8",
        "float64": "f8",
    },
}
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}
MEANS, COLOURS = ("x", "y", "z"), tuple(f"f_dc_{channel}" for channel in range(3))
SCALES, TURNS = (
    tuple(f"scale_{axis}" for axis in range(3)),
    tuple(f"rot_{part}" for part in range(4)),
)
# Properties by which other methods draw their Gaussians, and what they call these.
OTHER_GAUSSIANS = {
    "Spacetime Gaussians": re.compile(r"trbf_.*|motion_.*|omega_.*|f_t_.*"),
    "Gaussians in time (4D Gaussian splatting)": re.compile(r"t|scale_t|rot_r_.*|time|velocity.*"),
    "Mip-Splatting": re.compile(r"filter_3D"),
    "Scaffold-GS": re.compile(r"f_offset_.*|f_anchor_feat_.*"),
}
# Comments by which exporters say that a cloud was trained antialiased (gsplat, brush), and what is
# written as one.
ANTIALIASED = re.compile(r"SplatRenderMode\W+mip|anti-?alias(ed|ing)?\W*(true|1|on|yes)?$", re.I)
ANTIALIASED_COMMENT = "SplatRenderMode: mip"
NORMALISED_NOTE = (
    "written by nerfstudio, whose world is normalised; its dataparser_transforms.json next to the "
    "cloud undoes that"
)
PLAIN_COMMENT = re.compile(r"SplatRenderMode\W+default|://", re.I)
HARMLESS = {
    "nx",
    "ny",
    "nz",
    "red",
    "green",
    "blue",
    "alpha",
    "label",
    "obj_dc_0",
    "obj_dc_1",
    "obj_dc_2",
}
OTHER_FORMATS = (".spz", ".splat", ".ksplat", ".sog")
MEND = "give the point_cloud.ply that 3D Gaussian splatting writes"


def read_ply(path: Path) -> GaussianCloud:
    """Read a cloud in the layout of 3D Gaussian splatting, or compressed as SuperSplat and gsplat
    write it.

    Args:
        path: a binary ``.ply``; the order of its properties does not matter.

    Raises:
        RenderError: no such file, cut short, other properties, those of Gaussians that are drawn
            otherwise, NaN, or more Gaussians than the file has room for; nothing is read then that
            the file does not hold.
    """
    if path.suffix.lower() in OTHER_FORMATS:
        raise RenderError(
            f"{path}: wanted a .ply, {path.suffix} is not read; convert it, e.g. 'splat-transform "
            f"{path.name} out.ply'"
        )
    try:
        size = check_plain(path)
        with path.open("rb") as file:
            elements, comments = _read_header(file, path)
            is_compressed = elements[0].name == COMPRESSED[0]
            vertex_elements = elements if is_compressed else elements[:1]
            head, count = file.tell(), max(element.n_rows for element in vertex_elements)
            n_bytes = sum(element.n_rows * element.row.itemsize for element in vertex_elements)
            if count > MOST_GAUSSIANS or head + n_bytes > size:
                raise RenderError(
                    f"{path}: its header says {count} Gaussians in {n_bytes} bytes, the file has "
                    f"{max(size - head, 0)} for them (at most {MOST_GAUSSIANS} Gaussians are "
                    "supported); copy or save it again"
                )
            tables = [np.fromfile(file, element.row, element.n_rows) for element in vertex_elements]
    except OSError as error:
        raise RenderError(
            f"{path}: wanted a cloud of Gaussians (.ply), got an unreadable file: "
            f"{why_unread(error)}"
        ) from error
    if any(
        len(table) < element.n_rows for table, element in zip(tables, vertex_elements, strict=True)
    ):
        raise RenderError(
            f"{path}: wanted {count} Gaussians, the file ended after {len(tables[-1])}; copy or "
            f"save it again"
        )
    cloud = _cloud(decompressed(*tables) if is_compressed else tables[0], path)
    return antialiased(cloud) if any(map(ANTIALIASED.search, comments)) else cloud


def header_notes(path: Path) -> list[str]:
    """Return what a cloud's header says of its drawing, and which properties and settings in it are
    passed over.
    """
    with path.open("rb") as file:
        elements, comments = _read_header(file, path)
    names = next(element for element in elements if element.name == "vertex").row.names or ()
    known_names = {*MEANS, *COLOURS, "opacity", *SCALES, *TURNS, *HARMLESS, *PACKED}
    unknown = [name for name in names if name not in known_names and not name.startswith("f_rest_")]
    notes = (
        [NORMALISED_NOTE] if any("nerfstudio" in comment.lower() for comment in comments) else []
    )
    notes += [f"{', '.join(unknown)} of its Gaussians are unknown and ignored"] if unknown else []
    for comment in comments:
        if ANTIALIASED.search(comment):
            notes.append(f"its Gaussians are drawn antialiased, as its header says: {comment}")
        elif ":" in comment and not PLAIN_COMMENT.search(comment):
            notes.append(f"the comment in its header is ignored: {comment}")
    return notes


def write_ply(path: Path, cloud: GaussianCloud) -> None:
    """Write a cloud in the layout of 3D Gaussian splatting.

    What is read back is the same, bit by bit.

    Args:
        cloud: on any device, written as float32.
    """
    parts = [
        tensor.detach().to("cpu", torch.float32).numpy() for tensor in cloud.parameters().values()
    ]
    means, log_scales, quaternions, logits, sh = parts
    # channel after channel
    harmonics = sh[:, 1:].transpose(0, 2, 1).reshape(len(cloud), 3 * (sh.shape[1] - 1))
    names = [
        *MEANS,
        "nx",
        "ny",
        "nz",
        *COLOURS,
        *(f"f_rest_{n}" for n in range(harmonics.shape[1])),
        "opacity",
        *SCALES,
        *TURNS,
    ]
    table = np.concatenate(
        [
            means,
            np.zeros_like(means),
            sh[:, 0],
            harmonics,
            logits[:, None],
            log_scales,
            quaternions,
        ],
        axis=1,
    )
    properties = "".join(f"property float {name}\n" for name in names)
    comment = f"comment {ANTIALIASED_COMMENT}\n" if isinstance(cloud, AntialiasedCloud) else ""
    header = (
        f"ply\nformat binary_little_endian 1.0\n{comment}element vertex "
        f"{len(cloud)}\n{properties}end_header\n"
    )
    with atomic_file(path) as temporary, temporary.open("wb") as file:
        file.write(header.encode("ascii"))
        table.astype("<f4").tofile(file)


class _Element(NamedTuple):
    """One kind of rows of a file: its name, how many, and the layout of a row in the file."""

    name: str
    n_rows: int
    row: np.dtype


def _read_header(file: IO[bytes], path: Path) -> tuple[list[_Element], list[str]]:
    """Return the elements of a file that begins with its Gaussians, or of a compressed one, and the
    comments.
    """
    lines = _header_lines(file, path)
    order = ORDERS.get(
        lines[1][1] if len(lines) > 1 and lines[1][:1] == ["format"] and len(lines[1]) > 1 else ""
    )
    if order is None:
        kind = " ".join(lines[1]) if len(lines) > 1 else "nothing"
        raise RenderError(f"{path}: wanted a binary .ply, its second line says {kind!r}; {MEND}")
    starts = [n for n, words in enumerate(lines) if words[:1] == ["element"]]
    names = tuple(" ".join(lines[n][1:2]) for n in starts)
    is_compressed = names in (COMPRESSED, COMPRESSED[:2])
    spans = zip(starts, [*starts[1:], None], strict=False)
    read = None if is_compressed else 1  # others follow the Gaussians
    elements = [_read_element(lines[start:end], order, path) for start, end in islice(spans, read)]
    if is_compressed:
        _require_packed(elements, path)
    elif names[:1] != ("vertex",):
        first = " ".join(lines[starts[0]]) if starts else ""
        raise RenderError(
            f"{path}: wanted `element vertex N` with its Gaussians first, got {first!r}; {MEND}"
        )
    else:
        _require_properties(list(elements[0].row.names or ()), path)
    return elements, [
        " ".join(words[1:]) for words in lines if words[:1] in (["comment"], ["obj_info"])
    ]


def _read_element(lines: list[list[str]], order: str, path: Path) -> _Element:
    head, *properties = lines
    if len(head) != 3 or not head[2].isdecimal() or len(head[2]) > 18:
        raise RenderError(
            f"{path}: wanted `element vertex N` with its Gaussians first, got {' '.join(head)!r}; "
            f"{MEND}"
        )
    fields = []
    for words in properties:
        if words[:1] in (["comment"], ["obj_info"], []):
            continue
        if len(words) != 3 or words[0] != "property" or words[1] not in NUMBERS:
            raise RenderError(
                f"{path}: wanted properties of one number each, got {' '.join(words)!r}; {MEND}"
            )
        fields.append((words[2], order + NUMBERS[words[1]]))
    names = [name for name, _ in fields]
    if len(set(names)) < len(names):
        raise RenderError(f"{path}: wanted each property once in the header, got one twice; {MEND}")
    return _Element(head[1], int(head[2]), np.dtype(fields))


def _header_lines(file: IO[bytes], path: Path) -> list[list[str]]:
    """Return the words of each line up to ``end_header``."""
    lines: list[list[str]] = []
    for line in iter(lambda: file.readline(LONGEST_HEADER), b""):
        if not lines and line.strip() != b"ply":
            raise RenderError(f"{path}: wanted a .ply file, got another first line; {MEND}")
        if file.tell() > LONGEST_HEADER:
            break
        words = line.decode("latin-1").split()
        if words == ["end_header"]:
            return lines
        lines.append(words)
    raise RenderError(
        f"{path}: the header of this .ply has no end_header in its first {LONGEST_HEADER >> 10} "
        f"kB; save it again"
    )


def _require_packed(elements: list[_Element], path: Path) -> None:
    """Refuse a compressed cloud that lacks what it is unpacked from."""
    chunk, vertex = elements[:2]
    absent = [
        name
        for name in (*CHUNK, *PACKED)
        if name not in {*(chunk.row.names or ()), *(vertex.row.names or ())}
    ]
    n_chunks, sh = -(-vertex.n_rows // CHUNK_SIZE), elements[2] if len(elements) > 2 else None
    names = list(sh.row.names or ()) if sh else []
    if (
        absent
        or chunk.n_rows != n_chunks
        or (sh and (sh.n_rows != vertex.n_rows or len(names) not in (9, 24, 45)))
    ):
        raise RenderError(
            f"{path}: wanted {n_chunks} chunks, {', '.join(PACKED)} and 9, 24 or 45 harmonics of "
            f"{vertex.n_rows} compressed Gaussians, got {chunk.n_rows}, "
            f"{len(names)}{' and no ' * bool(absent)}{', '.join(absent)}; save it again"
        )


def _require_properties(names: list[str], path: Path) -> None:
    for kind, pattern in OTHER_GAUSSIANS.items():
        if foreign := [name for name in names if pattern.fullmatch(name)]:
            raise RenderError(
                f"{path}: {', '.join(foreign[:3])}{'...' * (len(foreign) > 3)} are of {kind}, "
                "which render differently; render them by their own code and score the frames by "
                "'ggvs-eval score --renders'"
            )
    if "scale_1" in names and "scale_2" not in names:
        raise RenderError(
            f"{path}: Gaussians of two scales are of 2D Gaussian Splatting, which renders "
            "differently; render them by its own code and score the frames by 'ggvs-eval score "
            "--renders'"
        )
    absent = [name for name in (*MEANS, *COLOURS, "opacity", *SCALES, *TURNS) if name not in names]
    if absent:
        raise RenderError(
            f"{path}: wanted a cloud of Gaussians with "
            f"{', '.join(absent[:4])}{'...' * (len(absent) > 4)}, got "
            f"{', '.join(names[:12])}{'...' * (len(names) > 12)}; {MEND}"
        )
    n_harmonics = sum(name.startswith("f_rest_") for name in names)
    counts = [3 * ((degree + 1) ** 2 - 1) for degree in range(HIGHEST_DEGREE + 1)]
    if n_harmonics not in counts or any(f"f_rest_{n}" not in names for n in range(n_harmonics)):
        raise RenderError(
            f"{path}: wanted f_rest_0 to f_rest_N of {', '.join(map(str, counts))} in all, got "
            f"{n_harmonics}; {MEND}"
        )


def _cloud(table: NDArray[np.void], path: Path) -> GaussianCloud:
    def columns(*names: str) -> Array32:
        with np.errstate(over="ignore"):  # of doubles beyond all floats: infinite, and so refused
            values = (
                np.stack([table[name].astype(np.float32) for name in names], axis=1)
                if names
                else np.empty((len(table), 0))
            )
        broken = ~np.isfinite(values).all(axis=1)
        if broken.any():
            raise RenderError(
                f"{path}: {np.count_nonzero(broken)} of {len(table)} Gaussians have a {names[0]}.. "
                f"that is not finite, first number {int(np.argmax(broken))}; the fit that wrote it "
                "has diverged, or the file is damaged"
            )
        return values.astype(np.float32)

    names = table.dtype.names or ()
    harmonics = columns(
        *(f"f_rest_{n}" for n in range(sum(name.startswith("f_rest_") for name in names)))
    )
    sh = np.concatenate(
        [
            columns(*COLOURS)[:, None],
            harmonics.reshape(len(table), 3, harmonics.shape[1] // 3).transpose(0, 2, 1),
        ],
        axis=1,
    )
    parts = (columns(*MEANS), columns(*SCALES), columns(*TURNS), columns("opacity")[:, 0], sh)
    return GaussianCloud(*(torch.from_numpy(np.ascontiguousarray(part)) for part in parts))
