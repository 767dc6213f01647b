"""Record of one pass over a camera's frames, gathered frame by frame.

It is bounded in size, regardless of the capture's length.

The questions of the check are answered from these records alone. Frames can be added as they are
written, so that a record of what is there so far can be had at any time.
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Array32, Image8
from ggvs_eval.capture import Capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.geometry.epipolar import Features, find_features

# Still fine enough to see an arm move, small enough to cost less than decoding.
LONGEST_SIDE_PX = 480
CELLS_PER_SIDE = 16
# Motion is measured on small pictures and kept in cells, of the first and the last N frames.
MOTION_LONGEST_SIDE_PX, ENERGY_LONGEST_SIDE_PX, TIMED_FRAMES = 240, 80, 384
# Differences below this multiple of the usual one of that frame are noise, or the pulse of a
# codec's key frames.
NOISE_FACTOR, LEAST_LEVELS = 4.0, 1.0
SMOOTHING_SIGMA = 1.0
# Pixels looked at singly for noise: averaging would hide it.
NOISE_SAMPLES_PER_SIDE = 200
# After damage, reading continues 1, 2, 4, ... frames later, this often at most.
RESTARTS = 6
# Corners followed from the first frame on, and how many of them must agree on one motion of the
# picture.
MOST_CORNERS, CORNER_QUALITY, CORNER_SPACING_PX = 240, 0.01, 8
CORNER_PX, LEAST_SHARE, FEWEST_CORNERS = 1.0, 0.35, 12
# Local mean and contrast are removed over N pixels before corners are followed: lamps fade.
CONTRAST_PX, LEAST_CONTRAST = 21, 4.0
# Instants of which the colours around the first frame's features are kept; the blur is of a picture
# of LONGEST_SIDE_PX.
MOST_COLOURS, COLOUR_SIGMA = 48, 1.2


@dataclass(frozen=True)
class Damage:
    """A frame that cannot be read, and the message that names its file."""

    frame: int
    message: str


@dataclass(frozen=True, eq=False)
class CameraRecord:
    """Record of one pass over the frames of a camera.

    Attributes:
        black: frames of which every pixel is 0.
        change: how much each frame differs from the one before it where it differs most, mean of a
            16th of the image's sides, 0..255, (T,); NaN for the first and where either was not
            read.
        noise_sigma_255: of a single pixel, from differences of consecutive frames; NaN with fewer
            than two frames.
        energy: frame -> motion since the frame before, in cells of the picture, float16 (h, w).
        instants: features of the first frame that was read and is not black, of the middle and of
            the last, by frame number as it would be without damage; empty if nothing was read.
        shifts_px: how the picture has moved since the first frame: right, down, turned and
            enlarged, the last two as the displacement at the root mean square distance from the
            middle; (T, 4), NaN where unknown.
        levels: logarithm of the brightness around the first frame's features, against the first
            frame, (T,).
        sampled: frames of which `colours` were kept.
        colours: RGB around the first frame's features, which are followed as the picture moves,
            uint8 (S, N, 3).
    """

    name: str
    n_read: int
    damage: tuple[Damage, ...]
    black: tuple[int, ...]
    change: NDArray[np.float32]
    noise_sigma_255: float
    energy: Mapping[int, NDArray[np.float16]]
    instants: Mapping[int, Features]
    shifts_px: Array
    levels: Array
    sampled: tuple[int, ...]
    colours: NDArray[np.uint8]


class Recorder:
    """Gathers the record of one camera.

    Args:
        n_frames: of the whole capture; None while it is still being written.
    """

    def __init__(self, name: str, n_frames: int | None = None) -> None:
        self.name, self._n_frames = name, n_frames
        self.damage: list[Damage] = []
        self._n_read, self._last = 0, -2
        self._last_image: Image8 | None = None
        self._small: Image8 | None = None
        self._sparse: Image8 | None = None
        self._change: list[float] = []
        self._black: list[int] = []
        self._noise = np.zeros(256, np.int64)
        self._first_energy: dict[int, NDArray[np.float16]] = {}
        self._last_energy: deque[tuple[int, NDArray[np.float16]]] = deque(maxlen=TIMED_FRAMES)
        self._instants: dict[int, Features] = {}
        self._followed: _Followed | None = None
        self._shifts: list[Array] = []
        self._levels: list[float] = []
        self._colours: dict[int, NDArray[np.uint8]] = {}
        self._stride = 1

    def add(self, index: int, image: Image8) -> None:
        """Add a frame; those between the last one and this were not read."""
        colour = shrink(image, LONGEST_SIDE_PX)
        small, sparse = (
            np.asarray(cv2.cvtColor(colour, cv2.COLOR_RGB2GRAY), np.uint8),
            _sparse(image),
        )
        missing = index - len(self._change)
        self._change += [np.nan] * (missing + 1)
        self._levels += [np.nan] * (missing + 1)
        self._shifts += [np.full(4, np.nan)] * (missing + 1)
        if index == self._last + 1 and self._small is not None and self._sparse is not None:
            self._change[index] = largest_change(small, self._small)
            self._noise += np.bincount(cv2.absdiff(sparse, self._sparse).ravel(), minlength=256)
            self._keep_energy(index, small)
        self._small, self._sparse, self._last, self._n_read = small, sparse, index, self._n_read + 1
        if not image.any():
            self._black.append(index)
            return
        self._last_image = image
        if not self._instants:
            self._instants[0] = find_features(image)
            self._followed = _Followed(
                small, colour, self._instants[0].uv * (colour.shape[1] / image.shape[1])
            )
        elif (
            self._n_frames is not None
            and 0 < self._n_frames // 2 <= index
            and len(self._instants) == 1
        ):
            self._instants[self._n_frames // 2] = find_features(image)
        self._follow(index, small, colour, image.shape[1] / colour.shape[1])

    def record(self, n_frames: int | None = None) -> CameraRecord:
        """Return the record of the frames so far.

        Args:
            n_frames: of the rig, where other cameras have more.
        """
        n_frames = n_frames or self._n_frames or len(self._change)
        instants = dict(self._instants)
        if self._last_image is not None and self._last > 0 and n_frames > 1:
            instants.setdefault(n_frames - 1, find_features(self._last_image))
        missing = n_frames - len(self._change)
        empty = np.full(missing, np.nan)
        shifts = np.concatenate([np.reshape(self._shifts, (-1, 4)), np.full((missing, 4), np.nan)])
        return CameraRecord(
            name=self.name,
            n_read=self._n_read,
            damage=tuple(self.damage),
            black=tuple(self._black),
            change=np.concatenate([self._change, empty]).astype(np.float32),
            noise_sigma_255=difference_sigma(self._noise),
            energy=self._first_energy | dict(self._last_energy),
            instants=instants,
            shifts_px=shifts,
            levels=np.concatenate([self._levels, empty]),
            sampled=tuple(self._colours),
            colours=np.stack([*self._colours.values()])
            if self._colours
            else np.empty((0, 0, 3), np.uint8),
        )

    def _keep_energy(self, index: int, small: Image8) -> None:
        if self._small is None:
            return
        before, current = (shrink(grey, MOTION_LONGEST_SIDE_PX) for grey in (self._small, small))
        energy = shrink(
            motion_energy(np.stack([before, current]))[0], ENERGY_LONGEST_SIDE_PX
        ).astype(np.float16)
        if index < TIMED_FRAMES:
            self._first_energy[index] = energy
        else:
            self._last_energy.append((index, energy))

    def _follow(self, index: int, small: Image8, colour: Image8, enlarged: float) -> None:
        if self._followed is None:
            return
        shift, colours = self._followed.see(small, colour)
        self._shifts[index] = shift * enlarged
        if not len(colours):
            return
        levels = colours.mean(axis=1)
        self._levels[index] = float(np.median(np.log((levels + 1) / (self._followed.levels + 1))))
        if index % self._stride == 0:
            self._colours[index] = colours
        if len(self._colours) > MOST_COLOURS:
            self._stride *= 2
            self._colours = {
                frame: values
                for frame, values in self._colours.items()
                if frame % self._stride == 0
            }


class _Followed:
    """The first frame's corners and the places of its features, found again in later frames.

    Reading:
        One similarity of the whole picture is fitted to the corners by RANSAC. What moves in the
        scene disagrees with what is fixed, and is in the minority where a camera films a place and
        not a crowd.
    """

    def __init__(self, small: Image8, colour: Image8, places: Array) -> None:
        self._reference = even_contrast(small)
        corners = cv2.goodFeaturesToTrack(
            self._reference, MOST_CORNERS, CORNER_QUALITY, CORNER_SPACING_PX
        )
        self._corners = np.empty((0, 1, 2), np.float32) if corners is None else corners
        self._guess = self._corners.copy()
        self._middle = np.array(small.shape[::-1]) / 2
        # root mean square distance of all pixels from the middle
        self._radius = float(np.hypot(*self._middle)) / np.sqrt(3)
        self._places = places
        self._shift = np.zeros(4)
        self.levels = self._colours_at(colour).mean(axis=1)

    def see(self, small: Image8, colour: Image8) -> tuple[Array, NDArray[np.uint8]]:
        """Shift of the picture since the first frame, (4,), pixels of `small`, and colours of the
        features' places, (N, 3).
        """
        shift = self._measure(even_contrast(small))
        if np.isfinite(shift).all():
            self._shift = shift
        return shift, self._colours_at(colour)

    def _measure(self, picture: Image8) -> Array:
        unknown = np.full(4, np.nan)
        if len(self._corners) < FEWEST_CORNERS:
            return unknown
        corners, status, _ = cv2.calcOpticalFlowPyrLK(
            self._reference,
            picture,
            self._corners,
            self._guess.copy(),
            winSize=(15, 15),
            maxLevel=3,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        is_tracked = status.ravel() > 0
        if is_tracked.sum() < FEWEST_CORNERS:
            return unknown
        motion, inliers = fit_similarity(
            self._corners[is_tracked, 0] - self._middle, corners[is_tracked, 0] - self._middle
        )
        if motion is None or inliers < LEAST_SHARE * len(self._corners):
            return unknown
        self._guess = (
            (self._corners[:, 0] - self._middle) @ motion[:, :2].T + motion[:, 2] + self._middle
        )
        self._guess = self._guess[:, None].astype(np.float32)
        zoom, turn = np.hypot(*motion[:, 0]) - 1, np.arctan2(motion[1, 0], motion[0, 0])
        return np.array([*motion[:, 2], turn * self._radius, zoom * self._radius])

    def _colours_at(self, colour: Image8) -> NDArray[np.uint8]:
        right, down, turn, zoom = self._shift / np.array([1, 1, self._radius, self._radius])
        matrix = (1 + zoom) * np.array(
            [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        )
        at = (self._places - self._middle) @ matrix.T + [right, down] + self._middle
        column, row = np.clip(np.floor(at).astype(int), 0, np.array(colour.shape[1::-1]) - 1).T
        return np.asarray(
            cv2.GaussianBlur(colour, (0, 0), COLOUR_SIGMA)[row, column], np.uint8
        ).reshape(-1, 3)


def fit_similarity(before: Array, after: Array) -> tuple[Array | None, int]:
    """Similarity (2, 3) that most points share, fitted to those that do, and how many do.

    None if no motion is shared.
    """
    motion, inliers = cv2.estimateAffinePartial2D(
        before, after, ransacReprojThreshold=CORNER_PX, maxIters=500, refineIters=10
    )
    return (None, 0) if motion is None else (np.asarray(motion), int(inliers.sum()))


def even_contrast(grey: Image8) -> Image8:
    """Return a picture with its local mean and contrast taken out.

    Equal for lamps of any strength.
    """
    values = grey.astype(np.float32)
    size = (CONTRAST_PX, CONTRAST_PX)
    centred = values - cv2.blur(values, size)
    contrast = np.sqrt(cv2.blur(centred * centred, size)) + LEAST_CONTRAST
    return np.asarray(np.clip(128 + 40 * centred / contrast, 0, 255), np.uint8)


def record_camera(capture: Capture, name: str) -> CameraRecord:
    """Decode a camera's frames once; what cannot be read is noted and passed over."""
    recorder = Recorder(name, capture.n_frames)
    for index, image in _readable_frames(capture, name, recorder.damage):
        recorder.add(index, image)
    return recorder.record()


def _readable_frames(
    capture: Capture, name: str, damage: list[Damage]
) -> Iterator[tuple[int, Image8]]:
    """Yield the frames with their numbers.

    Damage is noted and passed over in growing steps, so that a ruined file ends soon.
    """
    index = 0
    while index < capture.n_frames:
        try:
            for image in capture.frames(name, index):
                yield index, image
                index += 1
            if index < capture.n_frames:
                raise CaptureError(
                    f"{capture.path}: {name} ends after {index} of {capture.n_frames} frames; "
                    f"restore it"
                )
        except CaptureError as error:
            damage.append(Damage(index, str(error)))
            if len(damage) > RESTARTS:
                return
            index += 2 ** (len(damage) - 1)


def motion_energy(burst: NDArray[np.uint8]) -> Array32:
    """Square root of what changes from frame to frame beyond noise, (B - 1, h, w)."""
    energy = np.empty((max(len(burst) - 1, 0), *burst.shape[1:]), np.float32)
    for index in range(len(energy)):
        difference = cv2.absdiff(burst[index + 1], burst[index]).astype(np.float32)
        difference = cv2.GaussianBlur(difference, (0, 0), SMOOTHING_SIGMA)
        threshold = max(NOISE_FACTOR * float(np.median(difference)), LEAST_LEVELS)
        energy[index] = np.sqrt(np.maximum(difference - threshold, 0))
    return energy


def largest_change(grey: Image8, before: Image8) -> float:
    """Return the mean absolute difference of two grey images in the cell of a grid where it is
    largest, 0..255.
    """
    difference = cv2.absdiff(grey, before).astype(np.float32)
    cells = cv2.resize(difference, (CELLS_PER_SIDE, CELLS_PER_SIDE), interpolation=cv2.INTER_AREA)
    return float(cells.max())


def difference_sigma(counts: NDArray[np.int64]) -> float:
    """Return the standard deviation of a pixel's noise from how often each absolute difference of
    two frames occurs.

    The median is used, which a moving minority of the pixels does not disturb, and read between the
    integers: for a sigma of 1.5 a plain median of integers would be 30 % off.

    Args:
        counts: occurrences of the differences 0, 1, 2, ..., (256,).
    """
    total = counts.sum()
    if not total:
        return float("nan")
    upto = np.cumsum(counts) / total  # a difference of k represents all up to k + 1/2
    edges = np.arange(len(counts)) + 0.5
    median = float(np.interp(0.5, np.concatenate([[0.0], upto]), np.concatenate([[0.0], edges])))
    return median / 0.6745 / np.sqrt(2)


def robust_sigma(values: Array | Sequence[float]) -> float:
    """Return the standard deviation of the bulk of some values, by their median absolute deviation.

    NaN without any.
    """
    finite = np.asarray(values, np.float64)
    finite = finite[np.isfinite(finite)]
    return (
        float(1.4826 * np.median(np.abs(finite - np.median(finite))))
        if len(finite)
        else float("nan")
    )


def shrink(image: NDArray, longest_side_px: int) -> NDArray:
    """Return the picture averaged down to a longest side; a smaller one as it is."""
    scale = longest_side_px / max(image.shape[:2])
    if scale >= 1:
        return image
    size = (max(round(image.shape[1] * scale), 1), max(round(image.shape[0] * scale), 1))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def _sparse(image: Image8) -> Image8:
    """Return every Nth pixel of the green channel, not averaged."""
    step = max(min(image.shape[:2]) // NOISE_SAMPLES_PER_SIDE, 1)
    return np.ascontiguousarray(image[::step, ::step, 1])
