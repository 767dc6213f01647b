"""Faults of handling planted in the renders of a view: what a script between a method and its
folder of frames does wrong.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.datasets import open_capture
from ggvs_eval.files.images import round_levels
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames
from ggvs_eval.scoring import FrameReader
from ggvs_eval.transforms import TRANSFORMS
from helpers.packed_films import unpack_film

Spoil = Callable[[ViewFrames], FrameReader]
SEED = 1
SIZE = 192, 144  # pixels of what `film_without_noise` gives


def film_without_noise(folder: Path, n_frames: int) -> dict[str, np.ndarray]:
    """What four cameras of the demo room see without noise, each (T, H, W, 3); honest renders are
    made of it.
    """
    capture = open_capture(unpack_film("plain", folder))
    return {
        name: np.stack(list(capture.frames(name, 0, n_frames))) for name in capture.camera_names
    }


@dataclass(frozen=True)
class Fault:
    """A fault and what the doctor has to call it.

    Attributes:
        question: of the finding.
        spoil: view -> reader of its spoilt renders.
    """

    question: str
    spoil: Spoil


def change(question: str, **values: float | tuple[int, ...]) -> Callable[[Image8], Image8]:
    """What gives a picture a fault of this strength."""
    return lambda image: TRANSFORMS[question](values, image.shape[1::-1]).apply(image)


def moved(right_px: float, down_px: float) -> Callable[[Image8], Image8]:
    """What shifts a picture."""
    return change("shift", shift_x_px=right_px, shift_y_px=down_px)


def zoomed(scale: float) -> Callable[[Image8], Image8]:
    """What enlarges a picture about its centre, as by a longer focal length."""
    return change("focal length", scale_x=scale, scale_y=scale)


def each_picture(change: Callable[[Image8], np.ndarray]) -> Spoil:
    """The same change of every rendered frame."""
    return lambda view: lambda index: change(view.rendered(index))


def flicker(amplitude: float) -> Spoil:
    """Every frame brighter or darker by up to a share, at random."""

    def spoil(view: ViewFrames) -> FrameReader:
        gains = 1 + np.random.default_rng(SEED).uniform(-amplitude, amplitude, len(view.frames))
        return lambda index: round_levels(view.rendered(index) * gains[index - view.frames.start])

    return spoil


def alternating(amplitude: float) -> Spoil:
    """Every other frame brighter."""
    return lambda view: (
        lambda index: round_levels(view.rendered(index) * (1 + amplitude * (-1) ** index))
    )


def blended(share: float) -> Spoil:
    """Some of the truth in every frame."""
    return lambda view: (
        lambda index: round_levels(
            (1 - share) * view.rendered(index).astype(float) + share * view.truth(index)
        )
    )


def copied(every: int, recode: Callable[[Image8], Image8] = lambda image: image) -> Spoil:
    """Every so many frames the truth, written again."""

    def spoil(view: ViewFrames) -> FrameReader:
        start = view.frames.start + min(every, len(view.frames)) // 2
        return lambda index: (
            recode(view.truth(index)) if (index - start) % every == 0 else view.rendered(index)
        )

    return spoil


def reversed_time(view: ViewFrames) -> FrameReader:
    """The last frame first."""
    return view.reversed(0).rendered


def jpeg(quality: int) -> Callable[[Image8], Image8]:
    """What a JPEG file makes of a picture."""
    return lambda image: cv2.imdecode(
        cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR
    )


PLANTED: Mapping[str, Fault] = {
    "truth in every 6th frame": Fault("truth copied in", copied(6)),
    "truth in every 6th frame, JPEG 90": Fault("truth copied in", copied(6, jpeg(90))),
    "truth in one frame, JPEG 90": Fault("truth copied in", copied(1000, jpeg(90))),
    "blend with 50 % truth": Fault("truth copied in", blended(0.5)),
    "blend with 20 % truth": Fault("truth copied in", blended(0.2)),
    "blend with 10 % truth": Fault("truth copied in", blended(0.1)),
    "flicker, random +-3 %": Fault("flicker", flicker(0.03)),
    "flicker, alternating +-3 %": Fault("flicker", alternating(0.03)),
    "gamma 1.1": Fault("tone curve", each_picture(change("tone curve", power=1.1))),
    "gamma 1 / 1.1": Fault("tone curve", each_picture(change("tone curve", power=1 / 1.1))),
    "studio range 16-235": Fault("value range", each_picture(change("value range", slope=0.86))),
    "stretched from 16-235": Fault("value range", each_picture(change("value range", slope=1.16))),
    "quarter pixel right": Fault("shift", each_picture(moved(0.25, 0))),
    "quarter pixel right and down": Fault("shift", each_picture(moved(0.25, 0.25))),
    "quarter pixel left": Fault("shift", each_picture(moved(-0.25, 0))),
    "focal length + 1 %": Fault("focal length", each_picture(zoomed(1.01))),
    "focal length - 1 %": Fault("focal length", each_picture(zoomed(0.99))),
    "reversed time": Fault("reversed time", reversed_time),
}
