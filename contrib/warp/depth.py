"""Finish and cross-check of found depth, a kernel for each thought.

`device_maps` of the package is the same in torch.

Maps are stacks (K, H, W), 0 where depth is unknown. Points that meet in a pixel are decided by the
smallest depth, whose bits sort as the numbers do: whichever comes first, the outcome is the same.
"""

import torch
import warp as wp
from torch import Tensor

from ggvs_eval.contrib.warp.launch import MODULE_OPTIONS, launch, on_current_stream
from ggvs_eval.contrib.warp.registration import is_inside
from ggvs_eval.pipelines.offline.depth import consistency
from ggvs_eval.pipelines.offline.depth.camera_depth import (
    FILLED_CONFIDENCE,
    FLYING,
    SMOOTH,
    SMOOTH_RADIUS_PX,
    DepthOptions,
)

wp.set_module_options({**MODULE_OPTIONS, "fuse_fp": True})

# of the nine pixels around one, itself included, that make it no flying one
FEWEST_NEAR = wp.constant(4)
_LEAST_SLOPE, _UNCHECKED = (
    wp.constant(wp.float32(consistency.LEAST_SLOPE)),
    wp.constant(wp.float32(consistency.UNCHECKED)),
)
_NOWHERE = wp.constant(0x7F800000)  # bits of infinity
NOWHERE = 0x7F800000


@wp.kernel
def keep_surfaces(depth: wp.array3d[wp.float32], share: wp.float32, out: wp.array3d[wp.float32]):
    """See `fusion.drop_flying_pixels`."""
    k, y, x = wp.tid()
    centre = depth[k, y, x]
    near = wp.int32(0)
    for v in range(wp.max(y - 1, 0), wp.min(y + 2, depth.shape[1])):
        for u in range(wp.max(x - 1, 0), wp.min(x + 2, depth.shape[2])):
            if wp.abs(depth[k, v, u] - centre) < share * centre:
                near += 1
    out[k, y, x] = wp.where(near >= FEWEST_NEAR, centre, 0.0)


@wp.func
def mirrored(at: wp.int32, size: wp.int32) -> wp.int32:
    """Return the row or column that a border by reflection shows."""
    n = at
    if n < 0:
        n = -n
    if n >= size:
        n = 2 * size - 2 - n
    return n


@wp.kernel
def smooth(
    depth: wp.array3d[wp.float32], share: wp.float32, radius: wp.int32, out: wp.array3d[wp.float32]
):
    """See `fusion.smooth_surfaces`."""
    k, y, x = wp.tid()
    value = wp.float32(0.0)
    if depth[k, y, x] > 0.0:
        centre = wp.log(wp.max(depth[k, y, x], 1e-6))
        reach = 0.75 * wp.float32(radius)
        total = wp.float32(0.0)
        weights = wp.float32(0.0)
        for row in range(-radius, radius + 1):
            for column in range(-radius, radius + 1):
                square = row * row + column * column
                if square <= radius * radius:
                    neighbour = depth[
                        k, mirrored(y + row, depth.shape[1]), mirrored(x + column, depth.shape[2])
                    ]
                    off = wp.log(wp.max(neighbour, 1e-6)) - centre
                    weight = wp.exp(
                        -0.5 * off * off / (share * share)
                        - wp.float32(square) / (2.0 * reach * reach)
                    )
                    total += weight * off
                    weights += weight
        value = wp.exp(centre + total / weights)
    out[k, y, x] = value


@wp.kernel
def fill_rows(depth: wp.array3d[wp.float32], out: wp.array3d[wp.float32]):
    """The larger of the nearest known depths to the left and to the right of what is unknown.

    0 on empty rows.
    """
    k, y, x = wp.tid()
    value = depth[k, y, x]
    if not (value > 0.0):
        left = x - 1
        while left > 0 and not (depth[k, y, wp.max(left, 0)] > 0.0):
            left -= 1
        right = x + 1
        while right < depth.shape[2] - 1 and not (
            depth[k, y, wp.min(right, depth.shape[2] - 1)] > 0.0
        ):
            right += 1
        value = wp.max(depth[k, y, wp.max(left, 0)], depth[k, y, wp.min(right, depth.shape[2] - 1)])
    out[k, y, x] = wp.max(value, 0.0)


@wp.kernel
def fill_columns(
    rows: wp.array3d[wp.float32],
    depth: wp.array3d[wp.float32],
    confidence: wp.array3d[wp.float32],
    filled_confidence: wp.float32,
    out: wp.array3d[wp.float32],
    sure: wp.array3d[wp.float32],
):
    """Fill by columns what rows left unknown, and compute the confidence."""
    k, y, x = wp.tid()
    value = rows[k, y, x]
    if not (value > 0.0):
        up = y - 1
        while up > 0 and not (rows[k, wp.max(up, 0), x] > 0.0):
            up -= 1
        down = y + 1
        while down < rows.shape[1] - 1 and not (rows[k, wp.min(down, rows.shape[1] - 1), x] > 0.0):
            down += 1
        value = wp.max(rows[k, wp.max(up, 0), x], rows[k, wp.min(down, rows.shape[1] - 1), x])
    out[k, y, x] = value
    certainty = confidence[k, y, x]
    if not (depth[k, y, x] > 0.0):
        certainty = wp.where(value > 0.0, filled_confidence, 0.0)
    sure[k, y, x] = certainty


@wp.func
def moved(m: wp.array[wp.float32], u: wp.float32, v: wp.float32, depth: wp.float32) -> wp.vec3f:
    """Return the image coordinates and depth in another camera of a pixel at a depth."""
    x = depth * (m[0] * u + m[1] * v + m[2]) + m[9]
    y = depth * (m[3] * u + m[4] * v + m[5]) + m[10]
    z = depth * (m[6] * u + m[7] * v + m[8]) + m[11]
    return wp.vec3f(x / z, y / z, z)


@wp.struct
class Limits:
    """Bounds of agreement, see `consistency`."""

    error_px: wp.float32
    wide_share: wp.float32
    error_share: wp.float32


@wp.func
def look_up(depth: wp.array2d[wp.float32], at: wp.vec3f, share: wp.float32) -> wp.float32:
    """Return the depth of a map between its pixels, or of that which is nearest in depth where two
    surfaces meet.
    """
    height = depth.shape[0]
    width = depth.shape[1]
    x = wp.clamp(at[0] - 0.5, 0.0, wp.float32(width - 1))
    y = wp.clamp(at[1] - 0.5, 0.0, wp.float32(height - 1))
    left = wp.int32(x)
    top = wp.int32(y)
    right = wp.min(left + 1, width - 1)
    bottom = wp.min(top + 1, height - 1)
    taps = wp.vec4f(depth[top, left], depth[top, right], depth[bottom, left], depth[bottom, right])
    closest = taps[0]
    for n in range(1, 4):
        if wp.abs(taps[n] - at[2]) < wp.abs(closest - at[2]):
            closest = taps[n]
    low = wp.min(wp.min(taps[0], taps[1]), wp.min(taps[2], taps[3]))
    high = wp.max(wp.max(taps[0], taps[1]), wp.max(taps[2], taps[3]))
    fx = x - wp.float32(left)
    fy = y - wp.float32(top)
    upper = taps[0] + fx * (taps[1] - taps[0])
    lower = taps[2] + fx * (taps[3] - taps[2])
    return wp.where(high - low > share * at[2], closest, upper + fy * (lower - upper))


@wp.struct
class Verdict:
    """Verdict of the others on a point, see `consistency._Verdict`."""

    support: wp.float32
    conflict: wp.float32
    depth: wp.float32
    confidence: wp.float32


@wp.func
def evaluate(
    maps: wp.array3d[wp.float32],
    trusts: wp.array3d[wp.float32],
    between: wp.array3d[wp.float32],
    limits: Limits,
    k: wp.int32,
    y: wp.int32,
    x: wp.int32,
    depth: wp.float32,
    confidence: wp.float32,
) -> Verdict:
    """Ask all other maps about a point of a pixel.

    Nothing is supported or contradicted where its depth is unknown.
    """
    views = maps.shape[0]
    height = maps.shape[1]
    width = maps.shape[2]
    u = wp.float32(x) + 0.5
    v = wp.float32(y) + 0.5
    verdict = Verdict()
    total = confidence
    mass = confidence
    weighted = confidence * depth
    for shift in range(1, views):
        partner = (k + shift) % views
        at = moved(between[k, partner], u, v, depth)
        if depth > 0.0 and is_inside(at, width, height):
            map_depth = look_up(maps[partner], at, limits.error_share)
            if map_depth > 0.0:
                back = moved(between[partner, k], at[0], at[1], map_depth)
                gap = wp.abs(map_depth - at[2])
                apart = (back[0] - u) * (back[0] - u) + (back[1] - v) * (back[1] - v)
                near = (
                    apart <= limits.error_px * limits.error_px or gap <= limits.wide_share * at[2]
                )
                if near and gap <= limits.error_share * at[2]:
                    m = between[k, partner]
                    slope = m[6] * u + m[7] * v + m[8]
                    step = (map_depth - at[2]) / wp.max(slope, _LEAST_SLOPE)
                    trust = trusts[partner, wp.int32(at[1]), wp.int32(at[0])]
                    verdict.support += 1.0
                    total += trust
                    if (
                        slope > _LEAST_SLOPE
                        and wp.abs(step) <= limits.error_share * depth
                        and depth + step > 0.0
                    ):
                        mass += trust
                        weighted += trust * (depth + step)
                elif map_depth > at[2]:
                    verdict.conflict += 1.0
    verdict.depth = depth
    if verdict.support > 0.0 and mass > 0.0:
        verdict.depth = weighted / mass
    evaluated = verdict.support + verdict.conflict
    verdict.confidence = _UNCHECKED * confidence
    if evaluated > 0.0:
        verdict.confidence = total / (1.0 + evaluated)
    return verdict


@wp.kernel
def leave_doubtful(
    depth: wp.array3d[wp.float32],
    confidence: wp.array3d[wp.float32],
    least: wp.float32,
    out: wp.array3d[wp.float32],
):
    """Depth of enough confidence."""
    k, y, x = wp.tid()
    out[k, y, x] = wp.where(confidence[k, y, x] >= least, depth[k, y, x], 0.0)


@wp.kernel
def check(
    maps: wp.array3d[wp.float32],
    trusts: wp.array3d[wp.float32],
    between: wp.array3d[wp.float32],
    limits: Limits,
    min_support: wp.float32,
    out: wp.array3d[wp.float32],
    sure: wp.array3d[wp.float32],
):
    """Each map's depth as far as the others agree, and their mean."""
    k, y, x = wp.tid()
    depth = maps[k, y, x]
    verdict = evaluate(maps, trusts, between, limits, k, y, x, depth, trusts[k, y, x])
    agreed = wp.min(verdict.support + verdict.conflict, min_support)
    is_kept = depth > 0.0 and verdict.support >= agreed and verdict.conflict <= verdict.support
    out[k, y, x] = wp.where(is_kept, verdict.depth, 0.0)
    sure[k, y, x] = wp.where(is_kept, verdict.confidence, 0.0)


@wp.kernel
def project(
    maps: wp.array3d[wp.float32], between: wp.array3d[wp.float32], layers: wp.array4d[wp.int32]
):
    """Bits of the others' depth in a camera's pixels, the nearest where points meet.

    Layer n is of the map n + 1 later.
    """
    n, k, y, x = wp.tid()
    partner = (k + n + 1) % maps.shape[0]
    depth = maps[partner, y, x]
    at = moved(between[partner, k], wp.float32(x) + 0.5, wp.float32(y) + 0.5, depth)
    if depth > 0.0 and is_inside(at, maps.shape[2], maps.shape[1]):
        wp.atomic_min(layers, n, k, wp.int32(at[1]), wp.int32(at[0]), wp.cast(at[2], wp.int32))


@wp.kernel
def fill_from_others(
    maps: wp.array3d[wp.float32],
    trusts: wp.array3d[wp.float32],
    between: wp.array3d[wp.float32],
    layers: wp.array4d[wp.int32],
    limits: Limits,
    fewest: wp.float32,
    depth: wp.array3d[wp.float32],
    sure: wp.array3d[wp.float32],
):
    """Fill unknown depth by the nearest supported and uncontradicted proposal of the others, in
    place.
    """
    k, y, x = wp.tid()
    if depth[k, y, x] == 0.0:
        nearest = wp.cast(_NOWHERE, wp.float32)
        for n in range(maps.shape[0] - 1):
            bits = layers[n, k, y, x]
            if bits < _NOWHERE:
                verdict = evaluate(
                    maps, trusts, between, limits, k, y, x, wp.cast(bits, wp.float32), 0.0
                )
                if (
                    verdict.support >= fewest
                    and verdict.conflict == 0.0
                    and verdict.depth < nearest
                ):
                    nearest = verdict.depth
                    depth[k, y, x] = nearest
                    sure[k, y, x] = verdict.confidence


def finish_maps(
    depth: Tensor, confidence: Tensor, between: Tensor, *, options: DepthOptions
) -> tuple[Tensor, Tensor]:
    """Drop flying pixels, smooth surfaces, remove what the other maps contradict, and fill the rest
    from the background.

    Args:
        depth: as found, (K, H, W).
        confidence: of that, (K, H, W).
        between: from the pixels of each camera to those of each, (K, K, 12), see
            `projections_between`.

    Returns:
        Depth and confidence, (K, H, W).
    """
    with on_current_stream(depth.device):
        depth, confidence = depth.contiguous(), confidence.float().contiguous()
        surfaces, even = torch.empty_like(depth), torch.empty_like(depth)
        launch(keep_surfaces, depth.shape, depth, FLYING, surfaces)
        launch(smooth, depth.shape, surfaces, SMOOTH, SMOOTH_RADIUS_PX, even)
        depth, confidence = _filled(even, confidence, FILLED_CONFIDENCE)
        if not options.consistency or len(depth) == 1:
            return depth, confidence
        return _filled(*_checked(depth, confidence, between.contiguous()), FILLED_CONFIDENCE)


def _filled(depth: Tensor, confidence: Tensor, filled_confidence: float) -> tuple[Tensor, Tensor]:
    """See `fusion.fill_background`."""
    rows, out, sure = (torch.empty_like(depth) for _ in range(3))
    launch(fill_rows, depth.shape, depth, rows)
    launch(fill_columns, depth.shape, rows, depth, confidence, filled_confidence, out, sure)
    return out, sure


def _checked(depth: Tensor, confidence: Tensor, between: Tensor) -> tuple[Tensor, Tensor]:
    """Check each map of a stack against all others, see `consistency.check_consistency`."""
    limits = Limits()
    limits.error_px, limits.wide_share = consistency.ERROR_PX, consistency.WIDE_SHARE
    limits.error_share = consistency.ERROR_SHARE
    maps, out, sure = (torch.empty_like(depth) for _ in range(3))
    launch(leave_doubtful, depth.shape, depth, confidence, consistency.LEAST_CONFIDENCE, maps)
    launch(
        check,
        depth.shape,
        maps,
        confidence,
        between,
        limits,
        float(consistency.MIN_SUPPORT),
        out,
        sure,
    )
    if consistency.FILL_SUPPORT > 0:
        partners = len(depth) - 1
        layers = torch.full(
            (partners, *depth.shape), NOWHERE, dtype=torch.int32, device=depth.device
        )
        launch(project, layers.shape, maps, between, layers)
        fewest = float(min(consistency.FILL_SUPPORT, partners))
        launch(
            fill_from_others,
            depth.shape,
            maps,
            confidence,
            between,
            layers,
            limits,
            fewest,
            out,
            sure,
        )
    return out, sure
