"""The verb of the command line from the videos of a rig to a page: evaluate calls calibrate, check,
protocol and run.
"""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.capture import Capture
from ggvs_eval.errors import CaptureError, CommandError, no_such_path
from ggvs_eval.pipelines.commands import calibrate, captures, check, runs
from ggvs_eval.pipelines.commands.calibrate import Calibrating
from ggvs_eval.pipelines.commands.flags import (
    CAPTURE_DEFAULTS,
    DEPTH_DEFAULTS,
    HERE,
    USUAL_METHODS,
    CaptureFlags,
    DepthFlags,
    Device,
    Labels,
    Output,
    Poses,
    Running,
    changed_flags,
)
from ggvs_eval.pipelines.offline.calibration.calibrate import CalibrationOptions
from ggvs_eval.run_folder import RunFolder, read_json, write_json

Videos = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="VIDEOS|CAPTURE")]
# Of raw videos of one make. `calibrate` assumes less; with own pinhole lenses the rig of
# docs/your_rig.md fails its check.
RAW_VIDEOS = CalibrationOptions(camera_model="SIMPLE_RADIAL", shared_intrinsics=True)
CALIBRATED = "calibration.json"  # in a capture that `calibrate` has written whole
VERDICTS = "check.json"
FRAMES = "frames.json"  # camera -> digest of the frames that all is made from


def evaluate(
    videos: Videos,
    out: Output,
    frames: int | None = None,
    repair: bool = False,
    methods: Labels = USUAL_METHODS,
    poses: Poses = None,
    device: Device = "cpu",
    calibration: Calibrating = RAW_VIDEOS,
    reading: CaptureFlags = CAPTURE_DEFAULTS,
    depth: DepthFlags = DEPTH_DEFAULTS,
    engine: Running = HERE,
) -> None:
    """Calibrate, check and evaluate the videos of a rig in one command.

    Each step is printed as a command: calibrate, check, protocol, run. A bad verdict of `check`
    stops the evaluation with exit code 1, unless it is on poses alone and these are to be refined.
    A second call resumes.

    Args:
        videos: one video or image folder per camera; or a capture with poses.
        out: folder to write: capture/, check.json, protocol.toml, run/ with the page.
        frames: number of instants to evaluate, from the first; at most 100 by default.
        repair: correct whole-frame delays, brightness, and unequal lengths and rates by `check`,
            then check again.
        methods: methods to evaluate.
        poses: cameras given, refined, or compare: refined if source cameras render better; the
            protocol's by default.
        device: device of networks: cpu, cuda or auto.
        calibration: known and assumed parameters; by default one lens for all cameras, with one
            distortion coefficient.
        reading: capture reading.
        depth: depth estimation.
        engine: job execution.
    """
    if not videos.exists():
        raise CaptureError(no_such_path(videos, "videos, or folders of images, of several cameras"))
    from ggvs_eval.pipelines.inspection.capture.check import open_uncalibrated, pair_by_time
    from ggvs_eval.pipelines.inspection.capture.epipolar_findings import QUESTION as POSES_QUESTION

    steps = _Steps()
    if repair and (paired := pair_by_time(videos)):
        print(paired)
    uncalibrated = open_uncalibrated(videos) if reading.layout is None else None
    capture = out / "capture" if uncalibrated else videos
    if uncalibrated:
        _require_same(out, uncalibrated)
        if not (capture / CALIBRATED).is_file():
            steps.begin(
                "calibrate", videos, capture, *changed_flags(calibration, CalibrationOptions())
            )
            calibrate.calibrate(videos, capture, calibration)
        elif lenses := changed_flags(calibration, RAW_VIDEOS):
            print(
                f"{capture} is kept, {' '.join(lenses)} are ignored; choose another OUT for others",
                file=sys.stderr,
            )
    flags = changed_flags(reading, CAPTURE_DEFAULTS)
    # what `check` takes of them
    opened = [*_flag("--layout", reading.layout), *_flag("--units", reading.units)]
    verdicts, terms = out / VERDICTS, out / "protocol.toml"
    out.mkdir(parents=True, exist_ok=True)
    steps.begin("check", capture, "--out", verdicts, *(["--repair"] if repair else []), *opened)
    try:
        check.check(capture, reading.layout, reading.units, verdicts, repair, jobs=engine.jobs)
    except SystemExit:
        faults = {
            finding["question"]
            for finding in read_json(verdicts)["findings"]
            if finding["verdict"] == "bad"
        }
        if poses not in ("refined", "compare") or faults != {POSES_QUESTION}:
            raise CommandError(
                f"{capture}: stopped: check found faults, see above and {verdicts}; fix them and "
                "run this again (--repair corrects delays and brightness, --calibration compare "
                "poses that are slightly off; cameras of different lenses: another OUT with "
                f"--no-shared-intrinsics), or continue with `ggvs-eval run {out / 'run'} --capture "
                f"{capture}`"
            ) from None
        print(
            f"{capture}: check found poses alone at fault, which --calibration {poses} adjusts",
            file=sys.stderr,
        )
    if not terms.exists():
        count = [] if frames is None else ["--frames", frames]
        steps.begin("protocol", capture, terms, "--check", verdicts, *count, *flags)
        captures.protocol(capture, terms, verdicts, frames=frames, reading=reading)
    elif frames is not None:
        print(
            f"{terms} is kept, --frames {frames} is ignored; choose another OUT for other frames",
            file=sys.stderr,
        )
    named = [] if methods == USUAL_METHODS else ["--methods", *methods]
    flags = [
        *named,
        *_flag("--calibration", poses),
        *([] if device == "cpu" else ["--device", device]),
        *flags,
    ]
    flags += [*changed_flags(depth, DEPTH_DEFAULTS), *changed_flags(engine, HERE)]
    write_json(RunFolder(out / "run").check_record, read_json(verdicts))
    steps.begin("run", out / "run", "--capture", capture, "--protocol", terms, *flags)
    runs.run(
        out / "run",
        capture,
        str(terms),
        methods,
        poses=poses,
        device=device,
        reading=reading,
        depth=depth,
        engine=engine,
    )


def _require_same(out: Path, videos: Capture) -> None:
    """Refuse a folder that holds the evaluation of other videos.

    One of an earlier version does not say of which.
    """
    record, digests = out / FRAMES, {name: videos.digest(name) for name in videos.camera_names}
    if record.is_file() and read_json(record) != digests:
        raise CaptureError(
            f"{out}: holds the evaluation of other frames than {videos.path} has; choose another "
            f"OUT"
        )
    write_json(record, digests)


class _Steps:
    """Print each step as a separate command line."""

    def begin(self, *words: object) -> None:
        print(f"$ {shlex.join(['ggvs-eval', *map(str, words)])}", flush=True)


def _flag(name: str, value: str | None) -> list[str]:
    return [] if value is None else [name, value]
