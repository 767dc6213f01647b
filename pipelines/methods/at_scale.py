"""A method at a fraction of the size: its sources are made smaller before it, and its picture is enlarged after it."""

from dataclasses import replace
from time import perf_counter

import cv2
import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.method import Instant, Method, Rendering, SourceView

SMALLEST_PX = 16  # of the shorter side


class AtScale:
    """A method that renders small pictures for a large screen; both changes of size are stages of its time.

    Args:
        method: a fresh one.
        scale: of both sides, in (0, 1).

    Reading:
        Sources are averaged over areas; their depth is that of the nearest pixel, since means of two surfaces lie on none. The
        picture is enlarged by cubic interpolation, as screens do.
    """

    def __init__(self, method: Method, scale: float) -> None:
        self._method, self._scale = method, scale

    def step(self, instant: Instant) -> Rendering:
        """See `ggvs_eval.method.Method.step`."""
        begun = perf_counter()
        target = instant.target
        small_target = target.resized(*self._small(*target.size))
        small = replace(instant, target=small_target, sources=tuple(map(self._shrunk, instant.sources)))
        shrunk = perf_counter()
        rendering = self._method.step(small)
        rendered = perf_counter()
        image = np.clip(cv2.resize(rendering.image, target.size, interpolation=cv2.INTER_CUBIC), 0.0, 1.0)
        depth = None if rendering.depth is None else _nearest(rendering.depth, target.size)
        seconds = {"shrink": shrunk - begun, **rendering.seconds, "enlarge": perf_counter() - rendered}
        return replace(rendering, image=np.asarray(image, np.float32), depth=depth, seconds=seconds)

    def _small(self, width: int, height: int) -> tuple[int, int]:
        scale = max(self._scale, min(SMALLEST_PX / min(width, height), 1.0))
        return round(width * scale), round(height * scale)

    def _shrunk(self, source: SourceView) -> SourceView:
        size = self._small(*source.camera.size)
        image = np.asarray(cv2.resize(source.image, size, interpolation=cv2.INTER_AREA), np.uint8)
        depth, confidence = _nearest(source.depth, size), _nearest(source.confidence, size)
        return replace(source, camera=source.camera.resized(*size), image=image, depth=depth, confidence=confidence)


def _nearest(values: Map, size: tuple[int, int]) -> Map:
    return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_NEAREST), np.float32)
