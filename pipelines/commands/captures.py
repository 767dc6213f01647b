"""The verbs of the command line that deal with captures alone: demo, check, calibrate, protocol, undistort."""

import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.datasets.assemble import Crop, write_crop
from ggvs_eval.datasets.public_captures import find_scene, get_capture, locate
from ggvs_eval.errors import CaptureError, CommandError, ProtocolError, no_such_path
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.pipelines.commands.flags import (
    CAPTURE_DEFAULTS,
    ONE_PER_CORE,
    CaptureFlags,
    CaptureFolder,
    Jobs,
    Layout,
    Output,
    given_units,
)
from ggvs_eval.pipelines.offline.calibration.calibrate import CalibrationOptions
from ggvs_eval.pipelines.offline.calibration.undistort import UndistortOptions
from ggvs_eval.protocol import Stream, checked_protocol
from ggvs_eval.synthetic.shipped import MAIN, RoomName

MOST_NAMES = 6  # of cameras in one line
Frames = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FRAMES")]
Calibrating = tyro.conf.OmitArgPrefixes[CalibrationOptions]


def demo(out: Output, room: RoomName = MAIN, quick: bool = False) -> None:
    """Unpack a demo capture (a procedural dynamic room) in seconds.

    Args:
        out: folder to write; absent, or holding this demo.
        room: room to unpack: the main one (DyNeRF's layout) or a small one.
        quick: main room, sample renders and a short protocol (a few seconds); other options are ignored.
    """
    from ggvs_eval.synthetic.shipped import write_quick, write_room

    print(write_quick(out) if quick else write_room(out, room))


def get(scene: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="DATASET:SCENE")]) -> None:
    """Download a public capture; its name then works as --capture.

    Examples: n3v:flame_steak, immersive:02_Flames, panoptic:basketball. A stopped download resumes. Size and SHA-256 of the first
    download are stored; a later one must match.

    Args:
        scene: data set and scene; `n3v:` lists the scenes of a data set, `llff` names what to fetch by hand.
    """
    dataset, _ = find_scene(scene)
    print(f"{dataset.title}; licence: {dataset.licence}; {dataset.page}", file=sys.stderr)
    print(get_capture(scene))


def check(
    capture: CaptureFolder,
    layout: Layout = None,
    units: str | None = None,
    out: Path | None = None,
    repair: bool = False,
    crop: Annotated[tuple[int, int] | None, tyro.conf.arg(metavar="COLUMN ROW")] = None,
    jobs: Jobs = ONE_PER_CORE,
    watch: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None,
    rig: Path | None = None,
    page: Path | None = None,
    json: bool = False,
) -> None:
    """Check a capture for faults in frames, poses, timing and colour.

    Prints one verdict per question, writes them as JSON, and exits with 1 if a verdict is bad. Videos without poses get the
    checks that need none.

    Args:
        capture: capture, or videos without poses.
        layout: layout on disk; detected by default.
        units: world units per metre, or a TOML file with a known distance (docs/captures.md).
        out: JSON file; CAPTURE.check.json in the current folder by default.
        repair: write CAPTURE/corrections.toml (whole-frame delays, colour gains), which all commands apply.
        crop: first column and row of cropped frames; written to CAPTURE/crop.toml, which all commands apply.
        jobs: parallel processes, at least 1.
        watch: seconds between checks of a folder during capture; prints changes of a camera's state.
        rig: with --watch: calibrated capture of the same cameras, for time offsets and colours.
        page: with --watch: HTML file of the state, which refreshes itself.
        json: with --watch: print every round as JSON lines.
    """
    if watch is not None:
        _watch(capture, watch, rig, page, json)
        return
    from ggvs_eval.pipelines.inspection.capture.check import run_check
    from ggvs_eval.pipelines.inspection.capture.colour import describe_repair, repair_capture

    capture = locate(capture)
    if not capture.exists():
        raise CaptureError(no_such_path(capture, "a folder or a file with a capture"))
    out = out or Path(f"{capture.resolve().name}.check.json")
    if crop is not None:
        print(write_crop(capture if capture.is_dir() else capture.parent, Crop(*crop)))
    look = partial(run_check, capture, out, layout=layout, units=given_units(units), workers=jobs)
    inspected, table = look()
    if repair and (written := repair_capture(capture, inspected.findings)):
        print(written)
        before = inspected.findings
        inspected, table = look()
        print(*describe_repair(before, inspected.findings), sep="\n")
    print(table)
    print(out)
    if not inspected.is_usable:
        sys.exit(1)


def _watch(frames: Path, every_s: float, rig: Path | None, page: Path | None, as_json: bool) -> None:
    from ggvs_eval.pipelines.inspection.capture.watch import watch

    if not every_s > 0:
        raise CommandError(f"--watch {every_s:g}: wanted a positive number of seconds")
    try:
        for line in watch(frames, every_s, rig=rig and locate(rig), page=page, as_json=as_json):
            print(line, flush=True)
    except KeyboardInterrupt:
        return


def calibrate(frames: Frames, out: Output, calibration: Calibrating = CalibrationOptions()) -> None:  # noqa: B008 - frozen
    """Calibrate a fixed rig from one instant with COLMAP.

    Args:
        frames: videos, folders of images, or one image per camera.
        out: capture to write, absent or empty.
        calibration: known and assumed parameters.
    """
    from ggvs_eval.pipelines.offline.calibration.calibrate import calibrate as find_cameras
    from ggvs_eval.pipelines.offline.calibration.calibrate import own_lens_option

    rig = find_cameras(frames, out, calibration)
    for name, reason in rig.missing.items():
        print(f"{name} left out: {reason}", file=sys.stderr)
    for name, lens in rig.odd_lenses.items():
        print(f"{name} {lens.describe()}: another zoom? calibrate again with {own_lens_option(rig.odd_lenses)}", file=sys.stderr)
    error = f"mean reprojection error {rig.mean_reprojection_error_px:.3f} px over {rig.n_points} points"
    print(f"{rig.path}: {len(rig.cameras)} cameras, {error}")


def protocol(
    capture: CaptureFolder,
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.toml")],
    checked: Annotated[Path | None, tyro.conf.arg(name="check")] = None,
    test: Annotated[tuple[str, ...], tyro.conf.arg(metavar="CAMERA ...")] = (),
    metrics: Annotated[tuple[str, ...], tyro.conf.arg(metavar="METRIC ...")] = (),
    start: int = 0,
    frames: int | None = None,
    path_poses: int | None = None,
    stream: Annotated[float | None, tyro.conf.arg(metavar="FPS")] = None,
    reading: CaptureFlags = CAPTURE_DEFAULTS,
) -> None:
    """Propose a protocol for a capture and explain its test views.

    `run` uses the same protocol if none is given. The file can be edited.

    Args:
        capture: capture.
        out: TOML file to write.
        checked: JSON file of `check`; faulty cameras are not held out.
        test: cameras to hold out as test views; chosen by rule by default.
        metrics: metrics to measure; those of the layout's protocol by default.
        start: first instant to evaluate, from 0.
        frames: number of instants to evaluate, from the first; at most 100 by default.
        path_poses: poses of the camera path for view consistency.
        stream: frame rate of the cameras, fps, at which the displayed frames are also scored.
        reading: capture reading.
    """
    from ggvs_eval.metrics.registry import select_metrics
    from ggvs_eval.pipelines.inspection.capture.check import read_doubts
    from ggvs_eval.pipelines.inspection.table import text_table
    from ggvs_eval.pipelines.run.suggest_protocol import hold_out, propose_protocol, published_protocols

    if out.exists():
        raise ProtocolError(f"{out}: wanted a new file for the protocol, got an existing one; choose another name")
    opened = reading.open(capture)
    doubts = read_doubts(checked) if checked else {}
    proposal = propose_protocol(opened, doubts)
    if test:
        proposal = hold_out(proposal, opened, tuple(dict.fromkeys(test)), doubts)
    chosen = proposal.protocol.shortened(frames, path_poses)
    if not 0 <= start < opened.n_frames:
        raise ProtocolError(f"--start {start}: wanted an instant of {capture}, 0 to {opened.n_frames - 1}")
    chosen = replace(chosen, frames=replace(chosen.frames, start=start, count=min(chosen.frames.count, opened.n_frames - start)))
    if metrics:
        select_metrics(metrics)
        chosen = replace(chosen, measurement=replace(chosen.measurement, metrics=metrics))
    if chosen != proposal.protocol or test:  # a protocol of the user's own spares no frame
        chosen = replace(chosen, measurement=replace(chosen.measurement, lpips_every=1))
    if stream is not None:
        chosen = checked_protocol(chosen.streamed(Stream(fps=stream)), "--stream")
    with atomic_file(out) as unfinished:
        unfinished.write_text(chosen.to_toml(), encoding="utf-8")
    print(text_table({"cameras": 0, "reason for holding out, or not": 1}, _together(proposal.reasons)))
    print(f"{out}: {len(chosen.views.test)} test views, K = {chosen.synthesis.k}, {chosen.frames.count} frames")
    published: dict[str, list[str]] = {}
    for other in published_protocols(opened):
        held = f"{other.name} ({', '.join(other.views.test)} held out, {other.frames.count} frames)"
        published.setdefault(other.dataset, []).append(held)
    for dataset, choices in published.items():
        print(f"if this is {dataset}: --protocol {' or '.join(choices)} evaluates as published")


def _together(reasons: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the cameras of one reason in one line: their names, of many the first, the last and their number."""
    names: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        names.setdefault(reason, []).append(name)
    return [
        (", ".join(each) if len(each) <= MOST_NAMES else f"{each[0]} ... {each[-1]} ({len(each)})", reason)
        for reason, each in names.items()
    ]


def undistort(
    source: Frames,
    out: Output,
    lenses: Path | None = None,
    output: tyro.conf.OmitArgPrefixes[UndistortOptions] = UndistortOptions(),  # noqa: B008 - frozen
) -> None:
    """Convert videos of known lenses to pinhole videos.

    Writes the new intrinsics next to them, for `calibrate`.

    Args:
        source: folder of raw videos, with --lenses; or a capture whose layout includes lenses.
        out: folder to write, absent or empty.
        lenses: lens file of EasyMocap, D3DMV, Qualisys, OpenCV, anipose or freemocap (docs/captures.md).
        output: output format.
    """
    from ggvs_eval.pipelines.offline.calibration.undistort import undistort_videos

    written = undistort_videos(source, lenses, out, output)
    print(f"{written.path}: {len(written.cameras)} cameras of {written.n_frames} frames")
