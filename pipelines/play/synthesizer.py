"""Live synthesis: images of a rig go in, with depth or without, the view of a virtual camera comes
out, instant by instant.

Doubtful input is reported: mistakes that still give a picture, and views that no camera has.
"""

import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, get_args

import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.camera import Camera, SourceChoice
from ggvs_eval.depth_options import LIVE_MATCHER, DepthRunOptions
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import CameraError, DepthError, GgvsWarning, RenderError
from ggvs_eval.files.images import quantise
from ggvs_eval.geometry.pinhole import as_image8
from ggvs_eval.geometry.source_views import (
    ChosenSource,
    choose_sources,
    ray_angles,
    sample_view,
    sees,
    share_of_view,
)
from ggvs_eval.method import Instant, LookaheadMethod, Method, Rendering, SourceView
from ggvs_eval.pipelines.methods.network_options import NetworkOptions, checked_device
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.rig_depth import DeviceDepth, RigDepth

LEAST_FOCAL = 0.05  # of the image's width; a lens of 169 degrees
MOST_OUTSIDE = 0.5  # of the pixels with depth, farther outside near..far than by the factor
OUTSIDE_FACTOR = 2.0
MILLIMETRES = 100.0  # times the far bound, from which on depth is taken for millimetres
# between the rays of a view and of a camera to a point, up to which the camera shows what the view
# sees
SEEN_FROM_DEG = 20.0
LEAST_SEEN = 0.8  # of a view
DEFAULT_METHOD = "ours"


class OnlineSynthesizer:
    """A method behind a rig of fixed cameras.

    Each step looks from K cameras chosen for the target, so that the sources follow a target that
    moves; a camera counts less and less as it is about to give way to another one. A camera that
    was no source at the step before begins without history.

    Args:
        cameras: the rig, at the size of its images.
        k: number of source views per step; may be set anew between steps.
        method: a label of `ggvs_eval.pipelines.methods.registry.METHODS`, or what makes a fresh
            method.
        device: where the networks of a method compute that is given by its label, see
            `compute_device`.
        sources: which cameras a step takes: the K ``nearest``, or those that see most of the
            target's view (``coverage``).
        depth: how a step that is given no depth finds it: the name of a matcher, see
            `depth_choice.MATCHERS`, or its options. ``itermvs:CHECKPOINT`` finds that of all
            sources in one batch on the device, and leaves it there.

    Raises:
        DeviceError: no such device here.
        CameraError: two cameras of one name, or fewer than `k`.
        RenderError: unknown method, or one that is not online.

    Examples:
        >>> from ggvs_eval.camera import translated_path
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> rig = translated_path(camera, span=0.5, count=3)
        >>> synthesizer = OnlineSynthesizer(rig, k=2, method="ours-geometric")
        >>> images = {each.name: np.full((6, 8, 3), 128, np.uint8) for each in rig}
        >>> depths = {each.name: np.full((6, 8), 2.0, np.float32) for each in rig}
        >>> rendering = synthesizer.step(images, depths, target=camera)
        >>> rendering.image.shape, round(float(rendering.image[3, 4, 0]), 2)
        ((6, 8, 3), 0.5)
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        k: int = 4,
        units_per_metre: float = 1.0,
        method: str | Callable[[], Method] = DEFAULT_METHOD,
        device: str = "cpu",
        sources: SourceChoice = "nearest",
        depth: str | DepthOptions = LIVE_MATCHER,
    ) -> None:
        twice = [
            name for name, count in Counter(camera.name for camera in cameras).items() if count > 1
        ]
        if twice:
            raise CameraError(
                f"rig: wanted each camera once, got {', '.join(twice)} several times; name cameras "
                f"differently"
            )
        if not 0 < units_per_metre < np.inf:
            raise CameraError(
                f"rig: wanted a positive number of world units per metre, got {units_per_metre:g}"
            )
        self.cameras = tuple(cameras)
        self.units_per_metre = units_per_metre
        if sources not in get_args(SourceChoice):
            raise CameraError(
                f"rig: wanted sources to be one of {', '.join(get_args(SourceChoice))}, got "
                f"{sources!r}"
            )
        self._make = online_method(method, device)
        self._choice: SourceChoice = sources
        self._doubts = Doubts(self.cameras)
        self._depth, self._device = depth, checked_device(device)
        self._rig_depth: RigDepth | None = None
        self.k = k
        self.restart()

    @property
    def k(self) -> int:
        """Number of source views per step."""
        return self._k

    @k.setter
    def k(self, count: int) -> None:
        if not 1 <= count <= len(self.cameras):
            raise CameraError(f"rig: wanted 1 to {len(self.cameras)} source views, got {count}")
        self._k = count

    def restart(self) -> None:
        """Forget all that was seen: the next step is the first of another sequence."""
        self._method = self._make()
        self._index = 0

    def sources(self, target: Camera) -> list[Camera]:
        """Return the cameras that a step towards this target takes, nearest first.

        One of the target's own name is left out.

        Raises:
            CameraError: fewer than K are left, or none of them looks the target's way.
        """
        return [
            source.camera for source in choose_sources(target, self.cameras, self.k, self._choice)
        ]

    def needed(self, target: Camera) -> list[str]:
        """Return the names of the cameras whose images a step without depth takes: the sources, and
        those they are matched with.

        Raises:
            CameraError: see `sources`.
            DepthError: a source that no other camera can be matched with.
        """
        return self._finder().needed([camera.name for camera in self.sources(target)])

    def step(
        self,
        images_by_camera: Mapping[str, Image8],
        depths_by_camera: Mapping[str, Map | DepthMap] | None,
        target: Camera,
    ) -> Rendering:
        """Synthesise the next instant. Arrays may be overwritten afterwards.

        Warns, once each, of what gives a picture and is hardly meant: depth far outside near and
        far, as of millimetres, a K that is not in pixels, a target far off the rig.

        Args:
            images_by_camera: what each camera saw, RGB uint8 (H, W, 3), at least of the cameras of
                `sources`, of `needed` without depth.
            depths_by_camera: depth of the same cameras, (H, W), world units, 0 = unknown; a
                `DepthMap` knows its confidence, that of a bare array is 1. None: it is estimated,
                in the stage ``depth`` of the rendering's seconds.
            target: the virtual camera, of any size; it can move at each step.

        Raises:
            CameraError: fewer than K cameras next to the target.
            RenderError: an image that is missing or does not fit its camera.
            DepthError: depth that is missing, does not fit its camera, is negative or not finite.
        """
        instant, seconds = self._instant(images_by_camera, depths_by_camera, target)
        rendering = self._method.step(instant)
        self._index += 1
        return (
            replace(rendering, seconds={**seconds, **rendering.seconds}) if seconds else rendering
        )

    def show(
        self,
        images_by_camera: Mapping[str, Image8],
        depths_by_camera: Mapping[str, Map | DepthMap] | None,
        target: Camera,
    ) -> Image8:
        """As `step`, the picture alone, in 8 bit, (H, W, 3): a method on a GPU then downloads
        nothing else.
        """
        if not hasattr(self._method, "show"):
            return quantise(self.step(images_by_camera, depths_by_camera, target).image)
        picture: Image8 = self._method.show(
            self._instant(images_by_camera, depths_by_camera, target)[0]
        )
        self._index += 1
        return picture

    def _instant(
        self,
        images_by_camera: Mapping[str, Image8],
        depths_by_camera: Mapping[str, Map | DepthMap] | None,
        target: Camera,
    ) -> tuple[Instant, dict[str, float]]:
        """Return the method's input, and the seconds of depth computation."""
        choices = choose_sources(target, self.cameras, self.k, self._choice)
        names = [source.camera.name for source in choices]
        _check_names(images_by_camera, names, target, "an image")
        depths, seconds = (
            (depths_by_camera, {})
            if depths_by_camera is not None
            else self._found_depth(names, images_by_camera)
        )
        _check_names(depths, names, target, "depth")
        views = tuple(
            _source_view(source, images_by_camera[name], depths[name])
            for name, source in zip(names, choices, strict=True)
        )
        self._doubts.look_at_target(target)
        for view in views:
            if isinstance(view.depth, np.ndarray):
                self._doubts.look_at_depth(view.camera, view.depth)
        return Instant(
            index=self._index, target=target, sources=views, units_per_metre=self.units_per_metre
        ), dict(seconds)

    def _finder(self) -> RigDepth:
        """Return what finds depth, made when it is first asked for."""
        if self._rig_depth is None:
            options = (
                self._depth
                if isinstance(self._depth, DepthOptions)
                else DepthRunOptions(self._depth).options(self._device)
            )
            self._rig_depth = RigDepth(self.cameras, options)
        return self._rig_depth

    def _found_depth(
        self, names: Sequence[str], images: Mapping[str, Image8]
    ) -> tuple[Mapping[str, DepthMap | DeviceDepth], dict[str, float]]:
        """Return the depth of some cameras, on the device where the method takes it there, and the
        seconds that it took.
        """
        finder = self._finder()
        begun_s = finder.clock_s()
        depths = finder.estimate(names, images)
        seconds = {"depth": finder.clock_s() - begun_s}
        if getattr(self._method, "takes_device_depth", False):
            return depths, seconds
        return {
            name: depth.download() if isinstance(depth, DeviceDepth) else depth
            for name, depth in depths.items()
        }, seconds


def online_method(method: str | Callable[[], Method], device: str = "cpu") -> Callable[[], Method]:
    """Return the factory of a method, given its label and where its networks compute, or the
    factory itself.
    """
    networks = NetworkOptions(device=checked_device(device))
    make = find_method(method, networks).make if isinstance(method, str) else method
    if isinstance(make(), LookaheadMethod):
        raise RenderError(
            f"method {method!r} needs the whole sequence before its first step; choose an online "
            f"method"
        )
    return make


def _check_names(
    by_camera: Mapping[str, object], names: Sequence[str], target: Camera, noun: str
) -> None:
    missing = [name for name in names if name not in by_camera]
    if missing:
        raise RenderError(
            f"camera {target.name}: wanted {noun} of each of its sources {', '.join(names)}, got "
            f"none of {', '.join(missing)}; give those of the whole rig, or exclude cameras without"
        )


def _source_view(
    source: ChosenSource, image: Image8, source_depth: Map | DepthMap | DeviceDepth
) -> SourceView:
    """Return a copy of what a camera gives, since methods remember it and cameras write into the
    same memory again.
    """
    camera = source.camera
    shape = (camera.height, camera.width)
    image = as_image8(image, camera, RenderError)
    if isinstance(source_depth, DeviceDepth):
        depth_on_device: tuple[Any, Any] = source_depth.depth, source_depth.confidence
        return SourceView(camera, image.copy(), *depth_on_device, source.share)
    depth = _checked_depth(
        camera, source_depth.depth if isinstance(source_depth, DepthMap) else source_depth
    )
    confidence = (
        source_depth.confidence
        if isinstance(source_depth, DepthMap)
        else (depth > 0).astype(np.float32)
    )
    if confidence.shape != shape:
        raise DepthError(
            f"camera {camera.name}: wanted confidence of {shape} like its depth, got "
            f"{confidence.shape}"
        )
    return SourceView(
        camera=camera,
        image=image.copy(),
        depth=depth,
        confidence=confidence.astype(np.float32),
        share=source.share,
    )


def _checked_depth(camera: Camera, depth: Map) -> Map:
    """Return depth as float32 in separate memory."""
    depth, shape = np.asarray(depth), (camera.height, camera.width)
    if depth.shape != shape or not np.issubdtype(depth.dtype, np.floating):
        remedy = "depth has the size of its image, in world units"
        if depth.shape == shape:
            remedy = (
                "to world units, of a sensor's millimetres by depth.astype(np.float32) / 1000 * "
                "units_per_metre"
            )
        raise DepthError(
            f"camera {camera.name}: wanted float depth of {shape}, got {depth.dtype} "
            f"{depth.shape}; {remedy}"
        )
    low, high = float(depth.min()), float(depth.max())
    if not 0 <= low <= high < np.inf:
        raise DepthError(
            f"camera {camera.name}: depth must be finite and not negative, got {low:g} .. "
            f"{high:g}; write 0 where it is unknown"
        )
    return depth.astype(np.float32)


def seen_share(target: Camera, cameras: Sequence[Camera]) -> float:
    """Return the share of a view that some camera sees from nearly its own direction, by
    calibration alone.

    Below `LEAST_SEEN` the view is outside of what the rig sees, and most of its rim is guessed.

    Args:
        target: the view.
        cameras: the rig; one of the target's own name is left out.

    Reading:
        Between the cameras of the demo rig it is 1, and 0.99 in the middle of a rig carried by
        hand; next to the demo rig's middle by a quarter of its extent 0.96, by half of it 0.6, by
        the whole 0.2.
    """
    points = sample_view(target)
    mask = np.zeros(len(points), bool)
    for camera in cameras:
        if camera.name != target.name:
            mask |= sees(camera, points) & (
                ray_angles(target, camera, points) <= np.deg2rad(SEEN_FROM_DEG)
            )
    return share_of_view(target, mask)


class Doubts:
    """Warnings about a rig, its depth and the places of the virtual camera, at most one of each
    kind.
    """

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._centres = np.stack([camera.centre for camera in cameras])  # (N, 3)
        self._near = min(camera.near for camera in cameras)
        self._said: set[str] = set()
        for camera in cameras:
            self.look_at_intrinsics(camera)

    def look_at_intrinsics(self, camera: Camera) -> None:
        """Doubt a focal length that is no number of pixels."""
        focal = float(min(camera.K[0, 0] / camera.width, camera.K[1, 1] / camera.height))
        if focal < LEAST_FOCAL:
            self._say(
                "intrinsics",
                f"camera {camera.name}: a focal length of {camera.K[0, 0]:g} x {camera.K[1, 1]:g} "
                f"pixels for an image of {camera.width} x {camera.height}; K is in pixels: "
                "multiply the rows of a normalised one by width and height",
            )

    def look_at_target(self, target: Camera) -> None:
        """Warn of a virtual camera farther from the rig than the rig's width and its nearest
        surfaces.
        """
        self.look_at_intrinsics(target)
        distance = float(np.linalg.norm(self._centres - target.centre, axis=1).min())
        extent = float(np.linalg.norm(np.ptp(self._centres, axis=0)))
        if distance > extent + self._near:
            self._say(
                "target",
                f"camera {target.name}: is {distance:.4g} units from the nearest camera of a rig "
                f"{extent:.4g} units wide; is its pose world_to_camera, in the rig's units and "
                "axes?",
            )

    def look_at_depth(self, camera: Camera, depth: Map) -> None:
        """Warn of depth of which most is far outside the camera's near and far bounds."""
        depths = depth[depth > 0]
        outside = (depths < camera.near / OUTSIDE_FACTOR) | (depths > camera.far * OUTSIDE_FACTOR)
        if not depths.size or outside.mean() <= MOST_OUTSIDE:
            return
        median = float(np.median(depths))
        remedy = (
            "divide millimetres by 1000 and multiply by units_per_metre"
            if median > MILLIMETRES * camera.far
            else "as these are"
        )
        self._say(
            "depth",
            f"camera {camera.name}: {outside.mean():.0%} of its depth is far outside near..far = "
            f"{camera.near:g}..{camera.far:g}, its median is {median:g}; depth is in world units: "
            f"{remedy}",
        )

    def _say(self, kind: str, text: str) -> None:
        if kind not in self._said:
            self._said.add(kind)
            warnings.warn(text, GgvsWarning, stacklevel=4)
