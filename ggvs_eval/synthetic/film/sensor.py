"""What a sensor makes of a rendered picture: its gain, its noise, and its own picture-making where it has one."""

from dataclasses import dataclass

import numpy as np

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.files.images import quantise
from ggvs_eval.synthetic.film.options import DemoOptions
from ggvs_eval.synthetic.film.picture_making import compress, defocus, denoise, mosaic_and_back, sharpen, to_linear, to_srgb


@dataclass(frozen=True, eq=False)
class Sensor:
    """The sensor of one camera.

    Attributes:
        gain: factor on the sRGB values, (3,).
        noise_sigma_255: standard deviation of the noise of every pixel and frame, of 255 levels.
        seed: of the noise.
        defocus_px: radius of the disc of a point out of focus, pixels.
        processing: how strongly the camera makes its own picture, see `DemoOptions`.
        jpeg_quality: of its own pictures, 0 for none.
    """

    gain: Array32
    noise_sigma_255: float
    seed: tuple[int, ...]
    defocus_px: float = 0.0
    processing: float = 0.0
    jpeg_quality: int = 0

    def noise(self, stream: int) -> np.random.Generator:
        """The noise from the first picture on; each kind of pictures has a stream of its own."""
        return np.random.default_rng([self.seed[0], stream, *self.seed[1:]])

    def expose(self, image: Array32, noise: np.random.Generator) -> Image8:
        """The next picture, (H, W, 3) in [0, 1], as 8 bit with gain and noise."""
        grain = noise.standard_normal(image.shape, np.float32) * (self.noise_sigma_255 / 255)
        return compress(quantise(self._developed(image * self.gain, noise) + grain), self.jpeg_quality)

    def _developed(self, image: Array32, noise: np.random.Generator) -> Array32:
        """The picture after lens, mosaic, demosaicing, denoising and sharpening, sRGB, (H, W, 3)."""
        if not (self.defocus_px or self.processing):
            return image
        linear = defocus(to_linear(np.clip(image, 0, 1)), self.defocus_px)
        if not self.processing:
            return to_srgb(linear)
        developed = denoise(to_srgb(mosaic_and_back(linear, self.processing, noise)), self.processing)
        return sharpen(developed, self.processing)


def rig_sensors(options: DemoOptions) -> list[Sensor]:
    """The sensors of all cameras, in their order."""
    gains = camera_gains(options)
    picture = (options.defocus_px, options.processing, options.jpeg_quality)
    return [Sensor(gain, options.noise_sigma_255, (options.seed, number), *picture) for number, gain in enumerate(gains)]


def camera_gains(options: DemoOptions) -> Array32:
    """Factor on the sRGB values of each camera, (N, 3): an exposure, a smaller error of colour balance, and the wanted fault."""
    rng = np.random.default_rng([options.seed, 4])
    count = 2 * options.cameras_per_row
    exposure, balance = rng.standard_normal((count, 1)), rng.standard_normal((count, 3))
    gains = (1 + options.exposure_spread * (exposure + 0.5 * balance)).astype(np.float32)
    faults = dict(options.camera_gain)
    for index, name in enumerate(options.camera_names):
        gains[index] *= np.float32(faults.get(name, 1.0))
    return gains[: len(options.camera_names)]
