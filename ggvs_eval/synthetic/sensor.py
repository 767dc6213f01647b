"""What a sensor makes of a rendered picture: its gain and its noise."""

from dataclasses import dataclass

import numpy as np

from ggvs_eval.images import Image8, quantise
from ggvs_eval.synthetic.geometry import Array32
from ggvs_eval.synthetic.options import DemoOptions


@dataclass(frozen=True, eq=False)
class Sensor:
    """The sensor of one camera.

    Attributes:
        gain: factor on the sRGB values, (3,).
        noise_sigma_255: standard deviation of the noise of every pixel and frame, of 255 levels.
        seed: of the noise.
    """

    gain: Array32
    noise_sigma_255: float
    seed: tuple[int, ...]

    def noise(self, stream: int) -> np.random.Generator:
        """The noise from the first picture on; each kind of pictures has a stream of its own."""
        return np.random.default_rng([self.seed[0], stream, *self.seed[1:]])

    def expose(self, image: Array32, noise: np.random.Generator) -> Image8:
        """The next picture, (H, W, 3) in [0, 1], as 8 bit with gain and noise."""
        grain = noise.standard_normal(image.shape, np.float32) * (self.noise_sigma_255 / 255)
        return quantise(image * self.gain + grain)


def rig_sensors(options: DemoOptions) -> list[Sensor]:
    """The sensors of all cameras, in their order."""
    gains = camera_gains(options)
    return [Sensor(gain, options.noise_sigma_255, (options.seed, number)) for number, gain in enumerate(gains)]


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
