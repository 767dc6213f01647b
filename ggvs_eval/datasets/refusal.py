"""What a path shows that is of no layout, and the way on: loaded when a capture is refused, and not
before.
"""

import os
import re
from collections.abc import Mapping
from pathlib import Path

from ggvs_eval.datasets import DATASETS, open_capture
from ggvs_eval.datasets.camera_frames import rig_frames
from ggvs_eval.datasets.find_cameras import find_cameras, find_cameras_above, find_marked
from ggvs_eval.datasets.media import CameraFrames
from ggvs_eval.datasets.unread_files import unused_note
from ggvs_eval.errors import CaptureError, GgvsError
from ggvs_eval.files.listing import IMAGE_SUFFIXES, VIDEO_SUFFIXES, list_entries, list_files_below
from ggvs_eval.files.names import listed

LISTED = 8
FORMS = (
    "write them as transforms.json, OpenCV's YAML or capture.toml, or move what is not of "
    "these cameras elsewhere"
)


def calibration_mark(path: Path) -> tuple[str, tuple[str, ...], str] | None:
    """Return a name in a folder that shows a calibration, the layouts that have it, or what it is
    and what to do.

    None if there is none, or no folder. The marks of layouts go first; files of `find_marked` are
    of no layout.
    """
    if not path.is_dir():
        return None
    marks = [mark for _, spec in DATASETS.working() for mark in spec.marks]
    for mark in dict.fromkeys(marks):
        if marked_file := min(path.glob(mark), default=None):
            return (
                marked_file.name,
                tuple(layout for layout, spec in DATASETS.working() if mark in spec.marks),
                "",
            )
    if marked := find_marked(path):
        file, what, advice = marked
        return str(file.relative_to(path)), (), f"{what}, not read here; {advice}"
    files = find_cameras(path)
    if not files:
        return None
    first = {(file.parent, re.sub(r"\d+", "", file.name)): file for file in reversed(files)}
    names = listed(str(file.relative_to(path)) for file in sorted(first.values()))
    names += f" and {len(files) - len(first)} like these" if len(files) > len(first) else ""
    what = f"cameras ({', '.join(dict.fromkeys(files.values()))}) in a form that is not read here"
    what += f", and more in {listed(above)}" if (above := find_cameras_above(path)) else ""
    paths = {
        os.path.abspath(file)
        for file in (*files, *list_files_below(path, (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES)))
    }
    return names, (), "; ".join([what, FORMS, *unused_note(path, paths, ())])


def unfit(path: Path, refusals: Mapping[str, str]) -> str:
    """State why a path is of no layout: what it shows first, then what else was looked for."""
    if path.is_file():
        return (
            f"{path}: wanted a capture's folder or capture.toml, got another file; give its "
            f"folder, {path.parent.resolve().name}"
        )
    within, mark = _captures_within(path), calibration_mark(path)
    remedy = (
        f"name one of the captures in it: {within}"
        if within
        else "see docs/captures.md for the layouts"
    )
    rig: Mapping[str, CameraFrames] = {}
    try:
        rig = rig_frames(path) if not within and (mark is None or not mark[1]) else rig
    except CaptureError as error:
        if mark is None:
            raise
        remedy = str(error).removeprefix(f"{path}: ")
    if rig:
        first = next(iter(rig.values())).path.relative_to(path)
        remedy = f"frames of {listed(rig)} are there ({first}, ...)"
        remedy += (
            f": 'ggvs-eval calibrate {path} RIG' makes a capture of them" if mark is None else ""
        )
    reasons = "; ".join(f"not {name}: {refusal}" for name, refusal in refusals.items())
    if mark is None:
        return f"{path}: wanted a capture in a known layout; {remedy} (looked for: {reasons})"
    name, layouts, kind = mark
    if not layouts:
        return (
            f"{path}: {name} exist{'s' * (' ' not in name)}: {kind}; {remedy} (looked for: "
            f"{reasons})"
        )
    lacking = " or ".join(f"{layout}: {refusals.get(layout)}" for layout in layouts)
    return (
        f"{path}: {name} exists, but the capture is incomplete, {lacking}; {remedy} (also "
        f"looked for: {reasons})"
    )


def _captures_within(path: Path) -> str:
    """Return the folders one or two levels below that open, when a whole data set was named instead
    of a scene.
    """
    captures: list[Path] = []
    level = [path]
    for _ in range(2):
        level = [entry for folder in level for entry in list_entries(folder) if entry.is_dir()][
            : 4 * LISTED
        ]
        captures = captures or [folder for folder in level if _opens(folder)]
    return listed(str(folder.relative_to(path)) for folder in captures)


def _opens(folder: Path) -> bool:
    """Return whether advice to open a folder would help: its layout is known and all that it needs
    is there.
    """
    if all(spec.refuse(folder) is not None for _, spec in DATASETS.working()):
        return False
    try:
        return bool(open_capture(folder, measure_depth=False).cameras)
    except GgvsError:
        return False
