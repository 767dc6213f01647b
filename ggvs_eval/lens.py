"""Lens distortion, between the image of a real lens and the pinhole image that everything else
assumes.
"""

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import CameraError

LensModel = Literal["opencv", "fisheye"]
COEFFICIENTS = {"opencv": (4, 5, 8, 12, 14), "fisheye": (4,)}
# OpenCV calibrates with pixel centres at whole numbers, those of this package are at halves.
PIXEL_CENTRE = 0.5
BORDER_POINTS = 64
LARGEST_ZOOM = 4.0
RADIAL_STEPS = 16
# Of the focal length; 0.1 px at the edge of a large image. A K with more is one of another
# convention.
LARGEST_SKEW = 1e-4
# A principal point farther off the middle, in sides of the image, belongs to images of another
# size.
LARGEST_OFFSET = 0.15
# pixels, the half by which pixel centres differ included: so near the corner it is a fraction of
# the side
FRACTION = 1.5


def check_K_size(K: Array, size: tuple[int, int], is_stated: bool) -> None:
    """Refuse a K in fractions of the side and, where nothing says which size it is of, one of
    images of another size.

    Args:
        K: (3, 3), pixels.
        size: (width, height) of the images that it is taken for.
        is_stated: whether the file that K is from says that size.

    Raises:
        CameraError: with the size that the principal point is in the middle of.
    """
    point, sides = K[:2, 2], np.array(size, np.float64)
    if (np.abs(point) <= FRACTION).all() and min(size) > 4 * FRACTION:
        raise CameraError(
            f"wanted the principal point in pixels of {size[0]} x {size[1]} images, got "
            f"({point[0]:g}, {point[1]:g}): fractions of the side; multiply by width and height"
        )
    if is_stated or (np.abs(point / sides - 0.5) <= LARGEST_OFFSET).all():
        return
    factor = 2 * float(np.mean(point / sides))
    width, height = np.round(factor * sides)
    if factor > 0 and (np.abs(point / (factor * sides) - 0.5) <= LARGEST_OFFSET).all():
        raise CameraError(
            f"K is of about {width:g} x {height:g} images, by its principal point ({point[0]:g}, "
            f"{point[1]:g}), these have {size[0]} x {size[1]}: add the size that it is of, or "
            "scale K as the images were scaled"
        )


@dataclass(frozen=True, eq=False)
class Lens:
    """A lens in one of OpenCV's two models.

    Attributes:
        K: intrinsics of the distorted image in pixels, (3, 3); pixel centres at halves, as
            everywhere here.
        model: ``opencv`` (radial, tangential, rational: k1 k2 p1 p2 [k3 [k4 k5 k6 ...]]) or
            ``fisheye`` (equidistant: k1 .. k4).
        coefficients: of the model, in OpenCV's order.
        width: of the distorted image, pixels.

    Examples:
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> Lens(K, "opencv", (-0.1, 0.0, 0.0, 0.0), 8, 6).distort(
        ...     np.array([[8.0, 3.0]]), K
        ... ).tolist()
        [[7.9, 3.0]]
    """

    K: Array
    model: LensModel
    coefficients: tuple[float, ...]
    width: int
    height: int

    def __post_init__(self) -> None:
        """Refuse a K that is none, and coefficients that the model does not have or that are no
        numbers.
        """
        K = self.K
        is_K = (
            K.shape == (3, 3)
            and np.isfinite(K).all()
            and K[0, 0] > 0
            and K[1, 1] > 0
            and abs(K[0, 1]) <= LARGEST_SKEW * K[0, 0]
        )
        if not is_K or np.any(K[[1, 2, 2, 2], [0, 0, 1, 2]] != (0, 0, 0, 1)):
            rows = " / ".join(" ".join(f"{value:.6g}" for value in row) for row in K)
            raise CameraError(
                f"lens: K must be fx 0 cx / 0 fy cy / 0 0 1 in pixels, zero skew, got {rows}"
            )
        if self.width < 1 or self.height < 1:
            raise CameraError(f"lens: the size must be positive, got {self.width} x {self.height}")
        counts = COEFFICIENTS[self.model]
        if len(self.coefficients) not in counts or not np.isfinite(self.coefficients).all():
            raise CameraError(
                f"lens: the {self.model} model wants {' or '.join(map(str, counts))} finite "
                f"coefficients, got {self.coefficients}"
            )

    @property
    def is_pinhole(self) -> bool:
        """True if the lens does not distort at all."""
        return self.model == "opencv" and not any(self.coefficients)

    def resized(self, width: int, height: int) -> "Lens":
        """Return the lens of the same image resampled to width x height."""
        K = np.diag([width / self.width, height / self.height, 1.0]) @ self.K
        return replace(self, K=K, width=width, height=height)

    def cropped(self, left: int, top: int, width: int, height: int) -> "Lens":
        """Return the lens of a part of the image, of width x height from a column and a row on."""
        K = self.K - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]])
        return replace(self, K=K, width=width, height=height)

    def distort(self, uv: Array, K: Array) -> Array:
        """Map points of a pinhole image to the distorted one.

        Args:
            uv: image coordinates in the pinhole image, (..., 2), pixels.
            K: intrinsics of the pinhole image, (3, 3).

        Returns:
            Image coordinates in the distorted image, (..., 2).
        """
        normalised = (uv.reshape(-1, 1, 2) - K[:2, 2]) / K[[0, 1], [0, 1]]
        coefficients = np.array(self.coefficients)
        if self.model == "fisheye":
            distorted = cv2.fisheye.distortPoints(normalised, self.K, coefficients)
        else:
            rays = np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)
            distorted, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self.K, coefficients)
        return np.asarray(distorted, dtype=np.float64).reshape(uv.shape)

    def undistorted_K(self) -> Array:
        """Return the intrinsics of a pinhole image of the same size in which no pixel is blank.

        The lens's own K where that leaves no blank pixel (barrel distortion), else one zoomed in
        just far enough. The same where the model folds over, as strong barrel distortion does
        beyond the angles that it was calibrated for.
        """
        if self._covers(1.0):
            return self.K
        is_within = 0 < self.K[0, 2] < self.width and 0 < self.K[1, 2] < self.height
        if not any(self.coefficients) and self.model == "opencv" and not is_within:
            raise CameraError(
                f"lens: the principal point ({self.K[0, 2]:g}, {self.K[1, 2]:g}) is not within "
                f"{self.width} x {self.height} images; give K in pixels of these, or the size that "
                "it is of"
            )
        blank, covered = 1.0, LARGEST_ZOOM
        if not self._covers(covered):
            raise CameraError(
                f"lens: coefficients {self.coefficients} leave blank pixels even at "
                f"{LARGEST_ZOOM:g} times the focal length; calibrate this lens again"
            )
        while covered - blank > 1e-4:
            middle = (blank + covered) / 2
            blank, covered = (blank, middle) if self._covers(middle) else (middle, covered)
        return self._zoomed(covered)

    def _zoomed(self, zoom: float) -> Array:
        return self.K * np.array([[zoom, 1, 1], [1, zoom, 1], [1, 1, 1]])

    def _covers(self, zoom: float) -> bool:
        """Return whether the pinhole image at this zoom is inside the distorted one, and no part of
        it twice.
        """
        along = np.linspace(0.0, 1.0, BORDER_POINTS)
        ends = np.zeros(BORDER_POINTS), np.ones(BORDER_POINTS)
        border = np.concatenate(
            [np.stack(side, axis=-1) for end in ends for side in ((along, end), (end, along))]
        )
        size = np.array([self.width, self.height])
        outwards = np.linspace(0.0, 1.0, RADIAL_STEPS + 1)[1:, None, None]
        K = self._zoomed(zoom)
        # (steps, border, 2)
        spokes = self.distort(K[:2, 2] + outwards * (border * size - K[:2, 2]), K)
        u, v = spokes[-1].T
        is_inside = (u >= 0) & (u <= self.width) & (v >= 0) & (v <= self.height)
        radii = np.linalg.norm(spokes - K[:2, 2], axis=-1)
        return bool(is_inside.all() and (np.diff(radii, axis=0) > 0).all())
