"""The check of a capture: open it, walk once through every camera's frames, and answer the questions."""

import json
import time
from collections.abc import Callable, Iterable
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.camera_frames import find_rig_frames
from ggvs_eval.datasets.units import GivenUnits
from ggvs_eval.errors import CaptureError, GgvsError
from ggvs_eval.geometry.epipolar import neighbour_pairs
from ggvs_eval.jobs.processes import worker_pool
from ggvs_eval.pipelines.inspection.capture import (
    colour,
    depth_range,
    depth_registration,
    epipolar_findings,
    frames,
    intrinsics,
    overlap,
    poses,
    scale,
    timing,
)
from ggvs_eval.pipelines.inspection.capture.calibration_errors import triangulated_depths
from ggvs_eval.pipelines.inspection.capture.camera_record import CameraRecord, record_camera
from ggvs_eval.pipelines.inspection.capture.pairs import match_pairs
from ggvs_eval.pipelines.inspection.capture.uncalibrated import (
    ask_for_calibration,
    open_uncalibrated,
    uncalibrated_capture,
)
from ggvs_eval.pipelines.inspection.finding import RIG, SEVERITY, Finding
from ggvs_eval.pipelines.inspection.table import WIDTH, findings_table
from ggvs_eval.progress import track
from ggvs_eval.run_folder import write_json

OPENS = "opens"
QUESTIONS = (
    frames.FRAMES,
    frames.FROZEN,
    poses.QUESTION,
    intrinsics.QUESTION,
    depth_range.QUESTION,
    overlap.QUESTION,
    epipolar_findings.QUESTION,
    timing.QUESTION,
    colour.GAIN,
    colour.NOISE,
    scale.QUESTION,
)


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
        """The answers to one question."""
        return tuple(finding for finding in self.findings if finding.question == question)

    def to_json(self) -> dict[str, Any]:
        """The check as plain values for a JSON file."""
        findings = [{**asdict(finding), "values": dict(finding.values)} for finding in self.findings]
        return {
            "capture": str(self.path),
            "is_usable": self.is_usable,
            "seconds": round(self.seconds, 2),
            "findings": findings,
        }

    def table(self, width: int = WIDTH) -> str:
        """The check as text: one line per question, and one for each group of cameras that deviate."""
        return findings_table(self.findings, width)


def check_capture(path: Path, *, layout: str | None = None, units: GivenUnits = None, workers: int = 1) -> CaptureCheck:
    """Find what would spoil results on a capture.

    Every frame is decoded once. A capture that does not open gives one bad finding, and what frames alone tell; a frame that
    cannot be read is a finding too, and the other cameras go on.
    """
    start = time.perf_counter()
    try:
        uncalibrated = open_uncalibrated(path) if layout is None else None
        capture = uncalibrated or open_capture(path, layout, units=units)
    except GgvsError as error:
        return CaptureCheck(path, _examine_unopened(path, str(error), workers), time.perf_counter() - start)
    records = record_cameras(capture, workers)
    if uncalibrated:
        findings = examine_frames(capture, records)
        findings += ask_for_calibration(capture.path, _unanswered(findings))
    else:
        findings = examine(capture, records)
    return CaptureCheck(path, findings, time.perf_counter() - start)


def run_check(
    path: Path,
    out_json: Path | None = None,
    *,
    layout: str | None = None,
    units: GivenUnits = None,
    workers: int = 1,
) -> tuple[CaptureCheck, str]:
    """Check a capture and write the outcome beside; nothing is printed.

    Args:
        out_json: file to write the findings to; none when None.

    Returns:
        The check and its table as text.
    """
    check = check_capture(path, layout=layout, units=units, workers=workers)
    if out_json is not None:
        write_json(out_json, check.to_json())
    return check, check.table()


def read_doubts(file: Path) -> dict[str, str]:
    """Doubts that a check has about single cameras, the worst of each.

    Args:
        file: JSON that `run_check` wrote.

    Returns:
        Camera -> question and answer, for cameras with a verdict of ``warn`` or ``bad``.
    """
    try:
        findings = [Finding(**each) for each in json.loads(file.read_text(encoding="utf-8"))["findings"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CaptureError(f"{file}: wanted what 'ggvs-eval check' wrote, got {error!r:.120}; check the capture again") from error
    doubtful = [finding for finding in findings if finding.subject != RIG and finding.verdict in ("warn", "bad")]
    worst_last = sorted(doubtful, key=lambda finding: SEVERITY[finding.verdict])
    return {finding.subject: f"{finding.question}: {finding.measured}" for finding in worst_last}


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


def examine_frames(capture: Capture, records: list[CameraRecord]) -> tuple[Finding, ...]:
    """Answer the questions that need frames alone."""
    return (*frames.check_frames(capture, records), *frames.check_frozen(records), *colour.check_noise(records))


def examine(capture: Capture, records: list[CameraRecord]) -> tuple[Finding, ...]:
    """Answer every question from the cameras and what was recorded of their frames."""
    cameras = capture.cameras
    verdict = epipolar_findings.check_epipolar(cameras, records, match_pairs(cameras, records, neighbour_pairs(cameras)))
    depths = triangulated_depths(cameras, verdict.pairs, verdict.trusted)
    answers: tuple[Callable[[], tuple[Finding, ...]], ...] = (
        lambda: frames.check_frames(capture, records),
        lambda: frames.check_frozen(records),
        lambda: poses.check_poses(cameras, verdict.suspects),
        lambda: intrinsics.check_intrinsics(cameras),
        lambda: depth_range.check_depth_range(cameras, depths, verdict.suspects),
        lambda: overlap.check_overlap(cameras, capture.sensed_cameras),
        lambda: verdict.findings,
        lambda: timing.check_timing(cameras, records, verdict.suspects, capture.fps),
        lambda: colour.check_gain(capture.camera_names, verdict.pairs),
        lambda: colour.check_noise(records),
        lambda: scale.check_scale(capture, depths),
        lambda: depth_registration.check_depth_registration(capture),
    )
    return tuple(finding for answer in answers for finding in answer())


def _examine_unopened(path: Path, message: str, workers: int) -> tuple[Finding, ...]:
    """Report why a capture does not open, and findings on its frames where there are some."""
    found: tuple[Finding, ...] = (Finding(RIG, OPENS, "bad", message, {}, "mend this first"),)
    try:
        filmed = uncalibrated_capture(path, find_rig_frames(path))
        found += examine_frames(filmed, record_cameras(filmed, workers))
    except GgvsError:
        pass  # no frames of a rig; the first finding says what is wrong
    return (*found, *(Finding(RIG, question, "unknown", "the capture does not open") for question in _unanswered(found)))


def _unanswered(findings: Iterable[Finding]) -> tuple[str, ...]:
    answered = {finding.question for finding in findings}
    return tuple(question for question in QUESTIONS if question not in answered)
