"""The check of a capture: open it, walk once through every camera's frames, and answer the
questions.

World units per metre, where they come from and the sizes that they imply; and frames without a
calibration yet.
"""

import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera, pinhole_K
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import detect_layout, open_capture
from ggvs_eval.datasets.assemble import assemble_capture
from ggvs_eval.datasets.camera_frames import CameraFrames, find_rig_frames, rig_frames
from ggvs_eval.datasets.instants import write_pairing
from ggvs_eval.datasets.refusal import calibration_mark
from ggvs_eval.datasets.units import GivenUnits, Units
from ggvs_eval.datasets.unread_files import unused_note
from ggvs_eval.errors import CaptureError, GgvsError, OutOfStepError
from ggvs_eval.finding import RIG, Finding
from ggvs_eval.jobs.processes import worker_pool
from ggvs_eval.pipelines.inspection.capture import (
    colour,
    colour_drift,
    depth_range,
    epipolar_findings,
    frames,
    lens,
    poses,
    stillness,
    timing,
)
from ggvs_eval.pipelines.inspection.capture.depth_range import neighbour_spacing
from ggvs_eval.pipelines.inspection.capture.depth_registration import (
    REGISTRATION_QUESTION,
    check_depth_registration,
)
from ggvs_eval.pipelines.inspection.capture.pairs import triangulated_depths
from ggvs_eval.pipelines.inspection.capture.records import CameraRecord, record_camera
from ggvs_eval.pipelines.inspection.table import WIDTH, findings_table
from ggvs_eval.progress import track
from ggvs_eval.run_folder import write_json

SIZE_QUESTION = "units"
GUESS = "guess"
# Rooms, stages and streets; rigs from a phone's pair of lenses to a stadium's.
SCENE_M, SPACING_M = (0.2, 100.0), (0.005, 10.0)
LAYOUT = "no calibration"
OPENS = "opens"


@dataclass(frozen=True)
class CaptureCheck:
    """Everything that was found out about one capture.

    Attributes:
        findings: in the order of the questions; per question the rig first, then its cameras.
    """

    path: Path
    findings: tuple[Finding, ...]
    seconds: float = 0.0

    @property
    def is_usable(self) -> bool:
        """True if nothing was found that would spoil results."""
        return all(finding.verdict != "bad" for finding in self.findings)

    def of(self, question: str) -> tuple[Finding, ...]:
        """Return the answers to one question."""
        return tuple(finding for finding in self.findings if finding.question == question)

    def to_json(self) -> dict[str, Any]:
        """Return the check as plain values for a JSON file."""
        findings = [
            {**asdict(finding), "values": dict(finding.values)} for finding in self.findings
        ]
        return {
            "capture": str(self.path),
            "is_usable": self.is_usable,
            "seconds": round(self.seconds, 2),
            "findings": findings,
        }

    def table(self, width: int = WIDTH) -> str:
        """Return the check as text: one line per question, and one for each group of cameras that
        deviate.
        """
        return findings_table(self.findings, width)


def check_capture(
    path: Path, *, layout: str | None = None, units: GivenUnits = None, workers: int = 1
) -> CaptureCheck:
    """Find faults of a capture that would spoil results.

    Every frame is decoded once. A capture that does not open gives one bad finding, and the
    findings of its frames; a frame that cannot be read is a finding too, and the other cameras
    continue.
    """
    start = time.perf_counter()
    try:
        uncalibrated = open_uncalibrated(path) if layout is None else None
        capture = uncalibrated or open_capture(path, layout, units=units)
    except GgvsError as error:
        return CaptureCheck(
            path, _examine_unopened(path, str(error), workers), time.perf_counter() - start
        )
    records = record_cameras(capture, workers)
    if uncalibrated:
        findings = examine_frames(ExaminedRig(capture, records))
        advice = f"ggvs-eval calibrate {capture.path} RIG, then check RIG"
        unanswered = _unanswered(findings)
        findings += tuple(
            Finding(
                subject=RIG,
                question=question,
                verdict="unknown",
                measured="no calibration yet",
                values={},
                advice=advice,
            )
            for question in unanswered
        )
    else:
        findings = examine(ExaminedRig(capture, records))
    return CaptureCheck(path, findings, time.perf_counter() - start)


def run_check(
    path: Path,
    out_json: Path | None = None,
    *,
    layout: str | None = None,
    units: GivenUnits = None,
    workers: int = 1,
) -> tuple[CaptureCheck, str]:
    """Check a capture and write the outcome; nothing is printed.

    Args:
        out_json: file to write the findings to; none when None.

    Returns:
        The check and its table as text.
    """
    check = check_capture(path, layout=layout, units=units, workers=workers)
    if out_json is not None:
        write_json(out_json, check.to_json())
    return check, check.table()


def record_cameras(capture: Capture, workers: int) -> list[CameraRecord]:
    """Walk through the frames of all cameras, one process per camera at a time."""
    names = capture.camera_names
    if min(workers, len(names)) <= 1:
        return [record_camera(capture, name) for name in track(names, "reading frames")]
    with worker_pool(min(workers, len(names))) as pool:
        jobs = [pool.submit(record_camera, capture, name) for name in names]
        for job in track(as_completed(jobs), "reading frames", len(jobs)):
            job.result()
    return [job.result() for job in jobs]


@dataclass(frozen=True)
class ExaminedRig:
    """A capture whose frames have been read once, as the questions look at it.

    Attributes:
        records: of the frames of each camera.
    """

    capture: Capture
    records: Sequence[CameraRecord]

    @cached_property
    def calibration(self) -> epipolar_findings.ClipVerdict:
        """What matches between the cameras say of their poses."""
        frames = sorted({*self.records[0].instants, 0})
        instants = {
            frame: [record.instants.get(frame) for record in self.records] for frame in frames
        }
        return epipolar_findings.check_clip(self.capture.cameras, instants)

    @cached_property
    def depths(self) -> Mapping[int, Array]:
        """Depths of triangulated matches of the first instant by camera, world units."""
        return triangulated_depths(
            self.capture.cameras, self.calibration.at[0].pairs, self.calibration.trusted
        )


def examine_frames(rig: ExaminedRig) -> tuple[Finding, ...]:
    """Answer the questions that need frames alone."""
    return tuple(finding for question in OF_FRAMES for finding in ANSWERS[question](rig))


def examine(rig: ExaminedRig) -> tuple[Finding, ...]:
    """Answer every question from the cameras and what was recorded of their frames."""
    return tuple(finding for answer in ANSWERS.values() for finding in answer(rig))


def _examine_unopened(path: Path, message: str, workers: int) -> tuple[Finding, ...]:
    """Report why a capture does not open, and findings on its frames if there are some."""
    findings: tuple[Finding, ...] = (
        Finding(
            subject=RIG,
            question=OPENS,
            verdict="bad",
            measured=message,
            values={},
            advice="fix this first",
        ),
    )
    try:
        filmed = uncalibrated_capture(path, find_rig_frames(path))
        findings += examine_frames(ExaminedRig(filmed, record_cameras(filmed, workers)))
    except GgvsError:
        pass  # no frames of a rig; the first finding says what is wrong
    return (
        *findings,
        *(
            Finding(
                subject=RIG,
                question=question,
                verdict="unknown",
                measured="the capture does not open",
            )
            for question in _unanswered(findings)
        ),
    )


def pair_by_time(path: Path) -> str:
    """Make all commands pair the frames of a capture by time where they are out of step.

    Gives the file and what it does.
    """
    try:
        if not open_uncalibrated(path):
            open_capture(path, measure_depth=False)
    except OutOfStepError:
        return f"{write_pairing(path)}: frames are paired by the times in videos"
    except GgvsError:
        pass  # the check reports it
    return ""


def _unanswered(findings: Iterable[Finding]) -> tuple[str, ...]:
    answered = {finding.question for finding in findings}
    return tuple(question for question in QUESTIONS if question not in answered)


def check_scale(capture: Capture, depths: Mapping[int, Array]) -> tuple[Finding, ...]:
    """Evaluate the scale by the metres it gives for the scene's depth and the cameras' spacing.

    Args:
        depths: depths of triangulated matches per camera, world units, if there are any.
    """
    medians = [float(np.median(values)) for values in depths.values() if len(values)]
    depth = float(
        np.median(medians or [np.sqrt(camera.near * camera.far) for camera in capture.cameras])
    )
    depth_m = depth / capture.units_per_metre
    spacing_m = (
        float(np.median(neighbour_spacing(capture.cameras))) / capture.units_per_metre
        if len(capture.cameras) > 1
        else np.nan
    )
    values: dict[str, object] = {
        "units_per_metre": capture.units_per_metre,
        "origin": capture.units_origin,
        "median_depth_m": round(depth_m, 4),
    }
    if capture.units_origin.startswith(GUESS):
        return (_guessed(capture, depth, spacing_m * capture.units_per_metre, values),)
    text = (
        f"{capture.units_per_metre:.4g} units per metre ({capture.units_origin}): scene "
        f"{depth_m:.2f} m away"
    )
    if np.isfinite(spacing_m):
        values["spacing_m"] = round(spacing_m, 4)
        text += f", neighbours {100 * spacing_m:.0f} cm apart"
    if not SCENE_M[0] < depth_m < SCENE_M[1] or not (
        np.isnan(spacing_m) or SPACING_M[0] < spacing_m < SPACING_M[1]
    ):
        return (
            Finding(
                subject=RIG,
                question=SIZE_QUESTION,
                verdict="warn",
                measured=text,
                values=values,
                advice="measure a baseline and give the units (--units)",
            ),
        )
    return (
        Finding(subject=RIG, question=SIZE_QUESTION, verdict="ok", measured=text, values=values),
    )


def _guessed(capture: Capture, depth: float, spacing: float, values: dict[str, object]) -> Finding:
    """Return the finding in world units, for a capture of which nothing is known in metres."""
    near, far = (
        min(camera.near for camera in capture.cameras),
        max(camera.far for camera in capture.cameras),
    )
    text = (
        f"unknown scale; in world units the scene is within {near:.3g} .. {far:.3g}, "
        f"{depth:.3g} at the median"
    )
    if np.isfinite(spacing):
        values["spacing_units"] = round(spacing, 4)
        text += f", neighbours {spacing:.3g} apart"
    text += f"; {capture.units_per_metre:.4g} units per metre assumed ({capture.units_origin})"
    advice = (
        "measure one baseline or two points and give it (units.toml); thresholds in metres "
        "depend on it"
    )
    return Finding(
        subject=RIG,
        question=SIZE_QUESTION,
        verdict="warn",
        measured=text,
        values=values,
        advice=advice,
    )


# In the order of the table; a check of your own is one line here.
ANSWERS: Mapping[str, Callable[[ExaminedRig], tuple[Finding, ...]]] = {
    frames.FRAMES: lambda rig: frames.check_frames(rig.capture, rig.records),
    frames.FROZEN: lambda rig: frames.check_frozen(rig.records, rig.capture.fps),
    stillness.QUESTION: lambda rig: stillness.check_stillness(
        rig.capture.cameras, rig.records, rig.capture.fps
    ),
    poses.POSES_QUESTION: lambda rig: poses.check_poses(
        rig.capture.cameras, rig.calibration.suspects
    ),
    poses.INTRINSICS_QUESTION: lambda rig: poses.check_intrinsics(rig.capture.cameras),
    lens.QUESTION: lambda rig: lens.check_lens(rig.capture),
    depth_range.DEPTH_QUESTION: lambda rig: depth_range.check_depth_range(
        rig.capture.cameras, rig.depths, rig.calibration.suspects
    ),
    depth_range.OVERLAP_QUESTION: lambda rig: depth_range.check_overlap(
        rig.capture.cameras, rig.capture.sensed_cameras
    ),
    epipolar_findings.QUESTION: lambda rig: rig.calibration.findings,
    timing.QUESTION: lambda rig: timing.check_timing(
        rig.capture.cameras, rig.records, rig.calibration.suspects, rig.capture.fps
    ),
    timing.DROPPED: lambda _: (),  # answered with the offset
    colour.GAIN: lambda rig: colour.check_gain(rig.capture.camera_names, rig.calibration.pairs),
    colour.DRIFT: lambda rig: colour_drift.check_drift(
        rig.capture.camera_names, rig.records, rig.calibration.at[0].pairs, rig.capture.fps
    ),
    colour.NOISE: lambda rig: colour.check_noise(rig.records),
    SIZE_QUESTION: lambda rig: check_scale(rig.capture, rig.depths),
    REGISTRATION_QUESTION: lambda rig: check_depth_registration(rig.capture),
}
# that every capture has
QUESTIONS = tuple(question for question in ANSWERS if question != REGISTRATION_QUESTION)
OF_FRAMES = (frames.FRAMES, frames.FROZEN, stillness.QUESTION, colour.NOISE)  # that need no poses


def open_uncalibrated(path: Path) -> Capture | None:
    """Open the frames of a folder that is no capture yet.

    None if it is one, or holds no frames of two cameras.

    A folder that shows a calibration is none of these, though nothing can read it whole.

    The cameras are placeholders at one place, which nothing may be computed from.

    Raises:
        CaptureError: a calibration that cannot be read, or frames that do not fit each other, as
            those of one capture must.
    """
    try:
        detect_layout(path)
    except CaptureError:
        if calibration_mark(path):
            raise
    else:
        return None
    files = rig_frames(path)
    if not files:
        return None
    capture = uncalibrated_capture(path, files)
    paths = {os.path.abspath(file.path) for file in files.values()}
    return replace(capture, notes=(*capture.notes, *unused_note(path, paths, capture.notes)))


def uncalibrated_capture(path: Path, files: Mapping[str, CameraFrames]) -> Capture:
    """Return the frames by the names of their cameras as a capture.

    The cameras are placeholders, see `open_uncalibrated`.
    """
    cameras = [placeholder_camera(name, *file.size) for name, file in files.items()]
    return assemble_capture(path, LAYOUT, cameras, list(files.values()), Units(1.0, LAYOUT))


def placeholder_camera(name: str, width: int, height: int) -> Camera:
    """Return a camera of which only the size is known."""
    return Camera(
        name=name,
        K=pinhole_K(width, width, width / 2, height / 2),
        world_to_camera=np.eye(4),
        width=width,
        height=height,
        near=1.0,
        far=2.0,
    )
