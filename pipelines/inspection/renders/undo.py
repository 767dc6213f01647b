"""Changes of the pictures that findings have measured, taken back in the views."""

from collections.abc import Mapping, Sequence

from ggvs_eval.finding import Finding
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames
from ggvs_eval.transforms import TRANSFORMS, Transform


def change_of(finding: Finding, view: ViewFrames) -> Transform:
    """Return the change that a finding has measured, for pictures of the size of a view."""
    height, width = view.truth(view.frames[0]).shape[:2]
    return TRANSFORMS[finding.question](finding.values, (width, height))


def undo_changes(views: Mapping[str, ViewFrames], findings: Sequence[Finding]) -> dict[str, ViewFrames]:
    """Return the views without the changes that were found in them, the first one taken back first."""
    undone = dict(views)
    for finding in findings:
        view = undone[finding.subject]
        undone[finding.subject] = view.with_rendered(change_of(finding, view).inverse)
    return undone
