"""Metrics of epipolar plane images: structure-tensor coherence, and agreement of their lines with
depth.

Scene points draw straight lines as the camera moves; near points must move faster, and by the right
amount. The camera path is one camera that moves along its own rows in equal steps.

An EPI (v, x) is a row of the image over the poses of that path; a scene point draws the line x = x0
+ slope * v. Neighbouring rows may be many pixels apart, where derivatives mean nothing; so the EPI
is sheared by every whole slope of a range, and near its own slope each line is upright, where its
tensor is measured ("refocusing" an EPI).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array32
from ggvs_eval.camera import Camera
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import Image, white_level
from ggvs_eval.metrics.metric import Value
from ggvs_eval.metrics.path.rendered_path import PathMetric, PathScorer, RenderedPath, whole_path

SMOOTHING_PX = 1.0
WINDOW_PX = 1.5
MARGIN_PX = 10  # radius of both filters
# weights of the pairs (v + m, v + m + 1) around pose v
OVER_POSES = {-2: 0.125, -1: 0.375, 0: 0.375, 1: 0.125}
MAX_SHEARS = 128


@dataclass(frozen=True, eq=False)
class Lines:
    """The best line through every pixel of an epipolar plane image, within a range of slopes.

    Attributes:
        slope_px: dx/dv, px per pose, (V - 4, X).
        across: gradient energy across the line, mean over RGB, (grey levels of 255 per px)^2, (V -
            4, X).
        along: energy of the change along the line, mean over RGB, (grey levels of 255 per pose)^2,
            (V - 4, X).
        first_column: column of the EPI where they start; they end as far from the other side. Rows
            start at pose 2.
    """

    slope_px: Array32
    across: Array32
    along: Array32
    first_column: int


def find_lines(epi: Image, slope_range_px: tuple[float, float]) -> Lines:
    """Fit a line to every pixel by the structure tensor over 5 poses and about 7 columns, sheared
    by every whole slope.

    Args:
        epi: (V, W, 3), uint8 in 0..255 or float in [0, 1], V >= 5.
        slope_range_px: smallest and largest slope to allow, px per pose.

    Returns:
        For each pixel the line with the least change along it, relative to the change across it.

    Raises:
        MetricError: not an EPI, too narrow for these slopes, or more slopes than can be tried.

    Reading:
        The textbook's tensor takes its own orientation, and a flash of the whole image (a
        horizontal line) is perfectly coherent to it. Here a line must have a slope that some depth
        explains, and all other change counts against it. Change along v is the difference of
        neighbouring poses, not the smoother central one, which cannot see a line that jitters from
        pose to pose.
    """
    low, high = slope_range_px
    shears = range(math.floor(low + 0.5), math.ceil(high - 0.5) + 1)
    if epi.ndim != 3 or epi.shape[2] != 3 or epi.shape[0] < 5:
        raise MetricError(f"wanted an epipolar plane image (poses >= 5, width, 3), got {epi.shape}")
    first_column = MARGIN_PX + 2 * max(abs(shears[0]), abs(shears[-1]))
    if len(shears) > MAX_SHEARS or epi.shape[1] <= 2 * first_column:
        raise MetricError(
            f"slopes from {low:.1f} to {high:.1f} px per pose are too many for an image "
            f"{epi.shape[1]} px wide; use more poses on the same way, or a larger near"
        )
    smooth, gradient = _filtered(epi)
    best: Lines | None = None
    for shear in shears:
        limits = max(low, shear - 0.5), min(high, shear + 0.5)
        best = _straighter(best, _upright_lines(smooth, gradient, shear, limits, first_column))
    if best is None:
        raise MetricError(f"wanted a range of slopes, got {low:g} to {high:g} px per pose")
    return best


def _filtered(epi: Image) -> tuple[Array32, Array32]:
    """Return the EPI smoothed along x by a Gaussian and its derivative, both (V, W, 3) on the scale
    0..255.
    """
    scaled = epi.astype(np.float32) * np.float32(255.0 / white_level(epi))
    x = np.arange(-4.0, 5.0)
    gaussian = np.exp(-0.5 * (x / SMOOTHING_PX) ** 2)
    gaussian /= gaussian.sum()
    slope = x * gaussian
    slope /= (x * slope).sum()  # a ramp of 1 has derivative 1
    smooth, gradient = (
        cv2.filter2D(scaled, cv2.CV_32F, kernel[None]) for kernel in (gaussian, slope)
    )
    return smooth, gradient


def _upright_lines(
    smooth: Array32, gradient: Array32, shear: int, limits: tuple[float, float], first_column: int
) -> Lines:
    """Return the lines whose slope is within `limits`, half a pixel around `shear` at most."""
    xx, xv, vv = (
        _over_window(pairs, shear, first_column) for pairs in _pair_tensors(smooth, gradient, shear)
    )
    # how much less than `shear` a line moves per pose
    moved = np.divide(xv, xx, out=np.zeros_like(xx), where=xx > 1e-6)
    np.clip(moved, shear - limits[1], shear - limits[0], out=moved)
    along = np.maximum(vv + moved * (moved * xx - 2 * xv), 0)
    return Lines(slope_px=shear - moved, across=xx, along=along, first_column=first_column)


def _pair_tensors(
    smooth: Array32, gradient: Array32, shear: int
) -> tuple[Array32, Array32, Array32]:
    """xx, xv, vv of poses v and v + 1 of the sheared EPI, each (V - 1, W - |shear|), by the column
    at pose v.
    """
    columns_before, columns_after = _shifted(-shear), _shifted(shear)
    x = (gradient[:-1, columns_before] + gradient[1:, columns_after]) * np.float32(0.5)
    v = smooth[1:, columns_after] - smooth[:-1, columns_before]
    products = (
        np.einsum("vxc,vxc->vx", *pair) / np.float32(3) for pair in ((x, x), (x, v), (v, v))
    )
    xx, xv, vv = (cv2.GaussianBlur(product, (13, 1), WINDOW_PX) for product in products)
    return xx, xv, vv


def _shifted(shift: int) -> slice:
    """Return the columns that remain when an image is read `shift` further right."""
    return slice(shift, None) if shift >= 0 else slice(None, shift)


def _over_window(pairs: Array32, shear: int, first_column: int) -> Array32:
    """Return the weighted sum over the pairs around each pose, along the sheared lines, (V
    - 4, X).
    """
    n_poses, width = pairs.shape[0] + 1, pairs.shape[1] + abs(shear)
    total = np.zeros((n_poses - 4, width - 2 * first_column), np.float32)
    # a pair's column at its earlier pose starts there when `here` was cut on the left
    left = min(shear, 0)
    for pair, weight in OVER_POSES.items():
        start = first_column + shear * pair + left
        total += (
            np.float32(weight)
            * pairs[2 + pair : n_poses - 2 + pair, start : start + total.shape[1]]
        )
    return total


def _straighter(best: Lines | None, candidate: Lines) -> Lines:
    """Of two lines through each pixel the one that changes less along itself, relative to the
    change across it.
    """
    if best is None:
        return candidate
    # along / across < along' / across' without a division by zero
    take = candidate.along * best.across < best.along * candidate.across
    pairs = (
        (best.slope_px, candidate.slope_px),
        (best.across, candidate.across),
        (best.along, candidate.along),
    )
    slope_px, across, along = (
        np.where(take, candidate_values, best_values) for best_values, candidate_values in pairs
    )
    return Lines(slope_px=slope_px, across=across, along=along, first_column=best.first_column)


MIN_POSES = 5
STRAIGHT_PX = 0.5
EVEN_PX = 0.1
LEAST_TEXTURE_255 = 0.25
WIDER = 1.25
COHERENCE_NAMES = ("EPI_coherence", "EPI_line_texture")
BIN_PX = 1.0 / 1024
TOLERANCE_PX, SLOPE_TEXTURE_255 = 0.1, 4.0  # of the slope agreement
SLOPE_COHERENCE = 0.5  # of a line whose slope is believed, see `epi_coherence`
WIDER_PX = 1.0
SLOPE_NAMES = ("EPI_slope_error", "EPI_slope_agreeing", "EPI_slope_measured")
NO_SLOPE = "EPI slope: no pixel has texture and a coherent line; no slope to compare with depth's"


@dataclass(frozen=True)
class HorizontalPath:
    """Slopes of the lines in the epipolar plane images of a path.

    Attributes:
        slope_of_unit_depth_px: dx/dv of a point at depth 1, px per pose; negative where the camera
            moves to its right.
        near: smallest depth seen from the path, world units.
        far: largest depth seen from the path, world units.
    """

    slope_of_unit_depth_px: float
    near: float
    far: float

    def widened(self, factor: float) -> "HorizontalPath":
        """Return the same path with a depth range that begins nearer and ends farther by this
        factor.
        """
        return replace(self, near=self.near / factor, far=self.far * factor)

    def slope_px(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """dx/dv = -f * step / z in px per pose; 0 if the depth is 0, that is unknown."""
        has_depth = depth > 0
        return np.where(
            has_depth, self.slope_of_unit_depth_px / np.where(has_depth, depth, 1.0), 0.0
        ).astype(np.float32)

    @property
    def slope_range_px(self) -> tuple[float, float]:
        """Smallest and largest slope between near and far, px per pose."""
        ends = self.slope_of_unit_depth_px / self.near, self.slope_of_unit_depth_px / self.far
        return min(ends), max(ends)


def horizontal_path(cameras: Sequence[Camera]) -> HorizontalPath:
    """Check that image rows are epipolar lines and that the steps are equal, and return the slopes.

    Args:
        cameras: poses in order, at least 5.

    Raises:
        MetricError: too few poses, poses that differ in size, intrinsics or orientation, a camera
            that does not move, or one whose way would bend or speed up by more than the EPI's
            resolution: 0.5 px off the row and 0.1 px per step, both at the near end of the depth
            range.

    Reading:
        The paper's path is "horizontally translating". Along any other path a point leaves its row,
        and a row over poses is no epipolar plane image; such a path is refused instead of being
        scored.
    """
    if len(cameras) < MIN_POSES:
        raise MetricError(
            f"an epipolar plane image wants at least {MIN_POSES} poses, the path has "
            f"{len(cameras)}; add poses"
        )
    first = cameras[0]
    for camera in cameras[1:]:
        has_same_lens = camera.size == first.size and np.allclose(camera.K, first.K, atol=1e-3)
        if not has_same_lens or not np.allclose(camera.rotation, first.rotation, atol=1e-5):
            raise MetricError(
                f"pose {camera.name}: size, intrinsics or orientation differ from {first.name}'s; "
                "an epipolar plane image wants a camera that only moves sideways"
            )
    near, far = min(camera.near for camera in cameras), max(camera.far for camera in cameras)
    step = _even_step(
        np.array([first.rotation @ (camera.centre - first.centre) for camera in cameras]),
        first,
        near,
    )
    return HorizontalPath(-float(first.K[0, 0]) * step, near, far)


def _even_step(offsets: NDArray[np.float64], camera: Camera, near: float) -> float:
    """Return the step in world units along x of centres (V, 3) in the first pose's frame."""
    step = float(offsets[-1, 0]) / (len(offsets) - 1)
    if step == 0 or not np.isfinite(step):
        raise MetricError(
            f"pose {camera.name}: wanted a camera that moves along its rows, got no displacement; "
            f"move it"
        )
    down_px, ahead_px = (
        np.abs(offsets[:, 1:]).max(axis=0) * (camera.K[1, 1], max(camera.size) / 2) / near
    )
    if max(down_px, ahead_px) > STRAIGHT_PX:
        raise MetricError(
            f"pose {camera.name}: points leave their row by up to {max(down_px, ahead_px):.2f} px "
            f"along the path, with at most {STRAIGHT_PX:g} px allowed for an epipolar plane image; "
            "move the camera along its rows"
        )
    uneven_px = float(np.abs(np.diff(offsets[:, 0]) - step).max() * camera.K[0, 0] / near)
    if uneven_px > EVEN_PX:
        raise MetricError(
            f"pose {camera.name}: steps differ by {uneven_px:.2f} px, with at most {EVEN_PX:g} px "
            f"allowed; use equal steps"
        )
    return step


@dataclass(frozen=True)
class EpiCoherence:
    """Straightness of the lines in epipolar plane images.

    Attributes:
        coherence: 1 for straight lines, 0 where as much changes along the lines as across them,
            down to -1.
        line_texture_255: root mean square of the gradient that is on straight lines, that is of
            what remains of the energy across the lines after the energy along them is taken off;
            grey levels of 255 per pixel. Blur removes noise and jitter and so can raise the
            coherence, but it lowers this number, and so do noise and jitter.
    """

    coherence: float
    line_texture_255: float


def epi_coherence(epis: Iterable[Image], path: HorizontalPath) -> EpiCoherence:
    """Coherence of the structure tensor over all pixels of epipolar plane images, weighted by
    gradient energy.

    Args:
        epis: one or more rows of the image over the poses, each (V, W, 3), uint8 in 0..255 or float
            in [0, 1]; consumed as a stream.

    Returns:
        (across - along) / (across + along), both summed over all pixels: `across` is the gradient
        energy across the line through a pixel and `along` the energy of the changes along it. The
        tensor's (l1 - l2) / (l1 + l2), weighted by its trace, where the line is the tensor's own
        axis.

    Reading:
        Not in the paper, which shows EPIs and counts nothing. A line's slope must be one that a
        depth between the path's near and far explains, each taken 1.25 times as wide, since
        captures state percentiles; so a flash is no line, and a frozen image is none where even the
        far end moves. Weighting by energy leaves flat regions without a vote; an image without any
        texture (less than 0.25 grey levels per pixel) has no score instead of a perfect one.
        Occlusions end lines, so a perfect rendering stays a little below 1.
    """
    across = along = 0.0
    pixels = 0
    slope_range_px = path.widened(WIDER).slope_range_px
    for epi in epis:
        lines = find_lines(epi, slope_range_px)
        across += float(lines.across.sum(dtype=np.float64))
        along += float(lines.along.sum(dtype=np.float64))
        pixels += lines.across.size
    if not pixels:
        raise MetricError(
            "EPI coherence: no epipolar plane image to measure; give at least one row"
        )
    texture_255 = (across / pixels) ** 0.5
    if texture_255 < LEAST_TEXTURE_255:
        raise MetricError(
            f"EPI coherence: {texture_255:.2f} grey levels per pixel of texture, wanted "
            f"{LEAST_TEXTURE_255:g}; an image without texture has no lines"
        )
    return EpiCoherence(
        (across - along) / (across + along), (max(across - along, 0.0) / pixels) ** 0.5
    )


def _measure_coherence(path: RenderedPath) -> list[Value]:
    coherence = epi_coherence(path.epis(), horizontal_path(path.cameras))
    return whole_path(COHERENCE_NAMES, coherence.coherence, coherence.line_texture_255)


_COHERENCE_SCORER = PathScorer(COHERENCE_NAMES, _measure_coherence)
EPI_COHERENCE = PathMetric(
    name="EPI_coherence",
    function=epi_coherence,
    higher_is_better=True,
    describe="straightness of lines in epipolar plane images",
    scorer=_COHERENCE_SCORER,
)
EPI_LINE_TEXTURE = PathMetric(
    name="EPI_line_texture",
    function=epi_coherence,
    unit="grey levels per px",
    higher_is_better=True,
    describe="contrast across these lines; blur lowers it",
    scorer=_COHERENCE_SCORER,
)


@dataclass(frozen=True)
class SlopeAgreement:
    """Agreement between the slopes that the images show and those that depth predicts.

    Attributes:
        median_error_px: median absolute difference over the measured pixels, px per pose step; None
            if none was measured.
        agreeing_share: pixels whose slope could be measured and agrees, of all pixels with a depth.
            Blur lowers it.
        measured_share: pixels whose slope could be measured, of all pixels with a depth.
        predicted_px: mean absolute predicted slope, px per pose step: the error of an image that
            never moves.
    """

    median_error_px: float | None
    agreeing_share: float
    measured_share: float
    predicted_px: float


def slope_agreement(
    epis: Iterable[tuple[Image, NDArray[np.float32]]],
    path: HorizontalPath,
    tolerance_px: float = TOLERANCE_PX,
    least_texture_255: float = SLOPE_TEXTURE_255,
) -> SlopeAgreement:
    """Compare the slope of the lines in epipolar plane images with the slope that depth predicts,
    -f * step / z.

    Args:
        epis: pairs of an EPI, (V, W, 3), uint8 in 0..255 or float in [0, 1], and the same rows of
            the poses' depth, (V, W) float32, world units, 0 = unknown; consumed as a stream.
        tolerance_px: slopes that differ by no more agree, px per pose step.
        least_texture_255: least root mean square gradient across a line, grey levels of 255 per
            pixel.

    Returns:
        The agreement over all pixels; the median is exact to 0.001 px.

    Reading:
        Not in the paper. Slopes are searched 1 px beyond those of near and far, and from there to
        0, so that an image that is static shows it. The first and last two poses and a margin of
        columns have no whole window and no vote.
    """
    low, high = path.slope_range_px
    slope_range_px = min(low, 0.0) - WIDER_PX, max(high, 0.0) + WIDER_PX
    bins = np.zeros(int((slope_range_px[1] - slope_range_px[0]) / BIN_PX) + 2, np.int64)
    n_with_depth = agreeing = 0
    predicted_sum = 0.0
    for epi, depth in epis:
        if depth.shape != epi.shape[:2]:
            raise MetricError(
                f"EPI slope: the EPI is {epi.shape}, its depth {depth.shape}; wanted one depth per "
                f"pixel"
            )
        lines = find_lines(epi, slope_range_px)
        predicted = path.slope_px(_inner(depth, lines))
        has_depth = predicted != 0
        error = np.abs(lines.slope_px - predicted)[
            has_depth & _is_measured(lines, least_texture_255)
        ]
        bins += np.bincount(
            np.minimum(error / BIN_PX, len(bins) - 1).astype(np.int64), minlength=len(bins)
        )
        n_with_depth += int(np.count_nonzero(has_depth))
        agreeing += int(np.count_nonzero(error <= tolerance_px))
        predicted_sum += float(np.abs(predicted).sum(dtype=np.float64))
    if not n_with_depth:
        raise MetricError(
            "EPI slope: no depth along the path; give depth maps of the poses to compare slopes "
            "with"
        )
    return SlopeAgreement(
        median_error_px=_median(bins),
        agreeing_share=agreeing / n_with_depth,
        measured_share=int(bins.sum()) / n_with_depth,
        predicted_px=predicted_sum / n_with_depth,
    )


def _median(bins: NDArray[np.int64]) -> float | None:
    """Middle of the bin that holds the (lower) median, px."""
    count = int(bins.sum())
    return (
        (int(np.searchsorted(np.cumsum(bins), (count + 1) // 2)) + 0.5) * BIN_PX if count else None
    )


def _inner(depth: NDArray[np.float32], lines: Lines) -> NDArray[np.float32]:
    """Return the part of an EPI's depth where lines were measured."""
    return depth[2:-2, lines.first_column : depth.shape[1] - lines.first_column]


def _is_measured(lines: Lines, least_texture_255: float) -> NDArray[np.bool_]:
    """Return the mask where texture and coherence suffice to trust a slope."""
    coherent = lines.across - lines.along >= SLOPE_COHERENCE * (lines.across + lines.along)
    return coherent & (lines.across >= least_texture_255**2)


def _measure_slopes(path: RenderedPath) -> list[Value]:
    depths = [depth for depth in path.depths if depth is not None]
    if len(depths) < len(path.cameras):
        raise MetricError(
            f"EPI slope: {len(depths)} of {len(path.cameras)} poses have a depth; give all of them "
            f"one"
        )
    pairs = (
        (epi, np.stack([depth[row] for depth in depths])) for row, epi in enumerate(path.epis())
    )
    agreement = slope_agreement(pairs, horizontal_path(path.cameras))
    shares = whole_path(SLOPE_NAMES[1:], agreement.agreeing_share, agreement.measured_share)
    if agreement.median_error_px is None:
        return shares
    return [*whole_path(SLOPE_NAMES[:1], agreement.median_error_px), *shares]


_SLOPE_SCORER = PathScorer(SLOPE_NAMES, _measure_slopes, NO_SLOPE)
EPI_SLOPE_ERROR = PathMetric(
    name="EPI_slope_error",
    function=slope_agreement,
    unit="px per pose",
    higher_is_better=False,
    describe="deviation of the lines' slope from that of the fused depth",
    scorer=_SLOPE_SCORER,
)
EPI_SLOPE_AGREEING = PathMetric(
    name="EPI_slope_agreeing",
    function=slope_agreement,
    higher_is_better=True,
    describe="share of pixels whose slope agrees with the fused depth",
    scorer=_SLOPE_SCORER,
)
