"""Unit of rendering: a test view or the camera path, with its sources.

This code is part of every render's identity.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthJob, DepthStore
from ggvs_eval.method import Instant, LookaheadMethod, Method, SourceView
from ggvs_eval.tasks.task import Made

PATH = "path"  # the unit of the camera path, besides the test views
Shot = tuple[int, int, Camera]  # number of the frame in its folder, instant, target


@dataclass(frozen=True)
class SourcePlan:
    """Plan of the synthesis of one target view.

    Attributes:
        target: the camera to synthesise, at synthesis size.
        jobs: depth of each source camera, nearest first; the target takes no part in any of it.
        shares: source camera -> how far the choice counts on it, see `ChosenSource`.
    """

    target: Camera
    jobs: tuple[DepthJob, ...]
    shares: dict[str, float]

    @property
    def depth_keys(self) -> dict[str, str]:
        """Source camera -> key of its depth in the depth store."""
        return {job.camera_name: job.key for job in self.jobs}


@dataclass(frozen=True)
class RenderUnit:
    """A test view over all frames, or the camera path at its one instant.

    Attributes:
        name: of the test view, or `PATH`.
        plans: of the test view, or of every pose.
        depths: folder of the depth store.
        fit: of the scene that it is rendered from; None for what is not fitted.
    """

    name: str
    plans: tuple[SourcePlan, ...]
    frames: range
    path_frame: int
    capture: Capture
    depths: Path
    fit: Made | None = None

    @property
    def shots(self) -> list[Shot]:
        """Every picture of it, in order."""
        if self.name == PATH:
            return [(pose, self.path_frame, plan.target) for pose, plan in enumerate(self.plans)]
        return [(index, index, self.plans[0].target) for index in self.frames]

    def identity(self) -> dict[str, Any]:
        """Its targets, their sources, and how they are given."""
        sources = {
            (name, self.capture.digest(name), key)
            for plan in self.plans
            for name, key in plan.depth_keys.items()
        }
        return {
            "targets": [_values(plan.target) for plan in self.plans],
            "sources": sorted(sources),
            "shares": [plan.shares for plan in self.plans],
            "frames": [self.frames.start, self.frames.stop, self.path_frame],
            "units_per_metre": self.capture.units_per_metre,
            "resize": self.capture.resize_filter,
        }

    def identity_of_shots(self) -> list[list[float]]:
        """Return the same of what is rendered from a scene, which knows no sources."""
        return [[number, frame, *_values(target)] for number, frame, target in self.shots]

    def instants(self, method: Method) -> Iterator[Instant]:
        """Stream the sources; a method that looks ahead has seen those of a test view, last first,
        when this begins.

        Along the path time is static: a scene in which nothing moves.
        """
        if self.name == PATH:
            return self._along_path()
        if isinstance(method, LookaheadMethod):
            backwards = (range(index, index + 1) for index in reversed(self.frames))
            method.look_ahead(instant for frames in backwards for instant in self._decoded(frames))
        return self._decoded(self.frames)

    def _along_path(self) -> Iterator[Instant]:
        names = {name for plan in self.plans for name in plan.depth_keys}
        images = {name: self.capture.frame(name, self.path_frame) for name in sorted(names)}
        for pose, plan in enumerate(self.plans):
            yield Instant(
                index=pose,
                target=plan.target,
                sources=self._views(plan, images, self.path_frame),
                units_per_metre=self.capture.units_per_metre,
            )

    def _decoded(self, frames: range) -> Iterator[Instant]:
        """Decode the sources of one target side by side, frame by frame."""
        (plan,) = self.plans
        streams = [self.capture.frames(name, frames.start, frames.stop) for name in plan.depth_keys]
        for index, images in zip(frames, zip(*streams, strict=True), strict=True):
            by_name = dict(zip(plan.depth_keys, images, strict=True))
            yield Instant(
                index=index,
                target=plan.target,
                sources=self._views(plan, by_name, index),
                units_per_metre=self.capture.units_per_metre,
            )

    def _views(
        self, plan: SourcePlan, images: Mapping[str, Image8], frame: int
    ) -> tuple[SourceView, ...]:
        store, cameras = DepthStore(self.depths), self.capture
        depths = {name: store.read(key, frame) for name, key in plan.depth_keys.items()}
        return tuple(
            SourceView(
                camera=cameras.camera(name),
                image=images[name],
                depth=stored.depth,
                confidence=stored.confidence,
                share=plan.shares[name],
            )
            for name, stored in depths.items()
        )


def _values(camera: Camera) -> list[float]:
    return [
        *camera.K.ravel(),
        *camera.world_to_camera.ravel(),
        *camera.size,
        camera.near,
        camera.far,
    ]
