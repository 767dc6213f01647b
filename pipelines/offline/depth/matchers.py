"""What depth asks of a matcher, whatever finds it: the text table of built-ins makes matchers by
their names.
"""

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from ggvs_eval import built_in
from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.plugins import Registry

# Depth, confidence and disparity that a matcher found with a partner, by the names of both.
SharedMatches = dict[tuple[str, str], tuple[Map, Map, Map]]


class Estimator(Protocol):
    """Finds the depth of one camera with its partners at once."""

    def estimate(self, image: Image8, partner_images: Sequence[Image8]) -> DepthMap:
        """Return the depth at one instant, see `DepthEstimator.estimate`."""

    def forget(self) -> None:
        """Begin a new sequence.

        What finds every instant from itself alone has nothing to forget.
        """
        return


class Matcher(Protocol):
    """Finds depth from the pictures of a camera and its partners.

    A matcher is a frozen dataclass: its fields are its parameters and enter the key of what is
    stored, as does the code that its module imports.

    Attributes:
        name: of the algorithm.
        device: where it computes.
        rig: makes what finds the depth of several cameras from pairs that are matched once, of the
            cameras, of the names of each camera wanted and of its partners, and of the error of a
            pair in pixels; None where each camera is matched alone.
        batch: makes what finds the depth of several cameras in one batch on `device`, of what
            finishes the maps there; None where each camera is matched alone.
    """

    name: str
    device: str = "cpu"
    rig: Callable[..., Any] | None = None
    batch: Callable[..., Any] | None = None

    @property
    def views(self) -> int:
        """How many partners it sees at once without a common rectification; 0 if it wants pairs."""
        return 0

    def estimator(
        self,
        camera: Camera,
        partners: Sequence[Camera],
        error_px: float,
        warm: bool,
        shared: SharedMatches | None,
        /,
    ) -> Estimator:
        """Make what finds the depth of one camera.

        Args:
            error_px: see `PairwiseEstimator`, as `warm` and `shared`; who has no pairs ignores
                them.
        """


MATCHERS: Registry[Callable[..., Matcher]] = Registry("matchers", built_in.MATCHERS)
