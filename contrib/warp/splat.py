"""Forward rendering of all views (paper 3.1): Gaussians sorted by depth, listed by tile, and
blended pixel by pixel.

Every kernel gathers; none adds into what another thread adds into, so that equal inputs give equal
bits. What blending reads of a Gaussian is one record of 48 bytes. Tiles are 8 x 8: a list is then
2.4 times as short as one of 16 x 16, for 1.6 times the pairs.
"""

from dataclasses import dataclass

import torch
import warp as wp
from torch import Tensor

from ggvs_eval.contrib.warp.constants import StepConstants
from ggvs_eval.contrib.warp.launch import MODULE_OPTIONS, launch, load4, sort_pairs, store4
from ggvs_eval.contrib.warp.tables import Tables

wp.set_module_options(MODULE_OPTIONS)

TILE = 8  # pixels across and down whose Gaussians are listed together
DEPTH_BITS = 31  # of a positive float
SHORT_KEYS = 2**16  # tiles that two passes of the sort distinguish
_TILE, _HALF = wp.constant(TILE), wp.constant(TILE // 2)
_HIDDEN = wp.constant(0x7F7FFFFF)  # sorts behind every depth
LOG2_MIN_ALPHA = wp.constant(wp.float32(-7.99435344))


@dataclass(frozen=True, eq=False)
class DeviceSplats:
    """The K views in the target view.

    Attributes:
        features: colours in [0, 1] and difference mask, (K, H, W, 4), float32.
        alphas: coverage, (K, H, W).
        depths: z in the target camera, (K, H, W), world units.
        crowding: pairs of a Gaussian and a tile, per Gaussian, that a list needs, (1,); those
            beyond its room are lost.
    """

    features: Tensor
    alphas: Tensor
    depths: Tensor
    crowding: Tensor


@wp.struct
class Footprint:
    """A Gaussian in the target image: position in pixel indices, depth, covariance, half
    extents.
    """

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
def project(
    p: wp.array[wp.float32], column: wp.int32, row: wp.int32, source_depth: wp.float32
) -> Footprint:
    """Return the steps 1 to 4 of the splat; `p` is a row of `projectors`."""
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


@wp.kernel
def prepare(
    depths: wp.array3d[wp.float32],
    projectors: wp.array2d[wp.float32],
    images: wp.array4d[wp.uint8],
    masks: wp.array3d[wp.float32],
    keys: wp.array[wp.int32],
    ids: wp.array[wp.int32],
    boxes: wp.array[wp.vec2i],
    records: wp.array[wp.float32],
):
    """Of every source pixel: depth in the target as a key, tiles and record.

    Bits of positive floats sort like the floats.
    """
    k, row, column = wp.tid()
    p = projectors[k]
    f = project(p, column, row, depths[k, row, column])
    number = (k * depths.shape[1] + row) * depths.shape[2] + column
    ids[number] = number
    if not f.visible:
        keys[number] = _HIDDEN
        boxes[number] = wp.vec2i(0, -1)
        return
    keys[number] = wp.cast(f.depth, wp.int32)
    scale = 1.0 / wp.float32(_TILE)
    x0 = wp.int32(wp.max(f.u - f.reach_x, 0.0) * scale)
    x1 = wp.int32(wp.min(f.u + f.reach_x, p[20]) * scale)
    y0 = wp.int32(wp.max(f.v - f.reach_y, 0.0) * scale)
    y1 = wp.int32(wp.min(f.v + f.reach_y, p[21]) * scale)
    boxes[number] = wp.vec2i(x0 + (y0 << 16), (x1 - x0 + 1) + ((y1 - y0 + 1) << 16))
    per = 1.44269504 / (f.var_x * f.var_y - f.cov * f.cov)
    store4(records, 3 * number, wp.vec4f(f.u, f.v, -0.5 * f.var_y * per, f.cov * per))
    red = wp.float32(images[k, row, column, 0]) / 255.0
    green = wp.float32(images[k, row, column, 1]) / 255.0
    blue = wp.float32(images[k, row, column, 2]) / 255.0
    store4(records, 3 * number + 1, wp.vec4f(red, green, blue, masks[k, row, column]))
    store4(records, 3 * number + 2, wp.vec4f(-0.5 * f.var_x * per, f.depth, 0.0, 0.0))


@wp.kernel
def count_tiles(
    keys: wp.array[wp.int32],
    ids: wp.array[wp.int32],
    boxes: wp.array[wp.vec2i],
    counts: wp.array[wp.int32],
):
    """Count the tiles of each Gaussian, front to back."""
    n = wp.tid()
    touched = wp.int32(0)
    if keys[n] != _HIDDEN:
        size = boxes[ids[n]][1]
        touched = (size & 65535) * (size >> 16)
    counts[n] = touched


@wp.kernel
def list_pairs(
    counts: wp.array[wp.int32],
    ends: wp.array[wp.int32],
    boxes: wp.array[wp.vec2i],
    ids: wp.array[wp.int32],
    pixels: wp.int32,
    across: wp.int32,
    tiles: wp.int32,
    capacity: wp.int32,
    keys: wp.array[wp.int32],
    values: wp.array[wp.int32],
):
    """The tiles of each Gaussian, front to back, as pairs of tile and number.

    `ends` is the inclusive sum of the counts.
    """
    n = wp.tid()
    touched = counts[n]
    if touched == 0:
        return
    place = ends[n] - touched
    number = ids[n]
    box = boxes[number]
    first = (number // pixels) * tiles + (box[0] >> 16) * across + (box[0] & 65535)
    width = box[1] & 65535
    for y in range(box[1] >> 16):
        for x in range(width):
            if place < capacity:
                keys[place] = first + y * across + x
                values[place] = number
            place += 1


@wp.kernel
def find_ends(
    keys: wp.array[wp.int32], count: wp.int32, starts: wp.array[wp.int32], ends: wp.array[wp.int32]
):
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


@wp.struct
class Pixel:
    """Accumulated values of a pixel over its tile's Gaussians."""

    transmittance: wp.float32
    depth: wp.float32
    sums: wp.vec4f


@wp.func
def write_pixel(
    p: Pixel,
    k: wp.int32,
    y: wp.int32,
    x: wp.int32,
    features: wp.array[wp.float32],
    alphas: wp.array3d[wp.float32],
    depths: wp.array3d[wp.float32],
):
    """Normalise a pixel by its coverage."""
    if y < alphas.shape[1]:
        alpha = 1.0 - p.transmittance
        factor = wp.float32(0.0)
        if alpha > 1.0 / 255.0:
            factor = 1.0 / alpha
        alphas[k, y, x] = alpha
        depths[k, y, x] = p.depth * factor
        store4(features, (k * alphas.shape[1] + y) * alphas.shape[2] + x, p.sums * factor)


@wp.kernel
def blend_tiles(
    starts: wp.array[wp.int32],
    ends: wp.array[wp.int32],
    ids: wp.array[wp.int32],
    records: wp.array[wp.float32],
    across: wp.int32,
    tiles: wp.int32,
    features: wp.array[wp.float32],
    alphas: wp.array3d[wp.float32],
    depths: wp.array3d[wp.float32],
):
    """Steps 6 to 8 of two pixels, half a tile apart: its Gaussians front to back, the next record
    on its way meanwhile.
    """
    k, tile, lane = wp.tid()
    x = (tile % across) * _TILE + lane % _TILE
    y = (tile // across) * _TILE + lane // _TILE
    if x >= alphas.shape[2] or y >= alphas.shape[1]:
        return
    px = wp.float32(x)
    py = wp.float32(y)
    qy = wp.float32(y + _HALF)
    p = Pixel()
    p.transmittance = 1.0
    q = Pixel()
    q.transmittance = 1.0
    p_ends = wp.bool(False)
    q_ends = wp.bool(False)
    first = starts[k * tiles + tile]
    last = ends[k * tiles + tile]
    if first < last:
        number = ids[first]
        shape = load4(records, 3 * number)
        tail = load4(records, 3 * number + 2)
        following = ids[wp.min(first + 1, last - 1)]
        for n in range(first, last):
            current_shape = shape
            current_tail = tail
            current = number
            number = following
            shape = load4(records, 3 * number)
            tail = load4(records, 3 * number + 2)
            following = ids[wp.min(n + 2, last - 1)]
            dx = px - current_shape[0]
            along = current_shape[2] * dx
            dy = py - current_shape[1]
            ey = qy - current_shape[1]
            above = (along + current_shape[3] * dy) * dx + current_tail[0] * dy * dy
            below = (along + current_shape[3] * ey) * dx + current_tail[0] * ey * ey
            if wp.max(above, below) >= LOG2_MIN_ALPHA:
                colour = load4(records, 3 * current + 1)
                if above >= LOG2_MIN_ALPHA and not p_ends:
                    share = p.transmittance * wp.min(exp2_of(above), 0.99)
                    after = p.transmittance - share
                    p_ends = after < 1e-4
                    if not p_ends:
                        p.transmittance = after
                        p.depth += share * current_tail[1]
                        p.sums += share * colour
                if below >= LOG2_MIN_ALPHA and not q_ends:
                    share = q.transmittance * wp.min(exp2_of(below), 0.99)
                    after = q.transmittance - share
                    q_ends = after < 1e-4
                    if not q_ends:
                        q.transmittance = after
                        q.depth += share * current_tail[1]
                        q.sums += share * colour
                if p_ends and q_ends:
                    break
    write_pixel(p, k, y, x, features, alphas, depths)
    write_pixel(q, k, y + _HALF, x, features, alphas, depths)


def splat_views(
    images: Tensor, depths: Tensor, masks: Tensor, c: StepConstants, t: Tables, per_gaussian: float
) -> DeviceSplats:
    """Splat every view alone, colours and mask, as `splat` of the compiled path does.

    Args:
        images: (K, H, W, 3), uint8.
        depths: where the Gaussians are, (K, H, W).
        masks: a fourth feature, (K, H, W).
        per_gaussian: pairs of a Gaussian and a tile that there is room for, in the mean; see
            `DeviceSplats.crowding`.

    Reading:
        Two stable sorts of 32 bits, by depth and then by tile, order the pairs as the compiled
        splat does, equal depths in reading order; sorting pairs at once by 64 bits would move twice
        the bytes. Views are sorted together as long as they have at most 2^16 tiles: the sort then
        takes two passes, not three. How many pairs there are is known on the device alone: room is
        kept for a number of them, and anyone who reads the picture sees whether it was enough.
    """
    (width, height), device = t.sizes.target, depths.device
    across, down = -(-width // TILE), -(-height // TILE)
    tiles, views = across * down, len(depths)
    features, alphas = (
        torch.empty((views, height, width, 4), device=device),
        torch.empty((views, height, width), device=device),
    )
    z, needed = torch.empty_like(alphas), []
    group = max((SHORT_KEYS - 1) // tiles, 1)
    for first in range(0, views, group):
        part = slice(first, min(first + group, views))
        inputs = depths[part], c.projectors[part], images[part], masks[part]
        needed.append(
            _splat_group(
                inputs, across, tiles, per_gaussian, (features[part], alphas[part], z[part])
            )
        )
    return DeviceSplats(features, alphas, z, torch.stack(needed).amax(dim=0))


def _splat_group(
    views: tuple[Tensor, ...],
    across: int,
    tiles: int,
    per_gaussian: float,
    out: tuple[Tensor, Tensor, Tensor],
) -> Tensor:
    """Return the views whose pairs are sorted together; returns how many pairs a Gaussian has."""
    depths, device = views[0], views[0].device
    count, capacity = depths.numel(), int(per_gaussian * depths.numel()) + 1
    keys, ids = (torch.empty(2 * count, dtype=torch.int32, device=device) for _ in range(2))
    boxes, records = (
        torch.empty((count, 2), dtype=torch.int32, device=device),
        torch.empty(12 * count, device=device),
    )
    launch(prepare, depths.shape, *views, keys, ids, boxes, records)
    sort_pairs(keys, ids, count, DEPTH_BITS)
    counts = torch.empty(count, dtype=torch.int32, device=device)
    launch(count_tiles, count, keys, ids, boxes, counts)
    sums = torch.cumsum(counts, 0, dtype=torch.int32)
    places = len(depths) * tiles
    # of unused places: sorts last
    listed = torch.full((2 * capacity,), places, dtype=torch.int32, device=device)
    numbers = torch.empty(2 * capacity, dtype=torch.int32, device=device)
    launch(
        list_pairs,
        count,
        counts,
        sums,
        boxes,
        ids,
        depths[0].numel(),
        across,
        tiles,
        capacity,
        listed,
        numbers,
    )
    sort_pairs(listed, numbers, capacity, places.bit_length())
    begins, ends = (torch.zeros(places, dtype=torch.int32, device=device) for _ in range(2))
    launch(find_ends, capacity, listed, capacity, begins, ends)
    features, alphas, z = out
    threads = (len(depths), tiles, TILE**2 // 2)
    launch(
        blend_tiles,
        threads,
        begins,
        ends,
        numbers,
        records,
        across,
        tiles,
        features.view(-1),
        alphas,
        z,
    )
    return sums[-1:] / count
