"""Kernels of the forward splat (paper 3.1): `kernels/splat_project_simd.hpp`, a thread per Gaussian, then one per target pixel.

Every kernel gathers; none adds into what another thread adds into, so that equal inputs give equal bits.
"""

import warp as wp

from ggvs_eval.pipelines.online.device.launch import MODULE_OPTIONS

wp.set_module_options(MODULE_OPTIONS)

TILE = 16  # pixels across and down whose Gaussians are listed together
HIDDEN = 0x7F7FFFFF  # sorts behind every depth
_TILE = wp.constant(TILE)
_HIDDEN = wp.constant(HIDDEN)
LOG2_MIN_ALPHA = wp.constant(wp.float32(-7.99435344))


@wp.struct
class Footprint:
    """A Gaussian in the target image: position in pixel indices, depth, covariance, half extents."""

    visible: wp.bool
    u: wp.float32
    v: wp.float32
    depth: wp.float32
    var_x: wp.float32
    cov: wp.float32
    var_y: wp.float32
    reach_x: wp.float32
    reach_y: wp.float32


@wp.func
def project(p: wp.array[wp.float32], column: wp.int32, row: wp.int32, source_depth: wp.float32) -> Footprint:
    """Steps 1 to 4 of the splat; `p` is a row of `projectors`."""
    f = Footprint()
    f.visible = False
    if source_depth > 0.0 and source_depth < 1e30:
        u = wp.float32(column) + 0.5
        v = wp.float32(row) + 0.5
        x = source_depth * (p[0] * u + p[1] * v + p[2]) + p[9]
        y = source_depth * (p[3] * u + p[4] * v + p[5]) + p[10]
        z = source_depth * (p[6] * u + p[7] * v + p[8]) + p[11]
        if z > p[19]:
            inverse = 1.0 / z
            slope_x = x * inverse
            slope_y = y * inverse
            f.depth = z
            f.u = p[13] * slope_x + p[15]
            f.v = p[14] * slope_y + p[16]
            sigma = p[12] * source_depth * inverse
            jx = p[13] * sigma
            jy = p[14] * sigma
            jxz = jx * wp.max(wp.min(slope_x, p[17]), -p[17])
            jyz = jy * wp.max(wp.min(slope_y, p[18]), -p[18])
            f.var_x = jx * jx + jxz * jxz + 0.3
            f.cov = jxz * jyz
            f.var_y = jy * jy + jyz * jyz + 0.3
            f.reach_x = wp.sqrt(11.09 * f.var_x)
            f.reach_y = wp.sqrt(11.09 * f.var_y)
            across = f.u + f.reach_x >= 0.0 and f.u - f.reach_x <= p[20]
            down = f.v + f.reach_y >= 0.0 and f.v - f.reach_y <= p[21]
            f.visible = across and down
    return f


@wp.func
def tile_range(f: Footprint, p: wp.array[wp.float32]) -> wp.vec4i:
    """First and last tile across, first and last down, that a Gaussian touches."""
    scale = 1.0 / wp.float32(_TILE)
    x0 = wp.int32(wp.max(f.u - f.reach_x, 0.0) * scale)
    x1 = wp.int32(wp.min(f.u + f.reach_x, p[20]) * scale)
    y0 = wp.int32(wp.max(f.v - f.reach_y, 0.0) * scale)
    y1 = wp.int32(wp.min(f.v + f.reach_y, p[21]) * scale)
    return wp.vec4i(x0, x1, y0, y1)


@wp.kernel
def order_keys(
    depths: wp.array3d[wp.float32], projectors: wp.array2d[wp.float32], keys: wp.array[wp.int32], ids: wp.array[wp.int32]
):
    """Number every source pixel, and key it by its depth in the target; bits of positive floats sort like the floats."""
    k, row, column = wp.tid()
    f = project(projectors[k], column, row, depths[k, row, column])
    number = (k * depths.shape[1] + row) * depths.shape[2] + column
    key = wp.int32(_HIDDEN)
    if f.visible:
        key = wp.cast(f.depth, wp.int32)
    keys[number] = key
    ids[number] = number


@wp.kernel
def count_tiles(
    depths: wp.array3d[wp.float32],
    projectors: wp.array2d[wp.float32],
    keys: wp.array[wp.int32],
    ids: wp.array[wp.int32],
    counts: wp.array[wp.int32],
    ranges: wp.array[wp.vec4i],
    ellipses: wp.array2d[wp.float32],
):
    """Of each Gaussian, front to back: the tiles it touches, and, by its number, what blending reads of it."""
    n = wp.tid()
    counts[n] = 0
    if keys[n] == _HIDDEN:
        return
    number = ids[n]
    column = number % depths.shape[2]
    row = (number // depths.shape[2]) % depths.shape[1]
    k = number // (depths.shape[1] * depths.shape[2])
    p = projectors[k]
    f = project(p, column, row, depths[k, row, column])
    tiles = tile_range(f, p)
    ranges[n] = tiles
    counts[n] = (tiles[1] - tiles[0] + 1) * (tiles[3] - tiles[2] + 1)
    per = 1.44269504 / (f.var_x * f.var_y - f.cov * f.cov)
    ellipses[number, 0] = f.u
    ellipses[number, 1] = f.v
    ellipses[number, 2] = -0.5 * f.var_y * per
    ellipses[number, 3] = f.cov * per
    ellipses[number, 4] = -0.5 * f.var_x * per
    ellipses[number, 5] = f.depth


@wp.kernel
def list_pairs(
    counts: wp.array[wp.int32],
    starts: wp.array[wp.int32],
    ranges: wp.array[wp.vec4i],
    ids: wp.array[wp.int32],
    pixels: wp.int32,
    across: wp.int32,
    tiles: wp.int32,
    capacity: wp.int32,
    keys: wp.array[wp.int32],
    values: wp.array[wp.int32],
):
    """Write the tiles of each Gaussian, front to back, as pairs of tile and number; `pixels` and `tiles` are those of a view."""
    n = wp.tid()
    if counts[n] == 0:
        return
    place = starts[n]
    view = ids[n] // pixels
    box = ranges[n]
    for y in range(box[2], box[3] + 1):
        for x in range(box[0], box[1] + 1):
            if place < capacity:
                keys[place] = view * tiles + y * across + x
                values[place] = ids[n]
            place += 1


@wp.kernel
def find_ends(keys: wp.array[wp.int32], count: wp.int32, starts: wp.array[wp.int32], ends: wp.array[wp.int32]):
    """Range of the pairs of each tile; those of no tile sort last."""
    n = wp.tid()
    tile = keys[n]
    if tile < starts.shape[0]:
        if n == 0 or keys[n - 1] != tile:
            starts[tile] = n
        if n == count - 1 or keys[n + 1] != tile:
            ends[tile] = n + 1


@wp.func
def exp2_of(x: wp.float32) -> wp.float32:
    """2^x for -126 < x < 126 to 2e-7, by the polynomial of the compiled composition."""
    shifted = x + 12582912.0
    f = x - (shifted - 12582912.0)
    p = wp.float32(1.326472634e-3)
    p = p * f + 9.671513338e-3
    p = p * f + 5.550733752e-2
    p = p * f + 2.402224207e-1
    p = p * f + 6.931469776e-1
    p = p * f + 1.0
    return wp.cast(wp.cast(p, wp.int32) + (wp.cast(shifted, wp.int32) << 23), wp.float32)


@wp.kernel
def blend_tiles(
    starts: wp.array[wp.int32],
    ends: wp.array[wp.int32],
    ids: wp.array[wp.int32],
    ellipses: wp.array2d[wp.float32],
    images: wp.array4d[wp.uint8],
    masks: wp.array3d[wp.float32],
    across: wp.int32,
    tiles: wp.int32,
    features: wp.array4d[wp.float32],
    alphas: wp.array3d[wp.float32],
    depths: wp.array3d[wp.float32],
):
    """Steps 6 to 8 for one pixel of one view: blend its tile's Gaussians front to back, normalise by coverage."""
    k, tile, lane = wp.tid()
    x = (tile % across) * _TILE + lane % _TILE
    y = (tile // across) * _TILE + lane // _TILE
    if x >= alphas.shape[2] or y >= alphas.shape[1]:
        return
    width = images.shape[2]
    pixels = images.shape[1] * width
    transmittance = wp.float32(1.0)
    depth = wp.float32(0.0)
    sums = wp.vec4f()
    for n in range(starts[k * tiles + tile], ends[k * tiles + tile]):
        number = ids[n]
        dx = wp.float32(x) - ellipses[number, 0]
        dy = wp.float32(y) - ellipses[number, 1]
        exponent = (ellipses[number, 2] * dx + ellipses[number, 3] * dy) * dx + ellipses[number, 4] * dy * dy
        if exponent >= LOG2_MIN_ALPHA:
            share = transmittance * wp.min(exp2_of(exponent), 0.99)
            after = transmittance - share
            if after < 1e-4:
                break
            transmittance = after
            depth += share * ellipses[number, 5]
            row = (number - k * pixels) // width
            column = (number - k * pixels) % width
            red = wp.float32(images[k, row, column, 0]) / 255.0
            green = wp.float32(images[k, row, column, 1]) / 255.0
            blue = wp.float32(images[k, row, column, 2]) / 255.0
            sums += share * wp.vec4f(red, green, blue, masks[k, row, column])
    alpha = 1.0 - transmittance
    factor = wp.float32(0.0)
    if alpha > 1.0 / 255.0:
        factor = 1.0 / alpha
    alphas[k, y, x] = alpha
    depths[k, y, x] = depth * factor
    for c in range(4):
        features[k, y, x, c] = sums[c] * factor
