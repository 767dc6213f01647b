"""What was found against what is wanted: everything missing, extra or unusable, in one list."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.errors import RenderError
from ggvs_eval.renders.wanted import Found, Wanted
from ggvs_eval.run_folder import as_ranges

LISTED = 20


@dataclass(frozen=True)
class Fit:
    """How renders fit a protocol.

    Attributes:
        usable: view -> frames that can be scored, rising; views without any have no entry.
        missing: what is not there, by view.
        faulty: what is there and cannot be used, by view and reason.
        extras: what belongs to no view or frame.
    """

    usable: Mapping[str, tuple[int, ...]]
    missing: tuple[str, ...]
    faulty: tuple[str, ...]
    extras: tuple[str, ...]


def fit(found: Found, wanted: Wanted) -> Fit:
    """Hold what was found against what is wanted."""
    usable, missing, faulty = {}, [], []
    for view in wanted.views:
        rendered = found.views.get(view)
        there = rendered.numbers if rendered else ()
        faults = rendered.faults(wanted.sizes[view]) if rendered else {}
        absent = [frame for frame in wanted.frames if frame not in there]
        if absent:
            lacking = f"all {len(absent)} frames" if not there else as_ranges(absent)
            missing.append(f"{wanted.label} in {view} lacks {lacking}")
        by_fault: dict[str, list[int]] = defaultdict(list)
        for frame, fault in faults.items():
            by_fault[fault].append(frame)
        faulty += [f"{wanted.label} in {view}: {as_ranges(frames)} ({fault})" for fault, frames in by_fault.items()]
        good = tuple(frame for frame in there if frame not in faults)
        if good:
            usable[view] = good
    return Fit(usable, tuple(missing), tuple(faulty), found.extras)


def require_whole(fitted: Fit, path: Path) -> None:
    """Refuse renders that are not exactly what is wanted.

    Raises:
        RenderError: anything missing, extra or unusable; up to 20 of each are named, and all are counted.
    """
    groups = {"frames are missing": fitted.missing, "cannot be used": fitted.faulty, "belongs to nothing": fitted.extras}
    listed = [f"{title}: {_listed(items)}" for title, items in groups.items() if items]
    if listed:
        raise RenderError(f"{path}: {'; '.join(listed)}; render them again, or give --allow-partial to score what fits")


def partial_text(fitted: Fit, wanted: Wanted) -> str:
    """What a row of these renders stands on; empty where nothing is missing.

    Raises:
        RenderError: nothing at all fits.
    """
    if not fitted.usable:
        raise RenderError(
            f"{wanted.label}: not a single frame fits the protocol: {_listed((*fitted.missing, *fitted.faulty))}; "
            "check views, frames and size"
        )
    n_whole = sum(len(frames) == len(wanted.frames) for frames in fitted.usable.values())
    n_frames = sum(len(frames) for frames in fitted.usable.values())
    if n_whole == len(wanted.views):
        return ""
    text = f"{n_whole} of {len(wanted.views)} views complete, {n_frames} of {len(wanted.views) * len(wanted.frames)} frames"
    return f"{text} ({', '.join(fitted.usable)})"


def _listed(items: Sequence[str]) -> str:
    more = f" and {len(items) - LISTED} more" if len(items) > LISTED else ""
    return "; ".join(items[:LISTED]) + more
