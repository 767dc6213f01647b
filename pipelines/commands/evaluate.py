"""The verb of the command line from the videos of a rig to a page: evaluate calls calibrate, check, protocol and run."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.errors import CaptureError, CommandError
from ggvs_eval.jobs.engine import Engine
from ggvs_eval.pipelines.commands import captures, runs
from ggvs_eval.pipelines.commands.captures import Calibrating, DepthFlags, LayoutFlags, Output
from ggvs_eval.pipelines.commands.runs import Device, Labels, Running
from ggvs_eval.pipelines.offline.calibration.calibrate import CalibrationOptions

Videos = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="VIDEOS|CAPTURE")]
CALIBRATED = "calibration.json"  # in a capture that `calibrate` has written whole
VERDICTS = "check.json"


def evaluate(
    videos: Videos,
    out: Output,
    frames: int | None = None,
    repair: bool = False,
    methods: Labels = runs.USUAL_METHODS,
    device: Device = "cpu",
    calibration: Calibrating = CalibrationOptions(),  # noqa: B008 - frozen
    layout: LayoutFlags = captures.LAYOUT_DEFAULTS,
    depth: DepthFlags = captures.DEPTH_DEFAULTS,
    engine: Running = runs.HERE,
) -> None:
    """Calibrate, check and evaluate the videos of a rig in one command.

    Each step is printed as a command: calibrate, check, protocol, run. A bad verdict of `check` stops the evaluation with exit
    code 1. A second call resumes.

    Args:
        videos: one video or image folder per camera; or a capture with poses.
        out: folder to write: capture/, check.json, protocol.toml, run/ with the page.
        frames: number of instants to evaluate, from the first; at most 100 by default.
        repair: correct whole-frame delays and brightness by `check`, then check again.
        methods: methods to evaluate.
        device: device of networks: cpu, cuda or auto.
        calibration: known and assumed parameters.
        layout: capture reading.
        depth: depth estimation.
        engine: job execution.
    """
    if not videos.exists():
        raise CaptureError(f"{videos}: wanted videos, or folders of images, of several cameras, got no such path; check it")
    shown = _Steps()
    capture = out / "capture" if _needs_poses(videos, layout) else videos
    if capture != videos and not (capture / CALIBRATED).is_file():
        shown.begin("calibrate", videos, capture, *runs._flags(calibration, CalibrationOptions()))
        captures.calibrate(videos, capture, calibration)
    reading = runs._flags(layout, captures.LAYOUT_DEFAULTS)
    verdicts, terms = out / VERDICTS, out / "protocol.toml"
    out.mkdir(parents=True, exist_ok=True)
    shown.begin("check", capture, "--out", verdicts, *(["--repair"] if repair else []), *reading)
    try:
        captures.check(capture, layout, verdicts, repair, jobs=engine.jobs)
    except SystemExit:
        raise CommandError(
            f"{capture}: stopped: check found faults, see above and {verdicts}; fix them and run this again "
            f"(--repair corrects delays and brightness), or continue with `ggvs-eval run {out / 'run'} --capture {capture}`"
        ) from None
    whole = captures.ReadingOptions(**vars(layout))
    if not terms.exists():
        count = [] if frames is None else ["--frames", frames]
        shown.begin("protocol", capture, terms, "--check", verdicts, *count, *reading)
        captures.protocol(capture, terms, verdicts, frames=frames, reading=whole)
    elif frames is not None:
        print(f"{terms} is kept, --frames {frames} is ignored; choose another OUT for other frames", file=sys.stderr)
    named = [] if methods == runs.USUAL_METHODS else ["--methods", *methods]
    flags = [*named, *(["--device", device] if device != "cpu" else []), *reading, *runs._flags(depth, captures.DEPTH_DEFAULTS)]
    shown.begin("run", out / "run", "--capture", capture, "--protocol", terms, *flags, *runs._flags(engine, Engine()))
    runs.run(out / "run", capture, str(terms), methods, device=device, reading=whole, depth=depth, engine=engine)


class _Steps:
    """Print each step as a separate command line."""

    def begin(self, *words: object) -> None:
        print(f"$ {shlex.join(['ggvs-eval', *map(str, words)])}", flush=True)


def _needs_poses(path: Path, layout: captures.CaptureOptions) -> bool:
    """Return whether a path holds the frames of several cameras without a calibration."""
    from ggvs_eval.pipelines.inspection.capture.check import open_uncalibrated

    return layout.layout is None and open_uncalibrated(path) is not None
