"""Shots to be rendered, one per camera of the rig, per pose of the hand-held camera and of the true
path, and their sensors.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import (
    GRID_YAW_RAD,
    OUTERMOST_YAW_RAD,
    Coefficients,
    arc_rig,
    hand_held_poses,
    rig,
    sideways_path,
)
from ggvs_eval.files.images import quantise
from ggvs_eval.kernels.portable import blur, exp, power, product, rotation_by

# A telephone indoors, at processing 1: electrons of a white pixel, and the noise of reading one,
# electrons.
FULL_WELL, READ_NOISE = 2500.0, 4.0
# How much weaker red and blue arrive than green.
WHITE_BALANCE: Array32 = np.array([1.9, 1.0, 1.6], np.float32)
# Denoising: standard deviations over levels in [0, 1], of colour and of brightness, and over
# pixels.
COLOUR_LEVELS, BRIGHTNESS_LEVELS, DENOISED_PX = 0.08, 0.03, 1.5
# The unsharp mask: how much of what a blur takes away is added.
SHARPENING, SHARPENED_PX = 0.8, 1.0
# Share of red, green and blue in brightness.
LUMA: Array32 = np.array([0.299, 0.587, 0.114], np.float32)
LARGEST = np.iinfo(np.uint16).max
# Standard deviation of the lenses' vignetting around what is asked for, share of it.
FALLOFF_SPREAD = 0.2
# The lowest raw level, of the largest: noise around black must not be cut off.
BLACK_LEVEL = 0.02


def defocus(linear: Array32, radius_px: float) -> Array32:
    """Spread every point into a disc with a soft rim, linear light, (H, W, 3)."""
    if not radius_px:
        return linear
    reach = int(np.ceil(radius_px + 0.5))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = np.clip(radius_px + 0.5 - np.sqrt(x * x + y * y), 0, 1).astype(np.float32)
    disc /= disc.sum()
    spread = np.zeros_like(linear)
    for weight, moved in zip(disc.ravel(), _moved(linear, reach), strict=True):
        spread += weight * moved
    return spread


def mosaic_and_back(linear: Array32, strength: float, noise: np.random.Generator) -> Array32:
    """Sample linear light, (H, W, 3), under an RGGB mosaic and demosaic it along edges.

    Args:
        linear: in [0, 1].
        strength: of the shot and reading noise, 1 for a telephone indoors.

    Reading:
        Shot noise is normal with the variance of the electrons, which differs from Poisson's law by
        less than a level above twenty electrons, and every pixel takes one number, so that streams
        of noise stay in step.
    """
    weakened = linear / WHITE_BALANCE
    raw = np.empty(linear.shape[:2], np.float32)
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        raw[row::2, column::2] = weakened[row::2, column::2, channel]
    sigma = strength * np.sqrt(raw * FULL_WELL + READ_NOISE**2) / FULL_WELL
    raw += sigma * noise.standard_normal(raw.shape, np.float32)
    levels = np.rint(np.clip(BLACK_LEVEL + (1 - BLACK_LEVEL) * raw, 0, 1) * LARGEST).astype(
        np.uint16
    )
    colours = cv2.demosaicing(levels, cv2.COLOR_BayerRGGB2RGB_EA).astype(np.float32) / LARGEST
    return np.asarray((colours - BLACK_LEVEL) / (1 - BLACK_LEVEL) * WHITE_BALANCE, np.float32)


def denoise(image: Array32, strength: float) -> Array32:
    """Smooth an sRGB picture, (H, W, 3), within its edges: colour strongly, brightness a little."""
    image = np.clip(image, 0, 1)
    grey = brightness(image)[..., None]
    colour = (image - grey)[..., ::2]  # of red and blue
    smooth = _bilateral(grey, grey, 2, BRIGHTNESS_LEVELS * strength, DENOISED_PX)
    # Brightness leads colour across its edges.
    guide = np.concatenate([grey, 0.6 * colour], axis=-1)
    red, blue = np.moveaxis(
        _bilateral(guide, colour, 3, COLOUR_LEVELS * strength, 2 * DENOISED_PX), -1, 0
    )
    green = -(LUMA[0] * red + LUMA[2] * blue) / LUMA[1]
    return np.asarray(smooth + np.stack([red, green, blue], axis=-1), np.float32)


def sharpen(image: Array32, strength: float) -> Array32:
    """Unsharp mask on the brightness of an sRGB picture, (H, W, 3), with its halos."""
    grey = brightness(np.clip(image, 0, 1))
    detail = grey - blur(grey, SHARPENED_PX)
    return np.asarray(image + (SHARPENING * strength) * detail[..., None], np.float32)


def brightness(image: Array32) -> Array32:
    """Return the luma of an sRGB picture, (H, W, 3), after BT.601, (H, W)."""
    return LUMA[0] * image[..., 0] + LUMA[1] * image[..., 1] + LUMA[2] * image[..., 2]


def _bilateral(
    guide: Array32, values: Array32, reach: int, levels: float, spread_px: float
) -> Array32:
    """Return the mean of the values, (H, W, C), by distance in the picture and in the guide (Tomasi
    and Manduchi 1998).
    """
    total, sums = np.zeros_like(values[..., :1]), np.zeros_like(values)
    offsets = [
        (row - reach) ** 2 + (column - reach) ** 2
        for row, column in np.ndindex(2 * reach + 1, 2 * reach + 1)
    ]
    for squared_px, guiding, moved in zip(
        offsets, _moved(guide, reach), _moved(values, reach), strict=True
    ):
        if squared_px <= reach**2:
            away = np.abs(guiding - guide).sum(axis=-1, keepdims=True) / np.float32(levels)
            weight = exp(
                np.float32(-0.5) * away * away - np.float32(0.5 * squared_px / spread_px**2)
            )
            total += weight
            sums += weight * moved
    return sums / total


def _moved(image: Array32, reach: int) -> Iterator[Array32]:
    """Yield the picture moved by up to `reach` pixels up and left, row by row, mirrored at its
    border.
    """
    height, width = image.shape[:2]
    padded = np.pad(image, ((reach, reach), (reach, reach), (0, 0)), mode="reflect")
    for row, column in np.ndindex(2 * reach + 1, 2 * reach + 1):
        yield padded[row : row + height, column : column + width]


def compress(image: Image8, quality: int) -> Image8:
    """Return an RGB picture, (H, W, 3), after JPEG with halved colour, as cameras write it.

    Quality 0 leaves it alone.
    """
    if not quality:
        return image
    _, encoded = cv2.imencode(
        ".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    return np.asarray(
        cv2.cvtColor(cv2.imdecode(encoded, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB), np.uint8
    )


def to_linear(image: Array32) -> Array32:
    """Return the linear light of sRGB in [0, 1], any shape."""
    return np.where(image <= 0.04045, image / 12.92, power((image + 0.055) / 1.055, 2.4)).astype(
        np.float32
    )


def to_srgb(linear: Array32) -> Array32:
    """SRGB of linear light, any shape, clipped to black and white."""
    linear = np.clip(linear, 0, 1)
    return np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * power(linear, 1 / 2.4) - 0.055
    ).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Sensor:
    """The sensor of one camera.

    Attributes:
        gain: factor on the sRGB values, (3,).
        noise_sigma_255: standard deviation of the noise of every pixel and frame, of 255 levels.
        defocus_px: radius of the disc of a point out of focus, pixels.
        processing: how strongly the camera makes its own picture, see `DemoOptions`.
        jpeg_quality: of its pictures, 0 for none.
        vignetting: how much darker its lens makes the corners, share of the sRGB values.
    """

    gain: Array32
    noise_sigma_255: float
    seed: tuple[int, ...]
    defocus_px: float = 0.0
    processing: float = 0.0
    jpeg_quality: int = 0
    vignetting: float = 0.0

    def noise(self, stream: int) -> np.random.Generator:
        """Return the noise from the first picture on; each kind of pictures has its own stream."""
        return np.random.default_rng([self.seed[0], stream, *self.seed[1:]])

    def expose(self, image: Array32, noise: np.random.Generator) -> Image8:
        """Return the next picture, (H, W, 3) in [0, 1], as 8 bit with gain and noise."""
        grain = noise.standard_normal(image.shape, np.float32) * (self.noise_sigma_255 / 255)
        return compress(
            quantise(self._developed(self._shaded(image) * self.gain, noise) + grain),
            self.jpeg_quality,
        )

    def _shaded(self, image: Array32) -> Array32:
        """Return the picture behind a lens that falls off with the squared distance from the
        middle.
        """
        if not self.vignetting:
            return image
        down, across = (((np.arange(size) + 0.5) / size * 2 - 1) * size for size in image.shape[:2])
        share = (down[:, None] ** 2 + across**2) / (image.shape[0] ** 2 + image.shape[1] ** 2)
        return image * (1 - self.vignetting * share).astype(np.float32)[..., None]

    def _developed(self, image: Array32, noise: np.random.Generator) -> Array32:
        """Return the picture after lens, mosaic, demosaicing, denoising and sharpening, sRGB, (H,
        W, 3).
        """
        if not (self.defocus_px or self.processing):
            return image
        linear = defocus(to_linear(np.clip(image, 0, 1)), self.defocus_px)
        if not self.processing:
            return to_srgb(linear)
        developed = denoise(
            to_srgb(mosaic_and_back(linear, self.processing, noise)), self.processing
        )
        return sharpen(developed, self.processing)


def rig_sensors(options: DemoOptions) -> list[Sensor]:
    """Return the sensors of all cameras, in their order."""
    gains = camera_gains(options)
    picture = (options.defocus_px, options.processing, options.jpeg_quality)
    lenses = options.vignetting * (
        1 + FALLOFF_SPREAD * np.random.default_rng([options.seed, 15]).standard_normal(len(gains))
    )
    seeds = [(options.seed, number, *options.recording) for number in range(len(gains))]
    return [
        Sensor(gain, options.noise_sigma_255, seed, *picture, vignetting=float(max(lens, 0.0)))
        for gain, seed, lens in zip(gains, seeds, lenses, strict=True)
    ]


def camera_gains(options: DemoOptions) -> Array32:
    """Factor on the sRGB values of each camera, (N, 3): an exposure, a smaller error of colour
    balance, and the wanted fault.
    """
    rng = np.random.default_rng([options.seed, 4])
    count = 2 * options.cameras_per_row
    exposure, balance = rng.standard_normal((count, 1)), rng.standard_normal((count, 3))
    gains = (1 + options.exposure_spread * (exposure + 0.5 * balance)).astype(np.float32)
    faults = dict(options.camera_gain)
    for index, name in enumerate(options.camera_names):
        gains[index] *= np.float32(faults.get(name, 1.0))
    return gains[: len(options.camera_names)]


PATH_LENGTH = 5.0
# Pictures of which a blurred one is the mean.
BLUR_POSES = 4
# Barrel distortion as of a wide-angle lens: k1, k2, p1, p2, k3; every lens differs a little from
# it.
LENS = (-0.12, 0.03, 3e-4, -2e-4, 0.0)
LENS_SPREAD = (0.008, 0.002, 1e-4, 1e-4, 0.0)
# k1 .. k4 of a fisheye, as of the camera that the description of Google Immersive shows, and how
# its lenses differ.
FISHEYE_LENS = (0.097, -0.017, 0.0, 0.0)
FISHEYE_SPREAD = (0.003, 0.001, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Shot:
    """One camera and the instants it films.

    Attributes:
        camera: the true one, world units of the rig.
        noted: the camera as it is written down, wrong where the options want it to be.
        instants: the instant that each frame shows, in frames from time 0.
        sensor: what films; None gives the pictures without gain and noise.
        poses: where the camera is while it exposes a picture, evenly spaced in time; empty if it is
            static.
        depth_pose: where the sensor of depth of a hand-held camera is when it measures; None if it
            has none.
    """

    camera: Camera
    noted: Camera
    instants: tuple[int, ...]
    sensor: Sensor | None
    lens: Coefficients = ()
    poses: tuple[Camera, ...] = ()
    depth_pose: Camera | None = None


def rig_of(options: DemoOptions) -> list[Camera]:
    """Return the true cameras of the rig, in the order of their names."""
    if options.rig == "arc":
        return arc_rig(options.seed, options.width, options.height, len(options.camera_names))
    yaw_rad = GRID_YAW_RAD if options.rig == "grid" else OUTERMOST_YAW_RAD
    return rig(
        options.seed,
        options.width,
        options.height,
        options.cameras_per_row,
        outermost_yaw_rad=yaw_rad,
        spacing=options.spacing,
    )


def rig_shots(options: DemoOptions) -> list[Shot]:
    """Return the cameras of the rig, all frames of each, in the order of their names."""
    cameras = rig_of(options)
    offsets = dict(options.frame_offset)
    shots = []
    for number, (camera, sensor) in enumerate(zip(cameras, rig_sensors(options), strict=True)):
        first = offsets.get(camera.name, 0)
        noted = noted_camera(options, camera, camera.name, number)
        shots.append(
            Shot(
                camera=camera,
                noted=noted,
                instants=tuple(range(first, first + options.n_frames)),
                sensor=sensor,
            )
        )
    return shots


def distorted_shots(options: DemoOptions) -> list[Shot]:
    """Return the cameras of the rig, each through its own lens."""
    return _through_lenses(options, LENS, LENS_SPREAD)


def fisheye_shots(options: DemoOptions) -> list[Shot]:
    """Return the cameras of the rig, each through its own fisheye."""
    return _through_lenses(options, FISHEYE_LENS, FISHEYE_SPREAD)


def _through_lenses(options: DemoOptions, lens: Coefficients, spread: Coefficients) -> list[Shot]:
    shots = []
    for number, shot in enumerate(rig_shots(options)):
        rng = np.random.default_rng([options.seed, 7, number])
        shots.append(
            replace(
                shot, lens=tuple((np.array(lens) + spread * rng.uniform(-1, 1, len(lens))).tolist())
            )
        )
    return shots


def hand_held_shots(options: DemoOptions) -> list[Shot]:
    """Return one camera, cam00, that walks through the rig's volume while time is static at 0.

    A shot per pose.
    """
    sensor = rig_sensors(options)[0]
    exposed_s = options.shutter_s * ((np.arange(BLUR_POSES) + 0.5) / BLUR_POSES - 0.5)
    shots = []
    for index, camera in enumerate(_poses_at(options)):
        grain = replace(sensor, seed=(*sensor.seed, index))
        shots.append(
            Shot(
                camera=camera,
                noted=noted_camera(options, camera, "cam00", index),
                instants=(0,),
                sensor=grain,
                depth_pose=camera,
            )
        )
    if options.shutter_s:
        during = [_poses_at(options, seconds) for seconds in exposed_s]
        shots = [
            replace(shot, poses=poses)
            for shot, poses in zip(shots, zip(*during, strict=True), strict=True)
        ]
    if options.depth_delay_s:
        earlier = _poses_at(options, -options.depth_delay_s)
        shots = [replace(shot, depth_pose=pose) for shot, pose in zip(shots, earlier, strict=True)]
    return shots


def _poses_at(options: DemoOptions, later_s: float = 0.0) -> list[Camera]:
    """Return the poses of the hand-held camera, each delayed by N seconds."""
    size = (options.width, options.height)
    return hand_held_poses(
        options.seed,
        *size,
        options.n_frames,
        options.fps,
        later_s=later_s,
        sway=options.sway,
        spacing=options.spacing,
    )


def path_shots(options: DemoOptions) -> list[Shot]:
    """Return the true camera path, without gain and noise, all at one instant."""
    cameras = rig_of(options)
    middle = cameras[len(cameras) // 2 if options.rig == "arc" else 0]
    path = sideways_path(middle, PATH_LENGTH, options.path_poses)
    return [
        Shot(camera=pose, noted=pose, instants=(options.path_frame,), sensor=None) for pose in path
    ]


def rig_and_path_shots(options: DemoOptions) -> list[Shot]:
    """Return the rig first, then the true path."""
    return rig_shots(options) + path_shots(options)


def noted_camera(options: DemoOptions, camera: Camera, name: str, number: int) -> Camera:
    """Return the camera as the calibration says, with the errors that the options want.

    Reading:
        A rotation about the camera's own centre by a vector whose three components are normal with
        a standard deviation of error / focal length: the image's centre moves by the error along
        rows and along columns.
    """
    K, world_to_camera = camera.K.copy(), camera.world_to_camera.copy()
    K[[0, 1], [0, 1]] *= dict(options.focal_error).get(name, 1.0)
    if options.calibration_error_px:
        rng = np.random.default_rng([options.seed, 6, number])
        turn = rotation_by(rng.standard_normal(3) * options.calibration_error_px / camera.focal_px)
        world_to_camera[:3] = product(turn, world_to_camera[:3])
    return replace(camera, K=K, world_to_camera=world_to_camera)
