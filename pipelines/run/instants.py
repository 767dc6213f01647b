"""Inputs of a method: the sources of a target view, instant by instant; this code is part of every render's identity."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.method import Instant, LookaheadMethod, Method, SourceView

if TYPE_CHECKING:  # how views are planned is no part of what a plan gives
    from ggvs_eval.pipelines.run.run_plan import SourcePlan


def view_instants(method: Method, capture: Capture, plan: "SourcePlan", frames: range, depths: DepthStore) -> Iterator[Instant]:
    """Stream the sources of a test view; a method that looks ahead has seen all of them, last first, when this begins.

    Args:
        method: that will render them.
        capture: at synthesis size.
        plan: target, sources and keys of their depth.
        frames: consecutive instants.
        depths: where depth lies.
    """
    if isinstance(method, LookaheadMethod):
        backwards = (range(index, index + 1) for index in reversed(frames))
        method.look_ahead(instant for each in backwards for instant in _decoded(capture, plan, each, depths))
    yield from _decoded(capture, plan, frames, depths)


def path_instants(capture: Capture, plans: Sequence["SourcePlan"], frame: int, depths: DepthStore) -> Iterator[Instant]:
    """Move the target along a path while time stands still: a scene in which nothing moves; arguments as of `view_instants`."""
    names = {name for plan in plans for name in plan.depth_keys}
    images = {name: capture.frame(name, frame) for name in sorted(names)}
    for pose, plan in enumerate(plans):
        views = [
            SourceView(capture.camera(name), images[name], stored.depth, stored.confidence, plan.shares[name])
            for name, key in plan.depth_keys.items()
            for stored in [depths.read(key, frame)]
        ]
        yield Instant(pose, plan.target, tuple(views), capture.units_per_metre)


def _decoded(capture: Capture, plan: "SourcePlan", frames: range, store: DepthStore) -> Iterator[Instant]:
    """Decode the sources of one target side by side, frame by frame."""
    streams = [capture.frames(name, frames.start, frames.stop) for name in plan.depth_keys]
    for index, images in zip(frames, zip(*streams, strict=True), strict=True):
        depths = [store.read(key, index) for key in plan.depth_keys.values()]
        sources = tuple(
            SourceView(capture.camera(name), image, stored.depth, stored.confidence, plan.shares[name])
            for name, image, stored in zip(plan.depth_keys, images, depths, strict=True)
        )
        yield Instant(index, plan.target, sources, capture.units_per_metre)
