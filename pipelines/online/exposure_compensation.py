"""One colour for what several cameras see: gains and lens fall-off, estimated online where sources
see the same surface.

The fall-off towards the corners is one figure for all cameras, from what they see together.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.geometry.per_pixel import view_weights
from ggvs_eval.geometry.pinhole import rigid_between
from ggvs_eval.kernels import get_threads
from ggvs_eval.method import Instant, SourceView

# of the logarithm of a look-up's colour; what is off by more than four times that says nothing of a
# lens
FALL_OFF_NOISE = 0.02
FALL_OFF_ROUNDS = 4  # of reweighting
# weight of "none" relative to the look-ups; squared tangents count in those of the picture's corner
FALL_OFF_PRIOR = 1.0
# of the logarithm of brightness in the corner: less is not distinguished from none
LEAST_FALL_OFF = 0.03
# of the images that are compared, so that a registration that is off by a pixel does not matter
REDUCTION = 4
LATTICE_ROWS = 32  # of look-ups in a source, at least, if it has as many
DARK, BRIGHT = 20.0, 235.0  # levels of 255 between which a sensor is taken to be linear
FEWEST = 50  # look-ups that two sources must share
# weight of "no gain" relative to the share of the look-ups that two sources have in common
PRIOR = 1e-3
LARGEST_LOG_GAIN = 0.5
GAUGE_POWER = 2  # of the views' weights, by which their gains are averaged into the target's
MEMORY = 10  # instants that a ratio is the mean of, at most
UNKNOWN = (0, np.zeros(3), 0.0)  # of a ratio: instants, mean, weight
# colours of a surface are alike where their log ratio is as near to the pair's, or they are DARK
# levels apart
LIKE = 0.2
# share of alike looks below which a source is left out, if another pair has more than the second
ODD, COMMON = 0.2, 0.5


class ExposureCompensation:
    """Gains, one per source camera and channel, that make the sources agree about the surfaces they
    share.

    A lattice of pixels of each source is looked up in every other source that sees the same
    surface. The median ratio of two sources' colours gives the ratio of their gains; least squares
    over all pairs gives every source's. How the ratio changes with the angles from the two axes
    gives the fall-off of the lens that all share, see `LensFallOff`. State: the mean ratio of each
    pair of cameras that were sources together, whose weight fades while they share too little, and
    the mean fall-off, since the last gap in time.

    Args:
        memory: instants that a ratio is the mean of, at most; 1 for none but the present one.

    Reading:
        Not in the paper. A gain common to all sources does not show; the target camera, which is
        never looked at, is taken to have the mean gain of the sources, by the square of their
        `view_weights`: a camera that is carried changes its exposure on the way. Nine views of a
        real hand-held sequence score 24.2 dB if gains are averaged by weights that fall to 1 / e at
        a parallax of 0.1, 25.7 with these and geometric weights, rooms the same 30.6. Nine views of
        the validation rooms (demo seeds 101-103, gains of cameras 2 % apart): 31.20 to 31.33 dB and
        LPIPS 0.0872 to 0.0850 with the shipped network, 30.68 to 30.75 dB with geometric weights;
        with the plain mean of the sources 31.26 and 30.68 dB.
    """

    def __init__(self, memory: int = MEMORY) -> None:
        self._memory = memory
        self._ratios: dict[tuple[str, str], tuple[int, Array, float]] = {}  # instants, mean, weight
        self._odd: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._falloff = LensFallOff(memory)
        self._index: int | None = None
        self.slope, self._corner = 0.0, 1.0

    def step(self, instant: Instant, tolerance: float) -> Instant:
        """Return the instant with its source images multiplied by `gains` and without fall-off.

        They stay in 8 bit.

        A source whose colours are like no other's, black for an instant, is left out where others
        agree.
        """
        gains = self.gains(instant, tolerance)
        sources = [
            replace(source, image=self._compensated(source, gain))
            for source, gain, odd in zip(instant.sources, gains, self._odd, strict=True)
            if not odd
        ]
        return replace(instant, sources=tuple(sources))

    def finish(self, image: Map, target: Camera) -> Map:
        """Show what was blended of the last step's sources as the target's lens would, in place."""
        return fallen_off(image, target, self.slope, self._corner)

    def gains(self, instant: Instant, tolerance: float) -> Map:
        """Factors that turn the colours of each source into those of the target, (K, 3), except for
        the fall-off of lenses.

        Args:
            instant: source views, target camera.
            tolerance: depths that differ by less are the same surface, world units.
        """
        if self._index is not None and instant.index != self._index + 1:
            self._ratios.clear()  # stale history is worse than none
            self._falloff.forget()
        self._index = instant.index
        fade = 1 - 1 / self._memory
        self._ratios = {
            pair: (count, mean, weight * fade)
            for pair, (count, mean, weight) in self._ratios.items()
        }
        cameras, shares = (
            [source.camera for source in instant.sources],
            [source.share for source in instant.sources],
        )
        self._corner = corner_of([instant.target, *cameras])
        log_gains = self._solve(instant.sources, tolerance)
        weights = view_weights(instant.target, cameras, shares).astype(np.float64) ** GAUGE_POWER
        log_gains -= weights @ log_gains / weights.sum()
        return np.exp(-np.clip(log_gains, -LARGEST_LOG_GAIN, LARGEST_LOG_GAIN)).astype(np.float32)

    def _compensated(self, source: SourceView, gain: Map) -> Image8:
        if not self.slope:
            return gained_image(source.image, gain)
        return flattened(source.image, source.camera, gain, self.slope, self._corner)

    def _solve(self, sources: Sequence[SourceView], tolerance: float) -> Array:
        """Return the logarithm of every source's gain, (K, 3), whose mean is about 0: weighted
        least squares over all pairs.
        """
        pairs, samples, likeness = shared_looks(sources, tolerance)
        self._odd = odd_ones(likeness)
        self.slope = self._falloff.step(
            [(looks[:, :3].mean(axis=1), looks[:, 3]) for looks in pairs.values()], self._corner
        )
        normal, right = PRIOR * np.eye(len(sources)), np.zeros((len(sources), 3))
        for (j, k), looks in pairs.items():
            ratios = (
                looks[:, :3] - np.float32(self.slope) * looks[:, 3:] if self.slope else looks[:, :3]
            )
            share = len(looks) / (samples[j] + samples[k])
            self._remember(
                sources[j].camera.name, sources[k].camera.name, np.median(ratios, axis=0), share
            )
        for j, k in combinations(range(len(sources)), 2):
            _, ratio, weight = self._ratios.get(
                (sources[j].camera.name, sources[k].camera.name), UNKNOWN
            )
            normal[[j, k], [j, k]] += weight
            normal[[j, k], [k, j]] -= weight
            right[j] += weight * ratio
            right[k] -= weight * ratio
        return np.asarray(np.linalg.solve(normal, right))

    def _remember(self, first: str, second: str, ratio: Array, weight: float) -> None:
        """Take a log ratio of two cameras into their mean, in which the last instants count
        most.
        """
        count, mean, _ = self._ratios.get((first, second), UNKNOWN)
        count = min(count + 1, self._memory)
        mean = mean + (ratio - mean) / count
        self._ratios |= {
            (first, second): (count, mean, weight),
            (second, first): (count, -mean, weight),
        }


def odd_ones(likeness: Array) -> NDArray[np.bool_]:
    """Mark the sources that are like none of those that see the same surfaces, though others are
    like each other.

    Args:
        likeness: share of alike looks of every two sources, (K, K); NaN if they share too little.

    Examples:
        >>> odd_ones(np.array([[np.nan, 0.9, 0.0], [0.9, np.nan, 0.1], [0.0, 0.1, np.nan]]) - 0.05)
        array([False, False,  True])
    """
    closest = np.nan_to_num(likeness, nan=-1.0).max(axis=1, initial=-1.0)
    return (closest >= 0) & (closest < ODD) & (closest.max(initial=0.0) > COMMON)


def shared_looks(
    sources: Sequence[SourceView], tolerance: float
) -> tuple[dict[tuple[int, int], Map], list[int], Array]:
    """Pair every two sources by what they see together, at the lattices of both.

    Args:
        sources: the views.
        tolerance: depths that differ by less are the same surface, world units.

    Returns:
        Of the pairs that share enough, by their numbers: `log_ratios` of the first to the second,
        (N, 4). How many points the lattice of each source has. And the likeness of every two, see
        `odd_ones`.
    """
    pictures = [reduced(source.image) for source in sources]
    lattices = [lattice(source, picture) for source, picture in zip(sources, pictures, strict=True)]
    pairs, likeness = {}, np.full((len(sources), len(sources)), np.nan)
    for j, k in combinations(range(len(sources)), 2):
        forward, *seen_there = log_ratios(
            lattices[j], sources[j].camera, sources[k], pictures[k], tolerance
        )
        back, *seen_back = log_ratios(
            lattices[k], sources[k].camera, sources[j], pictures[j], tolerance
        )
        looks, (n_seen, close) = np.concatenate([forward, -back]), np.add(seen_there, seen_back)
        if len(looks) >= FEWEST:
            pairs[j, k] = looks
        if n_seen >= FEWEST:
            apart = np.abs(looks[:, :3] - (np.median(looks[:, :3], axis=0) if len(looks) else 0))
            likeness[j, k] = likeness[k, j] = (
                np.count_nonzero((apart < LIKE).all(axis=1)) + close
            ) / n_seen
    return pairs, [len(points) for points, _ in lattices], likeness


def lattice(source: SourceView, picture: Map) -> tuple[Map, Map]:
    """Points of a source's surface at a lattice of its reduced pixels, in the camera's frame, and
    their colours' logarithms.

    Args:
        picture: its `reduced` image, (h, w, 3).

    Returns:
        Both (N, 3), float32; there is no point where depth is unknown, or the colour too dark or
        too bright.
    """
    K, step = source.camera.K, max(len(picture) // LATTICE_ROWS, 1)
    colours = picture[step // 2 :: step, step // 2 :: step]
    rows, columns = (np.arange(count) * step + step // 2 for count in colours.shape[:2])
    v, u = (
        np.minimum(REDUCTION * cells + REDUCTION // 2, size - 1)
        for cells, size in zip((rows, columns), source.depth.shape, strict=True)
    )
    z = source.depth[np.ix_(v, u)]
    usable = (z > 0) & linear(colours)
    x, y = np.broadcast_arrays(
        z * ((u - K[0, 2]) / K[0, 0]), z * ((v - K[1, 2]) / K[1, 1])[:, None]
    )
    return np.stack([x[usable], y[usable], z[usable]], axis=-1).astype(np.float32), np.log(
        colours[usable]
    )


def log_ratios(
    points_of: tuple[Map, Map], camera: Camera, source: SourceView, picture: Map, tolerance: float
) -> tuple[Map, int, int]:
    """Logarithms of one source's colours less those of another one, at the points that both see in
    their linear range, (M, 4).

    The last column is the difference of the squared tangents of the angles from their axes. And of
    how many points both see the surface, and of how many of these the other's colour is out of
    range but hardly another.

    Args:
        points_of: the first source's `lattice`.
        camera: of the first source.
        source: the second source.
        picture: its `reduced` image.
        tolerance: depths that differ by less are the same surface, world units.
    """
    points, logarithms = points_of
    K, size, to_other = (
        source.camera.K,
        source.camera.size,
        rigid_between(camera, source.camera).astype(np.float32),
    )
    x, y, z = (points @ to_other[:3, :3].T + to_other[:3, 3]).T
    z = np.where(z > 0, z, np.float32(np.inf))  # behind the other camera: depths never agree
    u = (K[0, 0] * x / z + K[0, 2]).astype(np.float32)
    v = (K[1, 1] * y / z + K[1, 2]).astype(np.float32)
    inside = np.flatnonzero((u >= 0) & (u < size[0]) & (v >= 0) & (v < size[1]))
    u, v, z = u[inside], v[inside], z[inside]
    agrees = np.abs(source.depth[v.astype(np.intp), u.astype(np.intp)] - z) < tolerance
    colours = sampled(picture, u[agrees] / REDUCTION - 0.5, v[agrees] / REDUCTION - 0.5)
    counts = linear(colours)
    shared = inside[agrees][counts]
    own_points, other_points = (
        points[shared],
        np.stack([x[shared], y[shared], z[agrees][counts]], axis=-1),
    )
    spans = _squared_tangents(own_points) - _squared_tangents(other_points)
    beside = np.abs(np.exp(logarithms[inside[agrees][~counts]]) - colours[~counts]) <= DARK
    looks = np.concatenate(
        [logarithms[shared] - np.log(colours[counts]), spans[:, None]], axis=1, dtype=np.float32
    )
    return looks, len(counts), int(beside.all(axis=1).sum())


def _squared_tangents(points: Map) -> Map:
    """Return the squared tangents of the angles from the axis of points in a camera's frame, (N,
    3).
    """
    return np.asarray((points[:, 0] ** 2 + points[:, 1] ** 2) / points[:, 2] ** 2, np.float32)


def linear(colours: Map) -> NDArray[np.bool_]:
    """Return the mask colours (..., 3) whose channels all are in the range in which a sensor is
    assumed to be linear.
    """
    return np.asarray(np.logical_and.reduce((colours >= DARK) & (colours <= BRIGHT), axis=-1))


def reduced(image: Image8) -> Map:
    """Return the means of whole blocks of 4 x 4 pixels, float32.

    A few rows and columns may be left over.
    """
    height, width = (max(size // REDUCTION, 1) for size in image.shape[:2])
    blocks = image[: height * REDUCTION, : width * REDUCTION]
    return cv2.resize(blocks, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)


def sampled(image: Map, x: Map, y: Map) -> Map:
    """Return the bilinear samples of an image (h, w, 3) at positions whose integers are the centres
    of pixels, (N, 3).
    """
    height, width = image.shape[:2]
    x, y = np.clip(x, 0, width - 1).astype(np.float32), np.clip(y, 0, height - 1).astype(np.float32)
    left, top = (
        np.minimum(x.astype(np.intp), max(width - 2, 0)),
        np.minimum(y.astype(np.intp), max(height - 2, 0)),
    )
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    across, down = (x - left)[:, None], (y - top)[:, None]
    pixels, rows, columns = image.reshape(-1, 3), (top * width, bottom * width), (left, right)
    (first, second), (third, fourth) = (
        [pixels.take(row + column, axis=0) for column in columns] for row in rows
    )
    upper, lower = first + across * (second - first), third + across * (fourth - third)
    return np.asarray(upper + down * (lower - upper), np.float32)


def gained_image(image: Image8, gain: Map) -> Image8:
    """Return an 8-bit image with its channels multiplied, rounded and clipped to 8 bit."""
    return np.asarray(cv2.transform(image, np.diag(gain)), np.uint8)


class LensFallOff:
    """The fall-off that all sources share: the slope of the logarithm of brightness over the
    squared tangent from the axis.

    A surface that one camera sees near its axis and another near its corner is darker in the
    latter. Each pair of sources gives a slope; their mean counts as far as the pairs agree on it.
    State: the mean over the instants since the last gap in time.

    Args:
        memory: instants that the slope is the mean of, at most; 1 for none but the present one.

    Reading:
        Not in the paper. Only what the cameras share can be known of the target, which is never
        looked at: a fall-off of its own, or a field that each camera has for itself, cannot; of
        those that K sources have, their differences alone show, and taking them out leaves (1 +
        1/K) of the variance where the blend leaves (1 + sum of squared weights). The squared
        tangent is the first term of the cosine law and of every lens profile. Shrinking by the
        disagreement of the pairs makes it exactly 0 in rooms without, and nearly always where each
        camera has its own field.
    """

    def __init__(self, memory: int = 10) -> None:
        self._memory = memory
        self.forget()

    def forget(self) -> None:
        """Begin anew, after a gap in time."""
        self._count, self._slope = 0, 0.0

    def step(self, pairs: Sequence[tuple[Map, Map]], corner: float) -> float:
        """Return the slope by the present instant and those before, 0 if none can be measured.

        Args:
            pairs: of each pair of sources, what they see together: the logarithm of the ratio of
                its two brightnesses, (N,), and the difference of the squared tangents under which
                the two see it, (N,).
            corner: largest squared tangent in any of the pictures.
        """
        if len(pairs) < 2:  # they say nothing
            return self._slope
        self._count = min(self._count + 1, self._memory)
        self._slope += (
            shared_slope([fit_slope(*pair, corner) for pair in pairs], corner) - self._slope
        ) / self._count
        return self._slope


def fit_slope(ratios: Map, spans: Map, corner: float) -> tuple[float, float]:
    """Return the slope of log ratios over differences of squared tangents, and its weight, by
    robust least squares.
    """
    x, y = spans.astype(np.float64) / corner, ratios.astype(np.float64)
    y = y - np.median(y)
    weights, slope, evidence = np.ones(len(x)), 0.0, 0.0
    for _ in range(FALL_OFF_ROUNDS):
        from_mean, up = x - np.average(x, weights=weights), y - np.average(y, weights=weights)
        evidence = float((weights * from_mean**2).sum())
        slope = float((weights * from_mean * up).sum()) / max(evidence, 1e-12)
        residuals = np.abs(up - slope * from_mean)
        weights = np.where(
            residuals < 4 * FALL_OFF_NOISE,
            FALL_OFF_NOISE / np.maximum(residuals, FALL_OFF_NOISE),
            1e-9,
        )
    return slope / corner, evidence


def shared_slope(slopes: Sequence[tuple[float, float]], corner: float) -> float:
    """Return the mean of the pairs' slopes by their weights, shrunk by how far they disagree.

    0 of fewer than two pairs.

    Examples:
        >>> round(shared_slope([(-0.20, 90.0), (-0.21, 60.0), (-0.19, 80.0)], corner=1.0), 2)
        -0.19
        >>> shared_slope([(-0.20, 90.0), (0.15, 60.0), (0.05, 80.0)], corner=1.0)
        0.0
    """
    if len(slopes) < 2:
        return 0.0
    values, weights = np.array(slopes).T
    values = values * corner
    mean = float((weights * values).sum() / (weights.sum() + FALL_OFF_PRIOR))
    pairs = weights.sum() ** 2 / max((weights**2).sum(), 1e-12)  # that count alike
    variance = float(
        (weights * (values - mean) ** 2).sum()
        / (weights.sum() + FALL_OFF_PRIOR)
        / max(pairs - 1, 0.5)
    )
    doubt = LEAST_FALL_OFF**2 + 4 * variance
    return mean * (1 - doubt / mean**2) / corner if mean**2 > doubt else 0.0


def squared_tangents(camera: Camera) -> tuple[Array, Array]:
    """Squared tangents of the angle from the optical axis, of the camera's rows and of its columns.

    Their sum is a pixel's.
    """
    across = (np.arange(camera.width) + 0.5 - camera.K[0, 2]) / camera.K[0, 0]
    down = (np.arange(camera.height) + 0.5 - camera.K[1, 2]) / camera.K[1, 1]
    return down**2, across**2


def corner_of(cameras: Sequence[Camera]) -> float:
    """Return the largest squared tangent in any picture of the cameras."""
    return max(float(down.max() + across.max()) for down, across in map(squared_tangents, cameras))


def flattened(image: Image8, camera: Camera, gain: Map, slope: float, corner: float) -> Image8:
    """Return a source image as it would be under no lens's fall-off, times a gain per channel.

    8 bit.

    What is brightest is kept and the rest darkened, so that nothing is cut off.
    """
    from ggvs_eval.kernels import _core

    down, across = squared_tangents(camera)
    rows, columns = np.exp(-slope * down - max(-slope * corner, 0.0)), np.exp(-slope * across)
    gain = np.ascontiguousarray(gain, np.float32)
    return _core.shade(
        np.ascontiguousarray(image),
        gain,
        rows.astype(np.float32),
        columns.astype(np.float32),
        get_threads(),
    )


def fallen_off(image: Map, camera: Camera, slope: float, corner: float) -> Map:
    """Show what is blended of `flattened` sources, (H, W, 3), as the target's lens would, at most
    1; in place.
    """
    if not slope:
        return image
    down, across = squared_tangents(camera)
    image *= np.exp(slope * down + max(-slope * corner, 0.0)).astype(np.float32)[:, None, None]
    image *= np.exp(slope * across).astype(np.float32)[:, None]
    return np.minimum(image, np.float32(1), out=image)
