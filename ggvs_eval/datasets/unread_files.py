"""Files beside a capture that nothing reads, and those of this package that are no calibration."""

import os
import re
from collections.abc import Collection, Sequence
from pathlib import Path

from ggvs_eval.datasets.assemble import CROP_FILE
from ggvs_eval.datasets.instants import PAIRING_FILE
from ggvs_eval.files.listing import list_entries
from ggvs_eval.files.plain import LARGEST_PICTURE, check_plain

FIRST_BYTES = 1 << 20
# Our own, which are no calibration; calibration.json is a common name, and ours by its keys alone.
OWN = (
    *("units.toml", CROP_FILE, PAIRING_FILE, "corrections.toml", "depth_range.toml"),
    *("intrinsics.toml", "demo.json", "calibration.log"),
)
# Folder -> file that shows what it is: a true path, which is opened later, and the exact depth of a
# filmed room.
OWN_FOLDERS = {"path": "path/poses_bounds.npy", "depth": "demo.json"}
OWN_REPORT, OWN_KEYS = "calibration.json", (b'"registered"', b'"mean_reprojection_error_px"')
TEXTS = re.compile(r"readme|licen[cs]e|\.(md|pdf|html?)$", re.I)  # for people
LISTED = 8


def unused_note(path: Path, paths: Collection[str], notes: Sequence[str]) -> list[str]:
    """A note on what a folder holds beside a capture that was opened, and nothing of it was looked
    at.

    Args:
        paths: absolute paths of files that were.
        notes: of the capture, which may name some of it already.
    """
    named = set(re.split(r"[ ,;:/]+", " ".join(notes)))
    start = os.path.join(os.path.abspath(path), "")
    tops = {
        file.removeprefix(start).partition(os.sep)[0] for file in paths if file.startswith(start)
    }
    own_folders = {folder for folder, file in OWN_FOLDERS.items() if (path / file).is_file()}
    names = []
    for entry in list_entries(path):
        is_known = entry.name in tops | own_folders or is_own(entry) or TEXTS.search(entry.name)
        if not is_known and named.isdisjoint({entry.name, entry.stem}):
            names.append(f"{entry.name}/" if entry.is_dir() else entry.name)
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
