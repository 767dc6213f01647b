"""A reference that is not online: the same method, with depth that was filtered over the whole
sequence, future included.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.method import Instant, Rendering, SourceView
from ggvs_eval.pipelines.online.blending import Blender
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions


class WholeSequence:
    """The method of the paper after a pass over the sequence from its end to its beginning.

    `look_ahead` runs the temporal depth filter (Eqs. 1-2) backwards in time; `step` runs the online
    method forwards on what it gave. The two passes weigh past and future alike: in a still scene
    with noise that is new at each instant the noise of depth falls to half of its standard
    deviation, where the forward pass alone leaves two thirds. What this gains over the online
    method is the price of being online.

    Depth of the backward pass is in a temporary folder, of the same size as in the depth store;
    memory stays bounded.
    """

    def __init__(
        self, options: OnlineOptions | None = None, blender: Blender | None = None
    ) -> None:
        """Start with the constants and the blender of the online method."""
        self._forward = GeometryGuided(options, blender)
        self._folder = TemporaryDirectory(prefix="ggvs-eval-")
        self._seconds: dict[int, float] = {}

    def look_ahead(self, instants: Iterable[Instant]) -> None:
        """Filter the depth of every source backwards.

        Args:
            instants: the whole sequence, the last one first.
        """
        backward = self._forward.options.depth_filter()
        for instant in instants:
            started = perf_counter()
            for source in instant.sources:
                filtered, _ = backward.step(-instant.index, source)
                np.save(self._file(instant.index, source), filtered.depth)
            self._seconds[instant.index] = perf_counter() - started

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant; one that was not looked ahead at is synthesised online."""
        sources = tuple(
            replace(source, depth=self._depth(instant.index, source)) for source in instant.sources
        )
        rendering = self._forward.step(replace(instant, sources=sources))
        return replace(
            rendering,
            seconds={"look ahead": self._seconds.get(instant.index, 0.0)} | rendering.seconds,
        )

    def _depth(self, index: int, source: SourceView) -> Map:
        file = self._file(index, source)
        return np.asarray(np.load(file), dtype=np.float32) if file.is_file() else source.depth

    def _file(self, index: int, source: SourceView) -> Path:
        return Path(self._folder.name) / f"{source.camera.name}.{index}.npy"
