"""Adapters: whatever layout a capture has on disk, `open_capture` makes a `Capture` of it."""

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets import colmap, dynerf
from ggvs_eval.errors import CaptureError

# Streams known to be out of step with the rest of their capture, (scene, camera).
UNSYNCED = {("coffee_martini", "cam13")}


@dataclass(frozen=True)
class DatasetSpec:
    """One layout.

    Attributes:
        describe: the layout in one line, for help texts.
        refuse: says why a folder is not of this layout, None where it is.
        load: opens a folder of this layout; the second argument is the world units per metre or None.
    """

    describe: str
    refuse: Callable[[Path], str | None]
    load: Callable[[Path, float | None], Capture]


DATASETS = {
    "dynerf": DatasetSpec(f"poses_bounds.npy with {dynerf.ARRANGEMENTS}", dynerf.refuse, dynerf.load),
    "colmap": DatasetSpec(f"sparse/0 with {colmap.ARRANGEMENTS}", colmap.refuse, colmap.load),
}


def open_capture(
    path: Path, layout: str | None = None, *, units_per_metre: float | None = None, drop_unsynced: bool = True
) -> Capture:
    """Open a capture folder.

    Args:
        path: folder of one scene.
        layout: a name in `DATASETS`; the first that fits when None.
        units_per_metre: world units per metre where the user knows better than the capture.
        drop_unsynced: leave out cameras known to be out of step: cam13 of coffee_martini.

    Raises:
        CaptureError: no such folder, no layout that fits (with the reason of each), or a capture that is damaged.
    """
    if not path.is_dir():
        raise CaptureError(
            f"{path}: wanted a folder with a capture, there is {'a file' if path.exists() else 'none'}; check the path"
        )
    if not any(path.iterdir()):
        raise CaptureError(f"{path}: wanted a capture, the folder is empty; put frames and poses there, or try 'ggvs-eval demo'")
    spec = DATASETS[_detect_layout(path, layout)]
    capture = spec.load(path, units_per_metre)
    unsynced = [camera for scene, camera in UNSYNCED if scene == capture.scene]
    return capture.without(unsynced) if drop_unsynced else capture


def _detect_layout(path: Path, wanted: str | None) -> str:
    if wanted is not None and wanted not in DATASETS:
        near = get_close_matches(wanted, DATASETS, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise CaptureError(f"{path}: no layout {wanted!r}, there are {', '.join(DATASETS)}{hint}")
    refusals = {name: spec.refuse(path) for name, spec in DATASETS.items() if wanted in (None, name)}
    fitting = [name for name, refusal in refusals.items() if refusal is None]
    if not fitting:
        reasons = "; ".join(f"not {name}: {refusal}" for name, refusal in refusals.items())
        raise CaptureError(f"{path}: no capture that can be read ({reasons}); see docs/conventions.md for the layouts")
    return fitting[0]
