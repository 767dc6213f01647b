"""The registration of a depth sensor, estimated from the images of its sequence."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.pipelines.offline.depth_edges import DepthEdges, edge_response, find_edges, responses_at
from ggvs_eval.pipelines.offline.neighbour_warps import FramePair, choose_pairs, load_pair, warp_errors, warp_psnr_db
from ggvs_eval.pipelines.offline.registration import Registration, pose_after, read_depth, with_registration

Array = NDArray[np.float64]
# Enough frames and edges for a hundredth of a pixel where colour is sharp, in a few seconds.
FRAMES, EDGES_PER_FRAME, WIDTH_PX, FEWEST_EDGES = 16, 1500, 480, 200
SIGMAS_PX = (4.0, 2.0, 1.4)
LARGEST_OFFSET_PX, OFFSET_STEP_PX = 12, 2
# Simplex around the start: pixels, pixels, degrees, frames.
FIRST_STEPS = np.array([1.0, 1.0, 0.4, 0.3])
BLOCKS = 4
# An offset is believed beyond this many pixels and standard errors, and when edges respond better by this much.
LEAST_PX, LEAST_ERRORS, LEAST_GAIN = 0.5, 3.0, 0.01
SCALES = np.linspace(0.88, 1.12, 25)
LEAST_SCALE = 0.004


@dataclass(frozen=True)
class Displacement:
    """How far sensor depth lies off its colour.

    Attributes:
        registration: what would mend it, whether it is believed or not.
        applied: what is believed of that.
        displacement_px: root mean square over the edges, of images `width_px` wide.
        error_px: standard error of that, from blocks of frames.
        response: of colour at the edges of depth, 0..1, as given and mended.
        scale_error: standard error of the scale.
        frame_px: rms of the offsets of single frames about the common one; what no common registration mends.
        psnr_db: of neighbouring frames warped by the depth as given and by `applied`; NaN without pairs.
        n_edges: edges looked at.
        n_frames: frames looked at.
        width_px: width of the images.
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
class _Frame:
    """Edges of one frame, where they go per unit of each parameter, (N, 2, P), and what colour answers at each smoothing."""

    edges: DepthEdges
    motion: Array
    responses: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]


def measure_registration(capture: Capture, chosen: Sequence[int] | None = None) -> Displacement | None:
    """How far the depth of a sequence lies off its colour, and what mends it.

    Args:
        capture: frames of one moving camera before a still scene, each with depth.
        chosen: which of them to look at; 16 evenly spaced ones when None.

    Returns:
        None where there is no depth, or too few edges to tell.

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
    frames = [_frame(small, index) for index in chosen]
    n_edges = sum(len(frame.edges.uv) for frame in frames)
    if n_edges < FEWEST_EDGES or len(frames) < BLOCKS:
        return None
    values, error_px, believed = _estimate_offset(frames)
    before, after = (_response(frames, each, -1) for each in (np.zeros(4), values))
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
    displacement_px = _displacement_px(frames, values)
    return Displacement(
        measured,
        applied,
        displacement_px,
        error_px,
        (before, after),
        scale_error,
        _frame_scatter_px(frames, values),
        psnr_db,
        n_edges,
        len(frames),
        small.cameras[0].width,
    )


def _reduced(capture: Capture) -> Capture:
    width, height = capture.cameras[0].size
    share = WIDTH_PX / width
    return capture if share >= 1 else capture.resized(WIDTH_PX, round(height * share), "area")


def _frame(capture: Capture, index: int) -> _Frame:
    camera, image = capture.cameras[index], capture.frame(capture.cameras[index].name, 0)
    edges = find_edges(read_depth(capture, index)).thinned(EDGES_PER_FRAME)
    u, v = (edges.uv - camera.K[:2, 2]).T
    one, none = np.ones(len(u)), np.zeros(len(u))
    right, down = np.stack([one, none], axis=1), np.stack([none, one], axis=1)
    motion = [right, down, np.radians(np.stack([-v, u], axis=1)), _motion_per_frame(capture.cameras, index, edges)]
    return _Frame(edges, np.stack(motion, axis=2), tuple(edge_response(image, sigma) for sigma in SIGMAS_PX))


def _motion_per_frame(cameras: tuple[Camera, ...], index: int, edges: DepthEdges) -> Array:
    """Where edges that were measured a frame later belong, less where they lie, pixels, (N, 2): half the way between two frames."""
    camera = cameras[index]
    ways = []
    for frames in (-0.5, 0.5):
        later = replace(camera, world_to_camera=pose_after(cameras, index, frames))
        ways.append(camera.project(later.unproject(edges.uv, edges.depth))[0])
    return np.nan_to_num(ways[1] - ways[0])


def _estimate_offset(frames: Sequence[_Frame]) -> tuple[Array, float, bool]:
    """Right and down in pixels, roll in degrees, delay in frames, (4,); standard error in pixels; whether they are believed."""
    start = _coarse(frames)
    three, four = (_refined(frames, start, free) for free in (3, 4))
    gain = _response(frames, four, -1) - _response(frames, three, -1)
    delays = [_refined(block, four, 4, last_only=True)[3] for block in _blocks(frames)]
    moves = four[3] * np.sqrt(np.mean([(frame.motion[..., 3] ** 2).sum(axis=1).mean() for frame in frames if len(frame.motion)]))
    is_late = gain > LEAST_GAIN and abs(moves) > LEAST_PX and abs(four[3]) > LEAST_ERRORS * _standard_error(delays)
    values, free = (four, 4) if is_late else (three, 3)
    blocks = [_refined(block, values, free, last_only=True) for block in _blocks(frames)]
    error_px = float(np.sqrt(np.mean([_displacement_px(frames, block - values) ** 2 for block in blocks]) / (BLOCKS - 1)))
    better = _response(frames, values, -1) - _response(frames, np.zeros(4), -1)
    believed = better > LEAST_GAIN and _displacement_px(frames, values) > max(LEAST_PX, LEAST_ERRORS * error_px)
    return values, error_px, believed


def _coarse(frames: Sequence[_Frame]) -> Array:
    steps = np.arange(-LARGEST_OFFSET_PX, LARGEST_OFFSET_PX + 1, OFFSET_STEP_PX, dtype=np.float64)
    offsets = [np.array([right, down, 0.0, 0.0]) for down in steps for right in steps]
    return max(offsets, key=lambda offset: (_response(frames, offset, 0), -float(np.abs(offset).sum())))


def _refined(frames: Sequence[_Frame], start: Array, free: int, *, last_only: bool = False) -> Array:
    """The best of the first `free` parameters around a start, the others 0, from coarse to fine or at the finest alone."""
    from scipy.optimize import minimize

    values = start[:free]
    for level in [len(SIGMAS_PX) - 1] if last_only else range(len(SIGMAS_PX)):
        simplex = np.vstack([values, values + np.diag(FIRST_STEPS[:free] * SIGMAS_PX[level] / 2)])
        options = {"initial_simplex": simplex, "xatol": 0.005, "fatol": 1e-6, "maxiter": 300}
        worse: Callable[[Array], float] = lambda x, at=level: -_response(frames, np.append(x, np.zeros(4 - free)), at)  # noqa: E731
        values = minimize(worse, values, method="Nelder-Mead", options=options).x
    return np.append(values, np.zeros(4 - free))


def _response(frames: Sequence[_Frame], values: Array, level: int) -> float:
    """Mean response of colour to the edges of depth, moved."""
    total = sum(
        float(responses_at(frame.responses[level], frame.edges, frame.edges.uv + frame.motion @ values).sum(dtype=np.float64))
        for frame in frames
    )
    return total / max(sum(len(frame.edges.uv) for frame in frames), 1)


def _blocks(frames: Sequence[_Frame]) -> list[Sequence[_Frame]]:
    bounds = np.linspace(0, len(frames), BLOCKS + 1).round().astype(int)
    return [frames[first:last] for first, last in zip(bounds[:-1], bounds[1:], strict=True)]


def _standard_error(values: Sequence[float]) -> float:
    return float(np.std(values, ddof=1) / np.sqrt(len(values)))


def _displacement_px(frames: Sequence[_Frame], values: Array) -> float:
    ways = np.concatenate([frame.motion @ values for frame in frames])
    return float(np.sqrt((ways**2).sum(axis=1).mean()))


def _frame_scatter_px(frames: Sequence[_Frame], values: Array) -> float:
    """Median length of the offsets that single frames want beside the common registration."""
    rest = []
    for frame in frames:
        if len(frame.edges.uv) >= FEWEST_EDGES:
            moved = replace(frame.edges, uv=frame.edges.uv + frame.motion @ values)
            own = _refined([_Frame(moved, frame.motion, frame.responses)], np.zeros(4), 2)
            rest.append(float(np.hypot(own[0], own[1])))
    return float(np.median(rest)) if rest else float("nan")


def _registration(values: Array, width_px: int) -> Registration:
    right, down, roll_deg, delay = (float(value) for value in values)
    return Registration(right / width_px, down / width_px, float(np.radians(roll_deg)), delay)


def _estimate_scale(capture: Capture, applied: Registration, pairs: Sequence[FramePair]) -> tuple[float, float]:
    """The scale of depth under which warped neighbours look most alike, and its standard error; 1 and infinity without pairs."""
    if len(pairs) < BLOCKS:
        return 1.0, float("inf")
    registered = with_registration(capture, applied)
    errors = np.array([warp_errors(load_pair(registered, pair), SCALES) for pair in pairs])  # (P, S)
    blocks = [block for block in np.array_split(errors, BLOCKS) if len(block)]
    best = [_least(block.mean(axis=0)) for block in blocks]
    return _least(errors.mean(axis=0)), _standard_error(best)


def _least(errors: Array) -> float:
    """Where a curve over the scales is lowest, between them by a parabola."""
    at = int(np.clip(errors.argmin(), 1, len(SCALES) - 2))
    before, here, after = errors[at - 1 : at + 2]
    bend = before - 2 * here + after
    shift = 0.5 * (before - after) / bend if bend > 0 else 0.0
    return float(SCALES[at] + np.clip(shift, -1, 1) * (SCALES[1] - SCALES[0]))
