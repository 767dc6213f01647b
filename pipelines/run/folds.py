"""Folds of test cameras for methods that are fitted: those held out together, and the input of each
fit.

A feed-forward method renders each test camera from all others at no cost. A fit takes minutes to
hours, so test cameras that are far apart are held out together: the neighbours of each stay
training cameras.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthJob
from ggvs_eval.errors import CameraError
from ggvs_eval.pipelines.methods.render_unit import PATH
from ggvs_eval.pipelines.run.depth_of_run import DepthProvider
from ggvs_eval.protocol import Protocol

MOST_FOLDS = 3
ALL = "all"  # the fit that holds nothing out, for the camera path
FEWEST_CAMERAS = 2  # of a fit: one has no depth

Folds = tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class FoldPlan:
    """Footage of one fold.

    Attributes:
        name: ``fold1``, ``fold2``, ... or `ALL`.
        held_out: test cameras that are rendered from it and take no part in it; none for `ALL`,
            which renders the camera path.
        jobs: depth of each training camera, matched with training cameras, in the order of the
            capture.
    """

    name: str
    held_out: tuple[str, ...]
    jobs: tuple[DepthJob, ...]

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the training cameras."""
        return tuple(job.camera_name for job in self.jobs)

    @property
    def units(self) -> tuple[str, ...]:
        """Test views that are rendered from it, or the camera path."""
        return self.held_out or (PATH,)


def choose_folds(cameras: Sequence[Camera]) -> Folds:
    """Distribute test cameras over at most three folds of nearly equal size, so that those of a
    fold are far apart.

    Returns:
        Names by fold: a partition of the test cameras, each fold in their order.

    Reading:
        The literature fits once per test camera (4DGS, 4K4D: K = 17 of 18) or holds all out at
        once. Three folds cost three fits regardless of the number of test cameras. Cameras are
        dealt one by one to the fold whose nearest member is farthest away, among those that are not
        full; then pairs change places while that moves the nearest two cameras of a fold farther
        apart.

    Examples:
        >>> from ggvs_eval.camera import translated_path
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> for fold in choose_folds(translated_path(camera, span=8.0, count=9)):
        ...     print(*fold)
        path0000 path0003 path0006
        path0001 path0004 path0007
        path0002 path0005 path0008
    """
    centres = np.stack([camera.centre for camera in cameras])
    distances = np.linalg.norm(centres[:, None] - centres[None], axis=-1).round(9)  # (N, N)
    count = min(MOST_FOLDS, len(cameras))
    capacities = [len(cameras) // count + (at < len(cameras) % count) for at in range(count)]
    folds: list[list[int]] = [[] for _ in range(count)]
    for camera in range(len(cameras)):
        free = [at for at in range(count) if len(folds[at]) < capacities[at]]
        best = max(
            free,
            key=lambda at: min((distances[camera, member] for member in folds[at]), default=np.inf),
        )
        folds[best].append(camera)
    _exchange(folds, distances)
    return tuple(tuple(cameras[member].name for member in sorted(fold)) for fold in folds)


def _exchange(folds: list[list[int]], distances: Array) -> None:
    """Let two cameras of different folds change places while the smallest distances within folds,
    ascending, grow by it.
    """
    better = True
    while better:
        better = False
        for first, second in combinations(range(len(folds)), 2):
            for i in range(len(folds[first])):
                for j in range(len(folds[second])):
                    before = _closeness(folds, distances)
                    folds[first][i], folds[second][j] = folds[second][j], folds[first][i]
                    if _closeness(folds, distances) > before:
                        better = True
                    else:
                        folds[first][i], folds[second][j] = folds[second][j], folds[first][i]


def _closeness(folds: Sequence[Sequence[int]], distances: Array) -> list[float]:
    """Return the distances between cameras of the same fold, ascending."""
    return sorted(float(distances[i, j]) for fold in folds for i, j in combinations(fold, 2))


def fill_folds(protocol: Protocol, capture: Capture) -> Protocol:
    """State the folds of a protocol that leaves them open: those of `choose_folds`.

    Test cameras that no method may see (``views.sources``) are held out by every fit anyway, and
    are in the first fold.
    """
    views = protocol.views
    if views.folds:
        return protocol
    sources = views.sources_of(capture.scene)
    visible = [view for view in views.test if not sources or view in sources]
    folds = choose_folds([capture.camera(view) for view in visible]) if visible else ((),)
    unseen = tuple(view for view in views.test if view not in visible)
    return protocol.with_folds(((*unseen, *folds[0]), *folds[1:]))


def plan_folds(
    capture: Capture, folds: Folds, along_path: bool, depth: DepthProvider
) -> tuple[FoldPlan, ...]:
    """Plan the input of each fit.

    Args:
        capture: holds the cameras that may be seen; test cameras among them or not.
        along_path: also plan the fit of all cameras that may be seen.
    """
    held_out = [(f"fold{number}", fold) for number, fold in enumerate(folds, start=1)] + (
        [(ALL, ())] if along_path else []
    )
    return tuple(
        FoldPlan(name, fold, _rig_depth(capture, name, fold, depth)) for name, fold in held_out
    )


def _rig_depth(
    capture: Capture, name: str, held_out: Sequence[str], depth: DepthProvider
) -> tuple[DepthJob, ...]:
    """Depth of what is left when some cameras are held out.

    Nothing of those can reach it, as they are not in the capture.
    """
    training = capture.without(held_out, "held out")
    if len(training.cameras) < FEWEST_CAMERAS:
        raise CameraError(
            f"{name} holds out {', '.join(held_out)} and leaves {len(training.cameras)} training "
            f"cameras, wanted {FEWEST_CAMERAS} or more; make the folds smaller (views.folds) or "
            "add cameras (views.sources)"
        )
    return depth.of_rig(training)
