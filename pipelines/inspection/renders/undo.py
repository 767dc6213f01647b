"""Changes of the pictures that findings have measured, taken back in the views."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.finding import Finding
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames, spread
from ggvs_eval.transforms import TRANSFORMS, Transform

INSTANTS = 3  # of a view that are compared


def change_of(finding: Finding, view: ViewFrames) -> Transform:
    """Return the change that a finding has measured, for pictures of the size of a view."""
    height, width = view.truth(view.frames[0]).shape[:2]
    return TRANSFORMS[finding.question](finding.values, (width, height))


def undo_changes(
    views: Mapping[str, ViewFrames], findings: Sequence[Finding]
) -> dict[str, ViewFrames]:
    """Return the views without the changes that were found in them, the first one taken
    back first.
    """
    undone = dict(views)
    for finding in findings:
        view = undone[finding.subject]
        undone[finding.subject] = view.with_rendered(change_of(finding, view).inverse)
    return undone


def levels_of(image: Image8) -> Array32:
    """Return a frame's levels as numbers that differences do not wrap."""
    return image.astype(np.float32)


def drop_idle(
    views: Mapping[str, ViewFrames],
    findings: Sequence[Finding],
    least: float,
    features: Callable[[Image8], Array32] = levels_of,
) -> list[Finding]:
    """Drop the findings of views in which they explain little of the error: an honest bad rendering
    has such changes too.

    Args:
        findings: in the order in which they are undone.
        least: share of the squared error that the findings of a view explain together, see
            `explained_share`.
        features: frame -> what is compared of it.

    Returns:
        The others, by view.
    """
    clear_findings: list[Finding] = []
    for name, view in views.items():
        of_view = [finding for finding in findings if finding.subject == name]
        if of_view and explained_share(view, of_view, features) >= least:
            clear_findings += of_view
    return clear_findings


def explained_share(
    view: ViewFrames, findings: Sequence[Finding], features: Callable[[Image8], Array32]
) -> float:
    """Return how much of the squared error of a view its findings explain, 0 to 1 or a little
    below.

    Reading:
        Interpolation blurs, and blur alone lowers the error of a bad rendering. So the pictures
        without the change are compared with pictures that have it twice, which are blurred alike:
        where the error is quadratic in the change, a quarter of the difference is what the change
        costs.
    """
    (without,) = undo_changes({findings[0].subject: view}, findings).values()
    twice = view
    for finding in reversed(findings):
        twice = twice.with_rendered(change_of(finding, view).apply)
    frames = spread(view.frames, INSTANTS)
    errors = []
    for version in (view, without, twice):
        pairs = version.pairs(frames)
        errors.append(
            np.mean(
                [
                    np.square(features(rendered) - features(truth)).mean()
                    for rendered, truth in pairs
                ]
            )
        )
    as_it_is, none, double = errors
    return float((double - none) / 4 / max(as_it_is, 1e-9))
