"""The online method on a device: between the decoded frames and the picture nothing is copied to the host."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any

import torch
from torch import Tensor

from ggvs_eval.compute_device import compute_device, rendering_on
from ggvs_eval.errors import RenderError
from ggvs_eval.method import Instant, Rendering
from ggvs_eval.pipelines.online.blend_maps import Guidance, nearness
from ggvs_eval.pipelines.online.blend_weights import load_blend_network, shipped_blend_weights
from ggvs_eval.pipelines.online.device import memories, picture
from ggvs_eval.pipelines.online.device.exposure import show_fall_off
from ggvs_eval.pipelines.online.device.geometry import GeometryState, PairRoom, blending_inputs
from ggvs_eval.pipelines.online.device.launch import on_stream_of
from ggvs_eval.pipelines.online.device.memories import Background, Shown
from ggvs_eval.pipelines.online.device.stillness import cells, splatted_change, stillness
from ggvs_eval.pipelines.online.device.views import DeviceViews, upload
from ggvs_eval.pipelines.online.geometry_guided import SAME_SURFACE_TAU, OnlineOptions


@dataclass(frozen=True, eq=False)
class _State:
    """State that one instant leaves for the next."""

    geometry: GeometryState = field(default_factory=GeometryState)
    background: Background | None = None
    shown: Shown | None = None


@dataclass(frozen=True, eq=False)
class _Outcome:
    """A rendered instant, still on the device."""

    image: Tensor
    depth: Tensor
    diagnostics: Mapping[str, Tensor]
    pairs: Tensor
    state: _State


class DeviceGuided:
    """`GeometryGuided` with the blending network, every stage of it on one device.

    Args:
        options: constants of the method; those that `covers` refuses are not for here.
        guidance: of the network that ships.
        device: a GPU, see `compute_device`, or the CPU for tests: the compiled path is many times as fast there.
        weights: file of a network's weights in place of those that ship.

    Attributes:
        details: seconds of every part of the last step, finer than the stages of its `Rendering`.
        takes_device_depth: the depth of a source may be a tensor on the device.

    Reading:
        Pictures are those of the compiled path but for rounding. Filter, weights, march, contested depth and registration give
        the same bits from the same inputs on a CPU; masks, splats, convolutions and sums differ in the last ones. Where a
        comparison decides, a last bit may move a pixel: of the depths near a zero crossing of the fused field, of the votes on
        contested depth, of what is remembered. Three instants of two views of the demo room at 480 x 360, K = 4: no pixel off by
        a level (0.25 of one at most), 0.005 % of the depths off by more than 0.1 mm.
    """

    takes_device_depth = True

    def __init__(
        self,
        options: OnlineOptions | None = None,
        guidance: Guidance = "registered",
        device: str = "cpu",
        weights: Path | None = None,
    ) -> None:
        """Start a sequence.

        Raises:
            DeviceError: no such device here.
            RenderError: options that the device does not compute.
            WeightsError: no usable weights.
        """
        self.options, self._device = options or OnlineOptions(), compute_device(device)
        self._network = load_blend_network(weights or shipped_blend_weights(guidance), self._device)
        guidance = self._network.config.guidance
        if not covers(self.options, guidance):
            raise RenderError(f"online step on {device}: wanted the method as it ships, got {self.options}, guidance {guidance}")
        self._registered = guidance == "registered"
        self._state, self._room = _State(), PairRoom()
        self.details: dict[str, float] = {}

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant and remember what the next one needs.

        Raises:
            DeviceError: the GPU's memory is out.
            RenderError: more source views than the network is made for.
        """
        most = self._network.config.views
        if len(instant.sources) > most:
            raise RenderError(f"a blending network for at most {most} source views, got {len(instant.sources)}")
        sources = sorted(instant.sources, key=lambda source: nearness(source.camera, instant.target))
        clock = _StageClock(self._device)
        with rendering_on(self._device), on_stream_of(self._device):
            clock.mark("filter", "upload")
            views = upload(sources, self._device)
            while True:
                outcome = self._render(instant, views, clock)
                clock.mark("blend", "download")
                image = outcome.image.permute(1, 2, 0).contiguous().numpy(force=True)
                if self._room.sufficed(views, outcome.pairs):  # nothing was remembered yet
                    break
            self._state = outcome.state
            diagnostics = {name: value.contiguous().numpy(force=True) for name, value in outcome.diagnostics.items()}
            depth = outcome.depth.numpy(force=True)
            clock.mark("", "")
        seconds, self.details = clock.seconds()
        return Rendering(image, depth, seconds, diagnostics)

    def _render(self, instant: Instant, views: DeviceViews, clock: "_StageClock") -> _Outcome:
        """All of a step that computes; the state is read and not changed."""
        chosen, state, index, target = self.options, self._state, instant.index, instant.target
        inputs = blending_inputs(instant, views, chosen, state.geometry, self._room.capacity(views), clock.mark)
        splats, surface = inputs.splats, inputs.depth
        clock.mark("blend", "registration")
        largest = splatted_change(splats, inputs.changes, chosen.beta_mask, chosen.lambda_t)
        still = stillness(target, surface, inputs.views, inputs.changes, largest, SAME_SURFACE_TAU * inputs.tau)
        maps = picture.register_views(target, surface, inputs.views, splats, inputs.tau)
        clock.mark("blend", "network and composition")
        image, shares = picture.blend_views(self._network, maps, self._registered)
        if inputs.exposure is not None:
            image = show_fall_off(image, target, inputs.exposure)
        clock.mark("blend", "memories")
        background, shown = state.background, state.shown
        if chosen.temporal and chosen.remembered:
            image, background = memories.remember(index, target, image, surface, splats, still, background)
        if chosen.temporal and chosen.recurrent_limit > 0:
            shown = memories.recur(index, target, image, still, shown, chosen.recurrent_limit)
            image = shown.picture
        diagnostics = {
            "coverage": cells(splats.alphas).amax(dim=0),
            "motion": 1 - still,
            "depth": cells(surface),
            "weights": shares,
        }
        return _Outcome(image, surface, diagnostics, splats.pairs, _State(inputs.state, background, shown))


def covers(options: OnlineOptions | None, guidance: Guidance) -> bool:
    """Tell whether the device computes the method with such options; readings that were tried and dropped it does not."""
    usual = OnlineOptions()
    options = options or usual
    same = ("fused", "mask_views", "splatted_as", "signed_distance", "normalised_field")
    return guidance in ("registered", "channels") and all(getattr(options, name) == getattr(usual, name) for name in same)


class _StageClock:
    """Times of the stages and their parts: by events of the GPU, read when all is done, or by the host's clock."""

    def __init__(self, device: torch.device) -> None:
        self._device, self._on_gpu = device, device.type == "cuda"
        self._marks: list[tuple[str, str, Any]] = []

    def mark(self, stage: str, part: str) -> None:
        """A part of a stage begins, and the one before ends."""
        if self._on_gpu:
            event = torch.cuda.Event(enable_timing=True)
            event.record(torch.cuda.current_stream(self._device))
            self._marks.append((stage, part, event))
        else:
            self._marks.append((stage, part, perf_counter()))

    def seconds(self) -> tuple[dict[str, float], dict[str, float]]:
        """Seconds of each stage and of each part; those of one that was done twice add up."""
        if self._on_gpu:
            torch.cuda.synchronize(self._device)
        stages: dict[str, float] = {}
        parts: dict[str, float] = {}
        for (stage, part, begin), (_, _, end) in pairwise(self._marks):
            span = begin.elapsed_time(end) / 1e3 if self._on_gpu else end - begin
            stages[stage] = stages.get(stage, 0.0) + span
            parts[part] = parts.get(part, 0.0) + span
        return stages, parts
