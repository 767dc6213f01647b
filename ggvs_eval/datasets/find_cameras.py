"""Calibrations that no reader supports: of known programs by ``file_marks.toml``, of others by the
numbers that they hold.
"""

import re
import tomllib
from functools import cache
from importlib import resources
from itertools import product
from pathlib import Path

import numpy as np

from ggvs_eval.datasets.media import MEDIA, folders_beside
from ggvs_eval.datasets.unread_files import TEXTS, first_bytes, is_own
from ggvs_eval.files import pickle_reader
from ggvs_eval.files.array_file import map_array
from ggvs_eval.files.listing import list_entries, list_files_below
from ggvs_eval.side_process import SideProcess, SideProcessError

FILE = "file_marks.toml"
MOST_FILES = 100  # of a folder that are looked at
DEEPEST = 3  # folders between that and a file
MOST_NUMBERS = 20_000
CALIBRATIONS = re.compile(r"calib|intrin|extrin", re.I)
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
ENTRY = re.compile(
    r"""(?i)(?<![a-z_])(camera_?matri\w*|intrinsics?\w*|extrinsics?\w*|distortion\w*|dist_?coeff\w*|fx|fl_x|w2c|c2w|[rt]vecs?|k"""
    r"""(?=["\s]*[:=]\s*\[))["\s]*[:=>,]"""
)
K_ZEROS, K_POSITIVE, WITH_TRANSLATION = [1, 3, 6, 7], [0, 2, 4, 5], [0, 1, 2, 4, 5, 6, 8, 9, 10]
LEAST_VARIED = 4  # numbers of a rotation that are not 0 or 1
ROUNDED = 1e-3  # off an orthonormal matrix, of numbers that were printed with few digits
LEAST_FOCAL_PX = 10
UNIT = 1e-4  # off the length of a quaternion
LEAST_QUATERNIONS = 0.01  # of a file's numbers begin one: those of chance are rarer
_PICKLES = SideProcess(Path(pickle_reader.__file__))
PICKLE_TIMEOUT_S = 10


@cache
def file_marks() -> list[dict[str, str]]:
    """Return the rows of the table, in the order in which they are looked for: pattern, content,
    name and advice.
    """
    text = (resources.files("ggvs_eval.datasets") / FILE).read_text(encoding="utf-8")
    rows: list[dict[str, str]] = tomllib.loads(text)["mark"]
    return rows


def find_marked(path: Path) -> tuple[Path, str, str] | None:
    """Return the first file in a folder that the table knows, what it is, and what to do."""
    for mark, folder in product(file_marks(), folders_beside(path)):
        content = re.compile(mark.get("content", "").encode())
        for file in sorted(folder.glob(mark["pattern"])):
            if file.is_file() and not is_own(file) and content.search(first_bytes(file)):
                return file, mark["name"], mark["advice"]
    return None


def find_cameras(path: Path) -> dict[Path, str]:
    """Return the files up to four levels below a folder that hold cameras, with what they hold.

    Names say nothing.
    """
    folders = [list_entries(path)]
    for entries in folders:
        if entries and len(entries[0].relative_to(path).parts) <= DEEPEST:
            folders += [
                inner for entry in entries if entry.is_dir() and (inner := list_entries(entry))
            ]
    files = [
        file
        for folder in folders
        for file in folder[:MOST_FILES]
        if file.is_file() and not is_own(file)
    ]
    contents = {
        file: held_cameras(_content(file))
        for file in files
        if file.suffix.lower() not in MEDIA and not TEXTS.search(file.name)
    }
    return {file: content for file, content in contents.items() if content}


def find_cameras_above(path: Path) -> list[str]:
    """Return folders of calibrations next to a folder or the one that holds it, as they are named
    from there.
    """
    places = {
        f"{up}/{entry.name}/": entry
        for up in ("..", "../..")
        for entry in list_entries(path.resolve() / up)
    }
    named = {
        name: place
        for name, place in places.items()
        if CALIBRATIONS.search(name) and place.is_dir()
    }
    return [
        name
        for name, place in named.items()
        if not list_files_below(place, MEDIA) and find_cameras(place)
    ]


def held_cameras(text: str) -> str:
    r"""State what of cameras a text holds: an intrinsic matrix, rotations, or entries of such
    names; empty if nothing.

    Examples:
        >>> held_cameras("86.9 0 79.5\n0 86.9 59.5\n0 0 1")
        'an intrinsic matrix'
        >>> held_cameras("cam00,0.8,0.6,0,-0.6,0.8,0,0,0,1"), held_cameras("t x y\n0 1.5 2.5")
        ('rotations', '')
    """
    numbers = np.array(NUMBER.findall(text)[:MOST_NUMBERS], np.float64)
    padded = np.concatenate([numbers, np.full(12, np.nan)])
    # (N, 12), rows of three or four numbers
    windows = np.lib.stride_tricks.sliding_window_view(padded, 12)
    square = windows[:, :9]
    if (
        ((square[:, K_ZEROS] == 0) & (square[:, K_POSITIVE] > 0) & (square[:, 8:] == 1))
        .all(1)
        .any()
    ):
        return "an intrinsic matrix"
    for nine in (square, windows[:, WITH_TRANSLATION]):
        matrices = nine.reshape(-1, 3, 3)
        off = np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max((1, 2))
        is_varied = (~np.isin(np.abs(nine), (0, 1))).sum(1) >= LEAST_VARIED
        if (is_varied & (off < ROUNDED)).any():
            return "rotations"
    # K R of a matrix K [R t]: its last row is one of R
    projections = windows.reshape(-1, 3, 4)[:, :, :3]
    across = np.cross(projections[:, :2], projections[:, 2:])
    focal_px = np.linalg.norm(across, axis=2)
    is_scaled = (np.abs(np.linalg.norm(projections[:, 2], axis=1) - 1) < ROUNDED) & (
        focal_px > LEAST_FOCAL_PX
    ).all(1)
    skew = np.abs((across[:, 0] * across[:, 1]).sum(1)) / focal_px.prod(1).clip(1)
    if (is_scaled & (skew < ROUNDED)).any():
        return "projection matrices"
    fours = windows[:, :4]
    is_unit = (np.abs(np.linalg.norm(fours, axis=1) - 1) < UNIT) & (
        (np.abs(fours) > UNIT).sum(1) >= LEAST_VARIED - 1
    )
    if is_unit.sum() > max(1, LEAST_QUATERNIONS * len(numbers)):
        return "rotations as quaternions"
    entry = ENTRY.search(text)
    return f"an entry {entry[1]}" if entry else ""


def _content(file: Path) -> str:
    """Return what a file holds as text: arrays and pickled values too; empty if it is neither."""
    try:
        if file.suffix == ".npy":
            return " ".join(map(repr, map_array(file).ravel()[:MOST_NUMBERS].tolist()))
        if file.suffix in (".pkl", ".pickle"):
            return str(_PICKLES.ask(file, PICKLE_TIMEOUT_S))
    except (ValueError, SideProcessError, TimeoutError):
        return ""
    content = first_bytes(file)
    return "" if b"\0" in content else content.decode(errors="replace")
