"""The ladders of the study: each a degradation, its unit, and the strengths at which it is
planted.
"""

from collections.abc import Callable
from dataclasses import dataclass

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.study import frame_ladders, rendered_ladders
from ggvs_eval.contrib.study.clips import Clip
from ggvs_eval.errors import MetricError, did_you_mean

Plant = Callable[[Clip, float, int], Image8]
OF_FRAMES = frame_ladders.__name__


@dataclass(frozen=True)
class Ladder:
    """One degradation.

    Attributes:
        name: in tables and on the command line.
        strengths: at least five, ascending; 0, which is the undegraded clip, comes before them.
        plant: (clip, strength, seed) -> frames.
        describe: what is done, in a few words.
        module: that its code is in.
        wants_path: planted along a camera path alone.
        is_rendered: the undegraded clip is what the method renders of undisturbed inputs,
            regardless of what else is planted in.
    """

    name: str
    unit: str
    strengths: tuple[float, ...]
    plant: Plant
    describe: str
    module: str = OF_FRAMES
    wants_path: bool = False
    is_rendered: bool = False

    def frames(self, clip: Clip, strength: float, seed: int) -> Image8:
        """Return the clip at this strength; at 0 the undegraded one, bit for bit."""
        if strength == 0 and not self.is_rendered:
            return clip.undegraded
        return self.plant(clip, strength, seed)

    def refuses(self, clip: Clip) -> str:
        """Return the reason why a clip cannot be degraded so; empty if it can."""
        if self.wants_path and not clip.moves:
            return "the camera is static"
        if self.wants_path and clip.depths is None:
            return "the depth along the path is unknown"
        least = rendered_ladders.SWITCHED if self.wants_path else 1
        if self.is_rendered and len(clip.sources) < least:
            return (
                f"no {least} source cameras with depth"
                if least > 1
                else "no source camera with depth"
            )
        return ""


def _of_frames(function: Callable[[Image8, float, int], Image8]) -> Plant:
    return lambda clip, strength, seed: function(clip.undegraded, strength, seed)


def _wobble(clip: Clip, amplitude_px: float, seed: int) -> Image8:
    return frame_ladders.wobble(clip.undegraded, amplitude_px, seed, clip.view_angles_deg())


_ALL = (
    Ladder(
        name="blur",
        unit="px",
        strengths=(0.4, 0.6, 0.9, 1.4, 2.1),
        plant=_of_frames(frame_ladders.blur),
        describe="Gaussian blur",
    ),
    Ladder(
        name="noise",
        unit="grey levels",
        strengths=(0.5, 1, 2, 4, 8),
        plant=_of_frames(frame_ladders.noise),
        describe="white noise, new in every frame",
    ),
    Ladder(
        name="shift",
        unit="px",
        strengths=(0.05, 0.1, 0.2, 0.4, 0.8),
        plant=_of_frames(frame_ladders.shift),
        describe="all frames displaced alike",
    ),
    Ladder(
        name="colour",
        unit="%",
        strengths=(1, 2, 4, 8, 12),
        plant=_of_frames(frame_ladders.colour_cast),
        describe="white balance, each view its own",
    ),
    Ladder(
        name="compression",
        unit="CRF",
        strengths=(18, 23, 28, 33, 38),
        plant=_of_frames(frame_ladders.compress),
        describe="H.264 by x264",
    ),
    Ladder(
        name="flicker",
        unit="%",
        strengths=(1, 2, 3, 4, 5),
        plant=_of_frames(frame_ladders.flicker),
        describe="a gain for every frame",
    ),
    Ladder(
        name="drift",
        unit="%",
        strengths=(1, 2, 4, 8, 16),
        plant=_of_frames(frame_ladders.drift),
        describe="slowly brighter over the clip",
    ),
    Ladder(
        name="frozen",
        unit="% of frames",
        strengths=(20, 40, 60, 80, 100),
        plant=_of_frames(frame_ladders.freeze),
        describe="frames that repeat the one before",
    ),
    Ladder(
        name="late",
        unit="frames",
        strengths=(1, 2, 3, 4, 6),
        plant=_of_frames(frame_ladders.delay),
        describe="all frames late",
    ),
    Ladder(
        name="wobble",
        unit="px",
        strengths=(0.1, 0.2, 0.4, 0.8, 1.6),
        plant=_wobble,
        describe="displacement that changes with the angle of view",
        wants_path=True,
    ),
    Ladder(
        name="switch",
        unit="switches",
        strengths=(1, 2, 3, 5, 7),
        plant=rendered_ladders.switch_sources,
        describe="source cameras exchanged along a path",
        module=rendered_ladders.__name__,
        wants_path=True,
        is_rendered=True,
    ),
    Ladder(
        name="jump",
        unit="% brighter",
        strengths=(1, 2, 4, 8, 16),
        plant=rendered_ladders.switch_brightness,
        describe="three exchanges along a path, between cameras of unlike brightness",
        module=rendered_ladders.__name__,
        wants_path=True,
        is_rendered=True,
    ),
    Ladder(
        name="boiling",
        unit="% of depth",
        strengths=(0.25, 0.5, 1, 2, 4),
        plant=rendered_ladders.boil,
        describe="noise of depth, new in every frame, rendered",
        module=rendered_ladders.__name__,
        is_rendered=True,
    ),
)
LADDERS: dict[str, Ladder] = {ladder.name: ladder for ladder in _ALL}


def select_ladders(names: tuple[str, ...]) -> tuple[Ladder, ...]:
    """Return the ladders of these names; all where none is named."""
    for name in names:
        if name not in LADDERS:
            raise MetricError(
                f"no ladder {name!r}{did_you_mean(name, LADDERS)}; all are {', '.join(LADDERS)}"
            )
    return tuple(LADDERS[name] for name in dict.fromkeys(names)) or _ALL
