"""Screens of a run: what each method shows at each instant, from the times that its pictures took; ``stream.json`` for tables."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from ggvs_eval.coverage import Coverage
from ggvs_eval.errors import RenderError
from ggvs_eval.metrics.time.on_screen import Screen, on_screen
from ggvs_eval.pipelines.methods.registry import known_method
from ggvs_eval.protocol import Protocol, Stream
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json, write_json
from ggvs_eval.scoring import Displayed, ScorePart, ScoreRequest

DEPTH, FIT, STATED = "depth", "fit", "stated"  # stages besides those of the method
UNTIMED = "unknown render time; state it in the protocol: [[stream.stated]] method, ms"
WHOLE_CLIP = "offline: it needs the whole clip before its first frame, which is not live"
Clock = dict[str, float]  # stage -> seconds of a picture


def plan_screens(request: ScoreRequest) -> ScorePart:
    """Find what a viewer sees of each method; nothing if the protocol has no stream."""
    clocks = read_clocks(request.run, request.protocol, request.coverage, request.labels)
    displayed = {
        label: screen if isinstance(screen, str) else Displayed(screen.shown, screen.first)
        for label, screen in screens_of(request.protocol, clocks).items()
    }
    write = partial(write_screens, request.run, request.protocol, clocks)
    return ScorePart(write=write, displayed=displayed)


def read_clocks(run: RunFolder, protocol: Protocol, coverage: Coverage, labels: Sequence[str]) -> dict[str, Clock | str]:
    """Time that each method takes for a picture, or why it is not on the screen; nothing if the protocol has no stream."""
    stream = protocol.stream
    if stream is None:
        return {}
    partial = dict.fromkeys(coverage.partial, "partial renders: some frames are missing")
    return {label: partial.get(label) or _clock(run, stream, protocol.views.test, label) for label in labels}


def screens_of(protocol: Protocol, clocks: Mapping[str, Clock | str]) -> dict[str, Screen | str]:
    """Return the displayed frames by these clocks, or why nothing does."""
    return {label: clock if isinstance(clock, str) else _screen(protocol, clock) for label, clock in clocks.items()}


def write_screens(run: RunFolder, protocol: Protocol, clocks: Mapping[str, Clock | str]) -> None:
    """Write ``stream.json``, which the report makes its table of: label -> stages, counts and latency, or the reason."""
    if protocol.stream is None:
        return
    records: dict[str, Any] = {}
    for label, screen in screens_of(protocol, clocks).items():
        clock = clocks[label]
        stages = {} if isinstance(clock, str) else {"stages_ms": {stage: 1000 * each for stage, each in clock.items()}}
        records[label] = stages | ({"absent": screen} if isinstance(screen, str) else screen.record())
    write_json(run.stream_record, {"depth": _depth_note(run, protocol.stream), "methods": records})


def _screen(protocol: Protocol, clock: Clock) -> Screen | str:
    assert protocol.stream is not None
    screen = on_screen([*clock.values()], protocol.frames.count, protocol.stream)
    if screen.first is not None:
        return screen
    stream, seconds = protocol.stream, sum(clock.values())
    if stream.policy == "deadline" and seconds > stream.deadline_ms / 1000:
        return f"no frame in time: one takes {seconds:.3g} s, the deadline is {stream.deadline_ms:g} ms"
    return f"no frame within the clip: one takes {seconds:.3g} s, the clip {protocol.frames.count / stream.fps:.3g} s"


def _clock(run: RunFolder, stream: Stream, views: Sequence[str], label: str) -> Clock | str:
    """Return the median time of each stage over all views without each view's first frame, as the table of times has it."""
    stated = next((each.ms for each in stream.stated if each.method == label), None)
    if stated is not None:
        return {f"{STATED} {at}" if len(stated) > 1 else STATED: ms / 1000 for at, ms in enumerate(stated, 1)}
    files = [run.renders(label, view) / JOB_FILE for view in views]
    records = [read_json(file) for file in files if file.is_file()]
    if not records or "splats" in records[0]["identity"]:
        return UNTIMED
    fits = [record["fit"] for record in records if "fit" in record]
    spec = known_method(label)  # of an unknown one it is assumed that it looks at depth, and sees nothing of the future
    if (spec and not spec.online) or any(fit["look_ahead"] == "sequence" for fit in fits):
        return WHOLE_CLIP
    depth_s = _depth_seconds(run, stream) if spec is None or spec.uses_depth else 0.0
    clock = {DEPTH: depth_s} if depth_s else {}
    if fits:
        clock[FIT] = float(np.mean([fit["seconds"] / fit["instants"] for fit in fits]))
    for stage in records[0]["seconds"]:
        each = [record["seconds"][stage] for record in records]
        clock[stage] = float(np.median(np.concatenate([times[1:] or times for times in each])))
    return clock


def _depth_seconds(run: RunFolder, stream: Stream) -> float:
    """Time of the depth of all sources of a picture: stated, measured where it is live, none if it was computed before."""
    if stream.depth_ms is not None:
        return stream.depth_ms / 1000
    if not run.has_live_depth:
        return 0.0
    if not run.live_depth_record.is_file():
        raise RenderError(f"{run.live_depth_record}: wanted the time of live depth, got no file; run `ggvs-eval run`")
    return float(np.median(read_json(run.live_depth_record)["seconds"]))


def _depth_note(run: RunFolder, stream: Stream) -> str:
    """State which time the depth counts for."""
    if stream.depth_ms is not None:
        return f"{stream.depth_ms:g} ms per frame for the depth of its sources, by the protocol"
    if run.has_live_depth:
        return "with live depth of its sources, measured here"
    return "without depth, which was precomputed (set its time by depth_ms in [stream] of the protocol)"
