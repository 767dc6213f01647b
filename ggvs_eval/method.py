"""The interface of every method: it turns the frames of one instant into the target view, and sees
no further.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera

# what is closer to the target camera is not splatted, as the reference rasteriser leaves it out
NEAR_M = 0.2


@dataclass(frozen=True)
class SourceView:
    """One source camera at one instant: its pixels on the way from the decoder to the kernels.

    A step that changes some of it - a filter its depth, exposure compensation its image - hands on
    a view with that replaced.

    Attributes:
        camera: its calibration.
        image: captured frame, RGB uint8, (H, W, 3).
        depth: depth from the offline half, (H, W), world units, 0 where unknown.
        confidence: how far that depth is to be trusted, (H, W), in [0, 1].
        share: how far the choice of sources counts on this view, in (0, 1]; it falls towards 0 as
            the view is about to give way to another one, so that a target that moves sees no jump.
    """

    camera: Camera
    image: Image8
    depth: Map
    confidence: Map
    share: float = 1.0


@dataclass(frozen=True)
class Instant:
    """All that a method is shown at one instant: nothing of the future, nothing of the target's
    image.

    Attributes:
        index: frame number; consecutive calls of `Method.step` have increasing numbers.
        target: camera to synthesise; it may move from instant to instant.
        sources: the K source views, nearest first.
    """

    index: int
    target: Camera
    sources: tuple[SourceView, ...]
    units_per_metre: float

    @property
    def near_plane(self) -> float:
        """Depth in the target camera from which on sources are splatted, world units."""
        return NEAR_M * self.units_per_metre

    @property
    def depth_range(self) -> tuple[float, float]:
        """Nearest and farthest depth of the scene that any of the cameras gives, world units."""
        cameras = [self.target, *(source.camera for source in self.sources)]
        return min(camera.near for camera in cameras), max(camera.far for camera in cameras)


@dataclass(frozen=True)
class Rendering:
    """Output of a method for one instant.

    Attributes:
        image: synthesised view, float32 RGB in [0, 1], (H, W, 3).
        depth: geometry it used, (H, W), world units, 0 if it has none; None for methods without
            geometry in the target view.
        seconds: time of each stage, in the method's own words, for the timing table.
        diagnostics: what it decided on the way to the image, for finding out why a pixel flickers;
            any of ``depth`` (h, w), world units, 0 where unknown, ``coverage`` (h, w), how far the
            views show the pixel, ``motion`` (h, w) and ``weights`` (K, h, w), the share of each
            source view in the image, all in [0, 1]; (h, w) is the target's size or less.
    """

    image: Map
    depth: Map | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    diagnostics: Mapping[str, Map] = field(default_factory=dict)


class Method(Protocol):
    """A strictly online synthesiser; one object renders one sequence of one target."""

    def step(self, instant: Instant) -> Rendering:
        """Synthesise the target view of one instant from the views up to it."""


@runtime_checkable
class LookaheadMethod(Protocol):
    """A reference that is not online: it is shown the whole sequence before its first step.

    Its spec must say so.
    """

    def look_ahead(self, instants: Iterable[Instant]) -> None:
        """Look at every instant once, the last one first."""

    def step(self, instant: Instant) -> Rendering:
        """Synthesise the target view of one instant."""
