"""The interface of methods that are fitted to one capture: they see the footage of training cameras
and leave a scene behind.

Where a `ggvs_eval.method.Method` is shown the sources of a target instant by instant, a
`SceneFitter` is given time: it optimises a scene over the footage of some cameras, once per fold of
held-out ones, and the scene renders any view of any of its instants.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.capture import FrameSource
from ggvs_eval.depth_store import DepthMap, DepthStore
from ggvs_eval.errors import RenderError
from ggvs_eval.method import Rendering

LookAhead = Literal["none", "past", "sequence"]  # what an instant may depend on besides itself
Progress = Callable[[int, int], None]  # steps that are done, steps in all


@dataclass(frozen=True)
class Footage:
    """All that a fitter is shown: the training cameras at some instants, and nothing of any other
    camera.

    It holds the frames of its own cameras alone, so that what is held out cannot be asked for; nor
    has any other camera taken part in the depth.

    Attributes:
        cameras: training cameras at synthesis size, in the order of the capture.
        indices: frame numbers of the instants, ascending.
        fps: instants per second; 0 for a single instant.
        seed: of everything random in the fit.
        frames: view -> its frames.
        depth_keys: view -> key of its estimated depth in `depths`.
        depths: the depth store.
    """

    cameras: tuple[Camera, ...]
    indices: range
    fps: float
    units_per_metre: float
    seed: int
    frames: Mapping[str, FrameSource]
    depth_keys: Mapping[str, str]
    depths: DepthStore

    @property
    def views(self) -> tuple[str, ...]:
        """Names of the training cameras, in the order of `cameras`."""
        return tuple(camera.name for camera in self.cameras)

    @property
    def times(self) -> tuple[float, ...]:
        """Seconds from the first instant to each of `indices`."""
        return tuple(
            (index - self.indices.start) / self.fps if self.fps else 0.0 for index in self.indices
        )

    def image(self, view: str, index: int) -> Image8:
        """Return the image of a training camera, RGB uint8, (H, W, 3).

        Args:
            view: name of a training camera.
            index: frame number.

        Raises:
            RenderError: a camera or an instant that does not belong to the footage.
            CaptureError: a frame that cannot be read.
        """
        self._require(view, index)
        return next(iter(self.frames[view].frames(index, index + 1)))

    def depth(self, view: str, index: int) -> Map:
        """Return the estimated z-depth of a training camera, (H, W), world units, 0 where unknown.

        Errors as of `depth_map`.
        """
        return self.depth_map(view, index).depth

    def depth_map(self, view: str, index: int) -> DepthMap:
        """Return the estimated depth with its confidence.

        Only at the instants that `SceneFitter.depth_indices` has named.

        Raises:
            RenderError: a camera or an instant that does not belong to the footage.
            DepthError: an instant whose depth was not asked for.
        """
        self._require(view, index)
        return self.depths.read(self.depth_keys[view], index)

    def _require(self, view: str, index: int) -> None:
        if view not in self.views:
            raise RenderError(
                f"footage: {view!r} is not a training camera; there are {', '.join(self.views)}"
            )
        if index not in self.indices:
            raise RenderError(
                f"footage: wanted instants {self.indices.start}..{self.indices.stop - 1}, got "
                f"{index}"
            )


class FittedScene(ABC):
    """A scene as a fit has left it."""

    @abstractmethod
    def render(self, index: int, target: Camera) -> Rendering:
        """Render one instant of the footage from a camera that it may never have seen.

        Equal arguments give equal images.
        """

    @property
    @abstractmethod
    def size_bytes(self) -> int:
        """Bytes of everything that rendering the whole sequence needs."""


class SceneFitter(ABC):
    """A method that is fitted to a capture before it renders.

    One object with its options, which its constructor takes.

    Attributes:
        name: for messages.
        look_ahead: what an instant of the scene depends on: on itself alone (``none``), on instants
            before it too (``past``), or on the whole ``sequence``.
    """

    name: str
    look_ahead: LookAhead

    def depth_indices(self, indices: range) -> Sequence[int]:
        """At which instants of the footage it wants depth; all, unless it says otherwise.

        What is not asked for costs no time.
        """
        return indices

    @abstractmethod
    def fit(self, footage: Footage, folder: Path, progress: Progress) -> None:
        """Fit a scene and write it into a folder.

        Args:
            footage: what it may see.
            folder: exists. A fit that was killed is called again with what it has left there, and
                continues from it. When this returns the scene is whole: the caller notes that, no
                marker is needed.
            progress: to be called now and then with (steps done, steps in all), counted from the
                fit's very beginning.
        """

    @abstractmethod
    def load(self, folder: Path) -> FittedScene:
        """Read back the scene that `fit` has written."""
