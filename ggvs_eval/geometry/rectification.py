"""Rectify a calibrated pair so that matching points are on one row, and convert disparity to depth.

One rule serves horizontal, vertical and oblique pairs in either order: the canvas's x axis points
from the reference camera to its partner, so that the reference always plays the left image. A
partner on the left turns the canvas upside down, one above or below turns it on its side; a matcher
does not mind. (cv2.stereoRectify knows horizontal and vertical pairs only, needs swapped roles and
turned images for the rest, and either crops a converging rig or shrinks it to fit.)
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8, Map, Mask
from ggvs_eval.camera import Camera
from ggvs_eval.errors import DepthError
from ggvs_eval.kernels.portable import length, product, transformed, unit

# of a rectified ray; smaller ones would need a canvas more than ten focal lengths wide
MIN_RAY_Z = 0.1
SAME_SURFACE_PX = 0.75  # neighbouring disparities that differ by less are one surface
Values = TypeVar("Values", Map, NDArray[np.uint8])


@dataclass(frozen=True, eq=False)
class RectifiedPair:
    """Everything about a pair that does not depend on its images.

    Attributes:
        left_map: position of each canvas pixel in the reference image, (Hc, Wc, 2), array indices
            (pixel centres at integers).
        right_map: the same for the partner, (Hc, Wc, 2).
        left_inside: canvas pixels that the reference sees, (Hc, Wc).
        right_inside: canvas pixels that the partner sees, (Hc, Wc).
        canvas_map: position of each pixel of the reference on the canvas, (H, W, 2), array indices.
        depth_scale: depth of a reference pixel = depth_scale / disparity, (H, W), world units x
            pixels.
        rotation: reference camera to rectified camera, (3, 3).
        projection: intrinsics of the rectified cameras, (3, 3).
        baseline: distance of the two centres, world units.
        d_min: disparity of the farthest point of the reference, pixels.
        d_max: disparity of its nearest point, pixels.
    """

    left_map: Map
    right_map: Map
    left_inside: Mask
    right_inside: Mask
    canvas_map: Map
    depth_scale: Map
    rotation: Array
    projection: Array
    baseline: float
    d_min: int
    d_max: int

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the canvas in pixels."""
        return self.left_inside.shape[1], self.left_inside.shape[0]

    def sees(self, disparity: Map) -> Mask:
        """Canvas pixels that the reference sees and whose match at that disparity the partner sees,
        (Hc, Wc).
        """
        matched = at_matches(self.right_inside.view(np.uint8), disparity).view(np.bool_)
        return self.left_inside & matched & (disparity > 0)

    def warp_left(self, image: Image8) -> Image8:
        """Return the reference image on the canvas."""
        return _warp(image, self.left_map)

    def warp_right(self, image: Image8) -> Image8:
        """Return the partner's image on the canvas."""
        return _warp(image, self.right_map)


def rectify(reference: Camera, partner: Camera) -> RectifiedPair:
    """Rectify a pair on a canvas that holds all of the reference that the partner can match.

    Args:
        reference: the camera whose depth is wanted; its near and far bound the disparities.
        partner: any other camera.

    Raises:
        DepthError: the cameras share a centre, look apart so far that no plane holds both images,
            or see nothing together.

    Reading:
        The nearest surfaces may move by more than the images overlap: what is farther away is
        matched anyway. With cameras 26 degrees apart and people 1 m in front of them 12 of 58 pairs
        are such; they are worth 0.5 dB (docs/depth.md).
    """
    world_to_rectified, baseline = _rectifying_rotation(reference, partner)
    rotation = product(world_to_rectified, reference.rotation.T)
    rotation_partner = product(world_to_rectified, partner.rotation.T)
    rays = transformed(rotation, _rays(reference))  # (H, W, 3)
    rays_partner = transformed(rotation_partner, _rays(partner))
    depth_scale, (d_min, d_max), origin, size = _canvas(
        reference, partner, rays, rays_partner, baseline
    )
    focal_px = reference.focal_px
    projection = np.array(
        [[focal_px, 0.0, -origin[0]], [0.0, focal_px, -origin[1]], [0.0, 0.0, 1.0]]
    )
    left_map, left_inside = _canvas_to_image(reference, rotation, projection, size)
    right_map, right_inside = _canvas_to_image(partner, rotation_partner, projection, size)
    # (H, W, 2), pixel centres at halves
    canvas_uv = rays[..., :2] / rays[..., 2:] * focal_px - origin
    return RectifiedPair(
        left_map=left_map,
        right_map=right_map,
        left_inside=left_inside,
        right_inside=right_inside,
        canvas_map=(canvas_uv - 0.5).astype(np.float32),
        depth_scale=depth_scale.astype(np.float32),
        rotation=rotation,
        projection=projection,
        baseline=baseline,
        d_min=d_min,
        d_max=d_max,
    )


def rectify_each(reference: Camera, partners: Sequence[Camera]) -> dict[int, RectifiedPair]:
    """Rectify a camera with the partners that it can be rectified with, by their numbers.

    With none is a DepthError.
    """
    pairs, refusal = (
        {},
        DepthError(f"camera {reference.name}: wanted a partner to match with, got none"),
    )
    for number, partner in enumerate(partners):
        try:
            pairs[number] = rectify(reference, partner)
        except DepthError as error:
            refusal = error
    if not pairs:
        raise refusal
    return pairs


def nearest_disparity(reference: Camera, partner: Camera) -> float:
    """Disparity of the nearest point over the width that both cameras see, in microseconds: images
    end at their corners.

    Raises:
        DepthError: as `rectify`.
    """
    world_to_rectified, baseline = _rectifying_rotation(reference, partner)
    rays = [
        transformed(product(world_to_rectified, camera.rotation.T), _corner_rays(camera))
        for camera in (reference, partner)
    ]
    _, (_, d_max), _, (width, _) = _canvas(reference, partner, rays[0], rays[1], baseline)
    return d_max / (width - d_max)


def can_rectify(reference: Camera, partner: Camera, nearest: float = np.inf) -> bool:
    """Return whether `rectify` takes a pair, and its `nearest_disparity` is below `nearest`."""
    try:
        return nearest_disparity(reference, partner) < nearest
    except DepthError:
        return False


def exchange_roles(pair: RectifiedPair, reference: Camera, partner: Camera) -> RectifiedPair:
    """The same canvas turned upside down, on which the partner plays the left image: its pixels,
    matched with the reference's.

    Args:
        pair: what `rectify` has made of the two.
        reference: the camera that plays the left image there.
        partner: the one that plays it here.

    Returns:
        Return the pair with the roles exchanged; what one image shows at (column, row) of the
        canvas is at (width - 1 - column, height - 1 - row) of this one.
    """
    half_turn = np.diag([-1.0, -1.0, 1.0])
    rotation = product(
        half_turn, product(product(pair.rotation, reference.rotation), partner.rotation.T)
    )
    focal_px = pair.projection[0, 0]
    centre = np.array(pair.size) - pair.projection[:2, 2]
    rays = transformed(rotation, _rays(partner))  # (H, W, 3)
    return RectifiedPair(
        left_map=pair.right_map[::-1, ::-1],
        right_map=pair.left_map[::-1, ::-1],
        left_inside=pair.right_inside[::-1, ::-1],
        right_inside=pair.left_inside[::-1, ::-1],
        canvas_map=(rays[..., :2] / rays[..., 2:] * focal_px + centre - 0.5).astype(np.float32),
        depth_scale=(focal_px * pair.baseline / rays[..., 2]).astype(np.float32),
        rotation=rotation,
        projection=np.array(
            [[focal_px, 0.0, centre[0]], [0.0, focal_px, centre[1]], [0.0, 0.0, 1.0]]
        ),
        baseline=pair.baseline,
        d_min=pair.d_min,
        d_max=pair.d_max,
    )


def depth_from_disparity(
    pair: RectifiedPair, disparity: Map, confidence: Map
) -> tuple[Map, Map, Map]:
    """Map a disparity map on the canvas to the pixels of the reference.

    Disparity is interpolated where its neighbourhood is one surface and taken from the nearest
    canvas pixel elsewhere, so that no depth appears between two surfaces.

    Args:
        pair: the rectification.
        disparity: (Hc, Wc), pixels, 0 = invalid.
        confidence: (Hc, Wc), in [0, 1].

    Returns:
        Depth z in the reference camera, (H, W), world units, 0 = invalid, its confidence and its
        disparity, (H, W) each.
    """
    nearest = _sample(disparity, pair.canvas_map, cv2.INTER_NEAREST)  # (H, W)
    smooth = _sample(disparity, pair.canvas_map, cv2.INTER_LINEAR)
    sampled = np.where(np.abs(smooth - nearest) < SAME_SURFACE_PX, smooth, nearest)
    depth = np.divide(pair.depth_scale, sampled, out=np.zeros_like(sampled), where=sampled > 0)
    return (
        depth,
        np.where(
            sampled > 0, _sample(confidence, pair.canvas_map, cv2.INTER_NEAREST), np.float32(0)
        ),
        sampled,
    )


def at_matches(right: Values, disparity: Map) -> Values:
    """Look up the right image at the match of each pixel of the left one, rounded to whole pixels.

    Args:
        right: any values, (H, W).
        disparity: of the left image, (H, W), pixels.

    Returns:
        Values, (H, W), 0 if the match is outside.
    """
    columns = np.rint(np.arange(disparity.shape[1], dtype=np.float32) - disparity)
    rows = np.broadcast_to(np.arange(len(disparity), dtype=np.float32)[:, None], disparity.shape)
    values = cv2.remap(
        right,
        columns,
        np.ascontiguousarray(rows),
        cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_CONSTANT,
    )
    return np.asarray(values, right.dtype)


def _rectifying_rotation(reference: Camera, partner: Camera) -> tuple[Array, float]:
    """Return the transform of world to rectified axes: x towards the partner, z as near as can be
    to both viewing directions.
    """
    towards = partner.centre - reference.centre
    baseline = float(length(towards))
    forward = reference.axis + partner.axis
    if baseline < 1e-9 * reference.near or length(np.cross(towards, forward)) < 1e-3 * baseline:
        raise DepthError(
            f"cameras {reference.name} and {partner.name} have no parallax (distance "
            f"{baseline:g}); choose another partner"
        )
    x = towards / baseline
    y = unit(np.cross(forward, x))
    return np.stack([x, y, np.cross(x, y)]), baseline


def _rays(camera: Camera) -> Array:
    """Return the viewing rays in the camera's own frame, z = 1, (H, W, 3)."""
    return _rays_at(camera, camera.pixel_centres())


def _corner_rays(camera: Camera) -> Array:
    """Return the rays of the four outermost pixels, (2, 2, 3)."""
    return _rays_at(
        camera, np.stack(np.meshgrid(*([0.5, side - 0.5] for side in camera.size)), axis=-1)
    )


def _rays_at(camera: Camera, uv: Array) -> Array:
    """Return the viewing rays of pixels (H, W, 2) in the camera's own frame, z = 1, (H, W, 3)."""
    uv = (uv - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]]
    return np.concatenate([uv, np.ones((*uv.shape[:2], 1))], axis=-1)


def _canvas(
    reference: Camera, partner: Camera, rays: Array, rays_partner: Array, baseline: float
) -> tuple[Array, tuple[int, int], Array, tuple[int, int]]:
    """Depth x disparity of the rays, disparities, and the window of every reference pixel with a
    possible match, and its matches.

    Returns:
        (H, W); least and largest disparity, pixels; origin and size of the window, pixels.
    """
    if min(rays[..., 2].min(), rays_partner[..., 2].min()) < MIN_RAY_Z:
        raise DepthError(
            f"cameras {reference.name} and {partner.name} have too different directions for "
            f"matching; choose another partner"
        )
    focal_px = reference.focal_px
    depth_scale = focal_px * baseline / rays[..., 2]
    low, high = _bounds(rays, focal_px)
    low_partner, high_partner = _bounds(rays_partner, focal_px)
    d_min = int(np.floor(depth_scale.min() / reference.far))
    # no match is farther away
    d_max = int(np.ceil(min(depth_scale.max() / reference.near, high[0] - low_partner[0])))
    left, right = max(low[0], low_partner[0] + d_min), min(high[0], high_partner[0] + d_max)
    top, bottom = max(low[1], low_partner[1]), min(high[1], high_partner[1])
    origin = np.floor([left - 0.5 - d_max, top - 0.5])
    width, height = np.ceil([right + 0.5, bottom + 0.5]) - origin
    if width <= d_max or height < 1 or d_max < d_min:
        overlap = f"{width - d_max:g} x {height:g} pixels"
        raise DepthError(
            f"two rectified images overlap by {overlap}, too little for matching; choose another "
            f"partner"
        )
    return depth_scale, (d_min, d_max), origin, (int(width), int(height))


def _bounds(rays: Array, focal_px: float) -> tuple[Array, Array]:
    uv = rays[..., :2] / rays[..., 2:] * focal_px
    return uv.min(axis=(0, 1)), uv.max(axis=(0, 1))


def _canvas_to_image(
    camera: Camera, rotation: Array, projection: Array, size: tuple[int, int]
) -> tuple[Map, Mask]:
    """Map canvas pixels into the image (array indices), and mark those inside it."""
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV has pixel centres at integers
    u, v = cv2.initUndistortRectifyMap(
        camera.K - half, None, rotation, projection - half, size, cv2.CV_32FC1
    )
    inside = (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)
    return np.dstack([u, v]), inside


def _warp(image: Image8, positions: Map) -> Image8:
    return cv2.remap(image, positions, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def _sample(values: Map, positions: Map, interpolation: int) -> Map:
    """Return values at positions of the canvas; 0 outside it."""
    return cv2.remap(values, positions, None, interpolation, borderValue=0)
