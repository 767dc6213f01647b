"""Domains: kinds of captures that differ in rig, size, sensor, scene or depth.

Choices are made, and networks learn, by all.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.errors import CaptureError

FIRST_TRAINING_SEED = 1000  # below are the demo captures, for tests, and the validation seeds
VALIDATION_SEEDS = (101, 102, 103)
PLAIN = "plain"
Range = tuple[float, float]


@dataclass(frozen=True)
class Domain:
    """One kind of captures.

    Attributes:
        title: for tables, a few words.
        options: of the demo, by name, as validation films it; what is not named is as in `ROOM`.
        strengths: options that training draws evenly between two values for each seed, so that no
            network learns the one value by which it is chosen.
        size: of the images, pixels.
        gap: of captures by a hand-held camera: exclusive minimum distance of a source from the
            target, frames
        span: maximum of that distance, frames.
    """

    title: str
    description: str
    options: Mapping[str, Any] = field(default_factory=dict)
    strengths: Mapping[str, Range] = field(default_factory=dict)
    size: tuple[int, int] = (480, 360)
    gap: int = 0
    span: int = 30

    @property
    def hand_held(self) -> bool:
        """True if one moving camera films it, with a sensor of depth, and no rig."""
        return self.options.get("layout") == "rgbd"


# One instant, no camera path, no exact depth: what a sample needs.
ROOM: Mapping[str, Any] = {"n_frames": 1, "path_poses": 0, "depth_stride": 0}
USUAL: Mapping[str, Range] = {"noise_sigma_255": (0.0, 2.5), "exposure_spread": (0.0, 0.03)}
DOMAINS: dict[str, Domain] = {
    PLAIN: Domain(
        title="room",
        description="the living room by two rows of cameras, as the demo",
        options={},
        strengths=USUAL,
    ),
    "narrow": Domain(
        title="narrow rig",
        description="rows with a third of the usual spacing",
        options={"spacing": 0.33},
        strengths={**USUAL, "spacing": (0.2, 0.5)},
    ),
    "arc": Domain(
        title="wide arc",
        description="one row on a wide arc",
        options={"rig": "arc", "cameras_per_row": 9},
        strengths=USUAL,
    ),
    "grid": Domain(
        title="tiny grid",
        description="two parallel rows, a few centimetres apart",
        options={"rig": "grid", "cameras_per_row": 6, "spacing": 0.3},
        strengths={**USUAL, "spacing": (0.15, 0.5)},
    ),
    "large": Domain(
        title="1344 x 1008",
        description="large images",
        options={"cameras_per_row": 5, "spacing": 2.0},
        strengths={**USUAL, "spacing": (1.2, 2.4)},
        size=(1344, 1008),
    ),
    "exposure": Domain(
        title="exposure spread",
        description="cameras of different exposure",
        options={"exposure_spread": 0.07},
        strengths={**USUAL, "exposure_spread": (0.04, 0.1)},
    ),
    "noise": Domain(
        title="noise",
        description="noisy sensors",
        options={"noise_sigma_255": 5.0},
        strengths={**USUAL, "noise_sigma_255": (3.0, 7.0)},
    ),
    "misplaced_depth": Domain(
        title="misplaced depth",
        description="a hand-held camera whose depth sensor is shifted, rotated and early relative "
        "to colour",
        options={
            "layout": "rgbd",
            "n_frames": 24,
            "fps": 6.0,
            "depth_offset_px": 5.0,
            "depth_rotation_rad": 0.006,
            "depth_delay_s": 0.02,
            "depth_noise": 0.004,
        },
        strengths={
            **USUAL,
            "depth_offset_px": (1.0, 9.0),
            "depth_rotation_rad": (0.0, 0.012),
            "depth_delay_s": (0.0, 0.04),
            "depth_noise": (0.001, 0.008),
        },
        gap=1,
        span=12,
    ),
    "foliage": Domain(
        title="thin foliage",
        description="a garden: thin foliage before a far background",
        options={"scene": "garden"},
        strengths=USUAL,
    ),
    "handheld": Domain(
        title="hand-held, blurred",
        description="a rotating hand-held camera with motion blur, a few frames per second",
        options={
            "layout": "rgbd",
            "n_frames": 32,
            "fps": 4.0,
            "sway": 6.0,
            "shutter_s": 0.03,
            "depth_noise": 0.004,
        },
        strengths={
            **USUAL,
            "sway": (3.0, 8.0),
            "shutter_s": (0.012, 0.045),
            "depth_noise": (0.001, 0.008),
        },
        span=10,
    ),
    "camera": Domain(
        title="picture-making",
        description="cameras with full image processing: mosaic, demosaicing, denoising, "
        "sharpening, JPEG, a lens out of focus",
        options={"processing": 1.0, "defocus_px": 0.8, "jpeg_quality": 88, "noise_sigma_255": 0.0},
        strengths={
            "processing": (0.5, 1.5),
            "defocus_px": (0.0, 1.6),
            "jpeg_quality": (80, 95),
            "exposure_spread": (0.0, 0.03),
        },
    ),
    "vignetting": Domain(
        title="vignetting",
        description="lenses with vignetting, each slightly different",
        options={"vignetting": 0.2},
        strengths={**USUAL, "vignetting": (0.05, 0.3)},
    ),
}


def find_domain(name: str) -> Domain:
    """Return the domain of that name."""
    if name not in DOMAINS:
        raise CaptureError(f"domain {name!r}: wanted one of {', '.join(DOMAINS)}; correct the name")
    return DOMAINS[name]


def domain_options(
    name: str, seed: int, width: int | None = None, height: int | None = None
) -> DemoOptions:
    """Choose the options of a capture of a domain.

    Args:
        seed: of the room; from `FIRST_TRAINING_SEED` on it also draws the strengths, each on its
            own.
        width: of the images, pixels; the domain's where None.
    """
    domain = find_domain(name)
    size = {"width": width or domain.size[0], "height": height or domain.size[1]}
    options = DemoOptions(seed=seed, **{**ROOM, **size, **domain.options})
    return options if seed < FIRST_TRAINING_SEED else replace(options, **_drawn(name, domain, seed))


def _drawn(name: str, domain: Domain, seed: int) -> dict[str, Any]:
    """Return the strengths of a training capture.

    Plain rooms keep those that they have always had.
    """
    rng = np.random.default_rng([seed, 84] if name == PLAIN else [seed, 87, *name.encode()])
    values = {option: float(rng.uniform(*limits)) for option, limits in domain.strengths.items()}
    return {
        option: round(value) if option == "jpeg_quality" else value
        for option, value in values.items()
    }
