"""Partners as the plane sweep sees them: turned to the reference's axes, so that a plane of
constant depth scales and shifts.

The planes face the reference camera and are evenly spaced in inverse depth. A partner's image is
resampled once, as a camera at the partner's centre with the reference's orientation and focal
lengths would have seen it; from then on each plane moves it by a scale and a shift only.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Map, Mask
from ggvs_eval.camera import Camera
from ggvs_eval.pipelines.offline.plane_sweep.planes import SMALLEST_DENOMINATOR, SweepPlanes

MIN_RAY_Z = 1e-3


@dataclass(frozen=True, eq=False)
class PartnerView:
    """One partner, turned to the reference's axes.

    Everything about it that does not depend on its images.

    What the reference sees in array index (column, row) at inverse depth w is in the turned image
    at ``((column, row) + start + slope * w) / (1 - along * w) + origin``.

    Attributes:
        positions: position of each pixel of the turned image in the partner's, (Hv, Wv, 2), array
            indices.
        first: first column of each row whose window is inside the partner's image, (Hv,) float32.
        last: the last one, less than the first if there is none, (Hv,) float32.
        start: see above, pixels.
        slope: see above, pixels x world units.
        along: how far the partner's centre is in front of the reference's, world units.
        origin: see above, pixels.
    """

    positions: Map
    first: Map
    last: Map
    start: tuple[float, float]
    slope: tuple[float, float]
    along: float
    origin: tuple[float, float]

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the turned image in pixels."""
        return self.positions.shape[1], self.positions.shape[0]

    @property
    def motion(self) -> Map:
        """Start, slope, origin and along as the kernel takes them, (7,)."""
        return np.array([*self.start, *self.slope, *self.origin, self.along], np.float32)

    def turn(self, grey: Map) -> Map:
        """Return the partner's grey image on the reference's axes, (Hv, Wv)."""
        return cv2.remap(
            grey, self.positions, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )

    def project(self, inverse_depth: Map) -> "Projection":
        """Project the reference's pixels into the turned image, for inverse depths (H, W)."""
        height, width = inverse_depth.shape
        columns, rows = (
            np.arange(width, dtype=np.float32),
            np.arange(height, dtype=np.float32)[:, None],
        )
        start_x, start_y, slope_x, slope_y, x, y, along = self.motion
        denominator = 1 - along * inverse_depth
        scale = 1 / np.maximum(denominator, np.float32(SMALLEST_DENOMINATOR))
        across, down = (
            (columns + start_x + slope_x * inverse_depth) * scale,
            (rows + start_y + slope_y * inverse_depth) * scale,
        )
        return Projection(
            column=across + x,
            row=down + y,
            inverse_depth=inverse_depth * scale,
            column_slope=(slope_x + along * across) * scale,
            row_slope=(slope_y + along * down) * scale,
            in_front=denominator > SMALLEST_DENOMINATOR,
        )

    def sees(self, places: "Projection") -> Mask:
        """Return whether whole windows around these places are inside the partner's image,
        (H, W).
        """
        nearest = np.clip(np.rint(places.row), 0, self.size[1] - 1).astype(np.intp)
        inside = (places.row >= 0) & (places.row <= self.size[1] - 1) & places.in_front
        return (
            inside & (places.column >= self.first[nearest]) & (places.column <= self.last[nearest])
        )


@dataclass(frozen=True, eq=False)
class Projection:
    """Projection of the reference's pixels into a turned image; (H, W) each.

    Attributes:
        column: array index.
        row: array index.
        inverse_depth: as seen from the partner.
        column_slope: change of the column per unit of the reference's inverse depth.
        in_front: whether the point is before the partner, and not too near to it.
    """

    column: Map
    row: Map
    inverse_depth: Map
    column_slope: Map
    row_slope: Map
    in_front: Mask


def turn_partner(
    camera: Camera, partner: Camera, planes: SweepPlanes, radius: int
) -> PartnerView | None:
    """Prepare one partner of a sweep; None if it sees nothing of any plane.

    Args:
        radius: of the matched window, pixels.
    """
    towards = camera.rotation @ (partner.centre - camera.centre)
    focal, centre = camera.K[[0, 1], [0, 1]], camera.K[:2, 2]
    low, high = _reach(camera, partner, towards, planes)
    if (high - low < 2).any():
        return None
    columns, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    rays = np.stack(
        [
            (columns + 0.5 - centre[0]) / focal[0],
            (rows + 0.5 - centre[1]) / focal[1],
            np.ones(columns.shape),
        ],
        axis=-1,
    )
    turned = rays @ (partner.rotation @ camera.rotation.T).T  # (Hv, Wv, 3), the partner's own axes
    z = np.maximum(turned[..., 2:], MIN_RAY_Z)
    positions = turned[..., :2] / z * partner.K[[0, 1], [0, 1]] + partner.K[:2, 2] - 0.5
    inside = (turned[..., 2] > MIN_RAY_Z) & (
        (positions >= 0) & (positions <= np.array(partner.size) - 1)
    ).all(axis=-1)
    window = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * radius + 3, 2 * radius + 3))
    is_inside = cv2.erode(inside.astype(np.uint8), window, borderValue=0) > 0
    if not is_inside.any():
        return None
    some = is_inside.any(axis=1)
    return PartnerView(
        positions=positions.astype(np.float32),
        first=np.where(some, is_inside.argmax(axis=1), 1).astype(np.float32),
        last=np.where(some, is_inside.shape[1] - 1 - is_inside[:, ::-1].argmax(axis=1), 0).astype(
            np.float32
        ),
        start=_pair(0.5 - centre),
        slope=_pair(-focal * towards[:2]),
        along=float(towards[2]),
        origin=_pair(centre - 0.5 - low),
    )


def _reach(
    camera: Camera, partner: Camera, towards: Array, planes: SweepPlanes
) -> tuple[Array, Array]:
    """Window of the turned image that the planes project into and the partner sees, array indices.

    The upper end is excluded.
    """
    denominators = 1 - towards[2] * planes.inverse_depths()
    in_front = denominators >= SMALLEST_DENOMINATOR
    if not in_front.any():
        return np.zeros(2), np.zeros(2)
    # (P, 1, 1)
    scale, w = 1 / denominators[in_front, None, None], planes.inverse_depths()[in_front, None, None]
    corners = np.array([[0.5, 0.5], [camera.width - 0.5, camera.height - 0.5]]) - camera.K[:2, 2]
    # (P, 2, 2)
    positions = (
        (corners - camera.K[[0, 1], [0, 1]] * towards[:2] * w) * scale + camera.K[:2, 2] - 0.5
    )
    low, high = np.floor(positions.min(axis=(0, 1))) - 2, np.ceil(positions.max(axis=(0, 1))) + 3
    corners = np.array([[u, v] for u in (0, partner.width) for v in (0, partner.height)])
    rays = np.concatenate(
        [(corners - partner.K[:2, 2]) / partner.K[[0, 1], [0, 1]], np.ones((4, 1))], axis=1
    )
    turned = rays @ (camera.rotation @ partner.rotation.T).T
    # else the image reaches to infinity, and the planes alone bound the window
    if turned[:, 2].min() > MIN_RAY_Z:
        image = turned[:, :2] / turned[:, 2:] * camera.K[[0, 1], [0, 1]] + camera.K[:2, 2] - 0.5
        low, high = (
            np.maximum(low, np.floor(image.min(axis=0))),
            np.minimum(high, np.ceil(image.max(axis=0)) + 1),
        )
    return low, high


def _pair(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def find_hidden(view: PartnerView, inverse_depth: Map, tolerance_px: float) -> Mask:
    """Return the pixels that the surface itself hides from a partner, (H, W).

    Args:
        inverse_depth: the surface, (H, W), 1 / world units.
        tolerance_px: what hides a pixel is nearer by a parallax of more than this between reference
            and partner.
    """
    places = view.project(inverse_depth)
    width, height = view.size
    parallax_px = np.hypot(places.column_slope, places.row_slope)
    parallax_px *= inverse_depth / places.inverse_depth  # per unit of the partner's inverse depth
    column, row = np.rint(places.column), np.rint(places.row)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height) & places.in_front
    index = np.where(inside, row * width + column, 0).astype(np.intp)
    nearest: Map = np.zeros(width * height, np.float32)
    np.maximum.at(nearest, index[inside], places.inverse_depth[inside])
    # surfaces spread between pixels
    grown = cv2.dilate(nearest.reshape(height, width), np.ones((3, 3), np.uint8)).ravel()
    return inside & ((grown[index] - places.inverse_depth) * parallax_px > tolerance_px)
