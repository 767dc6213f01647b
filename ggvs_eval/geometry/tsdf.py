"""The image-based TSDF (paper 3.2, supplement A.1-A.2): depth images fused along the target's rays,
without a voxel grid.

Reading:
    * Eq. 9 prints z - D; the signed distance here is D - z, positive in front of the surface. With
      the printed sign the rule "no weight below -tau" deletes free space, and a march steps
      backwards.
    * Eq. 10 lacks the division by the sum of the weights; without it steps jump over surfaces once
      the weights sum above 2.5.
    * "Advance by 0.8 s" alone approaches a surface and never crosses it: a step is at least 0.1
      tau.
    * A sample no view knows is passed by 0.8 tau and forgotten; a crossing counts only between two
      known samples. A surface entered from behind is not a hit.
    * The surface is where the straight line through the distances on both sides of the crossing is
      zero, and its weight is on the line through their weights. Halving the interval in between
      costs a third of the march and is less exact.
    * D_k[u, v] is bilinear where the four neighbours are valid and differ by less than tau, else
      the nearest pixel's, so that no surface appears between foreground and background; weights are
      the nearest pixel's.
    * The previous frame's depth is one more depth camera at the previous target pose, so that a
      moving target is right too.
"""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.errors import DepthError, GgvsWarning
from ggvs_eval.geometry.pinhole import Pinhole, as_image, pinhole, rigid_between
from ggvs_eval.kernels import SIMD_LEVELS, get_simd_level, get_threads

MAX_VIEWS = 32
STEP_FRACTION = 0.8  # of the fused distance, taken as a step


@dataclass(frozen=True, eq=False)
class PreviousDepth:
    """The previous frame's result in the fused field (Eqs. 13-14): its weight is min(gain *
    accumulated_weight, limit).

    Attributes:
        camera: the target's pose at the previous frame.
        depth: the previous `RayMarch.depth`, (H', W') float32, world units.
        accumulated_weight: the previous `RayMarch.weight`, (H', W') float32.
        gain: beta * max(1 - M, 0) for each ray of the current target, (H', W') float32.
        limit: eta, the largest temporal weight.
    """

    camera: Camera
    depth: NDArray[np.float32]
    accumulated_weight: NDArray[np.float32]
    gain: NDArray[np.float32]
    limit: float


@dataclass(frozen=True, eq=False)
class RayMarch:
    """The surface seen by the target camera.

    Attributes:
        depth: (H, W) float32, world units, 0 = no surface met.
        weight: sum of all weights at the surface, temporal one included, (H, W) float32; the next
            frame's accumulated weight.
    """

    depth: NDArray[np.float32]
    weight: NDArray[np.float32]


def fusion_weights(
    depth: NDArray[np.float32], tau: float, depth_noise: float
) -> NDArray[np.float32]:
    """Weight depth pixels by trust: min(noise / rms, 1), rms of the truncated differences to the 7
    x 7 window (Eqs. 11-12).

    Args:
        depth: (H, W) float32, world units, 0 = invalid.
        tau: truncation distance, world units.
        depth_noise: the differences that are still trusted fully, world units (1 mm in the paper).

    Returns:
        (H, W) float32 from depth_noise / tau to 1, 0 if the depth is invalid. Invalid and outside
        neighbours count tau.

    Examples:
        >>> plane = np.full((9, 9), 2.0, np.float32)
        >>> float(fusion_weights(plane, tau=0.1, depth_noise=0.001)[4, 4])
        1.0
    """
    from ggvs_eval.kernels import _core

    _check_positive(tau=tau, depth_noise=depth_noise)
    if depth.ndim != 2:
        raise DepthError(f"fusion weights: wanted a depth image (H, W), got {depth.shape}")
    image = np.ascontiguousarray(depth, dtype=np.float32)
    return _core.fusion_weights(
        image, tau, depth_noise, get_threads(), SIMD_LEVELS.index(get_simd_level())
    )


def ray_march(
    target: Camera,
    cameras: Sequence[Camera],
    depths: Sequence[NDArray[np.float32]],
    weights: Sequence[NDArray[np.float32]],
    *,
    tau: float,
    previous: PreviousDepth | None = None,
    skip_empty: bool = True,
    step_fraction: float = STEP_FRACTION,
    min_step: float = 0.1,
) -> RayMarch:
    """Find the first surface of the fused field along each ray, from the target's near to its far
    depth (Eqs. 3, 9, 10, 13, 14).

    Args:
        target: the camera to render, at its current pose.
        cameras: the K source cameras; sizes may differ.
        depths: of each, (H, W) float32, world units, 0 = invalid.
        weights: omega_k of Eqs. 11-12, see `fusion_weights`: (H, W) float32 each, 0 = this pixel
            says nothing.
        tau: truncation distance, world units.
        previous: the previous frame's result, used for temporal smoothing.
        skip_empty: pass whole steps that no view can influence without sampling them; the result is
            the same, bit for bit.
        step_fraction: of the fused distance, taken as a step.
        min_step: smallest step, in tau.

    Raises:
        DepthError: images that do not fit their cameras, too many of them, or parameters for which
            the march would not end.

    Reading:
        A surface is found between two samples: one within the smallest step of the far depth, or at
        it, is not. Nor is one beyond `march_end`, regardless of the far depth.

    Examples:
        >>> from ggvs_eval.camera import translated_path
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> left, right = translated_path(camera, span=0.25, count=2)
        >>> plane, ones = np.full((6, 8), 2.0, np.float32), np.ones((6, 8), np.float32)
        >>> surface = ray_march(camera, [left, right], [plane, plane], [ones, ones], tau=0.1)
        >>> round(float(surface.depth[3, 4]), 2)
        2.0
    """
    from ggvs_eval.kernels import _core

    _check_positive(tau=tau, min_step=min_step, step_fraction=step_fraction)
    if min_step > step_fraction:
        raise DepthError(
            f"ray march: min_step must not exceed step_fraction, got {min_step:g} and "
            f"{step_fraction:g}"
        )
    far = march_end(target, tau, min_step, depths)
    if not len(cameras) == len(depths) == len(weights):
        raise DepthError(
            f"ray march: wanted depth and weights per camera, got {len(cameras)}, {len(depths)}, "
            f"{len(weights)}"
        )
    if len(cameras) + (previous is not None) > MAX_VIEWS:
        raise DepthError(
            f"ray march: wanted at most {MAX_VIEWS} depth views, got {len(cameras)} and the "
            f"previous depth"
        )
    fields = [_field(target, *view) for view in zip(cameras, depths, weights, strict=True)]
    if previous is not None:
        gain = as_image(previous.gain, target, "gain", DepthError)
        fields.append(
            _field(
                target,
                previous.camera,
                previous.depth,
                previous.accumulated_weight,
                gain,
                previous.limit,
            )
        )
    settings = (
        tau,
        step_fraction,
        min_step,
        skip_empty,
        get_threads(),
        SIMD_LEVELS.index(get_simd_level()),
    )
    return RayMarch(*_core.ray_march(pinhole(target), (target.near, far), fields, *settings))


def march_end(target: Camera, tau: float, min_step: float, depths: Iterable[Any]) -> float:
    """Depth where a march ends: the target's far one, at most a million smallest steps, beyond
    which they are lost in float32.

    Args:
        tau: truncation distance, world units.
        min_step: smallest step, in tau.
        depths: of the views, arrays or tensors, world units; warns once if they are beyond the end.

    Returns:
        World units; 2 km by the paper's constants, compared with which a loose far depth does not
        matter.

    Raises:
        DepthError: steps that vanish next to the near depth.

    Examples:
        >>> camera = Camera(
        ...     "cam00", np.diag([8.0, 8, 1]), np.eye(4), width=8, height=6, near=1.0, far=1e6
        ... )
        >>> round(march_end(camera, tau=0.02, min_step=0.1, depths=[]))
        2000
    """
    end = min(target.far, 1e6 * tau * min_step)
    if end <= target.near:
        step = f"{min_step:g} tau = {tau * min_step:g}"
        raise DepthError(
            f"ray march: wanted steps above rounding at the near depth {target.near:g}, got "
            f"{step}; raise tau"
        )
    if end < target.far and any(float(depth.max()) > end for depth in depths):
        text = (
            f"depth beyond {end:g} world units is unreachable by steps of {tau * min_step:g}; "
            f"are units_per_metre right?"
        )
        warnings.warn(text, GgvsWarning, stacklevel=2)
    return end


Field = tuple[
    Pinhole,
    NDArray[np.float64],
    NDArray[np.float32],
    NDArray[np.float32],
    NDArray[np.float32] | None,
    float,
]


def _field(
    target: Camera,
    camera: Camera,
    depth: NDArray,
    weight: NDArray,
    gain: NDArray[np.float32] | None = None,
    limit: float = 0.0,
) -> Field:
    """Return one depth image as the kernel takes it.

    Without a gain its weight is taken as it is.
    """
    return (
        pinhole(camera),
        rigid_between(target, camera),
        as_image(depth, camera, "depth", DepthError),
        as_image(weight, camera, "weight", DepthError),
        gain,
        limit,
    )


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not 0 < value < np.inf:
            raise DepthError(f"TSDF: {name} must be positive and finite, got {value:g}")
