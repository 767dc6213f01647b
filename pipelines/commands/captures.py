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
from ggvs_eval.errors import CaptureError, CommandError, ProtocolError
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
    """Unpack a demo capture that ships: a procedural dynamic room in the layout of a data set.

    With any option of `ggvs-eval film` another one is filmed.

    Args:
        out: folder to write; absent, or holding this very demo.
        room: the main one, in DyNeRF's layout, or a small one.
        quick: the main room, sample renders and a short protocol (a few seconds).
    """
    from ggvs_eval.synthetic.shipped import write_quick, write_room

    print(write_quick(out) if quick else write_room(out, room))


def get(scene: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="DATASET:SCENE")]) -> None:
    """Fetch a public capture from where its authors publish it; its name then serves as --capture.

    n3v:flame_steak, immersive:02_Flames, panoptic:basketball, ... A download that was stopped goes on; size and SHA-256 of the
    first one are kept, and a later one must be the same.

    Args:
        scene: data set and scene; `n3v:` lists those of a data set.
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
    """Check a capture for problems: frames, poses, intrinsics, timing, colour, epipolar geometry, overlap.

    Prints a verdict per question, writes them as JSON, and ends with 1 where a verdict is bad. Videos that have no poses yet are
    checked for what can be said without.

    Args:
        capture: the capture.
        layout: on disk; detected by default.
        units: world units per metre, or a TOML file with a known baseline or two marked points (docs/captures.md).
        out: JSON file; CAPTURE.check.json in the current folder by default.
        repair: write CAPTURE/corrections.toml, by which every command shifts cameras that are out of step by whole frames and
            divides the colours of those that are brighter or darker; then check again. Written is only what lies outside of its
            interval: no fraction of a frame, no offset or gain that changes within the clip.
        crop: frames are a part of the pictures that the calibration was made for, and begin with this column and row of them:
            write it into CAPTURE/crop.toml, which every command obeys, and check.
        jobs: processes.
        watch: look every so many seconds at a folder that is being filmed to, and print a line when a camera's state changes:
            moved, out of step, frames lost or frozen, exposure drifts.
        rig: with --watch: capture of the same cameras with poses, for time offsets and colours.
        page: with --watch: HTML file that shows the state and refreshes itself.
        json: with --watch: print every round as JSON lines.
    """
    if watch is not None:
        _watch(capture, watch, rig, page, json)
        return
    from ggvs_eval.pipelines.inspection.capture.check import run_check
    from ggvs_eval.pipelines.inspection.capture.colour import describe_repair, repair_capture

    capture = locate(capture)
    if not capture.exists():
        raise CaptureError(f"{capture}: wanted a folder or a file with a capture, there is none; check the path")
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
    """Find the cameras of a fixed rig from one instant, with COLMAP, and write them as a capture that every verb reads.

    Args:
        frames: videos, folders of images or one image per camera.
        out: capture to write, absent or empty.
        calibration: what is known and what is assumed.
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
    frames: int | None = None,
    path_poses: int | None = None,
    stream: Annotated[float | None, tyro.conf.arg(metavar="FPS")] = None,
    reading: CaptureFlags = CAPTURE_DEFAULTS,
) -> None:
    """Propose a protocol for a capture, and say of every camera why it is held out as a test view or not.

    It is the one that `run` takes when none is given; the file is yours to change.

    Args:
        capture: the capture.
        out: TOML file to write.
        checked: JSON file that `check` wrote; cameras that it found fault with are not held out, as they would be a wrong truth.
        test: cameras to hold out as test views, in place of those that a rule chooses.
        metrics: what to measure, in place of what the protocol of this layout does.
        frames: evaluate the first so many instants, for a first look; up to 100 by default.
        path_poses: poses of the camera path on which consistency over views is measured.
        stream: also score what is on a screen while cameras deliver so many frames per second, see `Stream` in the docs.
        reading: how the capture is read.
    """
    from ggvs_eval.metrics.registry import select_metrics
    from ggvs_eval.pipelines.inspection.capture.check import read_doubts
    from ggvs_eval.pipelines.inspection.table import text_table
    from ggvs_eval.pipelines.run.suggest_protocol import hold_out, propose_protocol, published_protocols

    if out.exists():
        raise ProtocolError(f"{out}: wanted a new file for the protocol, it is there already; choose another name")
    opened = reading.open(capture)
    doubts = read_doubts(checked) if checked else {}
    proposal = propose_protocol(opened, doubts)
    if test:
        proposal = hold_out(proposal, opened, tuple(dict.fromkeys(test)), doubts)
    chosen = proposal.protocol.shortened(frames, path_poses)
    if metrics:
        select_metrics(metrics)
        chosen = replace(chosen, measurement=replace(chosen.measurement, metrics=metrics))
    if chosen != proposal.protocol or test:  # a protocol of the user's own spares no frame
        chosen = replace(chosen, measurement=replace(chosen.measurement, lpips_every=1))
    if stream is not None:
        chosen = checked_protocol(chosen.streamed(Stream(fps=stream)), "--stream")
    with atomic_file(out) as unfinished:
        unfinished.write_text(chosen.to_toml(), encoding="utf-8")
    print(text_table({"cameras": 0, "why they are held out, or not": 1}, _together(proposal.reasons)))
    print(f"{out}: {len(chosen.views.test)} test views, K = {chosen.synthesis.k}, {chosen.frames.count} frames")
    published: dict[str, list[str]] = {}
    for other in published_protocols(opened):
        held = f"{other.name} ({', '.join(other.views.test)} held out, {other.frames.count} frames)"
        published.setdefault(other.dataset, []).append(held)
    for dataset, choices in published.items():
        print(f"if this is {dataset}: --protocol {' or '.join(choices)} evaluates as published")


def _together(reasons: Mapping[str, str]) -> list[tuple[str, str]]:
    """Cameras of one reason in one line: their names, of many the first, the last and their number."""
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
    """Write raw videos of known lenses as pinhole videos, with the new intrinsics beside them for `calibrate`.

    Args:
        source: folder of raw videos, with --lenses; or any capture whose layout knows its lenses.
        out: folder to write, absent or empty.
        lenses: intri.yml (EasyMocap), calib_1080.pkl or calib_2k.pkl (D3DMV; read, never unpickled), .qca.txt (Qualisys), YAML of
            OpenCV, or a TOML file, of anipose or freemocap too.
        output: how frames are written.
    """
    from ggvs_eval.pipelines.offline.calibration.undistort import undistort_videos

    written = undistort_videos(source, lenses, out, output)
    print(f"{written.path}: {len(written.cameras)} cameras of {written.n_frames} frames")
