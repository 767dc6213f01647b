"""Calibration files that no reader supports: named with their program and the export that is read, by ``file_marks.toml``."""

import os
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

from ggvs_eval.datasets.assemble import CROP_FILE
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.listing import IMAGE_SUFFIXES, VIDEO_SUFFIXES, list_entries
from ggvs_eval.files.plain import LARGEST_PICTURE, check_plain
from ggvs_eval.files.toml_tables import build_table, parse_toml

FILE = "file_marks.toml"
FIRST_BYTES = 1 << 20
# Our own, which are no calibration; calibration.json is a common name, and ours by its keys alone.
OWN = ("units.toml", CROP_FILE, "corrections.toml", "depth_range.toml", "intrinsics.toml", "demo.json", "calibration.log")
# Folder -> file that shows what it is: a true path, which is opened later, and the exact depth of a filmed room.
OWN_FOLDERS = {"path": "path/poses_bounds.npy", "depth": "demo.json"}
OWN_REPORT, OWN_KEYS = "calibration.json", (b'"registered"', b'"mean_reprojection_error_px"')
TEXTS = re.compile(r"readme|licen[cs]e|\.(md|pdf|html?)$", re.I)  # for people
LISTED = 8
# Words of a name that say that a file is of cameras.
CAMERA_WORDS = re.compile(r"calib|camera|(?<![a-z])cams?(?![a-z])|pose|extrinsic|intrinsic", re.I)


@dataclass(frozen=True)
class FileMark:
    """One row of the table.

    Attributes:
        pattern: of the file's path below the folder.
        name: what it is.
        advice: what to do.
        content: regular expression of what its first bytes hold; anything where empty.
    """

    pattern: str
    name: str
    advice: str
    content: str = ""

    def find(self, path: Path) -> Path | None:
        """The first file of this kind in a folder."""
        pattern = re.compile(self.content.encode())
        files = sorted(each for each in path.glob(self.pattern) if each.is_file() and not is_own(each))
        return next((each for each in files if not self.content or pattern.search(first_bytes(each))), None)


@dataclass(frozen=True)
class FileMarks:
    """The file."""

    mark: tuple[FileMark, ...]


@cache
def file_marks() -> tuple[FileMark, ...]:
    """The marks that ship with the package, in the order in which they are looked for."""
    text = (resources.files("ggvs_eval.datasets") / FILE).read_text(encoding="utf-8")
    return build_table(FileMarks, parse_toml(text, FILE, CaptureError), FILE, "", CaptureError).mark


def find_marked(path: Path) -> tuple[Path, FileMark] | None:
    """The first file in a folder that the table knows, with its row."""
    return next(((file, mark) for mark in file_marks() if (file := mark.find(path))), None)


def unread_note(path: Path) -> list[str]:
    """A note on files whose names say cameras, in a folder without a calibration or next to its frames, that nothing reads."""
    entries = list_entries(path)
    files = [*entries, *(file for folder in entries if folder.is_dir() for file in list_entries(folder))]
    media = (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES)
    named = [file for file in files if CAMERA_WORDS.search(file.stem) and file.suffix.lower() not in media]
    return [f"{file.relative_to(path)} is there and is not read" for file in named if file.is_file() and not is_own(file)]


def unused_note(path: Path, used: Collection[str], notes: Sequence[str]) -> list[str]:
    """A note on what a folder holds beside a capture that was opened, and nothing of it was looked at.

    Args:
        used: absolute paths of files that were.
        notes: of the capture, which may name some of it already.
    """
    named = set(re.split(r"[ ,;:/]+", " ".join(notes)))
    start = os.path.join(os.path.abspath(path), "")
    tops = {file.removeprefix(start).partition(os.sep)[0] for file in used if file.startswith(start)}
    left = [entry for entry in list_entries(path) if named.isdisjoint({entry.name, entry.stem}) and not is_own(entry)]
    own = {folder for folder, file in OWN_FOLDERS.items() if (path / file).is_file()}
    left = [entry for entry in left if entry.name not in tops | own and not TEXTS.search(entry.name)]
    names = [f"{entry.name}/" if entry.is_dir() else entry.name for entry in left]
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return [f"not used: {', '.join(names[:LISTED])}{more}"] if names else []


def is_own(file: Path) -> bool:
    """Tell whether a file is one that this package writes and that is no calibration."""
    if file.name == OWN_REPORT:
        content = first_bytes(file)
        return all(key in content for key in OWN_KEYS)
    return file.name in OWN


def first_bytes(file: Path) -> bytes:
    """First bytes of a file; empty if it cannot be read."""
    try:
        check_plain(file, LARGEST_PICTURE)
        with file.open("rb") as opened:
            return opened.read(FIRST_BYTES)
    except OSError:
        return b""
