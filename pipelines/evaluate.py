"""The whole evaluation on one page: capture -> prepare -> render -> score -> report. Each step reads a folder and writes one."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.pipelines.prepare import Prepared, prepare
from ggvs_eval.pipelines.render import render
from ggvs_eval.pipelines.score import score
from ggvs_eval.protocol import Frames, Protocol, Synthesis, Views, load_protocol, packaged_protocols
from ggvs_eval.run_folder import RunFolder


def evaluate(root: Path, capture: Path, protocol: Protocol, labels: Sequence[str], workers: int) -> Path:
    """Evaluate methods on a capture; a second call does only what is missing.

    Args:
        root: run folder, see `ggvs_eval.run_folder`.
        capture: folder of the capture.
        protocol: views, frames, sizes, metrics.
        labels: methods, see `ggvs_eval.pipelines.methods.METHODS`.
        workers: processes.

    Returns:
        Path of the report's page.
    """
    prepared = prepare(root, capture, protocol, workers)
    render(prepared, labels, workers)
    score(RunFolder(root), workers)
    return report([root])


def reopen(root: Path, workers: int) -> Prepared:
    """Pick up a run folder that `prepare` has made, from the protocol and capture that it names."""
    run = RunFolder(root)
    return prepare(root, Path(run.capture_record()["path"]), run.protocol(), workers)


def report(roots: Sequence[Path], out: Path | None = None) -> Path:
    """Write the page, tables and figures of one or several run folders."""
    from ggvs_eval.reports.report import write_report

    return write_report(roots, out)


def suggest_protocol(capture_path: Path) -> Protocol:
    """The packaged protocol that fits a capture, or one by rule for a rig of one's own.

    The rule: every second camera in the capture's order is a test view (at most nine, from the second on), K = 4, at most
    100 frames, the capture's own size. ``views.chosen_by`` says so.
    """
    capture = open_capture(capture_path)
    for name in ("demo", capture.layout):
        if name in packaged_protocols() and _fits(capture, load_protocol(name)):
            return load_protocol(name)
    return replace(
        load_protocol("dynerf"),
        name=f"{capture.scene} by rule",
        dataset=capture.scene,
        views=Views(capture.camera_names[1::2][:9], "by rule: every second camera, at most nine"),
        frames=Frames(0, min(capture.n_frames, 100)),
        synthesis=Synthesis(min(4, len(capture.cameras) - 1)),
    )


def _fits(capture: Capture, protocol: Protocol) -> bool:
    """Whether a packaged protocol was made for this capture; the demo's is for demo captures alone."""
    if (protocol.name == "demo") != (capture.units_origin == "demo.json"):
        return False
    enough = protocol.frames.start + protocol.frames.count <= capture.n_frames
    return enough and set(protocol.views.test) <= set(capture.camera_names)
