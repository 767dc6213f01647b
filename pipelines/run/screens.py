"""Screens of a run: what each method shows at each instant, from the times of its pictures, as a
row.

``stream.json`` has the times and counts for tables.
"""

import shutil
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.errors import RenderError
from ggvs_eval.files.atomic import atomic_file, link_file
from ggvs_eval.metrics.time.on_screen import Screen, on_screen
from ggvs_eval.pipelines.methods.registry import known_method
from ggvs_eval.protocol import Protocol, Stream
from ggvs_eval.run_folder import JOB_FILE, ON_SCREEN, RunFolder, frame_path, read_json, write_json
from ggvs_eval.scoring import ScorePart, ScoreRequest

DEPTH, FIT, STATED = "depth", "fit", "stated"  # stages besides those of the method
PARTIAL = "partial renders: some frames are missing"
UNTIMED = "unknown render time; state it in the protocol: [[stream.stated]] method, ms"
WHOLE_CLIP = "offline: it needs the whole clip before its first frame, which is not live"
Clock = dict[str, float]  # stage -> seconds of a picture


def plan_screens(request: ScoreRequest) -> ScorePart:
    """Make a row of what a viewer sees of each method; nothing if the protocol has no stream.

    The record of the stream has label -> stages, counts and latency, or why a method has no row.

    Reading:
        A row has frames from its first picture on. It has no mark of partial renders, with which no
        method that takes time would be ranked: rows are ranked among each other where they are of
        the same instants. A shard lacks the times of the other views and has no such rows.
    """
    run, protocol, coverage = request.run, request.protocol, request.coverage
    stream = protocol.stream
    if stream is None:
        return ScorePart()
    records: dict[str, Any] = {}
    lit: dict[str, Mapping[str, range]] = {}
    for label in request.labels:
        clock = (
            PARTIAL
            if label in coverage.partial
            else _clock(run, stream, protocol.views.test, label)
        )
        screen = clock if isinstance(clock, str) else _screen(protocol, stream, clock)
        stages = (
            {}
            if isinstance(clock, str)
            else {"stages_ms": {stage: 1000 * time for stage, time in clock.items()}}
        )
        records[label] = stages | (
            {"absent": screen} if isinstance(screen, str) else screen.record()
        )
        row = f"{label}{ON_SCREEN}"
        if request.units is not None:
            continue
        if isinstance(screen, str):
            shutil.rmtree(run.renders(row, ""), ignore_errors=True)  # of times that were shorter
        else:
            lit[row] = dict.fromkeys(request.views, _link_displayed(run, protocol, label, screen))
    record = {"depth": _depth_note(run, stream), "methods": records}
    return ScorePart(write=partial(write_json, run.stream_record, record), partial=lit)


def _link_displayed(run: RunFolder, protocol: Protocol, label: str, screen: Screen) -> range:
    """Link the displayed frame of each scored instant in the row's folder.

    Return these instants.
    """
    start = protocol.frames.start
    links: dict[Path, Path] = {}
    for view in protocol.views.test:
        for instant, frame in screen.scored.items():
            picture = frame_path(run.renders(label, view), start + frame)
            links[frame_path(Path(view), start + instant)] = picture
    folder = run.renders(f"{label}{ON_SCREEN}", "")
    inodes = {file.relative_to(folder): file.stat().st_ino for file in folder.glob("*/*.png")}
    for name, file in links.items():  # one by one, because another process may read them
        if inodes.pop(name, None) != file.stat().st_ino:
            with atomic_file(folder / name) as temporary:
                link_file(file, temporary)
    for name in inodes:
        (folder / name).unlink(missing_ok=True)
    return range(start + min(screen.scored), protocol.frames.numbers.stop)


def _screen(protocol: Protocol, stream: Stream, clock: Clock) -> Screen | str:
    screen = on_screen([*clock.values()], protocol.frames.count, stream)
    if screen.scored:
        return screen
    seconds = sum(clock.values())
    if stream.policy == "deadline" and seconds > stream.deadline_ms / 1000:
        return (
            f"no frame in time: one takes {seconds:.3g} s, the deadline is "
            f"{stream.deadline_ms:g} ms"
        )
    return (
        f"no frame within the clip: one takes {seconds:.3g} s, the clip "
        f"{protocol.frames.count / stream.fps:.3g} s"
    )


def _clock(run: RunFolder, stream: Stream, views: Sequence[str], label: str) -> Clock | str:
    """Return the median time of each stage over all views without each view's first frame, as the
    table of times has it.
    """
    stated = next((times.ms for times in stream.stated if times.method == label), None)
    if stated is not None:
        return {
            f"{STATED} {at}" if len(stated) > 1 else STATED: ms / 1000
            for at, ms in enumerate(stated, 1)
        }
    files = [run.renders(label, view) / JOB_FILE for view in views]
    records = [read_json(file) for file in files if file.is_file()]
    if not records or "splats" in records[0]["identity"]:
        return UNTIMED
    fits = [record["fit"] for record in records if "fit" in record]
    # of an unknown one it is assumed that it looks at depth, and sees nothing of the future
    spec = known_method(label)
    if (spec and not spec.online) or any(fit["look_ahead"] == "sequence" for fit in fits):
        return WHOLE_CLIP
    depth_s = _depth_seconds(run, stream) if spec is None or spec.uses_depth else 0.0
    clock = {DEPTH: depth_s} if depth_s else {}
    if fits:
        clock[FIT] = float(np.mean([fit["seconds"] / fit["instants"] for fit in fits]))
    for stage in records[0]["seconds"]:
        seconds_by_view = [record["seconds"][stage] for record in records]
        clock[stage] = float(
            np.median(np.concatenate([times[1:] or times for times in seconds_by_view]))
        )
    return clock


def _depth_seconds(run: RunFolder, stream: Stream) -> float:
    """Time of the depth of all sources of a picture: stated, measured where it is live, none if it
    was computed before.
    """
    if stream.depth_ms is not None:
        return stream.depth_ms / 1000
    if not run.has_live_depth:
        return 0.0
    if not run.live_depth_record.is_file():
        raise RenderError(
            f"{run.live_depth_record}: wanted the time of live depth, got no file; run `ggvs-eval "
            f"run`"
        )
    return float(np.median(read_json(run.live_depth_record)["seconds"]))


def _depth_note(run: RunFolder, stream: Stream) -> str:
    """State which time the depth counts for."""
    if stream.depth_ms is not None:
        return f"{stream.depth_ms:g} ms per frame for the depth of its sources, by the protocol"
    if run.has_live_depth:
        return "with live depth of its sources, measured here"
    return (
        "without depth, which was precomputed (set its time by depth_ms in [stream] of the "
        "protocol)"
    )
