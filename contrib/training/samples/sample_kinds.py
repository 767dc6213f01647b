"""The two kinds of samples: for the blending network and for the baselines."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.training.instant_samples import (
    InstantSample,
    camera_arrays,
    read_instant,
    stored_arrays,
    stored_cameras,
    write_arrays,
    write_instant,
)
from ggvs_eval.contrib.training.samples.samples import SampleKind, SampleMaker
from ggvs_eval.files.images import quantise
from ggvs_eval.geometry.warp import warp
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.online.blending import Blended, Blender, BlendingInputs, GeometricBlender
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions
from ggvs_eval.pipelines.online.network_inputs import (
    FAINT,
    BlendMaps,
    Guidance,
    blend_maps,
    nearest_first,
    nearness,
    reference_depth,
)
from ggvs_eval.plugins import DEVICE_PARTS

IN_8_BIT = ("splats", "alphas", "warps", "visibilities")
OF_VIEWS = (*IN_8_BIT, "depths")


@dataclass(frozen=True, eq=False)
class RawViews:
    """The K views in the target view as splatting and warping give them, nearest camera first.

    Attributes:
        splats: splatted colour, (K, H, W, 3), float32 in [0, 1].
        depths: splatted depth, (K, H, W), float32, world units, 0 if the view shows nothing.
        alphas: coverage of the splats, (K, H, W), float32 in [0, 1).
        warps: colour of the source image at the fused surface, (K, H, W, 3).
        visibilities: whether the view sees the fused surface, (K, H, W), in [0, 1].
        fused_depth: of the ray march, (H, W), float32, world units, 0 if it met nothing.
        shares: of the views, see `SourceView.share`, (K,); 1 unless given.
    """

    target: Camera
    sources: tuple[Camera, ...]
    splats: Map
    depths: Map
    alphas: Map
    warps: Map
    visibilities: Map
    fused_depth: Map
    shares: tuple[float, ...] | None = None

    def cropped(self, left: int, top: int, width: int, height: int) -> "RawViews":
        """Return the window that starts at pixel (left, top)."""
        rows, columns = slice(top, top + height), slice(left, left + width)
        windows = {name: getattr(self, name)[:, rows, columns] for name in OF_VIEWS}
        target = self.target.cropped(left, top, width, height)
        return replace(self, target=target, fused_depth=self.fused_depth[rows, columns], **windows)

    @property
    def splatted(self) -> BlendMaps:
        """Only the splats of the views."""
        stacks = self.splats, self.alphas, self.alphas, tuple(self.alphas), tuple(self.depths)
        return BlendMaps(self.target, self.sources, *stacks, self.fused_depth, self.shares)

    def maps(self, guidance: Guidance) -> BlendMaps:
        """Return the maps that a network of that guidance works on: what `blend_maps` gives in one
        pass.
        """
        if guidance != "registered":
            return self.splatted
        share = np.where(
            self.alphas > 0, self.visibilities, np.float32(1) * (self.visibilities > 0)
        )  # of nothing there is no mix
        colours = self.splats + share[..., None] * (self.warps - self.splats)
        coverage = np.maximum(self.visibilities, FAINT * self.alphas)
        return replace(
            self.splatted, colours=colours, coverage=coverage, visibilities=self.visibilities
        )


@dataclass(frozen=True, eq=False)
class BlendSample:
    """One target view.

    Attributes:
        views: what the network looks at.
        truth: what the target's camera saw, (H, W, 3) uint8.
        geometric: what the geometric blender makes of the same views, (H, W, 3) uint8; the network
            has to beat it.
    """

    views: RawViews
    truth: Image8
    geometric: Image8

    def cropped(self, left: int, top: int, width: int, height: int) -> "BlendSample":
        """Return the window that starts at pixel (left, top)."""
        rows, columns = slice(top, top + height), slice(left, left + width)
        return BlendSample(
            self.views.cropped(left, top, width, height),
            self.truth[rows, columns],
            self.geometric[rows, columns],
        )


def blend_sample(instant: Instant, truth: Image8, device: str = "cpu") -> BlendSample:
    """Return the sample of what a method is shown of a target, and what the target's camera took.

    Args:
        truth: (H, W, 3) uint8.
        device: where views are splatted and warped; another one than ``cpu`` wants NVIDIA Warp.

    Reading:
        The paper shifts the principal point to render a crop; a crop of the whole rendering shows
        the same.
    """
    views, geometric = rendered_views(instant, device)
    return BlendSample(views, truth, quantise(geometric))


def rendered_views(instant: Instant, device: str) -> tuple[RawViews, Map]:
    """Return the views of one instant by themselves, and what the geometric blender makes of them.

    See `blend_sample`.
    """
    options = OnlineOptions(temporal=False, compensated=False)
    if device == "cpu":
        recorder = _Recorder(GeometricBlender())
        GeometryGuided(options, recorder).step(instant)
        return raw_views(recorder.inputs[-1]), recorder.images[-1]
    from ggvs_eval.compute_device import compute_device

    sampled_maps = DEVICE_PARTS["training samples"]
    maps, sources, target = (
        sampled_maps(instant, options, compute_device(device)),
        instant.sources,
        instant.target,
    )
    order = sorted(range(len(sources)), key=lambda k: nearness(sources[k].camera, target))
    cameras, shares = (
        tuple(sources[k].camera for k in order),
        tuple(sources[k].share for k in order),
    )
    of_views = {name: maps[name][order] for name in OF_VIEWS}
    return RawViews(
        target, cameras, **of_views, fused_depth=maps["fused_depth"], shares=shares
    ), maps["geometric"]


class _Recorder:
    """A blender that keeps its input and another one's result."""

    def __init__(self, blender: Blender) -> None:
        self.inputs: list[BlendingInputs] = []
        self.images: list[Map] = []
        self._blender = blender

    def blend(self, inputs: BlendingInputs) -> Blended:
        """Return the other blender's result, and keep it."""
        self.inputs.append(inputs)
        blended = self._blender.blend(inputs)
        self.images.append(blended.image)
        return blended


def raw_views(inputs: BlendingInputs) -> RawViews:
    """Return the views of one instant, splats and warps side by side."""
    target, sources = (
        inputs.instant.target,
        [inputs.instant.sources[k] for k in nearest_first(inputs)],
    )
    splatted, warps = blend_maps(inputs, "none"), []
    for source in sources:
        image = source.image.astype(np.float32) / np.float32(255)
        arguments = target, inputs.depth, source.camera, image, source.depth, inputs.tau
        warps.append(warp(*arguments, bicubic=True, forgiven_px=inputs.forgiven_px))
    return RawViews(
        target,
        splatted.sources,
        splats=splatted.colours,
        depths=np.stack(splatted.depths),
        alphas=np.stack(splatted.alphas),
        warps=np.stack([view.colour for view in warps]),
        visibilities=np.stack([view.visibility for view in warps]),
        fused_depth=inputs.depth,
        shares=splatted.shares,
    )


def write_sample(path: Path, sample: BlendSample) -> None:
    """Write a sample so that a killed process leaves either the whole file or none.

    Colours, coverage and visibility are kept in 8 bit, splatted depth in half precision, relative
    to the view's `reference_depth`. The fused depth stays as it is, because its normals would show
    the rounding.
    """
    views = sample.views
    unit = reference_depth(views.fused_depth, views.target)
    arrays: dict[str, Any] = {name: quantise(getattr(views, name)) for name in IN_8_BIT}
    arrays |= camera_arrays((views.target, *views.sources))
    arrays |= {
        "unit": np.float64(unit),
        "depths": (views.depths / np.float32(unit)).astype(np.float16),
    }
    arrays |= {
        "fused_depth": views.fused_depth,
        "truth": sample.truth,
        "geometric": sample.geometric,
    }
    write_arrays(path, arrays)


def read_sample(path: Path) -> BlendSample:
    """Read a sample of `write_sample`."""
    with stored_arrays(path) as arrays:
        target, *sources = stored_cameras(arrays)
        views = RawViews(
            target=target,
            sources=tuple(sources),
            depths=arrays["depths"].astype(np.float32) * np.float32(arrays["unit"]),
            fused_depth=arrays["fused_depth"],
            splats=_unit_range(arrays["splats"]),
            alphas=_unit_range(arrays["alphas"]),
            warps=_unit_range(arrays["warps"]),
            visibilities=_unit_range(arrays["visibilities"]),
        )
        return BlendSample(views, arrays["truth"], arrays["geometric"])


def _unit_range(image: Image8) -> Map:
    return image.astype(np.float32) / np.float32(255)


@dataclass(frozen=True)
class BlendKind(SampleKind[BlendSample]):
    """The views of the sources in the target, and the geometric blender's result."""

    device: str = "cpu"
    folders: ClassVar = {"rooms": ("samples", 5), "captures": ("captures", 3)}

    def make(self, maker: SampleMaker, target: Camera, sources: Sequence[Camera]) -> BlendSample:
        """See `blend_sample`."""
        return blend_sample(maker.instant(target, sources), maker.image(target), self.device)

    def cropped(
        self, sample: BlendSample, left: int, top: int, width: int, height: int
    ) -> BlendSample:
        """Return a window of all that belongs to the target view."""
        return sample.cropped(left, top, width, height)

    def read(self, path: Path) -> BlendSample:
        """See `read_sample`."""
        return read_sample(path)

    def write(self, path: Path, sample: BlendSample) -> None:
        """See `write_sample`."""
        write_sample(path, sample)


@dataclass(frozen=True)
class InstantKind(SampleKind[InstantSample]):
    """Instants as a method is shown them, with the depth of its sources or with none, and the
    target's image.
    """

    depth: bool = True
    folders: ClassVar = {"rooms": ("instants", 1), "captures": ("capture-instants", 1)}

    def make(self, maker: SampleMaker, target: Camera, sources: Sequence[Camera]) -> InstantSample:
        """Return the instant; methods that take no depth need not wait for it."""
        if self.depth:
            return InstantSample(maker.instant(target, sources), maker.image(target))
        views = []
        for source in sources:
            unknown = np.zeros((source.height, source.width), np.float32)
            views.append(
                SourceView(
                    camera=source, image=maker.image(source), depth=unknown, confidence=unknown
                )
            )
        return InstantSample(
            Instant(
                index=0,
                target=target,
                sources=tuple(views),
                units_per_metre=maker.capture.units_per_metre,
            ),
            maker.image(target),
        )

    def cropped(
        self, sample: InstantSample, left: int, top: int, width: int, height: int
    ) -> InstantSample:
        """Return a window of the target, sources cut to what it can show of them."""
        return sample.cropped(left, top, width, height).focused()

    def read(self, path: Path) -> InstantSample:
        """See `read_instant`."""
        return read_instant(path)

    def write(self, path: Path, sample: InstantSample) -> None:
        """See `write_instant`."""
        write_instant(path, sample)
