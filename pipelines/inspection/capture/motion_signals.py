"""Comparison of the motion in two views without matching, by epipolar planes: those that hold both camera centres.

Every point of the scene lies in one half-plane that is bounded by the line through the two centres, and both cameras see it in
that same half-plane, whatever its depth. So the motion within each half-plane rises and falls in both at the same instants (the
idea of motion barcodes, Ben-Artzi et al. 2016, with energies in place of bits).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Array32
from ggvs_eval.camera import Camera

PLANES = 24
# Share of pixels at the rims that may lie outside the planes compared.
RIM_SHARE = 0.02
# Differences below so many times the usual one of that frame are noise, or the pulse of a codec's key frames.
NOISE_FACTOR, LEAST_LEVELS = 4.0, 1.0
SMOOTHING_SIGMA = 1.0


@dataclass(frozen=True)
class Lag:
    """By how much one camera's motion trails another's.

    Attributes:
        frames: lag of the best agreement, with a fraction.
        correlation: at that lag, 1 for equal signals.
        margin: how much better that is than the best lag two or more frames away.
        at_edge: the best lag is the largest that was tried, so the true one may lie beyond.
    """

    frames: float
    correlation: float
    margin: float
    at_edge: bool


def motion_energy(burst: NDArray[np.uint8]) -> Array32:
    """Square root of what changes from frame to frame beyond noise, (B - 1, h, w)."""
    energy = np.empty((max(len(burst) - 1, 0), *burst.shape[1:]), np.float32)
    for index in range(len(energy)):
        difference = cv2.absdiff(burst[index + 1], burst[index]).astype(np.float32)
        difference = cv2.GaussianBlur(difference, (0, 0), SMOOTHING_SIGMA)
        threshold = max(NOISE_FACTOR * float(np.median(difference)), LEAST_LEVELS)
        energy[index] = np.sqrt(np.maximum(difference - threshold, 0))
    return energy


def plane_signals(one: Camera, other: Camera, energy_one: Array32, energy_other: Array32) -> tuple[Array, Array] | None:
    """Motion energy per half-plane and frame as two cameras see it, both (PLANES, T); None where they share no plane.

    Args:
        energy_one: (T, h, w).
        energy_other: (T, h', w').
    """
    if np.linalg.norm(other.centre - one.centre) < 1e-9:
        return None
    angles = plane_angles(one, other)
    low = max(np.quantile(angle, RIM_SHARE) for angle in angles)
    high = min(np.quantile(angle, 1 - RIM_SHARE) for angle in angles)
    if not low < high:
        return None
    edges = np.linspace(low, high, PLANES + 1)
    first, second = (
        _per_plane(energy, np.digitize(angle.ravel(), edges))
        for energy, angle in zip((energy_one, energy_other), angles, strict=True)
    )
    return first, second


def plane_angles(one: Camera, other: Camera) -> tuple[Array, Array]:
    """Angle about the line through both centres of the half-plane that each pixel's ray lies in, radians, (H, W) each."""
    baseline = other.centre - one.centre
    baseline /= np.linalg.norm(baseline)
    forward = one.axis + other.axis
    forward = forward - baseline * (baseline @ forward)
    if np.linalg.norm(forward) < 1e-6:  # they look along the line, at each other or one behind the other
        forward = np.cross(baseline, np.eye(3)[np.abs(baseline).argmin()])
    forward /= np.linalg.norm(forward)
    side = np.cross(baseline, forward)
    rays = one.rays(), other.rays()
    return np.arctan2(rays[0] @ side, rays[0] @ forward), np.arctan2(rays[1] @ side, rays[1] @ forward)


def best_lag(one: Array, other: Array, largest: int) -> Lag | None:
    """The lag at which other[t + lag] follows one[t] best; None where too little happens in either.

    Args:
        one: signals, (P, T).
        largest: lags from -largest to largest are tried.
    """
    lags = np.arange(-largest, largest + 1)
    scores = np.array([_correlation(one, other, int(lag)) for lag in lags])
    if not np.isfinite(scores).all():
        return None
    peak = int(scores.argmax())
    far = scores[np.abs(lags - lags[peak]) >= 2]
    at_edge = peak in (0, len(lags) - 1)
    shift = 0.0 if at_edge else _parabola_peak(*scores[peak - 1 : peak + 2])
    return Lag(float(lags[peak] + shift), float(scores[peak]), float(scores[peak] - far.max()), at_edge)


def _per_plane(energy: Array32, planes: NDArray[np.int64]) -> Array:
    """Mean energy of the pixels of each plane, (PLANES, T); 0 where a plane has none."""
    count = np.bincount(planes, minlength=PLANES + 2)[1:-1]
    sums = np.stack([np.bincount(planes, frame.ravel(), PLANES + 2)[1:-1] for frame in energy], axis=1)
    return np.asarray(sums / np.maximum(count, 1)[:, None])


def _correlation(one: Array, other: Array, lag: int) -> float:
    """Correlation over all planes of the frames that overlap at a lag; planes count by how much happens in them."""
    frames = one.shape[1]
    first = one[:, max(0, -lag) : frames - max(0, lag)]
    second = other[:, max(0, lag) : frames + min(0, lag)]
    first, second = (signal - signal.mean(axis=1, keepdims=True) for signal in (first, second))
    energy = float((first**2).sum() * (second**2).sum())
    return float((first * second).sum() / np.sqrt(energy)) if energy > 1e-12 else float("nan")


def _parabola_peak(before: float, at: float, after: float) -> float:
    """Locate the maximum of the parabola through three equidistant values, relative to the middle one."""
    curvature = before - 2 * at + after
    return float(np.clip(0.5 * (before - after) / curvature, -0.5, 0.5)) if curvature < 0 else 0.0
