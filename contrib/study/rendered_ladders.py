"""Degradations of the input of rendering: depth that boils, and source cameras that are exchanged.

The online method renders the clip, without its network; what it makes of undisturbed inputs is the
undegraded clip.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.contrib.study.clips import Clip, SourceClip
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import quantise
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions

GRAIN_PX = 4.0  # standard deviation of the Gaussian that correlates the noise of depth
EXCHANGES = 3  # along a path whose cameras differ in brightness
SWITCHED = 4  # source cameras of the two pairs that take turns


def render(clip: Clip) -> Image8:
    """Return the rendering of a clip as it is."""
    return boil(clip, 0.0)


def boil(clip: Clip, percent: float, seed: int = 0) -> Image8:
    """Return the rendering with depth that boils: z (1 + s n), s = `percent`, in every source and
    frame anew.

    n is white Gaussian noise smoothed by a Gaussian of `GRAIN_PX` and scaled back to unit variance,
    so that surfaces boil in patches, as matched depth does.
    """
    random = np.random.default_rng(seed)

    def view(source: SourceClip, frame: int) -> SourceView:
        still = _view(source, frame)
        return replace(
            still,
            depth=still.depth * (1 + np.float32(percent / 100) * _grain(random, still.depth.shape)),
        )

    return _render(
        clip, [[view(source, frame) for source in clip.sources] for frame in range(len(clip.truth))]
    )


def switch_sources(clip: Clip, switches: float, seed: int = 0) -> Image8:
    """Return the rendering along a camera path with N exchanges of all source cameras, evenly
    spaced.

    Two pairs of the four nearest cameras take turns, the first with the last and the two between,
    so that neither pair is nearer to the path; the parity of the seed says which begins.
    """
    pairs = [sources_at(clip, frame, switches, seed) for frame in range(len(clip.truth))]
    return _render(
        clip, [[_view(source, frame) for source in pair] for frame, pair in enumerate(pairs)]
    )


def switch_brightness(clip: Clip, percent: float, seed: int = 0) -> Image8:
    """Rendering along a camera path with `EXCHANGES` exchanges, between one pair of cameras and one
    that is `percent` brighter.

    Colours of the cameras are not compensated, as the online method would do.
    """
    clip = require_sources(clip, SWITCHED)
    brighter = (clip.sources[1].camera.name, clip.sources[2].camera.name)

    def view(source: SourceClip, frame: int) -> SourceView:
        still = _view(source, frame)
        gain = (1 + percent / 100) / 255 if source.camera.name in brighter else 1 / 255
        return replace(still, image=quantise(still.image * gain))

    pairs = [sources_at(clip, frame, EXCHANGES, seed) for frame in range(len(clip.truth))]
    views = [[view(source, frame) for source in pair] for frame, pair in enumerate(pairs)]
    return _render(clip, views, OnlineOptions(compensated=False))


def sources_at(clip: Clip, frame: int, switches: float, seed: int) -> tuple[SourceClip, SourceClip]:
    """Return the pair of source cameras at a frame, of a path with N exchanges."""
    stretch = frame * (round(switches) + 1) // len(clip.truth)
    nearest = require_sources(clip, SWITCHED).sources
    return (nearest[0], nearest[3]) if (stretch + seed) % 2 == 0 else (nearest[1], nearest[2])


def require_sources(clip: Clip, count: int) -> Clip:
    """Return the clip if it has N source cameras."""
    if len(clip.sources) < count:
        raise RenderError(
            f"view {clip.name}: wanted {count} source cameras with depth to render from, got "
            f"{len(clip.sources)}"
        )
    return clip


def _render(
    clip: Clip, views: Sequence[Sequence[SourceView]], options: OnlineOptions | None = None
) -> Image8:
    method = GeometryGuided(options)
    rendered = []
    for frame, sources in enumerate(views):
        instant = Instant(
            index=frame,
            target=clip.camera(frame),
            sources=tuple(sources),
            units_per_metre=clip.units_per_metre,
        )
        rendered.append(quantise(method.step(instant).image))
    return np.stack(rendered)


def _view(source: SourceClip, frame: int) -> SourceView:
    at = min(frame, len(source.images) - 1)
    return SourceView(
        camera=source.camera,
        image=source.images[at],
        depth=source.depths[at],
        confidence=source.confidences[at],
    )


def _grain(random: np.random.Generator, shape: tuple[int, ...]) -> Map:
    """Return the noise of unit variance, correlated over a few pixels, (H, W)."""
    smooth = cv2.GaussianBlur(random.normal(size=shape).astype(np.float32), (0, 0), GRAIN_PX)
    return np.asarray(smooth / smooth.std(), np.float32)
