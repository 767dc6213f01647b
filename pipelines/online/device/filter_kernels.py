"""Kernels of the difference mask (Eq. 1), the temporal depth filter (Eq. 2) and the fusion weights (Eqs. 11-12)."""

import warp as wp

from ggvs_eval.pipelines.online.device.launch import MODULE_OPTIONS

wp.set_module_options(MODULE_OPTIONS)

REACH = wp.constant(3)  # of the 7 x 7 window of Eq. 12
FAR_AWAY = wp.constant(wp.float32(1e18))  # stands for an invalid depth: any difference to it exceeds tau


@wp.kernel
def colour_change(
    now: wp.array3d[wp.uint8],
    before: wp.array3d[wp.uint8],
    rows: wp.array2d[wp.int32],
    row_shares: wp.array2d[wp.float32],
    columns: wp.array2d[wp.int32],
    column_shares: wp.array2d[wp.float32],
    out: wp.array3d[wp.float32],
):
    """By how much a cell's mean colour has changed, see `kernels/filter.hpp`."""
    y, x = wp.tid()
    for c in range(3):
        value = wp.float32(0.0)
        for column in range(columns[x, 0], columns[x, 1]):
            line = wp.float32(0.0)
            for row in range(rows[y, 0], rows[y, 1]):
                difference = wp.float32(now[row, column, c]) - wp.float32(before[row, column, c])
                line += row_shares[y, row - rows[y, 0]] * difference
            value += column_shares[x, column - columns[x, 0]] * line
        out[y, x, c] = value / 255.0


@wp.kernel
def mix_depth(
    depth: wp.array2d[wp.float32],
    history: wp.array2d[wp.float32],
    mask: wp.array2d[wp.float32],
    tolerance: wp.float32,
    out: wp.array2d[wp.float32],
):
    """Eq. 2 where depth and history are one surface, else the one that is known."""
    y, x = wp.tid()
    new = depth[y, x]
    old = history[y, x]
    share = mask[y, x]
    result = new
    if new > 0.0:
        if old > 0.0 and wp.abs(new - old) <= tolerance * wp.max(new, 1e-9):
            result = share * new + (1.0 - share) * old
    elif share < 1.0:
        result = old
    else:
        result = 0.0
    out[y, x] = result


@wp.func
def valid_depth(depth: wp.array2d[wp.float32], y: wp.int32, x: wp.int32) -> wp.float32:
    """Depth of a pixel; far away where it is invalid or outside."""
    if y < 0 or x < 0 or y >= depth.shape[0] or x >= depth.shape[1]:
        return FAR_AWAY
    value = depth[y, x]
    if value > 0.0 and value < FAR_AWAY:
        return value
    return FAR_AWAY


@wp.kernel
def fusion_weights(depth: wp.array2d[wp.float32], tau: wp.float32, scale: wp.float32, out: wp.array2d[wp.float32]):
    """Eqs. 11-12; `scale` is 7 times the depth noise."""
    y, x = wp.tid()
    centre = valid_depth(depth, y, x)
    most = tau * tau
    nu = wp.float32(0.0)
    for down in range(-REACH, REACH + 1):
        line = wp.float32(0.0)
        for right in range(-REACH, REACH + 1):
            difference = centre - valid_depth(depth, y + down, x + right)
            line += wp.min(difference * difference, most)
        nu += line
    weight = wp.float32(0.0)
    if centre < FAR_AWAY * 0.5:
        weight = wp.float32(1.0)
        if nu > 0.0:
            weight = wp.min(scale / wp.sqrt(nu), 1.0)
    out[y, x] = weight
