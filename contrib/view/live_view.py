"""Live view of one viewer: the picture of a pose and an instant by a method, small while something
moves, whole at rest.

Frames and depth of a rig are kept in memory, up to a limit, at the sizes at which a live view reads
them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from time import perf_counter
from typing import Literal

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera, SourceChoice
from ggvs_eval.depth_options import LIVE_MATCHER
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import quantise
from ggvs_eval.method import Rendering
from ggvs_eval.pipelines.offline.depth.rig_depth import DeviceDepth, RigDepth
from ggvs_eval.pipelines.play.playback import Playback
from ggvs_eval.pipelines.play.synthesizer import LEAST_SEEN, OnlineSynthesizer, seen_share
from ggvs_eval.pipelines.run.render import diagnostics_picture

MEMORY_BYTES = 1 << 30
BYTES_PER_PIXEL = 3 + 4 + 4  # colour, depth, confidence
Layer = Literal["picture", "depth", "weights", "coverage", "motion"]
LAYERS: tuple[Layer, ...] = ("picture", "depth", "weights", "coverage", "motion")
DIVIDER_COLOUR = 255
FADED_GREY, MOST_FADED = 128, 0.85


class FrameStock:
    """Cache of what the cameras of a playback see, of at most N pixels.

    Least recently used frames are dropped first.

    Where depth is live it is found at that size, when it is asked for.

    Args:
        pixels: per image, at most; images are made smaller, never larger.

    Attributes:
        cameras: the rig at that size.
        live: see `Playback.live`.
    """

    def __init__(self, playback: Playback, pixels: int, memory: int = MEMORY_BYTES) -> None:
        self._playback = playback
        self.cameras = tuple(fitted(camera, pixels) for camera in playback.capture.cameras)
        self._sizes = {camera.name: camera.size for camera in self.cameras}
        largest = max(width * height for width, height in self._sizes.values())
        count = max(memory // (largest * BYTES_PER_PIXEL), len(self.cameras))
        self.image, self.read = lru_cache(count)(self._image), lru_cache(count)(self._read)
        self.live = playback.live
        self._finder = None if playback.live is None else RigDepth(self.cameras, playback.live)

    def _image(self, name: str, instant: int) -> Image8:
        """Return the frame of one camera at one instant, (H, W, 3)."""
        image, size = self._playback.capture.frame(name, instant), self._sizes[name]
        return (
            image
            if size == image.shape[1::-1]
            else cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
        )

    def _read(self, name: str, instant: int) -> tuple[Image8, DepthMap]:
        """Return the frame and the depth of one camera at one instant, (H, W, 3) and (H, W)."""
        image, size = self.image(name, instant), self._sizes[name]
        if self._finder is not None:
            images = {camera: self.image(camera, instant) for camera in self._finder.needed([name])}
            depth_map = self._finder.estimate([name], images)[name]
            return image, depth_map.download() if isinstance(depth_map, DeviceDepth) else depth_map
        depth_map = self._playback.store.read(self._playback.depth_keys[name], instant)
        if size == depth_map.depth.shape[1::-1]:
            return image, depth_map
        # Depths of two surfaces must not be mixed: a mean would be on neither.
        depth, confidence = (
            cv2.resize(values, size, interpolation=cv2.INTER_NEAREST_EXACT)
            for values in (depth_map.depth, depth_map.confidence)
        )
        return image, DepthMap(depth, confidence)


def fitted(camera: Camera, pixels: int) -> Camera:
    """Return the camera at its own size, or at the largest one of its shape with at most N pixels.

    Examples:
        >>> import numpy as np
        >>> camera = Camera(
        ...     "cam00",
        ...     np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]]),
        ...     np.eye(4),
        ...     8,
        ...     6,
        ...     near=1.0,
        ...     far=9.0,
        ... )
        >>> fitted(camera, 12).size, fitted(camera, 100).size
        ((4, 3), (8, 6))
    """
    share = min((pixels / (camera.width * camera.height)) ** 0.5, 1.0)
    return camera.resized(max(int(camera.width * share), 1), max(int(camera.height * share), 1))


@dataclass(frozen=True, eq=False)
class ViewRequest:
    """One picture that a viewer asks for.

    Attributes:
        pose: the virtual camera, at the size of the viewer's window.
        instant: frame number of the capture.
        methods: label of the method; of two, the first left of the divider and the second right of
            it.
        layer: the picture, or what the method decided on the way to it.
        divider: where the two meet, share of the width.
    """

    pose: Camera
    instant: int
    methods: tuple[str, ...]
    k: int
    layer: Layer = "picture"
    divider: float = 0.5


@dataclass(frozen=True)
class Picture:
    """The answer to a request.

    Attributes:
        image: (H, W, 3), RGB uint8.
        seconds: of each stage of each method: label -> stage -> seconds, with the whole step as
            ``step``.
        sources: names of the source cameras of the first method, nearest first.
        seen_share: share of the view that the cameras see, see `seen_share`.
        known_depth: share of the sources' pixels of which the depth is known.
    """

    image: Image8
    seconds: dict[str, dict[str, float]]
    sources: tuple[str, ...]
    seen_share: float = 1.0
    known_depth: float = 1.0

    @property
    def is_outside(self) -> bool:
        """True if the cameras do not see enough of the view."""
        return self.seen_share < LEAST_SEEN

    @property
    def faded(self) -> Image8:
        """The image as it is inside of what the cameras see.

        Outside of it grey, the more so the farther.
        """
        if not self.is_outside:
            return self.image
        share = MOST_FADED * (1 - self.seen_share / LEAST_SEEN)
        return cv2.addWeighted(
            self.image, 1 - share, np.full_like(self.image, FADED_GREY), share, 0
        ).astype(np.uint8)


@dataclass
class _Running:
    """A method in the middle of a sequence, and the instant it was last shown."""

    synthesizer: OnlineSynthesizer
    instant: int | None = None


@dataclass
class LiveView:
    """Pictures of one size for one viewer, each method with its history.

    A method sees instants as they come: the same one again while time is static, the next one while
    it plays. It begins anew after any other jump in time, since it would take what it remembers for
    the instant before.

    Attributes:
        pixels: of a picture, at most.
        sources: which cameras are source views, see `choose_sources`.
    """

    stock: FrameStock
    units_per_metre: float
    pixels: int
    device: str = "cpu"
    sources: SourceChoice = "nearest"
    _running: dict[str, _Running] = field(default_factory=dict)

    def picture(self, request: ViewRequest) -> Picture:
        """Synthesise the picture of a request."""
        target = fitted(request.pose, self.pixels)
        self._running = {
            label: method for label, method in self._running.items() if label in request.methods
        }
        seconds: dict[str, dict[str, float]] = {}
        images = []
        for label in request.methods:
            begun = perf_counter()
            rendering = self._step(label, request, target)
            images.append(layer_image(rendering, request.layer, target, label))
            seconds[label] = {**rendering.seconds, "step": perf_counter() - begun}
        sources = self._running[request.methods[0]].synthesizer.sources(target)
        names = tuple(camera.name for camera in sources)
        known_share = 1.0  # by a network that is sure of nothing, but has an opinion everywhere
        if self.stock.live is None:
            depths = [self.stock.read(name, request.instant)[1].depth for name in names]
            known_share = float(np.mean([(depth > 0).mean() for depth in depths]))
        return Picture(
            image=divided(images, request.divider),
            seconds=seconds,
            sources=names,
            seen_share=seen_share(target, self.stock.cameras),
            known_depth=known_share,
        )

    def restart(self) -> None:
        """Forget the methods' history."""
        self._running.clear()

    def _step(self, label: str, request: ViewRequest, target: Camera) -> Rendering:
        if label not in self._running:
            made_by = (label, self.device, self.sources, self.stock.live or LIVE_MATCHER)
            self._running[label] = _Running(
                OnlineSynthesizer(self.stock.cameras, request.k, self.units_per_metre, *made_by)
            )
        running = self._running[label]
        if running.instant is not None and request.instant not in (
            running.instant,
            running.instant + 1,
        ):
            running.synthesizer.restart()
        running.synthesizer.k, running.instant = request.k, request.instant
        if self.stock.live is not None:
            images = {
                name: self.stock.image(name, request.instant)
                for name in running.synthesizer.needed(target)
            }
            return running.synthesizer.step(images, None, target)
        frames = {
            camera.name: self.stock.read(camera.name, request.instant)
            for camera in running.synthesizer.sources(target)
        }
        images = {name: image for name, (image, _) in frames.items()}
        depths = {name: depth for name, (_, depth) in frames.items()}
        return running.synthesizer.step(images, depths, target)


def layer_image(rendering: Rendering, layer: Layer, target: Camera, label: str) -> Image8:
    """Return the picture, or a map behind it in colours, at the target's size."""
    if layer == "picture":
        return quantise(rendering.image)
    maps = dict(rendering.diagnostics)
    if rendering.depth is not None:
        maps["depth"] = rendering.depth
    if layer not in maps:
        raise RenderError(f"{label} has no {layer}; choose {', '.join(['picture', *sorted(maps)])}")
    return cv2.resize(
        diagnostics_picture(layer, maps[layer], target),
        target.size,
        interpolation=cv2.INTER_NEAREST_EXACT,
    )


def divided(images: Sequence[Image8], share: float) -> Image8:
    """Return the first image left of a line, the second right of it; a single one as it is."""
    if len(images) == 1:
        return images[0]
    left, right = images
    column = int(np.clip(round(share * left.shape[1]), 0, left.shape[1] - 1))
    joined = np.concatenate([left[:, :column], right[:, column:]], axis=1)
    joined[:, max(column - 1, 0) : column + 1] = DIVIDER_COLOUR
    return joined


def recorded_pose(request: ViewRequest, view: Camera, index: int) -> Camera:
    """Return the pose of a request as a camera of a rig's own size and depth range, called
    ``pose0000``, ...

    The vertical field of view is kept; a window of another shape shows more or less at the sides.
    """
    pose = request.pose
    focal = pose.K[1, 1] * view.height / pose.height
    K = np.array([[focal, 0, view.width / 2], [0, focal, view.height / 2], [0, 0, 1]])
    return replace(view, name=f"pose{index:04d}", K=K, world_to_camera=pose.world_to_camera)
