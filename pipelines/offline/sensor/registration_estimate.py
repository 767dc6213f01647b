"""The registration of a depth sensor, estimated from the images of its sequence: how well neighbouring frames fit each other."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array, Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.geometry.warp import warp
from ggvs_eval.pipelines.offline.sensor.registration import Registration, pose_after, read_depth, with_registration

# Baselines of this share of the depth turn a percent of scale into half a pixel, and still see the same surfaces.
BASELINE, LARGEST_BASELINE, LEAST_BASELINE, LEAST_COSINE = 0.08, 0.2, 0.02, 0.85
TOLERANCE = 0.03  # of the depth: two frames see the same surface
DETAIL_SIGMA_PX, LARGEST_ERROR = 6.0, 0.15
LEAST_SEEN = 0.05


@dataclass(frozen=True)
class FramePair:
    """Two frames of a sequence, by their index."""

    target: int
    source: int


def choose_pairs(capture: Capture, chosen: Sequence[int]) -> list[FramePair]:
    """For each chosen frame the later one whose baseline suits best; frames without one are left out."""
    pairs = []
    for index in chosen:
        camera = capture.cameras[index]
        depth = np.sqrt(camera.near * camera.far)
        shares = [float(np.linalg.norm(other.centre - camera.centre)) / depth for other in capture.cameras[index + 1 :]]
        facing = [float(other.axis @ camera.axis) > LEAST_COSINE for other in capture.cameras[index + 1 :]]
        fit = [(abs(share - BASELINE), place) for place, share in enumerate(shares)
               if facing[place] and LEAST_BASELINE < share < LARGEST_BASELINE]  # fmt: skip
        if fit:
            pairs.append(FramePair(index, index + 1 + min(fit)[1]))
    return pairs


@dataclass(frozen=True, eq=False)
class View:
    """One frame of a sequence.

    Attributes:
        image: RGB in [0, 1], (H, W, 3) float32.
        detail: the image less its blur; exposures of frames differ, their detail does not.
        depth: z, world units, 0 = unknown, (H, W).
    """

    camera: Camera
    image: Map
    detail: Map
    depth: Map


def load_pair(capture: Capture, pair: FramePair) -> tuple[View, View]:
    """Return the target and source of a pair."""
    target, source = (_view(capture, index) for index in (pair.target, pair.source))
    return target, source


def warp_errors(pair: tuple[View, View], scales: NDArray[np.float64]) -> list[float]:
    """Mean absolute difference of detail between a frame and its neighbour warped onto it, at each scale of both depths.

    Large differences count as 0.15 of the value range, and so do pairs of which too little is seen.
    """
    target, source = pair
    errors = []
    for scale in scales:
        colour, visibility = _warped(target, source, source.detail, float(scale))
        error = np.minimum(np.abs(colour - target.detail), LARGEST_ERROR)[visibility]
        errors.append(float(error.mean()) if visibility.mean() > LEAST_SEEN else LARGEST_ERROR)
    return errors


def warp_psnr_db(capture: Capture, pairs: Sequence[FramePair]) -> float:
    """Return the mean PSNR of frames against their warped neighbours where both see the surface; NaN without pairs."""
    values = []
    for target, source in (load_pair(capture, pair) for pair in pairs):
        colour, visibility = _warped(target, source, source.image, 1.0)
        if visibility.mean() > LEAST_SEEN:
            values.append(-10 * np.log10(max(float(((colour - target.image)[visibility] ** 2).mean()), 1e-10)))
    return float(np.mean(values)) if values else float("nan")


def _warped(target: View, source: View, image: Map, scale: float) -> tuple[Map, NDArray[np.bool_]]:
    """Return the source's image as the target sees it, (H, W, 3), and where both see the same surface, (H, W)."""
    factor = np.float32(scale)
    depths = target.depth[target.depth > 0]
    tolerance = TOLERANCE * float(np.median(depths)) if depths.size else 1.0
    warped = warp(target.camera, target.depth * factor, source.camera, image, source.depth * factor, tolerance)
    return warped.colour, warped.visibility > 0.5


def _view(capture: Capture, index: int) -> View:
    camera = capture.cameras[index]
    image = capture.frame(camera.name, 0).astype(np.float32) / np.float32(255)
    detail = image - cv2.GaussianBlur(image, (0, 0), DETAIL_SIGMA_PX)
    return View(camera, image, np.asarray(detail, np.float32), read_depth(capture, index))


# The background is farther by this share, the foreground's own depth differs by less within N pixels of its edge.
STEP, SMOOTH, INSIDE_PX = 0.06, 0.03, 3
# Sensors lose the pixels between two surfaces: holes up to this share of the image's width are looked across.
HOLE = 0.025
# Half of the largest response is a gradient of twice the image's median, and half a level of 255 if there is none.
GRADIENT_FACTOR, LEAST_GRADIENT = 2.0, 0.5


@dataclass(frozen=True, eq=False)
class DepthEdges:
    """Places where a near surface ends before a far one.

    Attributes:
        uv: on the border of the last pixel of the near surface, pixels, (N, 2).
        upright: whether the edge runs up and down, the far surface left or right of it; else it is below or above, (N,).
        depth: of the near surface, (N,).
    """

    uv: Array
    upright: NDArray[np.bool_]
    depth: Array

    def thinned(self, most: int) -> "DepthEdges":
        """At most N of them, evenly chosen."""
        if len(self.uv) <= most:
            return self
        chosen = np.linspace(0, len(self.uv) - 1, most).round().astype(np.intp)
        return DepthEdges(self.uv[chosen], self.upright[chosen], self.depth[chosen])


def find_edges(depth: Map) -> DepthEdges:
    """Return the edges along the rows and the columns of a depth map, (H, W), 0 = unknown."""
    hole_px = round(HOLE * depth.shape[1])
    edges = []
    for upright in (True, False):
        lines = depth if upright else depth.T
        for mirrored in (False, True):
            row, place, z = _edges_to_the_right(lines[:, ::-1] if mirrored else lines, hole_px)
            place = lines.shape[1] - place if mirrored else place
            uv = np.stack((place, row) if upright else (row, place), axis=1)
            edges.append(DepthEdges(uv, np.full(len(z), upright), z))
    return DepthEdges(*(np.concatenate([getattr(part, name) for part in edges]) for name in ("uv", "upright", "depth")))


def _edges_to_the_right(lines: Map, hole_px: int) -> tuple[Array, Array, Array]:
    """Return the row, column of the border and depth of surfaces that have a farther one to their right, (N,) each."""
    width = lines.shape[1]
    columns = np.broadcast_to(np.arange(width), lines.shape)
    following = np.full(lines.shape, width)  # column of the next known pixel
    following[:, :-1] = np.minimum.accumulate(np.where(lines > 0, columns, width)[:, :0:-1], axis=1)[:, ::-1]
    row, near = np.nonzero((lines > 0) & (following < width) & (following - columns <= hole_px + 1) & (columns >= INSIDE_PX))
    far = following[row, near]
    z, behind = lines[row, near], lines[row, np.minimum(far + INSIDE_PX, width - 1)]
    is_edge = (np.minimum(lines[row, far], behind) > (1 + STEP) * z) & (np.abs(lines[row, near - INSIDE_PX] - z) < SMOOTH * z)
    return row[is_edge] + 0.5, near[is_edge] + 1.0, z[is_edge].astype(np.float64)


def edge_response(image: Image8, sigma_px: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Measure how much like an edge every pixel looks, in [0, 1): vertical edges and horizontal ones, (H, W) each.

    Args:
        image: RGB, (H, W, 3).
        sigma_px: of the smoothing before the gradient of the three Lab channels is taken.
    """
    lab = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2LAB).astype(np.float32), (0, 0), sigma_px)
    across, down = (np.sqrt((cv2.Sobel(lab, cv2.CV_32F, *order, ksize=3) ** 2).sum(axis=-1)) / 8 for order in ((1, 0), (0, 1)))
    half = GRADIENT_FACTOR * float(np.median([across, down])) + LEAST_GRADIENT
    return across / (across + half), down / (down + half)


def responses_at(
    response: tuple[NDArray[np.float32], NDArray[np.float32]], upright: NDArray[np.bool_], uv: Array
) -> NDArray[np.float32]:
    """Return the response of colour to vertical and horizontal edges at uv, (N,).

    Cubic interpolation: a linear one is blunt between pixels, which would draw edges to pixels' centres.
    """
    result = np.empty(len(uv), np.float32)
    for is_upright, values in zip((True, False), response, strict=True):
        chosen = upright == is_upright
        x, y = ((uv[chosen, axis] - 0.5).astype(np.float32)[:, None] for axis in (0, 1))
        if len(x):
            result[chosen] = cv2.remap(values, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT).ravel()
    return result


# Enough frames and edges for a hundredth of a pixel where colour is sharp, in a few seconds.
FRAMES, EDGES_PER_FRAME, WIDTH_PX, FEWEST_EDGES = 16, 500, 480, 150
SIGMAS_PX = (4.0, 2.0, 1.4)
LARGEST_OFFSET_PX, OFFSET_STEP_PX = 12, 2
# Simplex around the start: pixels, pixels, degrees, frames.
FIRST_STEPS = np.array([1.0, 1.0, 0.4, 0.3])
BLOCKS = 4
# An offset is believed beyond this many pixels and standard errors, and when edges respond better by this much.
LEAST_PX, LEAST_ERRORS, LEAST_GAIN = 0.5, 3.0, 0.01
# The scale is looked for within this much of 1, then within this much of the best; and believed from this much on.
LARGEST_SCALE, FINE_SCALE, LEAST_SCALE = 0.12, 0.02, 0.004
STEPS = np.linspace(-1, 1, 9)


@dataclass(frozen=True)
class Displacement:
    """Displacement of sensor depth from its colour.

    Attributes:
        registration: correction, significant or not.
        applied: what is believed of that.
        displacement_px: root mean square over the edges, of images `width_px` wide.
        error_px: standard error of that, from blocks of frames.
        response: of colour at the edges of depth, 0..1, as given and corrected.
        scale_error: standard error of the scale.
        frame_px: rms of the offsets of single frames about the common one; which no common registration corrects.
        psnr_db: of neighbouring frames warped by the depth as given and by `applied`; NaN without pairs.
    """

    registration: Registration
    applied: Registration
    displacement_px: float
    error_px: float
    response: tuple[float, float]
    scale_error: float
    frame_px: float
    psnr_db: tuple[float, float]
    n_edges: int
    n_frames: int
    width_px: int


@dataclass(frozen=True, eq=False)
class _Edges:
    """Edges of all frames and what colour answers to them.

    Attributes:
        uv: of the edges in their frames, pixels, (N, 2).
        upright: whether they run up and down, (N,).
        frame: number of the frame of each, (N,).
        motion: where each goes per unit of the parameters, (N, 2, 4).
        responses: at each smoothing, of vertical and horizontal edges, frames one below the other, (F H, W) each.
        height: of a frame, pixels.
    """

    uv: Array
    upright: NDArray[np.bool_]
    frame: NDArray[np.intp]
    motion: Array
    responses: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    height: int

    def of(self, frames: Sequence[int]) -> "_Edges":
        """Return the edges of some frames."""
        chosen = np.isin(self.frame, frames)
        uv, upright, frame, motion = self.uv[chosen], self.upright[chosen], self.frame[chosen], self.motion[chosen]
        return replace(self, uv=uv, upright=upright, frame=frame, motion=motion)

    def response(self, values: Array, level: int) -> float:
        """Return the mean response of colour to the edges, moved; 0 outside the images."""
        maps = self.responses[level]
        uv = self.uv + self.motion[..., : len(values)] @ values
        inside = (uv >= 0).all(axis=1) & (uv <= (maps[0].shape[1], self.height)).all(axis=1)
        responses = responses_at(maps, self.upright, uv + self.frame[:, None] * np.array([0.0, self.height]))
        return float(np.where(inside, responses, 0).mean(dtype=np.float64)) if len(responses) else 0.0

    def displacement_px(self, values: Array) -> float:
        """Return the root mean square of how far the edges move."""
        return float(np.sqrt(((self.motion @ values) ** 2).sum(axis=1).mean()))


def measure_registration(capture: Capture, chosen: Sequence[int] | None = None) -> Displacement | None:
    """Measure the misregistration of depth and colour of a sequence, and its correction.

    Args:
        capture: frames of one moving camera before a still scene, each with depth.
        chosen: which of them to look at; 16 evenly spaced ones when None.

    Returns:
        None if there is no depth, or too few edges.

    Reading:
        Where a near surface ends before a far one, colour has an edge too. The offset, roll and delay are those under which the
        edges of depth meet most colour gradient across them (saturated, so that strong edges do not outvote the others), from
        coarse to fine. The scale is that under which neighbouring frames, warped by the depth, look most alike. Each is believed
        only if it is more than three standard errors of four blocks of frames; none that makes warped frames less alike.
        All frames are looked at, test views too, as calibration does: five numbers of the sensor, none of the picture.
    """
    small = _reduced(capture)
    names = [camera.name for camera in small.cameras if small.extras_of(camera.name).depth is not None]
    indices = [small.camera_names.index(name) for name in names]
    if chosen is None:
        chosen = (
            [indices[at] for at in np.unique(np.linspace(0, len(indices) - 1, FRAMES).round().astype(int))] if indices else []
        )
    if len(chosen) < BLOCKS:
        return None
    edges = _gather(small, chosen)
    if len(edges.uv) < FEWEST_EDGES:
        return None
    values, error_px, believed = _estimate_offset(edges, len(chosen))
    before, after = (edges.response(each, -1) for each in (np.zeros(4), values))
    moved = _registration(values, small.cameras[0].width)
    applied = _registration(values if believed else np.zeros(4), small.cameras[0].width)
    pairs = choose_pairs(small, chosen)
    scale, scale_error = _estimate_scale(small, applied, pairs)
    measured = replace(moved, scale=scale)
    if abs(scale - 1) > max(LEAST_SCALE, LEAST_ERRORS * scale_error):
        applied = replace(applied, scale=scale)
    psnr_db = warp_psnr_db(small, pairs), warp_psnr_db(with_registration(small, applied), pairs)
    if psnr_db[1] < psnr_db[0]:
        applied, psnr_db = Registration(), (psnr_db[0], psnr_db[0])
    return Displacement(
        measured,
        applied,
        edges.displacement_px(values),
        error_px,
        (before, after),
        scale_error,
        _frame_scatter_px(edges, values, len(chosen)),
        psnr_db,
        len(edges.uv),
        len(chosen),
        small.cameras[0].width,
    )


def _reduced(capture: Capture) -> Capture:
    width, height = capture.cameras[0].size
    share = WIDTH_PX / width
    return capture if share >= 1 else capture.resized(WIDTH_PX, round(height * share), "area")


def _gather(capture: Capture, chosen: Sequence[int]) -> _Edges:
    """Return the edges of the chosen frames and the responses of their images."""
    edge_sets, responses = [], []
    for index in chosen:
        camera = capture.cameras[index]
        edges = find_edges(read_depth(capture, index)).thinned(EDGES_PER_FRAME)
        image = capture.frame(camera.name, 0)
        responses.append([edge_response(image, sigma) for sigma in SIGMAS_PX])
        u, v = (edges.uv - camera.K[:2, 2]).T
        one, none = np.ones(len(u)), np.zeros(len(u))
        columns = [np.stack(pair, axis=1) for pair in ((one, none), (none, one), (-np.radians(v), np.radians(u)))]
        edge_sets.append((edges, np.stack([*columns, _motion_per_frame(capture.cameras, index, edges)], axis=2)))
    stacked = tuple(
        (np.concatenate([frame[level][0] for frame in responses]), np.concatenate([frame[level][1] for frame in responses]))
        for level in range(len(SIGMAS_PX))
    )
    frame = np.concatenate([np.full(len(edges.uv), number) for number, (edges, _) in enumerate(edge_sets)])
    uv, upright = (np.concatenate([getattr(edges, name) for edges, _ in edge_sets]) for name in ("uv", "upright"))
    return _Edges(uv, upright, frame, np.concatenate([motion for _, motion in edge_sets]), stacked, capture.cameras[0].height)


def _motion_per_frame(cameras: tuple[Camera, ...], index: int, edges: DepthEdges) -> Array:
    """Return the displacement of edges that were measured a frame later to their place, pixels, (N, 2)."""
    camera = cameras[index]
    ways = []
    for frames in (-0.5, 0.5):
        later = replace(camera, world_to_camera=pose_after(cameras, index, frames))
        ways.append(camera.project(later.unproject(edges.uv, edges.depth))[0])
    return np.nan_to_num(ways[1] - ways[0])


def _estimate_offset(edges: _Edges, n_frames: int) -> tuple[Array, float, bool]:
    """Right and down in pixels, roll in degrees, delay in frames, (4,); standard error in pixels; whether they are believed."""
    blocks = [edges.of(numbers.tolist()) for numbers in np.array_split(np.arange(n_frames), BLOCKS)]
    start = _coarse(edges)
    three, four = (_refined(edges, start, free) for free in (3, 4))
    late_px = edges.displacement_px(np.array([0, 0, 0, four[3]]))
    delays = [_refined(block, four, 4, last_only=True)[3] for block in blocks if len(block.uv)]
    gain = edges.response(four, -1) - edges.response(three, -1)
    is_late = gain > LEAST_GAIN and late_px > LEAST_PX and abs(four[3]) > LEAST_ERRORS * _standard_error(delays)
    values, free = (four, 4) if is_late else (three, 3)
    alone = [_refined(block, values, free, last_only=True) for block in blocks if len(block.uv)]
    error_px = float(np.sqrt(np.mean([edges.displacement_px(each - values) ** 2 for each in alone]) / max(len(alone) - 1, 1)))
    better = edges.response(values, -1) - edges.response(np.zeros(4), -1)
    believed = better > LEAST_GAIN and edges.displacement_px(values) > max(LEAST_PX, LEAST_ERRORS * error_px)
    return values, error_px, believed


def _coarse(edges: _Edges) -> Array:
    steps = np.arange(-LARGEST_OFFSET_PX, LARGEST_OFFSET_PX + 1, OFFSET_STEP_PX, dtype=np.float64)
    offsets = [np.array([right, down, 0.0, 0.0]) for down in steps for right in steps]
    return max(offsets, key=lambda offset: (edges.response(offset, 0), -float(np.abs(offset).sum())))


def _refined(edges: _Edges, start: Array, free: int, *, last_only: bool = False) -> Array:
    """Return the best of the first `free` parameters around a start, the others 0, from coarse to fine or at the finest alone."""
    from scipy.optimize import minimize

    values = start[:free]
    for level in [len(SIGMAS_PX) - 1] if last_only else range(len(SIGMAS_PX)):
        simplex = np.vstack([values, values + np.diag(FIRST_STEPS[:free] * SIGMAS_PX[level] / 2)])
        options = {"initial_simplex": simplex, "xatol": 0.01, "fatol": 1e-5, "maxiter": 150}
        values = minimize(partial(_lack, edges, level), values, method="Nelder-Mead", options=options).x
    return np.append(values, np.zeros(4 - free))


def _lack(edges: _Edges, level: int, values: Array) -> float:
    return -edges.response(values, level)


def _standard_error(values: Sequence[float]) -> float:
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("inf")


def _frame_scatter_px(edges: _Edges, values: Array, n_frames: int) -> float:
    """Return the median length of the offsets of single frames in addition to the common registration."""
    moved = replace(edges, uv=edges.uv + edges.motion @ values)
    singles = [single for single in (moved.of([number]) for number in range(n_frames)) if len(single.uv) >= FEWEST_EDGES]
    rest = [float(np.hypot(*_refined(single, np.zeros(4), 2)[:2])) for single in singles]
    return float(np.median(rest)) if rest else float("nan")


def _registration(values: Array, width_px: int) -> Registration:
    right, down, roll_deg, delay = (float(value) for value in values)
    return Registration(right / width_px, down / width_px, float(np.radians(roll_deg)), delay)


def _estimate_scale(capture: Capture, applied: Registration, pairs: Sequence[FramePair]) -> tuple[float, float]:
    """The scale of depth under which warped neighbours look most alike, and its standard error; 1 and infinity without pairs."""
    if len(pairs) < BLOCKS:
        return 1.0, float("inf")
    registered = with_registration(capture, applied)
    views = [load_pair(registered, pair) for pair in pairs]
    best = 1.0
    for width in (LARGEST_SCALE, FINE_SCALE):  # coarse, then around the best
        scales = best + width * STEPS
        errors = np.array([warp_errors(view, scales) for view in views])  # (P, S)
        best = _least(scales, errors.mean(axis=0))
    blocks = [_least(scales, block.mean(axis=0)) for block in np.array_split(errors, BLOCKS)]
    return best, _standard_error(blocks)


def _least(scales: Array, errors: Array) -> float:
    """Locate the minimum of a curve over the scales, between them by a parabola."""
    at = int(np.clip(errors.argmin(), 1, len(scales) - 2))
    before, here, after = errors[at - 1 : at + 2]
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend if bend > 0 else 0.0
    return float(scales[at] + np.clip(shift, -1, 1) * (scales[1] - scales[0]))
