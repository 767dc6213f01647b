"""Whether sensor depth lies where its colour does: how far the edges of both are apart.

Where a near surface ends before a far one, colour has an edge too. The offset and the roll, which all
frames share, are those under which the edges of depth meet most gradient of colour across them, from
coarse to fine.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8, Map, Vector
from ggvs_eval.capture import Capture
from ggvs_eval.errors import GgvsError
from ggvs_eval.finding import RIG, Finding, graded

REGISTRATION_QUESTION = "depth registration"
SEQUENCE_LAYOUT = "rgbd"  # frames of one camera and one sensor; of a rig every camera has its own
# Of images 480 pixels wide: a pixel next to an edge mixes in the other surface's colour; three show
# at arm's length.
WARN_PX, BAD_PX = 1.0, 3.0
# Enough frames and edges for a hundredth of a pixel where colour is sharp, in a few seconds.
FRAMES, EDGES_PER_FRAME, WIDTH_PX, FEWEST_EDGES = 16, 500, 480, 150
# The background is farther by this share, the foreground's own depth differs by less within N
# pixels of its edge.
STEP, SMOOTH, INSIDE_PX = 0.06, 0.03, 3
# Sensors lose the pixels between two surfaces: holes up to this share of the width are looked across.
HOLE = 0.025
# Half of the largest response is a gradient of twice the image's median, and half a level of 255 if
# there is none: strong edges do not outvote the others.
GRADIENT_FACTOR, LEAST_GRADIENT = 2.0, 0.5
SIGMAS_PX = (4.0, 2.0, 1.4)
LARGEST_OFFSET_PX, OFFSET_STEP_PX = 12, 2
FIRST_STEPS = np.array([1.0, 1.0, 0.4])  # simplex around the start: pixels, pixels, degrees
# Single frames off what all share, by poses, motion blur or the sensor's delay: sound ones are by a tenth
# or two, those of a room filmed by hand whose depth is a frame late by 1.8.
WARN_FRAME_PX = 1.5
FEWEST_FRAMES = 4
# A displacement is believed beyond this many pixels and standard errors of the frames' mean, and where
# edges respond better by this much.
LEAST_PX, LEAST_ERRORS, LEAST_GAIN = 0.5, 3.0, 0.01


def check_depth_registration(capture: Capture) -> tuple[Finding, ...]:
    """Measure how far sensor depth is off its colour; no finding for captures without sensor depth."""
    if not capture.sensed_cameras:
        return ()
    if capture.layout != SEQUENCE_LAYOUT:
        return (_unknown("several cameras with a sensor each: only sequences of one are measured"),)
    try:
        frames = _edges_of_frames(capture)
    except GgvsError as error:
        return (_unknown(f"frames cannot be read: {error}"),)
    if len(frames) < FEWEST_FRAMES or sum(len(frame.uv) for frame in frames) < FEWEST_EDGES:
        return (_unknown("too few edges of depth to compare with colour"),)
    return (_finding(frames, capture.cameras[0].width),)


@dataclass(frozen=True, eq=False)
class FrameEdges:
    """Edges of one frame's depth, and how much like an edge every pixel of its colour looks.

    Attributes:
        uv: on the border of the last pixel of the near surface, pixels, (N, 2).
        upright: whether the edge runs up and down, (N,).
        responses: at each smoothing, of colour to upright and to level edges, (H, W) each in [0, 1).
    """

    uv: Array
    upright: NDArray[np.bool_]
    responses: tuple[tuple[Map, Map], ...]

    def motion(self, registration: Vector) -> Array:
        """Return where edges go that are moved right and down (pixels) and turned (degrees), (N, 2)."""
        height, width = self.responses[0][0].shape
        from_middle = self.uv - np.array([width, height]) / 2
        return registration[:2] + np.radians(registration[2]) * from_middle[:, ::-1] * [-1, 1]

    def response(self, registration: Vector, level: int) -> Map:
        """Return the response of colour to the edges, moved, (N,).

        Cubic interpolation: a linear one is blunt between pixels and draws edges to their centres.
        """
        at = (self.uv + self.motion(registration) - 0.5).astype(np.float32)[:, None]
        upright, level_edges = (
            cv2.remap(values, at, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)[:, 0] for values in self.responses[level]
        )
        return np.where(self.upright, upright, level_edges)


def _edges_of_frames(capture: Capture) -> list[FrameEdges]:
    """Return the edges of some frames of a sequence, evenly chosen, those without edges left out."""
    width, height = capture.cameras[0].size
    if width > WIDTH_PX:
        capture = capture.resized(WIDTH_PX, round(height * WIDTH_PX / width), "area")
    sensed = [name for name in capture.camera_names if name in capture.sensed_cameras]
    frames = []
    for index in _evenly(len(sensed), FRAMES):
        image = capture.frame(sensed[index], 0)
        uv, upright = depth_edges(_depth_at_size(capture, sensed[index]))
        places = _evenly(len(uv), EDGES_PER_FRAME)
        responses = tuple(edge_response(image, sigma_px) for sigma_px in SIGMAS_PX)
        if len(places):
            frames.append(FrameEdges(uv[places], upright[places], responses))
    return frames


def _evenly(count: int, most: int) -> NDArray[np.intp]:
    """Return `most` whole numbers below a count, or all of them, evenly spaced."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.intp)


def _depth_at_size(capture: Capture, name: str) -> Map:
    """Return the depth of a frame at the size of its camera, the nearest value of each pixel, (H, W)."""
    source = capture.extras_of(name).depth
    assert source is not None
    depth = next(iter(source.depths(0, 1)))
    width, height = capture.camera(name).size
    rows = ((np.arange(height) + 0.5) * depth.shape[0] / height).astype(np.intp)
    columns = ((np.arange(width) + 0.5) * depth.shape[1] / width).astype(np.intp)
    return depth[np.ix_(rows, columns)]


def depth_edges(depth: Map) -> tuple[Array, NDArray[np.bool_]]:
    """Return places where a near surface ends before a far one, and whether the edge is upright.

    Args:
        depth: (H, W), 0 = unknown.

    Returns:
        Pixels, (N, 2), and a mask, (N,).
    """
    hole_px = round(HOLE * depth.shape[1])
    places, upright = [], []
    for is_upright in (True, False):
        lines = depth if is_upright else depth.T
        width = lines.shape[1]
        for is_mirrored in (False, True):
            row, border = _edges_to_the_right(lines[:, ::-1] if is_mirrored else lines, hole_px)
            along = width - border if is_mirrored else border
            places.append(np.stack((along, row) if is_upright else (row, along), axis=1))
            upright.append(np.full(len(row), is_upright))
    return np.concatenate(places), np.concatenate(upright)


def _edges_to_the_right(lines: Map, hole_px: int) -> tuple[Array, Array]:
    """Return row and border of surfaces that have a farther one to their right, (N,) each."""
    width = lines.shape[1]
    columns = np.broadcast_to(np.arange(width), lines.shape)
    following = np.full(lines.shape, width)  # column of the next known pixel
    known_columns = np.where(lines > 0, columns, width)
    following[:, :-1] = np.minimum.accumulate(known_columns[:, :0:-1], axis=1)[:, ::-1]
    is_near = (lines > 0) & (following < width) & (following - columns <= hole_px + 1)
    row, near = np.nonzero(is_near & (columns >= INSIDE_PX))
    far = following[row, near]
    depth, behind = lines[row, near], lines[row, np.minimum(far + INSIDE_PX, width - 1)]
    is_step = np.minimum(lines[row, far], behind) > (1 + STEP) * depth
    is_smooth = np.abs(lines[row, near - INSIDE_PX] - depth) < SMOOTH * depth
    is_edge = is_step & is_smooth
    return row[is_edge] + 0.5, near[is_edge] + 1.0


def edge_response(image: Image8, sigma_px: float) -> tuple[Map, Map]:
    """Measure how much like an edge every pixel looks, upright and level, (H, W) each in [0, 1).

    Args:
        image: RGB, (H, W, 3).
        sigma_px: of the smoothing before the gradient of the three Lab channels is taken.
    """
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB).astype(np.float32)
    smooth = cv2.GaussianBlur(lab, (0, 0), sigma_px)
    across, down = (np.sqrt((cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3) ** 2).sum(axis=-1)) / 8 for order in ((1, 0), (0, 1)))
    half = GRADIENT_FACTOR * float(np.median([across, down])) + LEAST_GRADIENT
    return across / (across + half), down / (down + half)


def _response(frames: Sequence[FrameEdges], registration: Vector, level: int) -> float:
    responses = np.concatenate([frame.response(registration, level) for frame in frames])
    return float(responses.mean(dtype=np.float64))


def _displacement_px(frames: Sequence[FrameEdges], registration: Vector) -> float:
    """Return the root mean square of how far the edges move."""
    motion = np.concatenate([frame.motion(registration) for frame in frames])
    return float(np.sqrt((motion**2).sum(axis=1).mean()))


def _coarse(frames: Sequence[FrameEdges]) -> Vector:
    steps = np.arange(-LARGEST_OFFSET_PX, LARGEST_OFFSET_PX + 1, OFFSET_STEP_PX, dtype=np.float64)
    offsets = [np.array([right, down, 0.0]) for down in steps for right in steps]
    offsets.sort(key=lambda offset: float(np.abs(offset).sum()))  # of equal ones the least
    return max(offsets, key=lambda offset: _response(frames, offset, 0))


def _lack(frames: Sequence[FrameEdges], level: int, registration: Vector) -> float:
    return -_response(frames, registration, level)


def _refined(frames: Sequence[FrameEdges], start: Vector) -> Vector:
    """Return the best registration near a start, from coarse to fine."""
    from scipy.optimize import minimize

    best = start
    for level, sigma_px in enumerate(SIGMAS_PX):
        simplex = np.vstack([best, best + np.diag(FIRST_STEPS * sigma_px / 2)])
        options = {"initial_simplex": simplex, "xatol": 0.01, "fatol": 1e-5, "maxiter": 150}
        cost = partial(_lack, frames, level)
        best = minimize(cost, best, method="Nelder-Mead", options=options).x
    return best


def _finding(frames: Sequence[FrameEdges], width_px: int) -> Finding:
    """Return what is found on the edges of a sequence whose frames are so wide."""
    finest = len(SIGMAS_PX) - 1
    registration = _refined(frames, _coarse(frames))
    scatter_px = []
    for frame in frames:
        alone = _refined([frame], registration)
        scatter_px.append(_displacement_px(frames, alone - registration))
    frame_px = float(np.median(scatter_px))
    error_px = float(np.sqrt(np.square(scatter_px).mean() / (len(frames) - 1)))
    displacement_px = _displacement_px(frames, registration)
    gain = _response(frames, registration, finest) - _response(frames, np.zeros(3), finest)
    is_off = gain > LEAST_GAIN and displacement_px > max(LEAST_PX, LEAST_ERRORS * error_px)
    enlarged = max(width_px / WIDTH_PX, 1)
    right_px, down_px, roll_deg = (registration * [enlarged, enlarged, 1]).tolist()
    values: dict[str, Any] = {
        "displacement_px": round(displacement_px * enlarged, 3),
        "error_px": round(error_px * enlarged, 3),
        "frame_px": round(frame_px * enlarged, 3),
        "right_px": round(right_px, 3),
        "down_px": round(down_px, 3),
        "roll_deg": round(roll_deg, 4),
        "n_frames": len(frames),
        "n_edges": sum(len(frame.uv) for frame in frames),
    }
    measured = (
        f"depth edges {values['displacement_px']:.2f} +- {values['error_px']:.2f} px off colour, "
        f"single frames {values['frame_px']:.1f} px"
    )
    verdict, advice = graded(displacement_px if is_off else 0.0, WARN_PX, BAD_PX), ""
    if verdict != "ok":
        advice = (
            "register the depth maps to the colour camera: "
            f"{right_px:+.2f} px right, {down_px:+.2f} px down, roll {roll_deg:+.2f} deg"
        )
    elif frame_px > WARN_FRAME_PX:
        verdict = "warn"
        advice = "no common registration corrects it: poses, motion blur or the sensor's delay differ from frame to frame"
    return Finding(RIG, REGISTRATION_QUESTION, verdict, measured, values, advice)


def _unknown(reason: str) -> Finding:
    return Finding(RIG, REGISTRATION_QUESTION, "unknown", reason)
