"""Supported kinds of renders, and the detection of the kind of a folder or file."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.errors import RenderError
from ggvs_eval.files.listing import list_entries, list_files_below
from ggvs_eval.renders import beside_truth, view_folders, view_streams
from ggvs_eval.renders.request import FrameRequest, RenderSet
from ggvs_eval.renders.view_folders import instead_of_all


@dataclass(frozen=True)
class Kind:
    """One way in which renders are on disk.

    Attributes:
        describe: what messages and records call it.
        refuse: why a path is not of this kind, in a few words; None if it is.
        files: what it is made of; enough to notice a change.
        find: views and frames; the flag marks temporary files, which are moved.
    """

    describe: str
    refuse: Callable[[Path, FrameRequest], str | None]
    files: Callable[[Path, FrameRequest], list[Path]]
    find: Callable[[Path, FrameRequest, bool], RenderSet]


KINDS = {
    "run": Kind(
        describe="a run folder",
        refuse=view_folders.refuse_run,
        files=view_folders.run_files,
        find=view_folders.find_run,
    ),
    "easyvolcap": Kind(
        describe="EasyVolcap output",
        refuse=beside_truth.refuse_easyvolcap,
        files=beside_truth.easyvolcap_files,
        find=beside_truth.find_easyvolcap,
    ),
    "flat": Kind(
        describe="renders next to copies of the reference",
        refuse=beside_truth.refuse_flat_set,
        files=beside_truth.flat_set_files,
        find=beside_truth.find_flat_set,
    ),
    "videos": Kind(
        describe="one video per view",
        refuse=view_streams.refuse_videos,
        files=view_streams.video_files,
        find=view_streams.find_videos,
    ),
    "arrays": Kind(
        describe="one array per view",
        refuse=view_streams.refuse_arrays,
        files=view_streams.array_files,
        find=view_streams.find_arrays,
    ),
    "folders": Kind(
        describe="<view>/<frame>.png",
        refuse=view_folders.refuse_folders,
        files=view_folders.folder_files,
        find=view_folders.find_folders,
    ),
    "names": Kind(
        describe="<view>_<frame>.png",
        refuse=view_folders.refuse_flat,
        files=view_folders.flat_files,
        find=view_folders.find_flat,
    ),
}
SEVERAL = "several"  # how reasons begin that ask to choose among renders which are there
LISTED, LEVELS = 8, 3
WEAKEST = "names"  # pictures can be next to the renders


def detect(path: Path, request: FrameRequest) -> str:
    """Return the kind of some renders, a key of `KINDS`."""
    reasons = {name: kind.refuse(path, request) for name, kind in KINDS.items()}
    fitting = [name for name, reason in reasons.items() if reason is None]
    if len(fitting) > 1 and WEAKEST in fitting:
        fitting.remove(WEAKEST)
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        listed = " and ".join(KINDS[name].describe for name in fitting)
        raise RenderError(f"{path}: holds {listed} at once; give a folder that holds one of them")
    instead = instead_of_all(path, request)
    if instead:
        raise RenderError(
            f"{path}: no renders of {', '.join(request.views)} that can be read: {instead}"
        )
    if (inner := _fitting_folder(path, request)) is not None:
        raise RenderError(
            f"{path}: no renders of {', '.join(request.views)} here, but in "
            f"{inner.relative_to(path)}/; give {inner}"
        )
    near = {
        name: reason for name, reason in reasons.items() if reason and reason.startswith(SEVERAL)
    }
    listed = "; ".join(
        f"{KINDS[name].describe}: {reason}" for name, reason in (near or reasons).items()
    )
    content = contents(path)
    prefix = f"holds {content}, but " if content and not near else ""
    raise RenderError(
        f"{path}: {prefix}no renders of {', '.join(request.views)} that can be read: {listed}"
    )


def _fitting_folder(path: Path, request: FrameRequest) -> Path | None:
    """Return the only folder below, at most `LEVELS` deep, that holds renders of some kind."""
    level, below = [path], []
    for _ in range(LEVELS):
        inner = [
            entry
            for folder in level
            for entry in list_entries(folder)
            if entry.name not in beside_truth.OTHER_SPLITS
        ]
        level = [entry for entry in inner if entry.is_dir()][: 4 * LISTED]
        below += level
    fitting = [
        folder
        for folder in below
        if any(kind.refuse(folder, request) is None for kind in KINDS.values())
    ]
    return fitting[0] if len(fitting) == 1 else None


def contents(path: Path) -> str:
    """Name what a folder holds, folders with the number of pictures below them.

    Empty for a file or an empty folder.
    """
    entries = list_entries(path)
    names = [
        f"{entry.name}/ ({len(list_files_below(entry))} pictures)" if entry.is_dir() else entry.name
        for entry in entries[:LISTED]
    ]
    return ", ".join(names) + (
        f" and {len(entries) - LISTED} more" if len(entries) > LISTED else ""
    )
