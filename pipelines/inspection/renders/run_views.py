"""The frames of a run folder as the doctor wants them."""

from pathlib import Path

from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image
from ggvs_eval.pipelines.inspection.renders.view_frames import FrameReader, ViewFrames
from ggvs_eval.run_folder import RunFolder, frame_path, missing_frames, require_frames


def views_of_run(run: RunFolder, label: str) -> dict[str, ViewFrames]:
    """Rendered and captured frames of one method in every test view.

    Args:
        run: a folder with truth and renders.
        label: ``method`` or ``method+variant``.

    Raises:
        ResultsError: the folder is not a run.
        RenderError: no such renders, or frames are missing (all gaps are listed).
    """
    if label not in run.labels():
        raise RenderError(f"{run.root}: no renders of {label!r}; there are {', '.join(run.labels()) or 'none'}")
    protocol = run.protocol()
    frames = protocol.frames.numbers
    require_frames({f"{label} in {view}": run.renders(label, view) for view in protocol.views.test}, frames)
    require_frames({f"truth of {view}": run.truth(view) for view in protocol.views.test}, frames)
    return {view: ViewFrames(_reader(run.renders(label, view)), _reader(run.truth(view)), frames) for view in protocol.views.test}


def cameras_of_run(run: RunFolder) -> dict[str, FrameReader]:
    """Captured frames of every camera whose truth the run folder holds whole, source cameras among them."""
    protocol = run.protocol()
    frames = protocol.frames.numbers
    root = run.root / "truth"
    folders = sorted(folder for folder in root.iterdir() if folder.is_dir()) if root.is_dir() else []
    return {folder.name: _reader(folder) for folder in folders if not missing_frames(folder, frames)}


def _reader(folder: Path) -> FrameReader:
    return lambda index: read_image(frame_path(folder, index))
