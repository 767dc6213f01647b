"""The two kinds of samples: for the blending network and for the baselines."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.training.instant_samples import InstantSample, read_instant, write_instant
from ggvs_eval.contrib.training.samples.blend_samples import BlendSample, blend_sample, read_sample, write_sample
from ggvs_eval.contrib.training.samples.sample_maker import SampleMaker
from ggvs_eval.contrib.training.samples.samples import SampleKind
from ggvs_eval.method import Instant, SourceView


@dataclass(frozen=True)
class BlendKind(SampleKind[BlendSample]):
    """The views of the sources in the target, and the geometric blender's result."""

    device: str = "cpu"
    folders: ClassVar = {"rooms": ("samples", 4), "captures": ("captures", 2)}

    def make(self, maker: SampleMaker, target: Camera, sources: Sequence[Camera]) -> BlendSample:
        """See `blend_sample`."""
        return blend_sample(maker.instant(target, sources), maker.image(target), self.device)

    def cropped(self, sample: BlendSample, left: int, top: int, width: int, height: int) -> BlendSample:
        """A window of all that belongs to the target view."""
        return sample.cropped(left, top, width, height)

    def read(self, path: Path) -> BlendSample:
        """See `read_sample`."""
        return read_sample(path)

    def write(self, path: Path, sample: BlendSample) -> None:
        """See `write_sample`."""
        write_sample(path, sample)


@dataclass(frozen=True)
class InstantKind(SampleKind[InstantSample]):
    """Instants as a method is shown them, with the depth of its sources or with none, and the target's image."""

    depth: bool = True
    folders: ClassVar = {"rooms": ("instants", 1), "captures": ("capture-instants", 1)}

    def make(self, maker: SampleMaker, target: Camera, sources: Sequence[Camera]) -> InstantSample:
        """The instant; methods that take no depth need not wait for it."""
        if self.depth:
            return InstantSample(maker.instant(target, sources), maker.image(target))
        views = []
        for source in sources:
            unknown = np.zeros((source.height, source.width), np.float32)
            views.append(SourceView(source, maker.image(source), unknown, unknown))
        return InstantSample(Instant(0, target, tuple(views), maker.capture.units_per_metre), maker.image(target))

    def cropped(self, sample: InstantSample, left: int, top: int, width: int, height: int) -> InstantSample:
        """A window of the target, sources cut to what it can show of them."""
        return sample.cropped(left, top, width, height).focused()

    def read(self, path: Path) -> InstantSample:
        """See `read_instant`."""
        return read_instant(path)

    def write(self, path: Path, sample: InstantSample) -> None:
        """See `write_instant`."""
        write_instant(path, sample)
