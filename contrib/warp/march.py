"""The ray march (paper 3.2): `kernels/occupancy.cpp` and `kernels/tsdf_simd.hpp`, a thread per
source block or ray.
"""

import torch
import warp as wp
from torch import Tensor

from ggvs_eval.contrib.warp.constants import END, NEAR, PAST, PER_BIT, SLABS, TAU, StepConstants
from ggvs_eval.contrib.warp.launch import MODULE_OPTIONS, launch
from ggvs_eval.contrib.warp.tables import Tables
from ggvs_eval.geometry.tsdf import STEP_FRACTION

wp.set_module_options(MODULE_OPTIONS)

COLUMN = 8  # target pixels across and down that share one column of the occupancy grid
BLOCK = 4  # source pixels across and down that are marked together
SEGMENTS = 16  # of a column, each searched by a thread
_COLUMN, _SLABS, _BLOCK = wp.constant(COLUMN), wp.constant(SLABS), wp.constant(BLOCK)
_SEGMENTS, _SEGMENT = wp.constant(SEGMENTS), wp.constant(SLABS // SEGMENTS)
_JUST_BELOW = wp.constant(wp.float32(0.99999994))  # the largest number below 1
FAR_AWAY = wp.constant(wp.float32(1e18))
NOWHERE = wp.constant(wp.float32(3e38))


@wp.struct
class Field:
    """Constants of the fused field: depth range, truncation, the slabs of the occupancy grid, and
    the target's size.
    """

    near: wp.float32
    far: wp.float32
    tau: wp.float32
    first_bits: wp.int32
    per_bit: wp.float32
    width: wp.int32
    height: wp.int32


@wp.func
def field_of(numbers: wp.array[wp.float32], width: wp.int32, height: wp.int32) -> Field:
    """Return the field of a step's numbers."""
    field = Field()
    field.near = numbers[NEAR]
    field.far = numbers[END]
    field.tau = numbers[TAU]
    field.first_bits = wp.cast(numbers[NEAR], wp.int32)
    field.per_bit = numbers[PER_BIT]
    field.width = width
    field.height = height
    return field


@wp.func
def slab_of(field: Field, z: wp.float32) -> wp.int32:
    """Slab of a depth: a float's bits are a piecewise linear logarithm."""
    slab = wp.float32(wp.cast(z, wp.int32) - field.first_bits) * field.per_bit
    return wp.int32(wp.min(wp.max(slab, 0.0), wp.float32(_SLABS - 1)))


@wp.func
def mark_frustum(
    field: Field,
    m: wp.array[wp.float32],
    left: wp.int32,
    top: wp.int32,
    right: wp.int32,
    bottom: wp.int32,
    low: wp.float32,
    high: wp.float32,
    marks: wp.array3d[wp.uint8],
):
    """Mark the columns and slabs that a piece of a source frustum reaches.

    Its corners bound its image and its depth.
    """
    u0 = wp.float32(1e30)
    u1 = wp.float32(-1e30)
    v0 = wp.float32(1e30)
    v1 = wp.float32(-1e30)
    z0 = wp.float32(1e30)
    z1 = wp.float32(-1e30)
    for corner in range(8):
        u = wp.float32(wp.where(corner % 2 == 1, right, left))
        v = wp.float32(wp.where((corner // 2) % 2 == 1, bottom, top))
        d = wp.max(wp.where(corner // 4 == 1, high, low), 0.0)
        z = d * (m[6] * u + m[7] * v + m[8]) + m[11]
        x = (d * (m[0] * u + m[1] * v + m[2]) + m[9]) / z
        y = (d * (m[3] * u + m[4] * v + m[5]) + m[10]) / z
        u0 = wp.min(u0, x)
        u1 = wp.max(u1, x)
        v0 = wp.min(v0, y)
        v1 = wp.max(v1, y)
        z0 = wp.min(z0, z)
        z1 = wp.max(z1, z)
    width = wp.float32(field.width)
    height = wp.float32(field.height)
    if z0 < 0.1 * field.near:  # behind the camera, the image is no bound
        u0 = wp.float32(0.0)
        v0 = wp.float32(0.0)
        u1 = width
        v1 = height
    z0 *= 1.0 - 1e-5
    z1 *= 1.0 + 1e-5
    rounding = wp.float32(0.01)  # pixels; far above the error of the arithmetic
    if (
        z1 < field.near
        or z0 > field.far
        or u1 < -rounding
        or v1 < -rounding
        or u0 > width
        or v0 > height
    ):
        return
    x0 = wp.int32(wp.max(u0 - rounding, 0.0)) // _COLUMN
    x1 = wp.int32(wp.min(u1 + rounding, width - 1.0)) // _COLUMN
    y0 = wp.int32(wp.max(v0 - rounding, 0.0)) // _COLUMN
    y1 = wp.int32(wp.min(v1 + rounding, height - 1.0)) // _COLUMN
    first = slab_of(field, wp.max(z0, field.near))
    last = slab_of(field, wp.min(z1, field.far))
    for row in range(y0, y1 + 1):
        for column in range(x0, x1 + 1):
            for slab in range(first, last + 1):
                marks[slab, row, column] = wp.uint8(1)  # all threads write the same value


@wp.kernel
def mark_shells(
    depths: wp.array3d[wp.float32],
    weights: wp.array3d[wp.float32],
    sizes: wp.array2d[wp.int32],
    to_target: wp.array2d[wp.float32],
    flags: wp.array[wp.int32],
    is_past: wp.bool,
    numbers: wp.array[wp.float32],
    target_width: wp.int32,
    target_height: wp.int32,
    marks: wp.array3d[wp.uint8],
):
    """Mark where a sample may be within the truncation of one block's pixels.

    Conservative, so that no result depends on it.
    """
    k, block_y, block_x = wp.tid()
    if is_past and flags[PAST] == 0:
        return
    width = sizes[k, 0]
    height = sizes[k, 1]
    top = block_y * _BLOCK
    left = block_x * _BLOCK
    bottom = wp.min(top + _BLOCK, height)
    right = wp.min(left + _BLOCK, width)
    low = FAR_AWAY
    high = wp.float32(0.0)
    ring_low = FAR_AWAY
    ring_high = wp.float32(0.0)
    # Interpolation with a pixel of the ring around the block moves a value, but by less than tau.
    for y in range(wp.max(top - 1, 0), wp.min(bottom + 1, height)):
        for x in range(wp.max(left - 1, 0), wp.min(right + 1, width)):
            value = depths[k, y, x]
            if value > 0.0:
                ring_low = wp.min(ring_low, value)
                ring_high = wp.max(ring_high, value)
                if y >= top and y < bottom and x >= left and x < right and weights[k, y, x] > 0.0:
                    low = wp.min(low, value)
                    high = wp.max(high, value)
    if low > high:
        return
    field = field_of(numbers, target_width, target_height)
    tau = field.tau
    if high - low <= 2.0 * tau:
        front = wp.max(low - tau, ring_low) - tau
        behind = wp.min(high + tau, ring_high) + tau
        mark_frustum(field, to_target[k], left, top, right, bottom, front, behind, marks)
        return
    for y in range(top, bottom):
        for x in range(left, right):
            value = depths[k, y, x]
            if value > 0.0 and weights[k, y, x] > 0.0:
                front = wp.max(value - tau, ring_low) - tau
                behind = wp.min(value + tau, ring_high) + tau
                mark_frustum(field, to_target[k], x, y, x + 1, y + 1, front, behind, marks)


@wp.kernel
def first_marks(marks: wp.array3d[wp.uint8], firsts: wp.array3d[wp.int32]):
    """First marked slab of a segment of a column, -1 for none."""
    s, y, x = wp.tid()
    first = wp.int32(-1)
    for n in range(_SEGMENT):
        slab = s * _SEGMENT + _SEGMENT - 1 - n
        if marks[slab, y, x] > wp.uint8(0):
            first = slab
    firsts[s, y, x] = first


@wp.func
def begin_of(slab: wp.int32, numbers: wp.array[wp.float32]) -> wp.float32:
    """Depth where a slab begins, rounded towards the camera: to stop early costs a sample, to stop
    late would lose one.
    """
    bits = wp.cast(numbers[NEAR], wp.int32) + wp.int32(
        wp.float32(slab) / numbers[PER_BIT] * 0.99999
    )
    return wp.cast(bits, wp.float32)


@wp.kernel
def find_next(
    marks: wp.array3d[wp.uint8],
    firsts: wp.array3d[wp.int32],
    numbers: wp.array[wp.float32],
    nexts: wp.array3d[wp.float32],
):
    """Beginning of the first marked slab at or behind each slab of a segment."""
    s, y, x = wp.tid()
    following = NOWHERE
    for n in range(_SEGMENTS):
        ahead = _SEGMENTS - 1 - n
        if ahead > s and firsts[ahead, y, x] >= 0:
            following = begin_of(firsts[ahead, y, x], numbers)
    for n in range(_SEGMENT):
        slab = s * _SEGMENT + _SEGMENT - 1 - n
        if marks[slab, y, x] > wp.uint8(0):
            following = begin_of(slab, numbers)
        nexts[slab, y, x] = following


@wp.func
def add_view(
    depths: wp.array2d[wp.float32],
    weights: wp.array2d[wp.float32],
    m: wp.array[wp.float32],
    width: wp.int32,
    height: wp.int32,
    gain: wp.float32,
    limit: wp.float32,
    pixel: wp.vec2f,
    z: wp.float32,
    tau: wp.float32,
) -> wp.vec2f:
    """Return one view's weighted distance at a sample, and its weight (Eqs. 9, 13, 14)."""
    depth_k = z * (m[6] * pixel[0] + m[7] * pixel[1] + m[8]) + m[11]
    if not (depth_k > 0.0):
        return wp.vec2f(0.0, 0.0)
    inverse = 1.0 / depth_k
    u = (z * (m[0] * pixel[0] + m[1] * pixel[1] + m[2]) + m[9]) * inverse
    v = (z * (m[3] * pixel[0] + m[4] * pixel[1] + m[5]) + m[10]) * inverse
    if not (u >= 0.0 and u < wp.float32(width) and v >= 0.0 and v < wp.float32(height)):
        return wp.vec2f(0.0, 0.0)
    row = wp.int32(v)
    column = wp.int32(u)
    depth = depths[row, column]
    if not (depth > 0.0):
        return wp.vec2f(0.0, 0.0)
    distance = (depth - depth_k) * (1.0 / tau)
    if distance > -2.01 and distance < 2.01:
        # At the border between the last two pixels, just before the centre of the last.
        left = wp.min(wp.max(u - 0.5, 0.0), _JUST_BELOW * wp.float32(width - 1))
        upper = wp.min(wp.max(v - 0.5, 0.0), _JUST_BELOW * wp.float32(height - 1))
        x0 = wp.int32(left)
        y0 = wp.int32(upper)
        x1 = wp.min(x0 + 1, width - 1)
        y1 = wp.min(y0 + 1, height - 1)
        fx = left - wp.float32(x0)
        fy = upper - wp.float32(y0)
        d00 = depths[y0, x0]
        d01 = depths[y0, x1]
        d10 = depths[y1, x0]
        d11 = depths[y1, x1]
        low = wp.min(wp.min(d00, d01), wp.min(d10, d11))
        high = wp.max(wp.max(d00, d01), wp.max(d10, d11))
        if low > 0.0 and high - low < tau:
            above = d00 + fx * (d01 - d00)
            below = d10 + fx * (d11 - d10)
            distance = (above + fy * (below - above) - depth_k) * (1.0 / tau)
    if not (distance >= -1.0):
        return wp.vec2f(0.0, 0.0)
    weight = wp.min(gain * weights[row, column], limit)
    return wp.vec2f(weight * wp.min(distance, 1.0), weight)


@wp.func
def sample(
    field: Field,
    depths: wp.array3d[wp.float32],
    weights: wp.array3d[wp.float32],
    maps: wp.array2d[wp.float32],
    sizes: wp.array2d[wp.int32],
    past_depth: wp.array2d[wp.float32],
    past_weight: wp.array2d[wp.float32],
    gain: wp.float32,
    limit: wp.float32,
    pixel: wp.vec2f,
    z: wp.float32,
) -> wp.vec2f:
    """Eq. 10, normalised: the mean of the views' clamped distances, and the sum of the weights.

    The previous depth comes last.
    """
    sums = wp.vec2f(0.0, 0.0)
    views = depths.shape[0]
    for k in range(views):
        sums += add_view(
            depths[k],
            weights[k],
            maps[k],
            sizes[k, 0],
            sizes[k, 1],
            1.0,
            NOWHERE,
            pixel,
            z,
            field.tau,
        )
    if gain >= 0.0:
        width = past_depth.shape[1]
        height = past_depth.shape[0]
        sums += add_view(
            past_depth, past_weight, maps[views], width, height, gain, limit, pixel, z, field.tau
        )
    mean = wp.float32(0.0)
    if sums[1] > 0.0:
        mean = sums[0] / sums[1]
    return wp.vec2f(mean, sums[1])


@wp.kernel
def march_rays(
    numbers: wp.array[wp.float32],
    step_fraction: wp.float32,
    min_step: wp.float32,
    skip_empty: wp.bool,
    depths: wp.array3d[wp.float32],
    weights: wp.array3d[wp.float32],
    maps: wp.array2d[wp.float32],
    sizes: wp.array2d[wp.int32],
    past_depth: wp.array2d[wp.float32],
    past_weight: wp.array2d[wp.float32],
    gains: wp.array2d[wp.float32],
    limit: wp.float32,
    nexts: wp.array3d[wp.float32],
    out_depth: wp.array2d[wp.float32],
    out_weight: wp.array2d[wp.float32],
):
    """Sphere tracing with the smallest step (Eq. 3 with the readings of
    ggvs_eval/geometry/tsdf.py).
    """
    y, x = wp.tid()
    field = field_of(numbers, out_depth.shape[1], out_depth.shape[0])
    pixel = wp.vec2f(wp.float32(x) + 0.5, wp.float32(y) + 0.5)
    gain = gains[y, x]
    step = step_fraction * field.tau
    base = field.near
    steps = wp.float32(0.0)
    previous = wp.float32(0.0)
    before = wp.vec2f(0.0, 0.0)
    depth = wp.float32(0.0)
    total = wp.float32(0.0)
    was_positive = wp.bool(False)
    active = wp.bool(True)
    while active:
        z = base + steps * step
        if skip_empty:
            empty = (nexts[slab_of(field, z), y // _COLUMN, x // _COLUMN] - z) * (1.0 / step) - 0.01
            steps += wp.float32(wp.int32(wp.min(wp.max(empty, 0.0), 1e6)))
            z = base + steps * step
        if not (z <= field.far):
            active = False
        else:
            s = sample(
                field, depths, weights, maps, sizes, past_depth, past_weight, gain, limit, pixel, z
            )
            positive = s[1] > 0.0 and s[0] > 0.0
            if s[1] > 0.0 and was_positive and not positive:
                # The surface is where the straight line through the two distances is zero.
                share = before[0] / (before[0] - s[0])
                depth = share * (z - previous) + previous
                total = share * (s[1] - before[1]) + before[1]
                active = False
            else:
                if positive and s[0] < 1.0:
                    base = z + wp.max(step_fraction * s[0], min_step) * field.tau
                    steps = wp.float32(0.0)
                else:
                    steps += 1.0
                previous = z
                before = s
                was_positive = positive
    out_depth[y, x] = depth
    out_weight[y, x] = total


def march(
    depths: Tensor,
    weights: Tensor,
    past: tuple[Tensor, Tensor],
    gain: Tensor,
    c: StepConstants,
    t: Tables,
    limits: tuple[float, float],
    out: tuple[Tensor, Tensor],
    skip_empty: bool = True,
) -> None:
    """Find the first surface of the fused field along each ray, as `ray_march` of the compiled path
    (Eqs. 3, 9, 10, 13, 14).

    Args:
        depths: of the sources, filtered, (K, H, W), world units.
        weights: of their pixels, (K, H, W).
        past: depth and weight that the march of the instant before found, of its target's size.
        gain: of the past along each ray, (H, W), see `trust_past`.
        limits: smallest step, in tau, and largest weight of the past.
        out: depth, (H, W), world units, 0 if there is no surface, and the sum of the weights behind
            it.
    """
    (width, height), device = t.sizes.target, depths.device
    columns = -(-height // COLUMN), -(-width // COLUMN)
    nexts = torch.empty((SLABS if skip_empty else 1, *columns), device=device)
    if skip_empty:
        marks = torch.zeros((SLABS, *columns), dtype=torch.uint8, device=device)
        past_size = t.past_size(past[0].shape[1], past[0].shape[0])
        groups = (
            (depths, weights, t.view_sizes, c.from_views[:-1]),
            (past[0][None], past[1][None], past_size, c.from_views[-1:]),
        )
        for number, (stack, of_pixels, sizes, to_target) in enumerate(groups):
            blocks = (len(stack), *(-(-size // BLOCK) for size in stack.shape[1:]))
            arguments = (
                stack,
                of_pixels,
                sizes,
                to_target,
                c.flags,
                number == 1,
                c.numbers,
                width,
                height,
            )
            launch(mark_shells, blocks, *arguments, marks)
        firsts = torch.empty((SEGMENTS, *columns), dtype=torch.int32, device=device)
        launch(first_marks, firsts.shape, marks, firsts)
        launch(find_next, firsts.shape, marks, firsts, c.numbers, nexts)
    steps = (c.numbers, STEP_FRACTION, limits[0], skip_empty)
    launch(
        march_rays,
        (height, width),
        *steps,
        depths,
        weights,
        c.to_views,
        t.view_sizes,
        *past,
        gain,
        limits[1],
        nexts,
        *out,
    )
