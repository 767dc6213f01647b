"""Endless training data for stereo matching: procedural scenes, seen by a rectified pair of cameras, with exact disparity."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import DepthError
from ggvs_eval.synthetic.stereo.stereo_builder import SceneBuilder
from ggvs_eval.synthetic.stereo.stereo_layouts import fill
from ggvs_eval.synthetic.stereo.stereo_render import Scene, draw_view, visible_on_the_right
from ggvs_eval.synthetic.stereo.stereo_sensor import SensorOptions, expose_pair
from ggvs_eval.synthetic.stereo.stereo_textures import texture_bank


@dataclass(frozen=True)
class StereoOptions:
    """What the scenes contain and how they are taken.

    Attributes:
        max_disparity_px: the disparity aimed at for the nearest things of a scene lies between `least_disparity_px` and this.
        max_disparity_share: it is also kept below this share of the width.
        least_disparity_px: see `max_disparity_px`.
        depth_ratio: largest ratio of near to far in a scene, in disparity.
        gloss: whether some surfaces shine, so that they look different from the two eyes.
        sensor: whether the pictures pass through two different cameras; without, they are only rounded to 8 bit.
        camera: how far the cameras differ.
    """

    max_disparity_px: float = 200.0
    max_disparity_share: float = 0.4
    least_disparity_px: float = 10.0
    depth_ratio: float = 14.0
    gloss: bool = True
    sensor: bool = True
    camera: SensorOptions = field(default_factory=SensorOptions)

    def __post_init__(self) -> None:
        """Refuse what no scene can have."""
        if (
            not 0 < self.least_disparity_px <= self.max_disparity_px
            or not 0 < self.max_disparity_share < 1
            or self.depth_ratio < 1.5
        ):
            raise DepthError(
                "stereo scenes need 0 < least_disparity_px <= max_disparity_px, 0 < max_disparity_share < 1 and "
                f"depth_ratio >= 1.5, not {self}"
            )


@dataclass(frozen=True, eq=False)
class StereoSample:
    """A rectified pair and its truth; the point at column x on the left lies at x - disparity on the right.

    Attributes:
        left: RGB uint8 (H, W, 3).
        right: RGB uint8 (H, W, 3).
        disparity: of the left image's surfaces, also where the right eye does not see them; pixels, float32 (H, W), > 0.
        visible: the match lies within the right image and nothing hides it, bool (H, W).
        right_disparity: of the right image's surfaces, pixels, float32 (H, W), > 0.
    """

    left: Image8
    right: Image8
    disparity: NDArray[np.float32]
    visible: NDArray[np.bool_]
    right_disparity: NDArray[np.float32]


def stereo_sample(seed: int, width: int, height: int, options: StereoOptions = StereoOptions()) -> StereoSample:
    """Make one pair; equal arguments give equal bits.

    Args:
        seed: chooses the scene and the cameras, >= 0.
        width: of the pictures, pixels, at least 64.
        height: of the pictures, pixels, at least 48.
        options: see there.

    Raises:
        DepthError: the size is too small or the seed negative.
    """
    if width < 64 or height < 48 or seed < 0:
        raise DepthError(f"a stereo sample needs at least 64 x 48 pixels and a seed >= 0, not {width} x {height}, seed {seed}")
    scene = stereo_scene(seed, width, height, options)
    bank = texture_bank()
    left, right = (draw_view(scene, bank, width, height, eye) for eye in (0.0, 1.0))
    if options.sensor:
        pictures = expose_pair(left.image, right.image, np.random.default_rng([seed, 82]), options.camera)
    else:
        pictures = (_rounded(left.image), _rounded(right.image))
    visible = visible_on_the_right(left, right)
    return StereoSample(pictures[0], pictures[1], left.disparity, visible, right.disparity)


def stereo_scene(seed: int, width: int, height: int, options: StereoOptions) -> Scene:
    """The scene of a sample, before it is drawn."""
    rng = np.random.default_rng([seed, 81])
    most = min(options.max_disparity_px, options.max_disparity_share * width)
    least = min(options.least_disparity_px, 0.5 * most)
    d_max = float(np.exp(rng.uniform(np.log(least), np.log(most))))
    ratio = float(np.exp(rng.uniform(np.log(1.5), np.log(options.depth_ratio))))
    d_min = min(max(d_max / ratio, 0.8), 0.15 * width)
    centre = (width / 2 + rng.normal(0, 0.03) * width, height / 2 + rng.normal(0, 0.05) * height)
    builder = SceneBuilder(rng, texture_bank(), width, height, float(rng.uniform(0.7, 1.6) * width), centre, options.gloss)
    fill(builder, d_min, d_max)
    return builder.scene()


def _rounded(image: NDArray[np.float32]) -> Image8:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
