"""Footage of a fit: the training cameras of its fold and nothing else.

Apart, since the identity of a fit begins here.
"""

from typing import TYPE_CHECKING

from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.scene_fitter import Footage

if TYPE_CHECKING:  # how folds are planned is no part of what they show
    from ggvs_eval.pipelines.run.folds import FoldPlan


def fold_footage(
    capture: Capture, fold: "FoldPlan", indices: range, depths: DepthStore, seed: int
) -> Footage:
    """Give a fit its training cameras, one by one: what is not named here does not travel
    with it.
    """
    names = fold.cameras
    training = capture.without([name for name in capture.camera_names if name not in names], "")
    return Footage(
        cameras=training.cameras,
        indices=indices,
        fps=training.fps,
        units_per_metre=training.units_per_metre,
        seed=seed,
        frames=dict(zip(names, training.sources, strict=True)),
        depth_keys={job.camera_name: job.key for job in fold.jobs},
        depths=depths,
    )
