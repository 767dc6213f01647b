"""Captures as a metric study takes them: opened, whatever they are, and prepared with depth to render views from."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.datasets.llff import open_path
from ggvs_eval.errors import CameraError, DepthError
from ggvs_eval.files.listing import VIDEO_SUFFIXES, list_images
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.pipelines.inspection.capture.check import LAYOUT, open_uncalibrated, uncalibrated_capture
from ggvs_eval.pipelines.run.prepare import prepare_run
from ggvs_eval.pipelines.run.run_plan import RunPlan, RunRequest, plan_run
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.protocol import CameraPath, Frames, Protocol, Synthesis, Views

K = 4
CHOSEN_BY = "by rule: cameras evenly spread over the capture, for a metric study"


def open_footage(path: Path) -> Capture:
    """A capture, videos without calibration, one video, or the pictures of one in a folder."""
    if path.is_file() and path.suffix.lower() in VIDEO_SUFFIXES:
        return uncalibrated_capture(path, {path.stem: VideoFrames(path)})
    if path.is_dir() and list_images(path):
        return uncalibrated_capture(path, {path.resolve().name: ImageFrames(path)})
    return (open_uncalibrated(path) if path.is_dir() else None) or open_capture(path)


def prepare_views(root: Path, capture: Capture, names: Sequence[str], frames: range, workers: Workers) -> RunPlan | None:
    """The capture prepared as for a run, with depth; None where its cameras are unknown or see too little in common."""
    if capture.layout == LAYOUT or len(capture.cameras) < 2:
        return None
    path = CameraPath() if open_path(capture.path) is not None else CameraPath(0)
    protocol = study_protocol(capture, names, frames, path)
    try:
        return prepare_run(plan_run(RunRequest(root, capture, protocol)), workers)
    except (CameraError, DepthError) as error:
        print(f"{capture.path}: nothing can be rendered of it, so that nothing boils or switches: {error}", file=sys.stderr)
        return None


def study_protocol(
    capture: Capture, names: Sequence[str], frames: range, path: CameraPath, sources: Sequence[str] = ()
) -> Protocol:
    """The protocol under which a capture is prepared, at the capture's own size.

    Args:
        sources: cameras that they are rendered from; all others where there are none.
    """
    base = suggest_protocol(capture)
    width, height = capture.cameras[0].size
    synthesis = Synthesis(min(K, len(sources or capture.cameras) - 1), width, height, "area", base.synthesis.sources)
    return replace(
        base,
        name=f"metric study of {capture.scene}",
        views=Views(tuple(names), CHOSEN_BY, sources=tuple(sources)),
        frames=Frames(frames.start, len(frames)),
        synthesis=synthesis,
        measurement=replace(base.measurement, metrics=("PSNR",), width=0, height=0, ceilings=False),
        path=path,
    )
