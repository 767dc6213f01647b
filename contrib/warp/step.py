"""The whole online step on a device: uploads, one recording, one download.

State stays there between the instants.
"""

import gc
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.compute_device import compute_device, out_of_memory, rendering_on
from ggvs_eval.contrib.warp import exposure as exposures
from ggvs_eval.contrib.warp.constants import Remembered, StepConstants
from ggvs_eval.contrib.warp.exposure import ExposureState
from ggvs_eval.contrib.warp.filter import filter_views, trust_past, weigh_depths
from ggvs_eval.contrib.warp.launch import WorkStream
from ggvs_eval.contrib.warp.march import march
from ggvs_eval.contrib.warp.network import DeviceNetwork
from ggvs_eval.contrib.warp.picture import DeviceMaps, blend_views, show_picture
from ggvs_eval.contrib.warp.registration import register_views, settle_depth
from ggvs_eval.contrib.warp.splat import DeviceSplats, splat_views
from ggvs_eval.contrib.warp.stillness import Output, rate_stillness, recur, remember_background
from ggvs_eval.contrib.warp.tables import Size, Sizes, Tables
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.tsdf import march_end
from ggvs_eval.method import Instant, Rendering, SourceView
from ggvs_eval.pipelines.online.blend_network import load_blend_network, shipped_blend_weights
from ggvs_eval.pipelines.online.geometry_guided import OnlineOptions
from ggvs_eval.pipelines.online.network_inputs import Guidance, nearness

PAIRS_PER_GAUSSIAN = 3.2  # pairs of a Gaussian and a tile that there is room for at first
ROOM = 1.25  # times what was needed when it was not enough
FEWEST_ROWS = 64  # of the table of ratios; doubled when a rig has more pairs of sources
PROGRAMS = 4  # sizes and numbers of sources that are kept ready
Precision = Literal["half", "single"]
Mark = Callable[[str], None]  # called when a part of the step begins


@dataclass(frozen=True, eq=False)
class State:
    """State that one instant leaves for the next.

    Attributes:
        images: of the sources, (K, H, W, 3), uint8.
        depths: of the sources, filtered, (K, H, W).
        march: fused depth before it was settled, and the weight behind it, (H, W).
        output: what was shown.
        background: colours (3, H, W) and depth (H, W), see `remember_background`.
        exposure: of the sources.
    """

    images: Tensor
    depths: Tensor
    march: tuple[Tensor, Tensor]
    output: Output
    background: tuple[Tensor, Tensor]
    exposure: ExposureState

    @classmethod
    def empty(cls, sizes: Sizes, rows: int, device: torch.device) -> "State":
        """Return a state in which nothing is remembered."""
        (wide, high), (width, height), (w, h), views = (
            sizes.largest,
            sizes.target,
            sizes.cells,
            len(sizes.views),
        )

        def zeros(*shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.zeros(shape, dtype=dtype, device=device)

        return cls(
            zeros(views, high, wide, 3, dtype=torch.uint8),
            zeros(views, high, wide),
            (zeros(height, width), zeros(height, width)),
            Output(zeros(3, height, width), zeros(3, h, w), zeros(h, w)),
            (zeros(3, height, width), zeros(height, width)),
            ExposureState(zeros(2, dtype=torch.float64), zeros(rows, 5, dtype=torch.float64)),
        )


@dataclass(frozen=True, eq=False)
class Results:
    """Output of a step for the host: the picture as float32 and in 8 bit, (H, W, 3), and the rest
    of `Rendering`.
    """

    image: Tensor
    levels: Tensor
    depth: Tensor
    diagnostics: Mapping[str, Tensor]
    crowding: Tensor

    @classmethod
    def empty(cls, sizes: Sizes, device: torch.device) -> "Results":
        """Room for the results of a step."""
        (width, height), (w, h), (wide, high) = sizes.target, sizes.cells, sizes.network
        maps = {
            name: torch.zeros((h, w), device=device) for name in ("coverage", "motion", "depth")
        }
        maps["weights"] = torch.zeros((len(sizes.views), high, wide), device=device)
        image = torch.zeros((height, width, 3), device=device)
        return cls(
            image, image.to(torch.uint8), image[..., 0].clone(), maps, torch.zeros(1, device=device)
        )


class Program:
    """Memory of a step of given sizes, at fixed places: inputs, constants, tables, two states and
    results.

    A step reads one state and writes the other. If it reads the program's own state, it is recorded
    once per order and replayed; one that reads the state of another program, after a source was
    lost or the target's size has changed, runs call by call. So does all on the CPU.

    Args:
        sizes: of the step.
        rows: of the table of ratios.
        device: where.
    """

    def __init__(self, sizes: Sizes, rows: int, device: torch.device) -> None:
        self.sizes, self.device = sizes, device
        self.tables, self.constants = Tables(sizes, device), StepConstants(sizes, device)
        self.states = State.empty(sizes, rows, device), State.empty(sizes, rows, device)
        self.depths, self.results = (
            torch.zeros_like(self.states[0].depths),
            Results.empty(sizes, device),
        )
        self.work, self.warm = WorkStream(device), False
        self._graphs: dict[int, torch.cuda.CUDAGraph] = {}
        self._on_gpu = device.type == "cuda"
        if self._on_gpu:
            self._copies = torch.cuda.Stream(device)
            self._pool = torch.cuda.graph_pool_handle()
            pinned: Any = {"device": "cpu", "pin_memory": True}
            self._images = torch.zeros(self.states[0].images.shape, dtype=torch.uint8, **pinned)
            self._depths = torch.zeros(self.depths.shape, **pinned)

    def upload(self, sources: Sequence[SourceView], after: int) -> None:
        """Copy images and depths where the step reads them, each view on its way while the next is
        read; no one waits.
        """
        images, depths = self.states[after].images, self.depths
        if self._on_gpu:
            # of who made depth there
            self._copies.wait_stream(torch.cuda.current_stream(self.device))
        with torch.cuda.stream(self._copies) if self._on_gpu else nullcontext():
            for k, (source, (width, height)) in enumerate(
                zip(sources, self.sizes.views, strict=True)
            ):
                self._copy(
                    torch.from_numpy(np.ascontiguousarray(source.image)),
                    images[k, :height, :width],
                    k,
                    "_images",
                )
                depth: Any = source.depth
                if not isinstance(depth, Tensor):
                    depth = torch.from_numpy(np.ascontiguousarray(depth, np.float32))
                self._copy(depth, depths[k, :height, :width], k, "_depths")

    def _copy(self, values: Tensor, out: Tensor, k: int, staging: str) -> None:
        if self._on_gpu and values.device.type == "cpu":
            pinned = getattr(self, staging)[k, : out.shape[0], : out.shape[1]]
            pinned.copy_(values)
            values = pinned
        out.copy_(values, non_blocking=True)

    @contextmanager
    def working(self, launching: bool) -> Iterator[None]:
        """Within, work is queued behind the uploads.

        `launching` where it is launched call by call, or recorded.
        """
        if self._on_gpu:
            assert self.work.stream is not None
            self.work.stream.wait_stream(self._copies)
        with rendering_on(self.device) if launching else nullcontext(), self.work.working():
            self.constants.upload()
            yield

    def is_recorded(self, after: int) -> bool:
        """Return whether the step that writes a state can be played."""
        return after in self._graphs

    def play(self, after: int, compute: Callable[[], None]) -> None:
        """Compute, or play what was recorded of it for that order of the states."""
        if not (self._on_gpu and self.warm):
            compute()
        else:
            if after not in self._graphs:
                self._graphs[after] = self._record(compute)
            self._graphs[after].replay()

    def _record(self, compute: Callable[[], None]) -> torch.cuda.CUDAGraph:
        graph = torch.cuda.CUDAGraph()
        torch.cuda.synchronize(self.device)
        gc.collect()
        gc.disable()  # what a collection frees must not be freed while recording
        try:
            with self.work.recording(graph, self._pool):
                compute()
        finally:
            gc.enable()
        return graph

    def forget_recordings(self) -> None:
        """Record anew, since something has another size."""
        self._graphs.clear()

    def downloaded(self, tensors: Sequence[Tensor]) -> list[Any]:
        """Copy tensors to the host and wait for them; the arrays are the caller's."""
        if not self._on_gpu:
            return [tensor.numpy().copy() for tensor in tensors]
        hosts = [
            torch.empty(tensor.shape, dtype=tensor.dtype, device="cpu", pin_memory=True)
            for tensor in tensors
        ]
        for host, tensor in zip(hosts, tensors, strict=True):
            host.copy_(tensor, non_blocking=True)
        assert self.work.stream is not None
        self.work.stream.synchronize()
        return [host.numpy() for host in hosts]


class DeviceGuided:
    """`GeometryGuided` with the blending network, every stage of it on one device.

    Args:
        options: constants of the method; those that `covers` refuses are not for here.
        guidance: of the network that ships.
        device: a GPU, see `compute_device`, or the CPU for tests: the compiled path is many times
            as fast there.
        weights: file of a network's weights in place of those that ship.
        precision: of the network's activations; half on a GPU and single on the CPU unless given.
        recorded: play steps from recordings on a GPU; without, each part is timed.

    Attributes:
        details: seconds of every part of the last step that was not recorded.
        takes_device_depth: makes `OnlineSynthesizer` leave estimated depth on the device.

    Reading:
        Pictures are those of the compiled path except for rounding. Weights, march, contested depth
        and registration give the same bits from the same inputs on a CPU; masks, splats,
        convolutions and sums differ in the last ones. Where a comparison decides, a last bit may
        move a pixel: of the depths near a zero crossing of the fused field, of the votes on
        contested depth, of what is remembered. Three instants of two views of the demo room at 480
        x 360, K = 4: no pixel off by a level (0.25 of one at most), 0.005 % of the depths off by
        more than 0.1 mm. For half precision see `DeviceNetwork`.
    """

    takes_device_depth = True

    def __init__(
        self,
        options: OnlineOptions | None = None,
        guidance: Guidance = "registered",
        device: str = "cpu",
        weights: Path | None = None,
        precision: Precision | None = None,
        recorded: bool = True,
    ) -> None:
        """Start a sequence.

        Raises:
            DeviceError: no such device here.
            RenderError: options that the device does not compute.
            WeightsError: no usable weights.
        """
        self.options, self._device, self._recorded = (
            options or OnlineOptions(),
            compute_device(device),
            recorded,
        )
        network = load_blend_network(weights or shipped_blend_weights(guidance), self._device)
        guidance = network.config.guidance
        if not self.covers(self.options, guidance) or network.refiner is None:
            raise RenderError(
                f"online step on {device}: wanted the method as it ships, got {self.options}, "
                f"guidance {guidance}"
            )
        precision = precision or ("half" if self._device.type == "cuda" else "single")
        self._network = DeviceNetwork(
            network, torch.float16 if precision == "half" else torch.float32
        )
        self._registered = guidance == "registered"
        self._programs: OrderedDict[tuple[Any, ...], Program] = OrderedDict()
        self._latest: tuple[Program, int, Remembered] | None = None
        self._rows: dict[tuple[str, str], int] = {}  # of pairs of cameras in the table of ratios
        self._per_gaussian = PAIRS_PER_GAUSSIAN
        self.details: dict[str, float] = {}

    @staticmethod
    def covers(options: OnlineOptions | None, guidance: Guidance) -> bool:
        """Return whether the device computes the method with such options.

        Readings that were tried and dropped it does not.
        """
        usual = OnlineOptions()
        options = options or usual
        compared = ("fused", "mask_views", "splatted_as", "signed_distance", "normalised_field")
        return guidance in ("registered", "channels") and all(
            getattr(options, name) == getattr(usual, name) for name in compared
        )

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant and remember what the next one needs.

        Args:
            instant: its sources' depth may be tensors on the device.

        Raises:
            DeviceError: the GPU's memory is out.
            RenderError: more source views than the network is made for.
        """
        begun_s = perf_counter()
        results, (image, depth, *maps), seconds = self._advance(
            instant, lambda r: [r.image, r.depth, *r.diagnostics.values()]
        )
        return Rendering(
            image,
            depth,
            _stages(begun_s, seconds),
            dict(zip(results.diagnostics, maps, strict=True)),
        )

    def show(self, instant: Instant) -> Image8:
        """As `step`, the picture alone, in 8 bit, (H, W, 3)."""
        _, (levels,), _ = self._advance(instant, lambda results: [results.levels])
        return np.asarray(levels, np.uint8)

    def _advance(
        self, instant: Instant, select: Callable[[Results], Sequence[Tensor]]
    ) -> tuple[Results, list[Map], tuple[float, float]]:
        """Make a step; its results, those that are wanted on the host, when it was queued and how
        many seconds it took.
        """
        most = self._network.config.views
        if len(instant.sources) > most:
            raise RenderError(
                f"a blending network for at most {most} source views, got {len(instant.sources)}"
            )
        sources = sorted(
            instant.sources, key=lambda source: nearness(source.camera, instant.target)
        )
        program, rows = self._program(instant, sources)
        before, after = self._states(program)
        options, tau = self.options, self.options.tau_m * instant.units_per_metre
        depths = [] if program.warm else [source.depth for source in sources]
        end = march_end(instant.target, tau, options.min_step, depths)
        plays = self._recorded and before is program.states[1 - after]
        with out_of_memory(self._device, "render at a smaller size"), torch.inference_mode():
            program.constants.fill(
                instant, sources, options, end, self._latest[2] if self._latest else None, rows
            )
            program.upload(sources, after)
            while True:
                with program.working(launching=not (plays and program.is_recorded(after))):
                    clock, queued_s = _Clock(self._device), perf_counter()
                    clock.mark("step")
                    if plays:
                        program.play(
                            after, lambda: self._compute(program, before, after, lambda part: None)
                        )
                    else:
                        self._compute(program, before, after, clock.mark)
                    clock.mark("")
                    *arrays, crowding = program.downloaded(
                        [*select(program.results), program.results.crowding]
                    )
                if self._room_sufficed(float(crowding[0])):
                    break
        program.warm = True
        cameras = tuple(source.camera for source in sources)
        self._latest = program, after, Remembered(instant.index, instant.target, cameras)
        parts = clock.seconds()
        self.details = {name: value for name, value in parts.items() if name != "step"}
        return program.results, arrays, (queued_s, sum(parts.values()))

    def _program(
        self, instant: Instant, sources: Sequence[SourceView]
    ) -> tuple[Program, list[int]]:
        """Return the program of an instant's sizes, and the rows of its pairs of sources in the
        table of ratios.
        """
        names = [source.camera.name for source in sources]
        pairs = [(min(pair), max(pair)) for pair in combinations(names, 2)]
        if self._latest is None or self._latest[2].index != instant.index - 1:
            self._rows = {}  # gains are forgotten too
        rows = [self._rows.setdefault(pair, 1 + len(self._rows)) for pair in pairs] or [0]
        room = max(FEWEST_ROWS, 1 << len(self._rows).bit_length())
        if self._latest is not None:
            room = max(room, len(self._latest[0].states[0].exposure.ratios))
        views: tuple[Size, ...] = tuple(source.camera.size for source in sources)
        sizes = Sizes(views, instant.target.size, self._network.config.scale)
        if (sizes, room) not in self._programs:
            while len(self._programs) >= PROGRAMS:
                self._programs.popitem(last=False)
            with rendering_on(self._device):
                self._programs[sizes, room] = Program(sizes, room, self._device)
        self._programs.move_to_end((sizes, room))
        return self._programs[sizes, room], rows

    def _states(self, program: Program) -> tuple[State, int]:
        """Return the state that a step reads, and the number of the program's own that it writes.

        What the target showed at another size is not read: that program's own takes its place.
        """
        if self._latest is None:
            return program.states[1], 0
        latest, number, _ = self._latest
        if latest is program:
            return program.states[number], 1 - number
        state, target_state = latest.states[number], program.states[1]
        if latest.sizes.target != program.sizes.target:
            state = State(
                state.images,
                state.depths,
                state.march,
                target_state.output,
                target_state.background,
                state.exposure,
            )
        return state, 0

    def _room_sufficed(self, needed: float) -> bool:
        """Return whether all pairs found room, and make more of it where they did not: the step is
        made again then.
        """
        if needed <= self._per_gaussian:
            return True
        self._per_gaussian = ROOM * needed
        for program in self._programs.values():
            program.forget_recordings()
        return False

    def _compute(self, program: Program, before: State, after: int, mark: Mark) -> None:
        """All of a step that computes; nothing is read back."""
        options, c, t, out, results = (
            self.options,
            program.constants,
            program.tables,
            program.states[after],
            program.results,
        )
        mark("masks and filter")
        history = before.images, before.depths
        masks, changes = filter_views(
            out.images, program.depths, history, c, t, options, out.depths
        )
        images, depths, exposure = out.images, out.depths, None
        splatted = depths if options.splatted_depth == "filtered" else program.depths
        if options.compensated:
            mark("exposure")
            exposure = exposures.estimate_exposure(
                images, depths, before.exposure, c, t, out.exposure
            )
            images = exposures.compensate(images, exposure)
            depths, splatted = (
                exposures.leave_out(depth, exposure) for depth in (depths, splatted)
            )
        mark("fusion weights")
        weights = weigh_depths(depths, c, t)
        mark("splat")
        splats = splat_views(images, splatted, masks, c, t, self._per_gaussian)
        mark("occupancy and march")
        gain = trust_past(splats.features, splats.alphas, c, options)
        limits = options.min_step, options.eta
        march(depths, weights, before.march, gain, c, t, limits, out.march)
        mark("contested depth")
        surface = out.march[0]
        if options.settled:
            surface = settle_depth(
                surface, images, splats, c, t, exposure.odd if exposure else None
            )
        mark("stillness")
        cells = rate_stillness(
            surface, splats, (out.images, before.images), depths, changes, c, t, options
        )
        mark("registration")
        maps = DeviceMaps(*register_views(surface, images, depths, splats, c, t), splats, surface)
        mark("network and composition")
        picture, shares = blend_views(self._network, maps, self._registered, c, t)
        if exposure is not None:
            picture = exposures.show_fall_off(picture, exposure)
        mark("memories")
        if options.temporal and options.remembered:
            picture = remember_background(
                picture, surface, splats, cells.still, before.background, c, out.background
            )
        if options.temporal and options.recurrent_limit > 0:
            recur(picture, cells.still, before.output, options.recurrent_limit, c, t, out.output)
            picture = out.output.picture
        show_picture(picture, results.image, results.levels)
        self._leave(
            results,
            surface,
            splats,
            {"coverage": cells.coverage, "depth": cells.depth, "weights": shares},
        )
        results.diagnostics["motion"].copy_(cells.still).neg_().add_(1)

    @staticmethod
    def _leave(
        results: Results, surface: Tensor, splats: DeviceSplats, maps: Mapping[str, Tensor]
    ) -> None:
        """Put what a step found where it is read."""
        results.depth.copy_(surface)
        results.crowding.copy_(splats.crowding)
        for name, values in maps.items():
            results.diagnostics[name].copy_(values)


def _stages(begun_s: float, step: tuple[float, float]) -> dict[str, float]:
    """Return the seconds until the step was queued, of the step, and from its end to the
    picture.
    """
    queued_s, seconds = step
    return {
        "upload": queued_s - begun_s,
        "step": seconds,
        "download": max(perf_counter() - queued_s - seconds, 0.0),
    }


class _Clock:
    """Times of the parts of a step: by events of the GPU, read when all is done, or by the host's
    clock.
    """

    def __init__(self, device: torch.device) -> None:
        self._device, self._marks = device, list[tuple[str, Any]]()

    def mark(self, part: str) -> None:
        """A part begins, and the one before ends."""
        if self._device.type == "cuda":
            event: Any = torch.cuda.Event(enable_timing=True)
            event.record(torch.cuda.current_stream(self._device))
        else:
            event = perf_counter()
        self._marks.append((part, event))

    def seconds(self) -> dict[str, float]:
        """Return the seconds of each part."""
        spans = [(part, begin, end) for (part, begin), (_, end) in pairwise(self._marks)]
        if self._device.type == "cuda":
            self._marks[-1][1].synchronize()
            return {part: begin.elapsed_time(end) / 1e3 for part, begin, end in spans}
        return {part: end - begin for part, begin, end in spans}
